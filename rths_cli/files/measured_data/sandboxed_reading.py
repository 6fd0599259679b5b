"""Try to read a file in a child process first: damaged files hang or crash the HDF5 library."""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress

TIME_LIMIT_S = 20.0


def survives(read: Callable[[], object]) -> bool:
    """Say whether `read` ends, with a result or an exception, when a copy of this process calls it."""
    child = os.fork()
    if child == 0:
        faulthandler.disable()  # a crash here is no news for the screen
        gc.disable()  # a collection would copy all memory that is shared with the parent
        with suppress(BaseException):  # what it raises, it raises again where it counts
            read()
        os._exit(0)
    try:
        return _ended_well(child, time.monotonic() + TIME_LIMIT_S)
    except BaseException:  # Ctrl-C
        _end(child)
        raise


def _ended_well(child: int, deadline: float) -> bool:
    """Wait for a process; end it at the deadline."""
    pause = 0.001
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.WIFEXITED(status)
        time.sleep(pause)
        pause = min(2.0 * pause, 0.02)
    _end(child)
    return False


def _end(child: int) -> None:
    """End a process and take its status."""
    with suppress(OSError):
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
