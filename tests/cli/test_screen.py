"""What progress looks like: lines where there is no terminal, a status line where there is one, little when quiet."""

from __future__ import annotations

import io
from pathlib import Path

from rths_cli.screen import Screen
from rths_cli.workflows.run import Ended

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
