"""Whatever the bytes: a recording whose parts fit together, or sentences that start with the path."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter

from rths_cli.errors import InputError
from rths_cli.files import sandboxed_reading
from rths_cli.files.measured_data import (
    Recording,
    choose,
    file_formats,
    mend,
    missing,
    read_recording,
    write_recording,
)

N = 40
ROWS = np.arange(3.0 * N).reshape(3, N)
NAMES = ("time_s", "command_v", "table_g")
ROLES = ("command", "table")


def make(folder: Path, kind: str) -> bytes:
    path, series = folder / f"seed.{kind}", dict(zip(NAMES, (ROWS[0] / 1000, *ROWS[1:]), strict=True))
    if kind == "csv":
        path.write_text(",".join(NAMES) + "\n" + "".join(f"{k / 1000},{k},-\n" for k in range(N)))
    elif kind == "mat":
        scipy.io.savemat(path, {**series, "names": np.array(["a", "b", "c"], object), "s": {"x": ROWS}})
    elif kind == "h5":
        with h5py.File(path, "w") as file:
            for name, row in series.items():
                file[f"group/{name}"] = row
                file[f"group/{name}"].attrs["units"] = name.partition("_")[2]
    elif kind == "own":
        write_recording(path, Recording(path, "", 0.001, NAMES, ("s", "V", "g"), ROWS))
    else:
        with TdmsWriter(path) as writer:
            writer.write_segment(
                [ChannelObject("g", k, v, properties={"wf_increment": 0.001}) for k, v in series.items()]
            )
    return path.read_bytes()


def read_anything(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    try:
        recording = read_recording(path, None)
    except InputError as error:
        assert error.faults
        assert all(fault.startswith(str(path)) and "\n" not in fault for fault in error.faults)
        return
    count, length = recording.samples.shape
    assert len(recording.names) == len(recording.units) == count
    assert 0 < recording.dt_s <= 1
    assert not np.isinf(recording.samples).any()
    assert mend(recording.samples, recording.names)[0].shape == (count, length)
    assert len(missing(recording.samples, recording.names, recording.dt_s)) <= count
    try:
        assert choose(recording, ROLES, {}).command_v.shape == (length,)
    except InputError as error:
        assert error.faults


@pytest.fixture(scope="module", params=["csv", "mat", "h5", "own", "tdms"])
def seed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    folder = tmp_path_factory.mktemp("fuzz")
    return folder / "any", make(folder, request.param)


def test_the_seed_itself_is_read(seed: tuple[Path, bytes]) -> None:
    path, data = seed
    path.write_bytes(data)
    assert read_recording(path).dt_s == 0.001


def test_a_file_on_which_the_library_hangs_or_crashes_is_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, parent = tmp_path / "any.h5", os.getpid()
    read_here: list[Path] = []
    path.write_bytes(make(tmp_path, "h5"))
    monkeypatch.setattr(sandboxed_reading, "TIME_LIMIT_S", 0.2)
    for disaster in (lambda: time.sleep(60), os.abort):

        def read(given: Path, happen: Callable[[], None] = disaster) -> None:
            if os.getpid() == parent:
                read_here.append(given)
                raise ValueError
            happen()

        monkeypatch.setattr(file_formats, "hdf5_contents", read)
        with pytest.raises(InputError, match=r"any\.h5: is a damaged or truncated HDF5 file and cannot be read"):
            read_recording(path)
    assert read_here == []


def test_a_cut_tdms_file_is_not_read_in_silence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cut.tdms"
    path.write_bytes(make(tmp_path, "tdms")[:-100])
    with pytest.raises(InputError, match="the channels have unequal numbers of samples"):
        read_recording(path)
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("g", "table_g", ROWS[0], properties={"wf_increment": 0.001})])
    path.write_bytes(path.read_bytes()[:-100])
    (note,) = read_recording(path).notes
    assert note.startswith("the TDMS file is damaged (Last segment of file has less data than expected")
    assert capfd.readouterr().err == ""


@pytest.mark.campaign
@settings(derandomize=True, max_examples=60, deadline=None)
@given(data=st.data())
def test_changed_bytes(seed: tuple[Path, bytes], data: st.DataObject) -> None:
    path, original = seed
    mutated = bytearray(original)
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(mutated) - 1))
        mutated[place] = data.draw(st.integers(0, 255))
    read_anything(path, bytes(mutated))


@pytest.mark.campaign
@settings(derandomize=True, max_examples=20, deadline=None)
@given(data=st.data())
def test_cut_files(seed: tuple[Path, bytes], data: st.DataObject) -> None:
    path, original = seed
    read_anything(path, original[: data.draw(st.integers(0, len(original) - 1))])


WORDS = [
    "time_s,a_v",
    "# fs: 100",
    "0,1",
    "0.01,2",
    "0.02,nan",
    "1;2",
    "1,5;2",
    "-",
    ",,",
    "a b",
    "1 2",
    "\ufeff",
    "_",
    "1e999,inf",
]


@pytest.mark.campaign
@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.one_of(st.binary(max_size=80), st.lists(st.sampled_from(WORDS)).map(lambda rows: "\n".join(rows).encode())))
def test_any_text_or_bytes(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    read_anything(tmp_path_factory.getbasetemp() / "any.txt", data)
