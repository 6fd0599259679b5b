"""What a terminal shows while work goes on: a status line on a terminal, plain lines elsewhere, all on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rths_cli.workflows.run import Ended


def _nothing() -> None:
    """Do nothing."""


class Screen:
    """Show the progress of a batch; `quiet` shows only what went wrong.

    `poll` is called at every sign of progress: it may raise to end the batch.
    """

    def __init__(self, quiet: bool = False, stream: TextIO | None = None, poll: Callable[[], None] = _nothing) -> None:
        self._poll = poll
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._live = not quiet and self._stream.isatty()
        self._label = ""
        self._said: set[str] = set()

    def started(self, number: int, count: int, name: str) -> None:
        """Show that a case starts."""
        self._poll()
        self._label = f"[{number:>{len(str(count))}}/{count}] {name}"
        self._status("")

    def doing(self, what: str) -> None:
        """Show what is being done."""
        self._poll()
        self._status(what)

    def ended(self, ended: Ended, seconds: float) -> None:
        """Show how a case ended."""
        self._clear()
        good = ended.exit_code == 0
        where = f"{ended.path}{' (replaced)' if ended.replaced else ''}" if ended.path else "no result"
        line = f"{self._label}: {ended.status}, {where}, {seconds:.1f} s"
        if not good:
            line = f"{self._label}: {ended.status}{f', {where}' if ended.path else ''}: {ended.reason}"
        if not (good and self._quiet):
            print(line, file=self._stream, flush=True)
        for warning in ended.warnings:
            if warning not in self._said and not self._quiet:
                print(f"  note: {warning}", file=self._stream, flush=True)
            self._said.add(warning)

    def message(self, text: str) -> None:
        """Show a line, for instance a warning."""
        self._clear()
        print(text, file=self._stream, flush=True)

    def clear(self) -> None:
        """Take the status line away; what has been said stays."""
        self._clear()
        if self._live:
            self._stream.flush()

    def _status(self, what: str) -> None:
        if self._live:
            self._clear()
            text = f"{self._label}  {what}" if self._label else what
            self._stream.write(text[:100])
            self._stream.flush()

    def _clear(self) -> None:
        if self._live:
            self._stream.write("\r\x1b[K")
