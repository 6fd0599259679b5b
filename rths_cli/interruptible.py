"""Long computations that a signal can end, although Python hears of it only between two calls of a library."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

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
