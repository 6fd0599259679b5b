"""Signals of the process, none of which may be lost."""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import Any

INTERRUPTED = 130
TERMINATED = 143


class Terminated(BaseException):
    """SIGTERM or SIGHUP arrived."""


class Signals:
    """Turn SIGINT, SIGTERM and SIGHUP into exceptions, and remember them: a library may swallow one on its way."""

    def __init__(self) -> None:
        self._arrived: type[BaseException] | None = None

    def install(self) -> None:
        """Take the signals."""
        signal.signal(signal.SIGINT, self._take)
        signal.signal(signal.SIGTERM, self._take)
        if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup
            signal.signal(signal.SIGHUP, self._take)
        sys.unraisablehook = self._unraisable

    def ignore(self) -> None:
        """Take no more notice of them: the exit code stands, and Python on its way out would let them kill it."""
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)

    def _take(self, number: int, frame: FrameType | None) -> None:
        self._arrived = KeyboardInterrupt if number == signal.SIGINT else Terminated
        raise self._arrived

    def _unraisable(self, ignored: Any) -> None:
        """Report what cannot be raised, except a signal's exception: `poll` raises that again."""
        if not isinstance(ignored.exc_value, KeyboardInterrupt | Terminated):
            sys.__unraisablehook__(ignored)

    @property
    def code(self) -> int:
        """Return the exit code of the signal that arrived, 0 without one."""
        if self._arrived is None:
            return 0
        return INTERRUPTED if self._arrived is KeyboardInterrupt else TERMINATED

    def poll(self) -> None:
        """Raise what arrived earlier."""
        if self._arrived is not None:
            raise self._arrived
