"""How long a command still takes, told from parts whose durations are made up and from a clock of the test."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from rths_cli.cli import terminal
from rths_cli.cli.progress import PRIOR_S, Estimate, learn, part_of, usual
from rths_cli.cli.terminal import Screen

USUAL = {"starting": 1.0, "compile a": 10.0, "probe of": 2.0, "identification": 4.0, "compile b": 5.0, "EXP-RTHS": 3.0}


def test_a_part_is_the_words_before_any_number() -> None:
    assert [*map(part_of, ("probe of 25 s at 0.4 m/s^2", "SIM-DELAY, 5 ms", "SIM", "check: a", "3 of 40 runs"))] == [
        "probe of", "SIM-DELAY", "SIM", "check", ""
    ]  # fmt: skip


def test_what_is_left_are_the_parts_ahead_as_much_slower_as_those_that_have_ended() -> None:
    estimate = Estimate(USUAL)
    estimate.begin("starting", 100.0)
    assert estimate.left_s(100.0) == pytest.approx(10.0)  # 1 + 2 + 4 + 3: nothing is compiled yet
    estimate.begin("probe of", 102.0)  # twice as long as usual
    first = (PRIOR_S + 2) / (PRIOR_S + 1)
    assert estimate.left_s(102.0) == pytest.approx(first * (2 + 4 + 3))
    assert estimate.left_s(104.0) == pytest.approx(first * (2 + 4 + 3) - 2)
    estimate.begin("EXP-RTHS", 106.0)  # no identification
    both = (PRIOR_S + 2 + 4) / (PRIOR_S + 1 + 2)
    assert estimate.left_s(106.0) == pytest.approx(both * 3)
    assert estimate.left_s(200.0) == pytest.approx(0.1 * both * 3)  # longer than usual: never nothing
    assert estimate.spent_s() == pytest.approx(100.0)


def test_compiling_stands_beside_the_stage_around_it() -> None:
    estimate = Estimate(USUAL)
    estimate.begin("probe of", 0.0)
    estimate.compiling("a", True, True, 1.0)
    assert estimate.left_s(1.0) == pytest.approx((2 - 1) + 10 + 4 + 5 + 3)
    estimate.compiling("a", False, True, 6.0)  # 5 s, half of usual
    faster = (PRIOR_S + 5) / (PRIOR_S + 10)
    assert estimate.left_s(6.0) == pytest.approx(faster * (2 - 1 / faster + 4 + 5 + 3))
    estimate.begin("EXP-RTHS", 6.5)
    assert estimate.ended(8.0) == pytest.approx({"probe of": 1.5, "compile a": 5.0, "EXP-RTHS": 1.5})


def test_what_was_measured_here_is_kept_in_the_order_of_the_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    learn("own", {"a": 1.0, "c": 3.0})
    learn("own", {"a": 2.0, "b": 2.0, "c": 3.0})
    assert [*usual("own").items()] == [("a", 1.5), ("b", 2.0), ("c", 3.0)]
    (tmp_path / "rths/progress.json").write_text("{damaged")
    assert usual("own") == {}
    learn("own", {"a": 4.0})
    assert json.loads((tmp_path / "rths/progress.json").read_text()) == {"own": {"a": 4.0}}


def test_each_command_has_shipped_durations_of_a_first_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # nothing was learned
    for command in ("run", "check", "identify"):
        known = usual(command)
        assert any(part.startswith("compile rths_cli.") for part in known) and all(0 <= s < 100 for s in known.values())


def test_without_a_terminal_a_line_begins_each_stage_and_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    now, stream = [50.0], io.StringIO()
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(terminal, "BEAT_S", 60.0)
    monkeypatch.setattr(terminal, "usual", lambda command: USUAL)
    monkeypatch.setattr(terminal, "learn", lambda command, spent: None)
    screen = Screen(stream=stream, command="run")
    screen.doing("starting")
    for now[0], what in ((51.0, "probe of 25 s"), (51.5, "identification, 9 s"), (58.0, "identification, 9 s")):
        screen.doing(what)
    now[0] = 61.5
    screen.doing("identification, 9 s")
    screen.clear()
    assert stream.getvalue().splitlines() == [
        "starting",
        "10 %, about 9 s left: probe of 25 s",
        "82 %, about 3 s left: identification, 9 s",  # 4.5 / 6 (0.4 + 3), with PRIOR_S
    ]
