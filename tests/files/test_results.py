"""Result files: what is written is read back, by us and by xarray; what is broken says so in one sentence."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

from rths_cli.errors import InputError
from rths_cli.files.durable_files import part_of
from rths_cli.files.result_reader import ResultWriter, check_writable, read_dataset, read_result, read_series
from rths_cli.quantities import DATASETS, Interval

ATTRIBUTES = {
    "case_name": "demo",
    "method": "best",
    "rig_kind": "virtual",
    "seed": 3,
    "sample_rate_hz": 2000.0,
}
N = 500
TIME = np.arange(N) / 2000.0
ACCEL = np.sin(np.arange(3)[:, None] + 20.0 * TIME)
STOREYS = [1, 2, 3]


def fill(writer):
    writer.case("record: el_centro # µ\n", "scaling: 0.3\n")
    writer.group("sim", {"abs_accel_m_s2": ACCEL, "base_shear_n": ACCEL[0]}, time_s=TIME, storey=STOREYS)
    writer.group(
        "exp_rths",
        {"abs_accel_m_s2": ACCEL[:, :200], "floor_accel_measured_m_s2": ACCEL[1:, :200]},
        TIME[:200],
        STOREYS,
        {"floor": [2, 3]},
    )
    writer.group("exp_rths/truth", {"table_accel_m_s2": ACCEL[0, :200]}, TIME[:200])
    frequency = {"frequency_hz": np.linspace(0.5, 50, 40)}
    frf = np.exp(1j * np.linspace(0, 6, 40))
    writer.group(
        "identification",
        {"frf": frf, "poles": np.array([-1 + 2j, -1 - 2j, -5]), "gain": 2.5},
        scales=frequency,
    )
    eye = np.eye(2)
    writer.block("feedforward", eye * 0.9, eye[:, :1], eye[:1], np.array([[0.5]]), 0.0005, ["a_m_s2"], ["u_v"])
    writer.block(
        "base_shear", np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[2.0]]), 0.0005, ["a"], ["b"]
    )
    writer.metrics(
        {
            "exp_rths.rms_error_m_s2": [0.1, 0.2, np.nan],
            "shake_table.tracking_rms_m_s2": 0.0012,
        }
    )


def write(path, attributes=ATTRIBUTES):
    with ResultWriter(path, attributes) as writer:
        fill(writer)
        writer.finish("complete")
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write(tmp_path_factory.mktemp("results") / "demo.h5")


def test_what_is_written_is_read_back(written):
    result = read_result(written)
    assert {key: result.attributes[key] for key in ATTRIBUTES} == ATTRIBUTES
    assert result.attributes["status"] == "complete" and result.attributes["format_version"] == 1
    assert result.case_yaml == "record: el_centro # µ\n" and result.resolved_yaml == "scaling: 0.3\n"
    assert set(result.metrics) == {"exp_rths.rms_error_m_s2", "shake_table.tracking_rms_m_s2"}
    np.testing.assert_array_equal(result.metrics["exp_rths.rms_error_m_s2"], [0.1, 0.2, np.nan])
    assert result.metrics["shake_table.tracking_rms_m_s2"] == 0.0012
    assert result.units["exp_rths.rms_error_m_s2"] == "m/s^2"
    declared = "RMS of desired - measured table acceleration, in the test band"
    assert result.definitions["shake_table.tracking_rms_m_s2"].startswith(declared)
    np.testing.assert_array_equal(read_series(written, "exp_rths/abs_accel_m_s2"), ACCEL[:, :200])
    truth = read_dataset(written, "exp_rths/truth/table_accel_m_s2")
    assert (truth.units, truth.long_name, truth.source, truth.dims) == (
        "m/s^2",
        DATASETS["exp_rths/truth/table_accel_m_s2"].text,
        "true",
        ("time_s",),
    )


def with_intervals(path):
    with ResultWriter(path, ATTRIBUTES) as writer:
        writer.metrics(
            {
                "check.rms_error_m_s2": Interval([0.1, 0.2, 0.3], [0.1, 0.1, 0.2], [0.2, np.inf, 0.4], 0.8),
                "check.growth": Interval(0.5, np.nan, np.nan, 0.8),
                "check.spectral_radius": 0.99,
            }
        )
        writer.finish("complete")
    return path


def test_a_metric_with_an_interval_keeps_its_value_and_gives_the_interval_back(tmp_path):
    path = with_intervals(tmp_path / "a.h5")
    result = read_result(path)
    np.testing.assert_array_equal(result.metrics["check.rms_error_m_s2"], [0.1, 0.2, 0.3])
    assert result.metrics["check.growth"] == 0.5
    assert set(result.intervals) == {"check.rms_error_m_s2", "check.growth"}
    found = result.intervals["check.rms_error_m_s2"]
    np.testing.assert_array_equal(
        [found.value, found.low, found.high], [[0.1, 0.2, 0.3], [0.1, 0.1, 0.2], [0.2, np.inf, 0.4]]
    )
    assert found.probability == result.intervals["check.growth"].probability == 0.8
    assert np.isnan(result.intervals["check.growth"].low) and np.isnan(result.intervals["check.growth"].high)
    with h5py.File(path) as file:
        assert set(file["metrics/check/growth"].attrs) - set(file["metrics/check/spectral_radius"].attrs) == {
            "low", "high", "probability",
        }  # fmt: skip


def test_an_interval_of_another_shape_than_its_value_is_not_written(tmp_path):
    with ResultWriter(tmp_path / "a.h5", ATTRIBUTES) as writer:
        with pytest.raises(ValueError, match="interval of another shape"):
            writer.metrics({"check.growth": Interval(0.5, [0.1, 0.2], [0.6, 0.7], 0.8)})
        writer.finish("complete")


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("low", 1.0), ("low", [0.3, 0.2, 0.1]), ("low", [0.0, 0.0]), ("high", None), ("high", "wide"),
        ("high", ["a", "b", "c"]), ("high", [1e200, 1.0, 1.0]), ("probability", 1.2), ("probability", np.nan),
        ("probability", [0.8]), ("probability", None),
    ],
)  # fmt: skip
def test_a_damaged_interval_is_refused(tmp_path, attribute, value):
    path = with_intervals(tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        about = file["metrics/check/rms_error_m_s2"].attrs
        del about[attribute]
        if value is not None:
            about[attribute] = value
    with pytest.raises(InputError, match=r"whose interval|beyond 1e\+100|neither texts nor numbers"):
        read_result(path)


def test_units_and_definitions_are_read_when_they_are_asked_for(tmp_path):
    result = read_result(write(tmp_path / "a.h5"))
    assert set(result.units) == set(result.definitions) == set(result.metrics) and len(result.units) == 2
    assert dict(read_result(tmp_path / "a.h5").units) == dict.fromkeys(result.metrics, "m/s^2")
    with pytest.raises(KeyError):
        read_result(tmp_path / "a.h5").units["exp_rths"]
    (tmp_path / "a.h5").unlink()
    with pytest.raises(InputError, match=r"a\.h5: no such file; check the path"):
        result.definitions["shake_table.tracking_rms_m_s2"]


def test_complex_values_are_stored_as_real_and_imag(written):
    frf = read_series(written, "identification/frf_real") + 1j * read_series(written, "identification/frf_imag")
    np.testing.assert_allclose(frf, np.exp(1j * np.linspace(0, 6, 40)), rtol=1e-15)
    np.testing.assert_array_equal(read_series(written, "identification/poles_imag"), [2, -2, 0])


def test_every_dataset_carries_units_name_and_source_and_none_is_at_the_root(written):
    with h5py.File(written) as file:
        assert all(isinstance(node, h5py.Group) for node in file.values())
        nodes = []
        file.visititems(lambda name, node: nodes.append(node) if isinstance(node, h5py.Dataset) else None)
        assert len(nodes) > 30
        for node in nodes:
            assert node.attrs["units"] and node.attrs["long_name"], node.name
            assert node.attrs["source"] in ("computed", "measured", "estimated", "true"), node.name


@pytest.mark.filterwarnings("error:.*duplicate dim.*")
def test_xarray_opens_every_group_with_named_axes(written):
    with h5py.File(written) as file:
        groups = []
        file.visititems(lambda name, node: groups.append(name) if isinstance(node, h5py.Group) else None)
    for name in groups:
        with xarray.open_dataset(written, group=name, engine="h5netcdf", decode_timedelta=False) as group:
            assert not [dim for dim in group.sizes if "phony" in str(dim)], name
    with xarray.open_dataset(written, group="exp_rths", engine="h5netcdf", decode_timedelta=False) as group:
        assert group.abs_accel_m_s2.dims == ("storey", "time_s")
        assert group.floor_accel_measured_m_s2.dims == ("floor", "time_s")
        third = group.abs_accel_m_s2.sel(storey=3)
        np.testing.assert_array_equal(third.values, ACCEL[2, :200])
        np.testing.assert_array_equal(third.time_s.values, TIME[:200])
    with xarray.open_dataset(written, group="identification", engine="h5netcdf") as group:
        assert group.frf_real.dims == ("frequency_hz",) and group.poles_real.dims == ("pole",)
    with xarray.open_dataset(written, group="controller/feedforward", engine="h5netcdf") as group:
        assert group.A.dims == ("next_state", "state") and group.attrs["dt_s"] == 0.0005
        assert list(np.atleast_1d(group.attrs["inputs"])) == ["a_m_s2"]


def test_xarray_opens_the_file_as_a_tree(written):
    with xarray.open_datatree(written, engine="h5netcdf", decode_timedelta=False) as tree:
        assert tree["sim"].sizes["time_s"] == N and tree["exp_rths"].sizes["time_s"] == 200


def test_time_is_the_last_axis_even_of_a_square_array_and_a_lone_scale_is_a_coordinate(tmp_path):
    with ResultWriter(tmp_path / "a.h5", ATTRIBUTES) as writer:
        writer.group("sim", {"abs_accel_m_s2": np.eye(3)}, TIME[:3], STOREYS)
        writer.group("record", {}, TIME[:3])
        writer.finish("complete")
    assert read_dataset(tmp_path / "a.h5", "sim/abs_accel_m_s2").dims == ("storey", "time_s")
    with xarray.open_dataset(tmp_path / "a.h5", group="record", engine="h5netcdf") as group:
        assert group.time_s.dims == ("time_s",)


def test_the_same_data_give_the_same_bytes_later(tmp_path, written):
    time.sleep(1.1)  # a time stamp in an HDF5 object has a resolution of one second
    assert write(tmp_path / "later.h5").read_bytes() == written.read_bytes()


def test_a_dataset_or_axis_that_does_not_say_what_it_is_is_refused(tmp_path):
    path = tmp_path / "x.h5"
    for values, words in (
        ({"a_m_s2": ACCEL}, "sim/a_m_s2 is declared nowhere"),
        ({"abs_accel_m_s2": ACCEL[:2]}, r"abs_accel_m_s2: axis 0 has 2 values, scale storey does not"),
        ({"abs_accel_m_s2": ACCEL[0]}, "sim/abs_accel_m_s2 is real with 1 axes, declared is real with 2"),
        ({"abs_accel_m_s2": 1j * ACCEL}, "is complex with 2 axes, declared is real with 2"),
    ):
        with pytest.raises(ValueError, match=words), ResultWriter(path, ATTRIBUTES) as writer:
            writer.group("sim", values, TIME, STOREYS)
    for words, given in (
        ("sim/base_shear_n needs the scale time_s", {}),
        ("the axis floors is declared nowhere", {"scales": {"time_s": TIME, "floors": [2, 3]}}),
        ("with the remark 'filtered'", {"time_s": TIME, "remarks": {"base_shear_n": ("filtered",)}}),
    ):
        with pytest.raises(ValueError, match=words), ResultWriter(path, ATTRIBUTES) as writer:
            writer.group("sim", {"base_shear_n": ACCEL[0]}, **given)
    for about, words in (({"sped": 3}, "attribute sped is declared nowhere"), ({"seed": "3"}, "declared is a number")):
        with pytest.raises(ValueError, match=words):
            ResultWriter(path, about)
        with pytest.raises(ValueError, match=words), ResultWriter(path, ATTRIBUTES) as writer:
            writer.about(about)
    with (
        pytest.raises(ValueError, match="other values"),
        ResultWriter(path, ATTRIBUTES) as writer,
    ):
        writer.group("sim", {}, TIME)
        writer.group("sim", {}, TIME + 1)
    with pytest.raises(ValueError, match="other values"), ResultWriter(path, ATTRIBUTES) as writer:
        writer.group("sim", {}, TIME)
        writer.group("sim/truth", {}, TIME[:9])
    assert os.listdir(tmp_path) == []


def end(path, status, error, lasting=False):
    with ResultWriter(path, ATTRIBUTES, lasting=lasting) as writer:
        writer.group("sim", {"abs_accel_m_s2": ACCEL}, TIME, STOREYS)
        if status:
            writer.finish(status, "the reason")
        if error:
            raise error


def test_a_virtual_run_that_raises_leaves_nothing_unless_it_was_finished(tmp_path):
    for status in (None, "complete"):
        with pytest.raises(KeyError):
            end(tmp_path / "a.h5", status, KeyError("x"))
        assert os.listdir(tmp_path) == []
    for status in ("aborted", "interrupted", "failed"):
        with pytest.raises(KeyboardInterrupt):
            end(tmp_path / f"{status}.h5", status, KeyboardInterrupt())
        result = read_result(tmp_path / f"{status}.h5")
        assert (result.attributes["status"], result.attributes["status_reason"]) == (status, "the reason")
        np.testing.assert_array_equal(read_series(result.path, "sim/abs_accel_m_s2"), ACCEL)
    assert len(os.listdir(tmp_path)) == 3


def test_a_virtual_result_stays_when_its_successor_fails_and_is_replaced_when_it_succeeds(tmp_path):
    path = write(tmp_path / "a.h5")
    before = path.read_bytes()
    with pytest.raises(KeyError):
        end(path, None, KeyError("x"))
    assert path.read_bytes() == before
    end(path, "complete", None)
    assert read_result(path).metrics == {}


def test_a_hardware_run_is_always_kept_and_never_replaced(tmp_path):
    with pytest.raises(KeyError):
        end(tmp_path / "a.h5", None, KeyError("lost the link"), lasting=True)
    result = read_result(tmp_path / "a.h5")
    assert result.attributes["status"] == "failed" and "lost the link" in result.attributes["status_reason"]
    with pytest.raises(InputError, match="holds a hardware run"):
        end(tmp_path / "a.h5", "complete", None, lasting=True)


def test_forgetting_to_finish_is_a_bug(tmp_path):
    with pytest.raises(RuntimeError, match="finish"):
        end(tmp_path / "a.h5", None, None)
    assert os.listdir(tmp_path) == []


def child(code, *arguments):
    prelude = """
import os, resource, signal, sys, numpy as np
from pathlib import Path
from rths_cli.errors import InputError
from rths_cli.files.result_reader import ResultWriter
path, attributes = Path(sys.argv[1]), {"case_name": "demo", "rig_kind": "virtual"}
series = lambda n, name="base_shear_n": {name: np.random.default_rng(0).normal(size=n)}
"""
    return subprocess.run([sys.executable, "-c", prelude + code, *map(str, arguments)], capture_output=True, text=True)


def test_what_a_killed_process_leaves_opens_and_says_so(tmp_path):
    code = """
with ResultWriter(path, attributes) as writer:
    writer.group("sim", series(1000), np.arange(1000) / 2000)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert child(code, tmp_path / "a.h5").returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".a.h5.") and left.name.endswith(".part")
    result = read_result(left)
    assert result.attributes["status"] == "interrupted" and "process ended" in result.attributes["status_reason"]
    assert read_series(left, "sim/base_shear_n").shape == (1000,)


def fill_the_disk(path, limit, lasting=False):
    code = f"""
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
try:
    with ResultWriter(path, attributes, lasting={lasting}) as writer:
        for run in ("sim", "sim_delay", "exp_rths", "shake_table"):
            name = "command_v" if run == "shake_table" else "base_shear_n"
            writer.group(run, series(108_000, name), np.arange(108_000) / 2000)
            writer.finish("aborted")
except InputError as error:
    print(error, end="")
    sys.exit(error.exit_code)
"""
    done = child(code, path)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr and "\n" not in done.stdout
    return done.stdout


@pytest.mark.campaign
@pytest.mark.parametrize("limit", [100, 3_000_000])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(tmp_path, limit):
    said = fill_the_disk(tmp_path / "a.h5", limit)
    assert said.startswith(f"{tmp_path}/a.h5: cannot write the result file: File too large; free space or")
    assert os.listdir(tmp_path) == []


def test_a_file_that_missed_a_write_is_not_published_although_it_was_finished(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr("rths_cli.files.result_writer.write_group", refuse)
    with pytest.raises(InputError, match="No space left on device"):
        end(tmp_path / "a.h5", "aborted", None)
    with pytest.raises(InputError), ResultWriter(tmp_path / "a.h5", ATTRIBUTES) as writer:
        writer.finish("aborted")
        writer.group("sim", {})
    assert os.listdir(tmp_path) == []


def test_a_full_disk_does_not_lose_what_hardware_produced(tmp_path):
    said = fill_the_disk(tmp_path / "a.h5", 3_000_000, lasting=True)
    (left,) = tmp_path.iterdir()
    assert str(left) in said and left.name.endswith(".part")
    assert read_series(left, "sim/base_shear_n").shape == (108_000,)


def test_a_series_in_another_unit_than_its_name_says_is_refused(written, tmp_path):
    copied = tmp_path / "g.h5"
    shutil.copyfile(written, copied)
    with h5py.File(copied, "a") as file:
        file["exp_rths/abs_accel_m_s2"].attrs["units"] = "g"
    with pytest.raises(InputError, match=r"g\.h5: exp_rths/abs_accel_m_s2 is in g, expected is m/s\^2; convert it"):
        read_series(copied, "exp_rths/abs_accel_m_s2")


def test_an_unwritable_folder_is_named_with_its_cause(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file/sub: is a file, or below one, not a folder; choose another"):
        check_writable(tmp_path / "file" / "sub")
    with pytest.raises(InputError, match=r"a\.h5: cannot write the result file: "):
        write(tmp_path / "file" / "a.h5")
    write(tmp_path / "missing" / "a.h5")
    assert (tmp_path / "missing" / "a.h5").exists()
    with pytest.raises(InputError, match=r"a\.h5: cannot write the result file: Is a directory"):
        (tmp_path / "a.h5").mkdir()
        write(tmp_path / "a.h5")
    check_writable(tmp_path / "new" / "results")
    assert os.listdir(tmp_path / "new" / "results") == []
    with pytest.raises(InputError, match="MB needed"):
        check_writable(tmp_path / "no" / "room", needed_bytes=shutil.disk_usage(tmp_path).total + 1)
    assert not (tmp_path / "no").exists()
    assert sorted(os.listdir(tmp_path)) == ["a.h5", "file", "missing", "new"]


def sentence(path):
    with pytest.raises(InputError) as caught:
        read_result(path)
    (fault,) = caught.value.faults
    assert fault.startswith(f"{path}: ") and "\n" not in fault
    return fault


@pytest.mark.parametrize("part", [0.0, 0.02, 0.5, 0.97, 0.9999])
def test_a_truncated_file_is_one_sentence(tmp_path, written, part):
    whole = written.read_bytes()
    path = tmp_path / "cut.h5"
    path.write_bytes(whole[: int(part * len(whole))])
    assert "truncated" in sentence(path) or "not an HDF5 file" in sentence(path)


def test_foreign_later_missing_and_other_files_are_one_sentence(tmp_path, written):
    path = tmp_path / "x.h5"
    assert sentence(path) == f"{path}: no such file; check the path"
    assert "Is a directory" in sentence(tmp_path)
    path.write_text(json.dumps({"format": "rths-result"}))
    assert "is not an HDF5 file" in sentence(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    assert "not a result file" in sentence(path)
    shutil.copy(written, path)
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 2
    assert "format version 2" in sentence(path) and "update rths" in sentence(path)


def test_a_missing_dataset_is_named_with_what_there_is(written):
    with pytest.raises(InputError, match=r"holds no dataset exp_rths/nothing; its groups are .*exp_rths"):
        read_series(written, "exp_rths/nothing")
    with pytest.raises(InputError, match="holds no dataset exp_rths;"):
        read_series(written, "exp_rths")


def test_what_a_killed_process_left_is_removed_but_a_living_ones_part_stays(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", "pass"])
    dead.wait()
    stale, alive = part_of(tmp_path / "a.h5", dead.pid), part_of(tmp_path / "a.h5", 1)
    other = part_of(tmp_path / "b.h5", dead.pid)
    elsewhere = stale.with_name(stale.name.replace(".a.h5.", ".a.h5.other-"))
    for part in (stale, alive, other, elsewhere):
        part.write_bytes(b"left")
    with ResultWriter(tmp_path / "a.h5", {"rig_kind": "virtual"}) as writer:
        writer.finish("complete")
    assert not stale.exists() and alive.exists() and other.exists()
    assert elsewhere.exists()  # a process of another machine that shares the folder may write it


def test_a_file_that_does_not_say_how_it_ended_is_refused(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "a.h5", {"rig_kind": "virtual"}) as writer:
        writer.finish("complete")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file.attrs["status"]
    with pytest.raises(InputError, match="status"):
        read_result(tmp_path / "a.h5")


def test_a_signal_while_the_file_is_opened_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = h5py.File

    def interrupted(*arguments: object, **options: object) -> None:
        real(*arguments, **options).close()
        raise KeyboardInterrupt

    monkeypatch.setattr(h5py, "File", interrupted)
    with pytest.raises(KeyboardInterrupt), ResultWriter(tmp_path / "a.h5", {"rig_kind": "virtual"}):
        pass
    assert list(tmp_path.iterdir()) == []
