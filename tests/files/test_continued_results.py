"""A finished result is continued on a copy: whatever happens, a whole file stands under its name."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

from rths_cli.errors import InputError
from rths_cli.files import result_writer
from rths_cli.files.durable_files import Stamp, part_of
from rths_cli.files.result_reader import ResultWriter, read_result, read_series

N = 3000
TIME = np.arange(N) / 1000.0
COMMAND = np.sin(TIME)
ERRORS = {"exp_rths.rms_error_m_s2": [0.1, 0.2]}


def command() -> dict[str, np.ndarray]:
    return {"command_v": COMMAND}


ABOUT = {"case_name": "demo", "rig_kind": "udp", "seed": 3}


def begin(path: Path) -> Path:
    """Write what is known before the table moves."""
    with ResultWriter(path, ABOUT, lasting=True) as writer:
        writer.case("a: 1\n", "a: 1\nb: 2\n")
        writer.group("record", {}, TIME)
        writer.metrics({"exp_rths.max_error_m_s2": [0.3, 0.4]})
        writer.finish("interrupted", "the table moves")
    return path


def test_a_continued_result_holds_both_halves(tmp_path: Path) -> None:
    path = begin(tmp_path / "a.h5")
    first = read_result(path)
    assert (first.attributes["status"], first.attributes["status_reason"]) == ("interrupted", "the table moves")
    with ResultWriter(path, {"driver_verified": "loopback"}, continues=True) as writer:
        writer.group("exp_rths", command(), TIME)
        writer.metrics(ERRORS)
        assert read_result(path).groups == first.groups  # until all of it is there
        writer.finish("complete")
    result = read_result(path)
    expected = {**first.attributes, "driver_verified": "loopback", "status": "complete", "status_reason": ""}
    assert result.attributes == expected and result.case_yaml == "a: 1\n"
    assert set(result.metrics) == {"exp_rths.rms_error_m_s2", "exp_rths.max_error_m_s2"}
    np.testing.assert_array_equal(read_series(path, "exp_rths/command_v"), COMMAND)
    with xarray.open_datatree(path, engine="h5netcdf", decode_timedelta=False) as tree:
        assert tree["metrics/exp_rths"].rms_error_m_s2.dims == ("storey",)
        np.testing.assert_array_equal(tree["exp_rths"].time_s.values, TIME)
    assert os.listdir(tmp_path) == ["a.h5"]


@pytest.mark.parametrize("status", [None, "complete"])
def test_a_continuation_that_raises_leaves_the_file_as_it_was(tmp_path: Path, status: str | None) -> None:
    path = begin(tmp_path / "a.h5")
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt), ResultWriter(path, ABOUT, continues=True) as writer:
        writer.group("exp_rths", command(), TIME)
        if status:
            writer.finish("complete")
        raise KeyboardInterrupt
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["a.h5"]


def test_a_disk_that_is_full_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = begin(tmp_path / "a.h5")
    before = path.read_bytes()

    def refuse(*_: object) -> None:
        raise OSError(28, "full")

    with monkeypatch.context() as patched:
        patched.setattr(result_writer, "write_group", refuse)
        told = r"a\.h5: cannot write the result file: No space left on device; [^.]*\.$"
        with pytest.raises(InputError, match=told), ResultWriter(path, ABOUT, continues=True) as writer:
            writer.group("exp_rths", command(), TIME)
    with monkeypatch.context() as patched:
        patched.setattr(result_writer, "sync", refuse)
        with pytest.raises(InputError, match="No space left"), ResultWriter(path, {}, continues=True) as writer:
            writer.finish("complete")
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["a.h5"]


def test_hardware_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[str, str]] = []
    real = result_writer.publish
    monkeypatch.setattr(result_writer, "sync", lambda path: calls.append(("sync", path.suffix)))

    def publish(part: Path, path: Path, seen: Stamp) -> Path:
        calls.append(("rename", path.suffix))
        return real(part, path, seen)

    monkeypatch.setattr(result_writer, "publish", publish)
    path = begin(tmp_path / "a.h5")
    assert calls == [("sync", ".part"), ("rename", ".h5"), ("sync", "")]
    with ResultWriter(path, {}, continues=True) as writer:
        writer.finish("complete")
    assert calls[3:] == calls[:3]
    with ResultWriter(tmp_path / "virtual.h5", {"rig_kind": "virtual"}) as writer:
        writer.finish("complete")
    assert calls[6:] == [("rename", ".h5")]  # a virtual run is repeated in seconds


def test_a_continuation_that_is_killed_leaves_the_file_as_it_was_and_the_next_one_clears_up(tmp_path: Path) -> None:
    path = begin(tmp_path / "a.h5")
    before = path.read_bytes()
    code = """
import os, signal, sys, numpy as np
from pathlib import Path
from rths_cli.files.result_reader import ResultWriter
with ResultWriter(Path(sys.argv[1]), {}, continues=True) as writer:
    writer.group("exp_rths", {}, np.arange(5.0))
    os.kill(os.getpid(), signal.SIGKILL)
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code, str(path)], env=environment, check=False)
    assert done.returncode == -signal.SIGKILL
    assert path.read_bytes() == before and len(os.listdir(tmp_path)) == 2
    with ResultWriter(path, {}, continues=True) as writer:
        writer.finish("interrupted", "again")
    assert os.listdir(tmp_path) == ["a.h5"]


def test_a_parked_file_can_be_read_until_it_is_resumed_and_afterwards(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with ResultWriter(path, ABOUT, lasting=True) as writer:
        writer.group("record", {}, TIME)
        for run in ("shake_table", "exp_rths"):
            writer.park(f"{run} was under way")
            assert os.listdir(tmp_path) == ["a.h5"]
            found = read_result(path)
            assert (found.attributes["status"], found.attributes["status_reason"]) == (
                "interrupted",
                f"{run} was under way",
            )
            assert found.groups == (("record",) if run == "shake_table" else ("record", "shake_table"))
            writer.resume()
            writer.group(run, command(), TIME)
        assert read_result(path).groups == ("record", "shake_table")
        writer.finish("complete")
    assert read_result(path).groups == ("exp_rths", "record", "shake_table")
    assert os.listdir(tmp_path) == ["a.h5"]


@pytest.mark.parametrize(
    ("error", "status", "reason"),
    [
        (KeyError("lost the link"), "failed", "'lost the link'"),
        (KeyboardInterrupt(), "interrupted", "interrupted before the run had ended"),
        (GeneratorExit(), "interrupted", "terminated before the run had ended"),
    ],
)
def test_a_fault_while_a_file_is_parked_or_after_that_is_told_and_what_it_holds_stays(
    tmp_path: Path, error: BaseException, status: str, reason: str
) -> None:
    with pytest.raises(type(error)), ResultWriter(tmp_path / "a.h5", ABOUT, lasting=True) as writer:
        writer.group("record", {}, TIME)
        writer.park("it moves")
        raise error
    found = read_result(tmp_path / "a.h5")
    assert found.attributes["status"] == status and found.groups == ("record",)
    assert found.attributes["status_reason"] == reason
    with pytest.raises(type(error)), ResultWriter(tmp_path / "b.h5", ABOUT, lasting=True) as writer:
        writer.park("it moves")
        writer.resume()
        writer.group("exp_rths", command(), TIME)
        raise error
    found = read_result(tmp_path / "b.h5")
    assert (found.attributes["status"], found.groups) == (status, ("exp_rths",))
    assert found.attributes["status_reason"] == reason
    assert sorted(os.listdir(tmp_path)) == ["a.h5", "b.h5"]


def test_a_half_written_group_is_removed_and_written_anew(tmp_path: Path) -> None:
    path = begin(tmp_path / "a.h5")
    for size in (5, 7):
        with ResultWriter(path, {}, continues=True) as writer:
            if size == 7:
                writer.drop("exp_rths")
            writer.group("exp_rths", {}, np.arange(float(size)))
            writer.finish("interrupted", "again")
    assert read_series(path, "exp_rths/time_s").size == 7


def test_what_is_not_there_cannot_be_continued(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.h5: cannot write the result file: No such file"):
        ResultWriter(tmp_path / "a.h5", {}, continues=True).__enter__()
    assert os.listdir(tmp_path) == []


def test_what_an_earlier_process_left_of_a_hardware_run_survives_a_resumed_one(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left = part_of(tmp_path / "a.h5", dead.pid)
    left.write_bytes(b"samples of an earlier run")
    with ResultWriter(tmp_path / "a.h5", {"rig_kind": "udp", "case_name": "a"}, lasting=True) as writer:
        writer.park("it moves")
        writer.resume()
        writer.finish("complete")
    assert left.read_bytes() == b"samples of an earlier run"
