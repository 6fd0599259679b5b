"""Read a file in a copy of this process: damaged files hang or crash the HDF5 library and scipy's MATLAB reader.

Windows cannot copy a process. A file is then read in this one, which a damaged file may end.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import pickle
import select
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

TIME_LIMIT_S = 20.0
CHUNK_BYTES = 1 << 20
COPIES = hasattr(os, "fork")

Read = TypeVar("Read")


def survives(read: Callable[[], object]) -> bool:
    """Say whether `read` ends, with a result or an exception, when a copy of this process calls it."""
    if not COPIES:
        return True
    child = os.fork()
    if child == 0:
        _become_silent()
        with suppress(BaseException):  # what it raises, it raises again where it counts
            read()
        os._exit(0)
    try:
        return _ended_well(child, time.monotonic() + TIME_LIMIT_S)
    except BaseException:  # Ctrl-C
        _end(child)
        raise


def read_in_copy(read: Callable[[], Read]) -> Read:
    """Return what `read` returns when a copy of this process calls it; nothing that it does to its memory stays.

    Raises ValueError where `read` raises anything, crashes, or does not come to an end.
    """
    if not COPIES:
        try:
            return read()
        except Exception as fault:
            raise ValueError("the file cannot be read") from fault
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        _become_silent()
        with suppress(BaseException), open(sending, "wb") as pipe:
            pickle.dump(read(), pipe, pickle.HIGHEST_PROTOCOL)
            pipe.flush()
            os._exit(0)
        os._exit(1)
    os.close(sending)
    deadline = time.monotonic() + TIME_LIMIT_S
    try:
        with open(receiving, "rb", buffering=0) as pipe:
            told = _until_closed(pipe.fileno(), deadline)
        if not _ended_well(child, deadline, 0):
            raise ValueError("the file cannot be read, its reader crashes on it, or does not come to an end")
    except BaseException:  # Ctrl-C, too
        _end(child)
        raise
    found: Read = pickle.loads(told)
    return found


def _become_silent() -> None:
    """Prepare a copy of this process for a crash."""
    faulthandler.disable()  # a crash here is no news for the screen
    gc.disable()  # a collection would copy all memory that is shared with the parent


def _until_closed(pipe: int, deadline: float) -> bytes:
    """Return what comes through a pipe until its other end is closed, or until the deadline."""
    told = bytearray()
    while select.select([pipe], [], [], max(deadline - time.monotonic(), 0.0))[0]:
        part = os.read(pipe, CHUNK_BYTES)
        if not part:
            break
        told += part
    return bytes(told)


def _ended_well(child: int, deadline: float, code: int | None = None) -> bool:
    """Say whether a process ends by itself, with this exit code (None: any); end it at the deadline."""
    pause = 0.001
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.WIFEXITED(status) and code in (None, os.WEXITSTATUS(status))
        time.sleep(pause)
        pause = min(2.0 * pause, 0.02)
    _end(child)
    return False


def _end(child: int) -> None:
    """End a process and take its status."""
    with suppress(OSError):
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
