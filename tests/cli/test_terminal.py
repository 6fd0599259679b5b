"""What progress looks like: lines where there is no terminal, a status line where there is one, little when quiet."""

from __future__ import annotations

import io
import os
import pty
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from rths_cli.cli import terminal as screens
from rths_cli.cli.terminal import Keys, Screen
from rths_cli.experiment.run_case import Ended
from rths_cli.loop.live_view import View
from rths_cli.report.document import Line, Verdict, grid, labelled
from rths_cli.report.to_text import text

GOOD = Ended("a", Path("results/a.h5"), "complete", "", 0, ("mind the gap",))
BAD = Ended("b", None, "failed", "no luck", 4)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown(stream: io.StringIO, quiet: bool = False) -> str:
    screen = Screen(quiet, stream)
    screen.started(1, 2, "a")
    screen.doing("SIM")
    screen.ended(GOOD, 1.25)
    screen.started(2, 2, "b")
    screen.ended(BAD, 0.5)
    screen.started(2, 2, "a")
    screen.ended(GOOD, 1.25)
    return stream.getvalue()


def test_without_a_terminal_there_are_plain_lines_only() -> None:
    lines = shown(io.StringIO()).splitlines()
    assert lines[0] == "[1/2] a: complete, results/a.h5, 1.2 s"
    assert lines[1] == "  note: mind the gap"
    assert lines[2] == "[2/2] b: failed: no luck"
    assert len(lines) == 4  # the note is said once
    assert "\x1b" not in "".join(lines) and "\r" not in "".join(lines)


def test_a_terminal_sees_what_is_being_done_and_keeps_only_the_endings() -> None:
    text = shown(Terminal())
    assert "[1/2] a  SIM" in text
    kept = [part.rsplit("\x1b[K", 1)[-1] for part in text.split("\n")]
    assert kept[0].startswith("[1/2] a: complete")


def test_quiet_shows_only_what_went_wrong() -> None:
    assert shown(io.StringIO(), quiet=True).splitlines() == ["[2/2] b: failed: no luck"]


def test_a_case_whose_answer_follows_has_no_reason_and_no_note_before_it() -> None:
    refused = replace(GOOD, status="refused", reason="no room", exit_code=3)
    loud, quiet = io.StringIO(), io.StringIO()
    for stream in (loud, quiet):
        screen = Screen(stream is quiet, stream, answered=True)
        for one in (GOOD, refused, BAD):
            screen.ended(one, 1.25)
    assert [line.partition(": ")[2] for line in loud.getvalue().splitlines()] == [
        "complete, results/a.h5, 1.2 s",
        "refused, results/a.h5, 1.2 s",
        "failed: no luck",
    ]
    assert quiet.getvalue() == ": failed: no luck\n"


VIEW = View("running", 2.5, 10.0, 1.0, 1.1, 0.01, {"stroke": 0.5, "force": 0.25}, 1, 2, 80.0, 9.0)


def test_a_moving_table_is_a_line_now_and_then_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(screens.time, "monotonic", lambda: now[0])
    stream = io.StringIO()
    screen = Screen(stream=stream)
    screen.started(1, 1, "a")
    for now[0] in (100.0, 101.0, 109.9, 110.1, 111.0):
        assert not screen.moving("EXP-RTHS", VIEW)
    lines = stream.getvalue().splitlines()
    assert len(lines) == 2
    assert lines[0] == (
        "[1/1] a: EXP-RTHS running, 2.5 of 10.0 s, tracking error 0.0100 m/s^2 rms, stroke at 50 % of its limit, "
        "1 overruns, 2 lost"
    )
    quiet = io.StringIO()
    Screen(True, quiet).moving("EXP-RTHS", VIEW)
    assert quiet.getvalue() == ""


def test_a_terminal_shows_a_panel_that_goes_away() -> None:
    stream = Terminal()
    screen = Screen(stream=stream)
    screen.started(1, 1, "a")
    screen.moving("EXP-RTHS", VIEW)
    screen.ended(GOOD, 1.25)
    text = stream.getvalue()
    assert "EXP-RTHS: running" in text and "stroke 50 %" in text
    assert text.rstrip().splitlines()[-2].endswith("complete, results/a.h5, 1.2 s")


@pytest.mark.parametrize(("typed", "moves"), [("yes\n", True), (" YES \n", True), ("y\n", False), ("", False)])
def test_only_yes_moves_a_table(monkeypatch: pytest.MonkeyPatch, typed: str, moves: bool) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
    stream = io.StringIO()
    assert Screen(stream=stream).confirm(["demo:", "rig lab", "emergency stop"]) is moves
    assert stream.getvalue().splitlines()[:3] == ["demo:", "  rig lab", "  emergency stop"]


RATES = [["rate", "late", "held"], ["500", "0", Verdict("yes")], ["1000", "7", Verdict("no")], ["a\x1b[0m", "no", "-"]]
SAID = [
    Line("GOOD: error 0.1 %", verdict="GOOD"),
    Line("GOOD for nothing"),
    labelled("verdict", "unsafe: no", "unsafe"),
]
PAGE = [SAID, [grid(RATES)]]


def test_verdicts_are_coloured_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    monkeypatch.setattr(sys, "stdout", stream)
    screens.show_page(lambda: text(PAGE))
    lines = stream.getvalue().splitlines()
    assert lines[0] == "\x1b[32mGOOD\x1b[0m: error 0.1 %" and lines[1] == "GOOD for nothing"
    assert lines[2] == "verdict                 \x1b[33munsafe\x1b[0m: no"
    assert lines[5].endswith("\x1b[32myes\x1b[0m") and lines[6].endswith("\x1b[31mno\x1b[0m")
    assert lines[7].startswith("  a\\x1b[0m") and "\x1b" not in lines[7]  # what a text brings itself is made visible
    for name, value in (("NO_COLOR", "1"), ("TERM", "dumb")):
        plain = Terminal()
        monkeypatch.setenv(name, value)
        assert not screens.coloured(plain)
        monkeypatch.delenv(name)
    assert not screens.coloured(io.StringIO())


@pytest.mark.skipif(os.name != "posix", reason="no pseudo-terminals here")
def test_the_stop_key_is_seen_without_enter_and_the_terminal_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    import termios

    outside, inside = pty.openpty()
    before = termios.tcgetattr(inside)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True, fileno=lambda: inside))
    keys = Keys()
    for typed, stops in ((b"", False), (b"x", False), (b"ab s", True), (b"\x1b", True), (b"S", True)):
        os.write(outside, typed)
        assert keys.stop_pressed() is stops, typed
    keys.release()
    assert termios.tcgetattr(inside) == before
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    assert not Keys().stop_pressed()
