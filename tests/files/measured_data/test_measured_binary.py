"""Oracles: known figures written by scipy.io.savemat, by nptdms, and by h5py in the layout of MATLAB v7.3."""

import os
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from nptdms import ChannelObject, TdmsWriter
from numpy.typing import NDArray
from portfolio import parametrize_first

from rths_cli.errors import InputError
from rths_cli.files.matlab_files import matlab_variables
from rths_cli.files.measured_data import Recording, read_recording, write_recording

N = 500
RNG = np.random.default_rng(5)
TIME, U, TABLE, FLOOR = np.arange(N) / 2000.0, *RNG.standard_normal((3, N))
FLOOR[7] = np.nan
SAMPLES = np.array([U, TABLE, FLOOR])
NAMES = ("command_v", "table_g", "floor_2_m_s2")


def the_fault(path: Path, dt_s: float | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, dt_s)
    assert len(caught.value.faults) == 1
    assert "\n" not in caught.value.faults[0]
    return caught.value.faults[0].removeprefix(str(path))


def check(recording: Recording, names: tuple[str, ...] = NAMES, notes: tuple[str, ...] = ()) -> None:
    assert sorted(recording.names) == sorted(names)
    order = [recording.names.index(name) for name in names]
    np.testing.assert_array_equal(recording.samples[order], SAMPLES)
    assert recording.dt_s == 0.0005
    assert [recording.units[k] for k in order] == ["V", "g", "m/s^2"]
    assert recording.notes == notes


def cells(*texts: str) -> NDArray[np.object_]:
    array = np.empty((len(texts), 1), dtype=object)
    array[:, 0] = texts
    return array


VECTORS = dict(zip(NAMES, SAMPLES, strict=True))
MATLAB = {
    "vectors and time": {"t": TIME, **VECTORS},
    "vectors and fs": {"fs": 2000.0, **VECTORS},
    "rows and Ts": {"Ts": 0.0005, **{name: row[None, :] for name, row in VECTORS.items()}},
    "matrix of columns": {"dt": 0.0005, "data": SAMPLES.T, "names": cells(*NAMES)},
    "matrix of rows": {"dt": 0.0005, "data": SAMPLES, "channel_names": cells(*NAMES)},
    "names as the rows of a text": {"dt": 0.0005, "data": SAMPLES.T, "names": np.array([f"{n:<14}" for n in NAMES])},
    "matrix with time": {"data": np.vstack([TIME, SAMPLES]).T, "names": cells("time", *NAMES)},
    "struct": {"recording": {"time": TIME, **VECTORS}},
    "struct beside fs": {"recording": VECTORS, "fs": np.int32(2000)},
}


@pytest.mark.campaign
@parametrize_first(6, "form", MATLAB)
@parametrize_first(6, "compressed", [False, True])
def test_matlab_v5(tmp_path: Path, form: str, compressed: bool) -> None:
    scipy.io.savemat(tmp_path / "made.mat", MATLAB[form], do_compression=compressed)
    check(read_recording(tmp_path / "made.mat"))


REAL = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"


@pytest.mark.campaign
@pytest.mark.skipif(not REAL.is_dir(), reason="this scipy comes without its test files")
@parametrize_first(6, "made_by", ["6.1_SOL2", "6.5.1_GLNX86", "7.4_GLNX86"])
@parametrize_first(6, "kind", ["double", "matrix", "minus", "3dmatrix", "string", "stringarray"])
def test_files_that_matlab_itself_wrote(kind: str, made_by: str) -> None:
    path = REAL / f"test{kind}_{made_by}.mat"
    mine = matlab_variables(path)[f"test{kind}"]
    np.testing.assert_array_equal(np.array(mine), scipy.io.loadmat(path)[f"test{kind}"])


def test_numbers_stored_as_integers_and_single(tmp_path: Path) -> None:
    whole = np.arange(N) % 100
    for kind in (np.int8, np.uint8, np.int16, np.int32, np.int64, np.float32):
        scipy.io.savemat(tmp_path / "made.mat", {"fs": np.int16(2000), "u_v": whole.astype(kind)})
        recording = read_recording(tmp_path / "made.mat")
        assert recording.samples.dtype == np.float64
        np.testing.assert_array_equal(recording.samples, [whole])


def test_matlab_units_beside_the_names(tmp_path: Path) -> None:
    content = {"fs": 2000, "y": SAMPLES, "names": cells("u", "table", "floor 2"), "units": cells("V", "g", "m/s²")}
    scipy.io.savemat(tmp_path / "made.mat", content)
    check(read_recording(tmp_path / "made.mat"), ("u", "table", "floor 2"))


def test_a_matrix_without_names_has_numbered_columns(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "made.mat", {"fs": 2000, "y": SAMPLES.T})
    assert read_recording(tmp_path / "made.mat").names == ("y(:,1)", "y(:,2)", "y(:,3)")


def test_what_is_no_series_is_named(tmp_path: Path) -> None:
    content = {
        "fs": 2000.0,
        **VECTORS,
        "gain": 3.0,
        "taps": np.ones(4),
        "valid": np.ones(N, dtype=bool),
        "nested": {"deep": {"a": 1.0}},
        "cube": np.ones((2, 2, 2)),
    }
    scipy.io.savemat(tmp_path / "made.mat", content)
    check(
        read_recording(tmp_path / "made.mat"),
        notes=("not used, because they are no series: valid, gain, a, cube, taps",),
    )


def write_v73(path: Path, content: dict[str, object]) -> None:
    """Write the layout of `save -v7.3`: user block, classes, transposed arrays, character codes, references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        _put_all(file, file, content)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan 01 00:00:00 2024 HDF5 schema 1.00 ."
    with path.open("r+b") as raw:
        raw.write(head.ljust(116) + bytes(8) + b"\x00\x02IM")


def _put_all(file: h5py.File, group: h5py.Group, content: dict[str, object]) -> None:
    for name, value in content.items():
        if isinstance(value, dict):
            child = group.create_group(name)
            child.attrs["MATLAB_class"] = np.bytes_("struct")
            _put_all(file, child, value)
        elif isinstance(value, np.ndarray) and value.dtype == object:
            references = np.array([[_put_text(file, str(text)).ref for text in value.ravel()]], dtype=h5py.ref_dtype)
            group.create_dataset(name, data=references).attrs["MATLAB_class"] = np.bytes_("cell")
        elif isinstance(value, np.ndarray) and value.dtype.kind == "U":
            codes = np.array([[ord(letter) for letter in row] for row in value], dtype=np.uint16)
            group.create_dataset(name, data=codes.T).attrs["MATLAB_class"] = np.bytes_("char")
        else:
            array = np.asarray(value, dtype=float)
            shaped = array.reshape(-1, 1) if array.ndim < 2 else array
            group.create_dataset(name, data=shaped.T).attrs["MATLAB_class"] = np.bytes_("double")


def _put_text(file: h5py.File, text: str) -> h5py.Dataset:
    group = file.require_group("#refs#")
    codes = np.array([[ord(letter)] for letter in text], dtype=np.uint16)
    node = group.create_dataset(f"a{len(group)}", data=codes)
    node.attrs["MATLAB_class"] = np.bytes_("char")
    node.attrs["MATLAB_int_decode"] = np.int32(2)
    return node


@pytest.mark.parametrize("form", MATLAB)
def test_matlab_v73(tmp_path: Path, form: str) -> None:
    write_v73(tmp_path / "made.dat", MATLAB[form])
    check(read_recording(tmp_path / "made.dat"))


def test_matlab_v73_empty_and_hidden_variables_are_left_alone(tmp_path: Path) -> None:
    write_v73(tmp_path / "made.mat", {"fs": 2000, **VECTORS})
    with h5py.File(tmp_path / "made.mat", "r+") as file:
        file["#subsystem#/x"] = np.ones(N)
        file["hollow"] = np.zeros(2, dtype=np.uint64)
        file["hollow"].attrs["MATLAB_empty"] = np.uint8(1)
    check(read_recording(tmp_path / "made.mat"), notes=("not used, because they are no series: hollow",))


@pytest.mark.parametrize("where", ["root", "dataset", "scalar", "time"])
def test_any_hdf5_with_series_units_and_a_rate(tmp_path: Path, where: str) -> None:
    with h5py.File(tmp_path / "made.hdf", "w") as file:
        for name, row, unit in zip(("run/u", "run/base", "run/floor_2"), SAMPLES, ("V", "g", "m/s2"), strict=True):
            file[name] = row
            file[name].attrs["units"] = unit
        if where == "root":
            file.attrs["sample_rate_hz"] = 2000.0
        elif where == "dataset":
            file["run/u"].attrs["dt"] = 0.0005
        elif where == "scalar":
            file["settings/fs"] = 2000
        else:
            file["run/time"] = TIME * 1000
            file["run/time"].attrs["units"] = "ms"
    check(read_recording(tmp_path / "made.hdf"), ("u", "base", "floor_2"))


def test_two_groups_with_the_same_names_keep_their_paths(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "made.h5", "w") as file:
        file.attrs["fs"] = 2000
        file["first/table"], file["second/table"] = U, TABLE
    assert read_recording(tmp_path / "made.h5").names == ("first/table", "second/table")


def write_tdms(path: Path, channels: dict[str, NDArray[np.float64]], increments: list[float | None]) -> None:
    units = ("V", "g", "m/s^2")
    objects = []
    for (name, values), unit, increment in zip(channels.items(), units, increments, strict=False):
        stated = {} if increment is None else {"wf_increment": increment}
        objects.append(ChannelObject("daq", name, values, properties={"unit_string": unit, **stated}))
    with TdmsWriter(path) as writer:
        writer.write_segment(objects)


TDMS = dict(zip(("AO0 cmd", "Table", "Floor 2"), SAMPLES, strict=True))


def test_tdms(tmp_path: Path) -> None:
    write_tdms(tmp_path / "made.bin", TDMS, [0.0005] * 3)
    check(read_recording(tmp_path / "made.bin"), tuple(TDMS))


def test_tdms_without_a_rate_takes_the_users(tmp_path: Path) -> None:
    write_tdms(tmp_path / "made.tdms", TDMS, [None] * 3)
    assert the_fault(tmp_path / "made.tdms") == ": states no sample rate and has no time column; give --rate HZ"
    check(read_recording(tmp_path / "made.tdms", dt_s=0.0005), tuple(TDMS))


def test_tdms_channels_of_different_rates_come_to_the_slowest(tmp_path: Path) -> None:
    wave = [
        np.sin(2.0 * np.pi * 3.0 * np.arange(n) * step) for n, step in ((4000, 0.0005), (2000, 0.001), (4000, 0.0005))
    ]
    write_tdms(tmp_path / "made.tdms", dict(zip(TDMS, wave, strict=True)), [0.0005, 0.001, 0.0005])
    found = read_recording(tmp_path / "made.tdms")
    assert found.dt_s == 0.001 and "AO0 cmd: sampled at 2000 Hz, the slowest channel at 1000" in found.notes[0]
    for samples in found.samples:
        np.testing.assert_allclose(samples, found.samples[1], atol=2e-4)


def test_tdms_channels_of_which_some_state_no_rate_are_refused(tmp_path: Path) -> None:
    write_tdms(tmp_path / "made.tdms", TDMS, [0.0005, 0.001, None])
    assert the_fault(tmp_path / "made.tdms").startswith(
        ": wf_increment of AO0 cmd says 2000 Hz (0.0005 s), wf_increment of Table says 1000 Hz (0.001 s)"
    )


def test_without_the_tdms_reader_the_sentence_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_tdms(tmp_path / "made.tdms", TDMS, [0.0005] * 3)
    monkeypatch.setitem(sys.modules, "nptdms", None)
    assert 'pip install "rths-cli[tdms]"' in the_fault(tmp_path / "made.tdms")


def test_unequal_lengths_are_named_in_every_format(tmp_path: Path) -> None:
    cut = {"command_v": U, "table_g": TABLE[:-1]}
    write_tdms(tmp_path / "a.tdms", cut, [0.0005] * 2)
    scipy.io.savemat(tmp_path / "a.mat", {"fs": 2000, **cut})
    write_v73(tmp_path / "b.mat", {"t": TIME, **cut})
    for name, time in (("a.tdms", ""), ("a.mat", ""), ("b.mat", ", t 500")):
        expected = f": the channels have unequal numbers of samples (command_v 500, table_g 499{time}); export them"
        assert the_fault(tmp_path / name).startswith(expected)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"a": 1.0}, ": holds no series of numbers"),
        ({"y": SAMPLES, "names": cells("a", "b")}, ": y has 3 channels, names has 2 texts"),
        ({"a": np.arange(5.0), "fs": -2.0}, ": fs says an interval of -0.5 s"),
        ({"a": np.arange(5.0), "fs": 10, "dt": 0.2}, ": fs says 10 Hz (0.1 s), dt says 5 Hz (0.2 s)"),
        ({"a": np.arange(5.0), "t": np.array([0, 1, 2, 2, 3.0])}, ": row 4: 't' repeats (2 after 2)"),
        ({"a": np.arange(5.0) * 1j, "fs": 10}, ": holds no series of numbers"),
    ],
)
def test_faulty_variables_are_refused(tmp_path: Path, content: dict[str, object], expected: str) -> None:
    scipy.io.savemat(tmp_path / "made.mat", content)
    assert the_fault(tmp_path / "made.mat").startswith(expected)


def test_other_files_of_the_project_are_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.attrs["format"] = "rths-result"
        file["sim/time_s"] = TIME
    assert the_fault(tmp_path / "run.h5").startswith(": is a file of rths (rths-result), not a recording")


def test_own_form_of_a_later_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.h5"
    write_recording(path, Recording(path, "", 0.0005, NAMES, ("V", "g", "m/s^2"), SAMPLES))
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 2
    assert "has format version 2, this rths reads up to 1; update rths" in the_fault(path)


@pytest.mark.parametrize(
    ("name", "values"),
    [("samples", np.arange(3.0)), ("samples", np.zeros((2, 9))), ("names", "one"), ("units", ["V", "g"])],
)
def test_own_form_whose_parts_do_not_fit_is_refused(tmp_path: Path, name: str, values: object) -> None:
    path = tmp_path / "own.h5"
    write_recording(path, Recording(path, "", 0.0005, NAMES, ("V", "g", "m/s^2"), SAMPLES))
    with h5py.File(path, "r+") as file:
        del file[name]
        file[name] = values
    assert the_fault(path).startswith(": has not a row of samples, a name and a unit for each channel")


def test_own_form_with_a_unit_that_no_channel_has_is_read_without_it(tmp_path: Path) -> None:
    path = tmp_path / "own.h5"
    write_recording(path, Recording(path, "", 0.0005, NAMES, ("V", "g", "m/s^2"), SAMPLES))
    with h5py.File(path, "r+") as file:
        file["units"][1] = "furlong"
    back = read_recording(path)
    assert back.units == ("V", "", "m/s^2")
    assert back.notes == (f"channel {NAMES[1]!r}: the unit 'furlong' is not known",)


def test_own_form_opens_in_xarray(tmp_path: Path) -> None:
    import xarray

    path = tmp_path / "own.h5"
    write_recording(path, Recording(path, "", 0.0005, NAMES, ("V", "g", "m/s^2"), SAMPLES))
    opened = xarray.open_dataset(path, engine="h5netcdf")
    assert opened.samples.dims == ("channel", "time_s")
    np.testing.assert_array_equal(opened.samples.sel(channel=2), TABLE)
    np.testing.assert_allclose(opened.time_s, TIME, rtol=1e-15)


texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)


@pytest.mark.campaign
@settings(derandomize=True, max_examples=25, deadline=None)
@given(data=st.data(), dt_s=st.floats(1e-6, 1.0), notes=st.lists(texts, max_size=3))
def test_own_form_comes_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, dt_s: float, notes: list[str]
) -> None:
    count, length = data.draw(st.integers(1, 4)), data.draw(st.integers(3, 50))
    bits = data.draw(arrays(np.float64, (count, length), elements=st.floats(-1e29, 1e29) | st.just(float("nan"))))
    names = tuple(data.draw(st.lists(texts, min_size=count, max_size=count)))
    units = tuple(data.draw(st.lists(st.sampled_from(["", "V", "g", "m/s^2"]), min_size=count, max_size=count)))
    path = tmp_path_factory.getbasetemp() / "own.h5"
    path.unlink(missing_ok=True)
    write_recording(path, Recording(path, "", dt_s, names, units, bits, tuple(notes)))
    back = read_recording(path)
    assert (back.dt_s, back.names, back.units, back.notes) == (dt_s, names, units, tuple(notes))
    assert back.samples.tobytes() == bits.tobytes()


@pytest.mark.parametrize("empty", [False, True])
def test_writing_is_atomic_repeats_its_bytes_and_replaces_no_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, empty: bool
) -> None:
    path, other = tmp_path / "deep" / "own.h5", tmp_path / "deep" / "own-2.h5"
    recording = Recording(path, "", 0.0005, NAMES, ("V", "g", "m/s^2"), SAMPLES)
    assert write_recording(path, recording) == path
    first = path.read_bytes()
    assert write_recording(path, recording) == other
    assert path.read_bytes() == other.read_bytes() == first
    changed = Recording(path, "", 0.1, ("a",), ("",), SAMPLES[:1])
    other.write_bytes(b"")
    assert write_recording(other, changed) == other and read_recording(other).dt_s == 0.1
    assert path.read_bytes() == first
    if empty:
        path.write_bytes(first := b"")
    before = other.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace" if empty else "link", full)
    with pytest.raises(InputError, match=r"own\.h5: cannot write the recording: No space left on device; free space"):
        write_recording(path, changed)
    assert path.read_bytes() == first and other.read_bytes() == before
    assert sorted(os.listdir(path.parent)) == ["own-2.h5", "own.h5"]
