"""A case on a real rig that fails early: its file, its exit code and its reason are those of what happened."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rths_cli.errors import InputError, RigError
from rths_cli.experiment import real_stage, run_command
from rths_cli.experiment.one_table_run import after_the_record, why_ended
from rths_cli.experiment.run_case import Ended
from rths_cli.experiment.run_command import run_one
from rths_cli.files.result_reader import ResultWriter, read_result
from rths_cli.findings import stated
from rths_cli.loop import guard
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.rigs.description import capabilities_of

ABOUT = {"case_name": "a", "rig_kind": "udp"}


def setup(kind: str = "udp") -> Any:
    case = SimpleNamespace(name="a", runs=("shake_table", "exp_rths"), recorded={})
    can = capabilities_of(kind)
    return SimpleNamespace(
        case=case, rig=SimpleNamespace(kind=kind, can=can), moves_hardware=can.moves_hardware, recorded={}
    )


def ran(path: Path, monkeypatch: pytest.MonkeyPatch, act: Any, ask: Any = lambda *_: None) -> Ended:
    monkeypatch.setattr(real_stage, "ask_the_rig", ask)
    monkeypatch.setattr(run_command, "run_case", lambda setup, path, *_: act(path))
    monkeypatch.setattr(run_command, "before_error", lambda setup, error: (stated(str(error)),))
    watcher: Any = SimpleNamespace(moving=None)
    return run_one(setup(), path, SimpleNamespace(), SharedValues(), "", lambda _: None, watcher)  # type: ignore[arg-type]


def second_run_fails(error: Exception) -> Any:
    """Return what writes the first run of a case, and fails before the second one moves."""

    def act(path: Path) -> Ended:
        with ResultWriter(path, ABOUT, lasting=True) as writer:
            writer.group("record", {}, np.arange(3.0))
            writer.park("shake-table test: under way")
            writer.resume()
            writer.group("shake_table", {"command_v": np.zeros(3)}, np.arange(3.0))
            raise error

    return act


@pytest.mark.parametrize(("error", "code"), [(RigError("the target is silent"), 4), (InputError("no zero"), 4)])
def test_a_second_run_that_fails_before_it_moves_leaves_its_reason_and_the_first_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, code: int
) -> None:
    ended = ran(tmp_path / "a.h5", monkeypatch, second_run_fails(error))
    assert (ended.path, ended.status, ended.exit_code) == (tmp_path / "a.h5", "failed", code)
    found = read_result(tmp_path / "a.h5")
    assert (found.attributes["status"], found.attributes["status_reason"]) == ("failed", str(error))
    assert found.groups == ("record", "shake_table")


def test_what_refuses_before_the_file_begins_is_bad_input_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise InputError("sample_rate_hz: 1000 Hz was not held")

    begun: list[Path] = []
    ended = ran(tmp_path / "a.h5", monkeypatch, begun.append, refuse)
    assert (ended.path, ended.exit_code, begun) == (None, 2, []) and list(tmp_path.iterdir()) == []


def test_a_file_of_that_name_from_before_is_not_this_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.h5").write_bytes(b"another run")
    ended = ran(tmp_path / "a.h5", monkeypatch, second_run_fails(RigError("never")))
    assert (ended.path, ended.exit_code) == (None, 2) and "holds a hardware run" in ended.reason
    assert (tmp_path / "a.h5").read_bytes() == b"another run"


def outcome(reason: int, limit: str, at_s: float, state: int = 1, **more: Any) -> Any:
    about = {"rig_fault": "", "played": False, "ramp_s": 1.0, "whole": None} | more
    log = SimpleNamespace(state=np.zeros(state))
    return SimpleNamespace(stop=None, stopped_by_limit=limit, stopped_at_s=at_s, reason=reason, log=log, **about)


def test_why_and_when_a_run_ended_is_one_sentence() -> None:
    def told(*given: Any) -> str:
        stop = why_ended("EXP-RTHS", outcome(*given), 9.0)
        assert stop is not None
        return stop.reason

    word = guard.REASONS[guard.INTERRUPT]
    assert told(guard.INTERRUPT, word, 1.5) == f"EXP-RTHS: {word} at 1.500 s of 9.000 s, the table was led to rest"
    early = f"EXP-RTHS: {word} in the ramp-up, before the record began, the table was led to rest"
    assert told(guard.INTERRUPT, word, 0.0) == early
    assert told(guard.INTERRUPT, word, -1.5) == f"EXP-RTHS: {word} at rest, before the table moved"
    assert told(guard.STROKE, "too far", 0.0, 0) == "EXP-RTHS: too far at 0.000 s"  # on the counted clock
    assert why_ended("EXP-RTHS", outcome(guard.NONE, "", 0.0), 9.0) is None


@pytest.mark.parametrize(
    ("reason", "fault", "code"),
    [
        (guard.END, "the target died", 4),
        (guard.RIG_FAULT, "the target died", 4),  # at the very exchange after the last step of the record
        (guard.NONE, "the driver fails", 4),
        (guard.INTERRUPT, "", 130),
        (guard.TERMINATION, "", 143),
        (guard.OPERATOR, "", 3),
        (guard.LOG_FAILED, "", 4),
        (guard.WATCHER_FAILED, "", 5),
    ],
)
def test_what_ends_a_run_after_its_record_leaves_it_complete_with_its_own_exit_code(
    reason: int, fault: str, code: int
) -> None:
    limit = "" if reason in (guard.END, guard.NONE) else guard.REASONS[reason]
    ended = outcome(reason, limit, 9.0, rig_fault=fault, played=True, whole=SimpleNamespace(after_v=np.zeros((3, 600))))
    assert why_ended("EXP-RTHS", ended, 9.0) is None
    late = after_the_record("EXP-RTHS", ended, 2e-3)
    assert late is not None and late.exit_code == code
    assert (fault or limit) in late.reason and "watched at rest for 1.20 s of 3 s" in late.reason


def test_a_run_that_ended_by_itself_has_nothing_to_say_of_its_rest() -> None:
    assert after_the_record("EXP-RTHS", outcome(guard.END, "", 9.0, played=True), 2e-3) is None
    assert after_the_record("EXP-RTHS", outcome(guard.STROKE, "too far", 4.0), 2e-3) is None
