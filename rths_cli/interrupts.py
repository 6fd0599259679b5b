"""Signals of the process (Ctrl-C, SIGTERM), none lost, and long computations that they can end."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

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
        signal.signal(signal.SIGINT, self.take)
        signal.signal(signal.SIGTERM, self.take)
        if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup
            signal.signal(signal.SIGHUP, self.take)
        sys.unraisablehook = self._unraisable

    def leave_at_once(self) -> None:
        """Let each further signal end the process with its exit code: only a sentence is still to be said."""
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(INTERRUPTED))
        signal.signal(signal.SIGTERM, lambda number, frame: os._exit(TERMINATED))
        if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) == self.take:
            signal.signal(signal.SIGHUP, lambda number, frame: os._exit(TERMINATED))

    def ignore(self) -> None:
        """Take no more notice of them: the exit code stands, and Python on its way out would let them kill it."""
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)

    def take(self, number: int, frame: FrameType | None) -> None:
        """Remember a signal and raise its exception: what `install` has the system call."""
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


Result = TypeVar("Result")

LOOKED_S = 0.05  # between two looks at whether the waiting thread is to end
_THREAD = threading.local()
_ABANDONED: list[threading.Event] = []  # each set when its computation is through


def interruptible(work: Callable[[], Result]) -> Result:
    """Return what `work` returns, or raise what it raises; a signal is obeyed at once, whatever library it is in.

    `work` runs in a thread of its own, so it must only compute: it writes no file and holds no rig. When the caller is
    interrupted, the thread is left alone: the process is about to end.
    """
    done: list[Result] = []
    failed: list[BaseException] = []
    through = threading.Event()

    def run() -> None:
        try:
            done.append(work())
        except BaseException as error:
            failed.append(error)
        finally:
            through.set()

    try:
        threading.Thread(target=run, daemon=True).start()
        while not through.wait(LOOKED_S):  # an interrupted Thread.join takes a running thread for ended
            getattr(_THREAD, "look", _nothing)()
    except BaseException:
        _ABANDONED.append(through)
        raise
    if failed:
        raise failed[0]
    return done[0]


@contextmanager
def ended_by(look: Callable[[], None]) -> Iterator[None]:
    """Have what waits in this thread call `look`, which raises when the thread is to end."""
    before = getattr(_THREAD, "look", _nothing)
    _THREAD.look = look
    try:
        yield
    finally:
        _THREAD.look = before


def any_abandoned() -> bool:
    """Tell whether a computation that nobody waits for any more still runs: libraries must not be unloaded then."""
    return any(not through.is_set() for through in _ABANDONED)


def _nothing() -> None:
    """Let the thread go on."""
