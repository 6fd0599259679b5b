"""Read a file that rths did not write in a copy of this process: damaged HDF5, MATLAB and TDMS files hang or crash
their libraries.

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
from typing import TypeVar, cast

from rths_cli.errors import InputError

TIME_LIMIT_S = 20.0
CHUNK_BYTES = 1 << 20
COPIES = hasattr(os, "fork")

Read = TypeVar("Read")


def read_in_copy(read: Callable[[], Read]) -> Read:
    """Return what `read` returns when a copy of this process calls it; nothing that it does to its memory stays.

    Raises its InputError, and ValueError where it raises anything else, crashes, or does not come to an end.
    """
    if not COPIES:
        try:
            return read()
        except InputError:
            raise
        except Exception as fault:
            raise ValueError("the file cannot be read") from fault
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        _become_silent()
        with suppress(BaseException), open(sending, "wb") as pipe:
            pickle.dump(_outcome(read), pipe, pickle.HIGHEST_PROTOCOL)
            pipe.flush()
            os._exit(0)
        os._exit(1)
    os.close(sending)
    deadline = time.monotonic() + TIME_LIMIT_S
    try:
        with open(receiving, "rb", buffering=0) as pipe:
            told = _until_closed(pipe.fileno(), deadline)
        if not _ended_well(child, deadline):
            raise ValueError("the file cannot be read, its reader crashes on it, or does not come to an end")
    except BaseException:  # Ctrl-C, too
        _end(child)
        raise
    found, faults = pickle.loads(told)
    if faults:
        raise InputError(*faults)
    return cast(Read, found)


def _outcome(read: Callable[[], Read]) -> tuple[Read | None, tuple[str, ...]]:
    """Return what `read` returns, or the sentences of its InputError."""
    try:
        return read(), ()
    except InputError as error:
        return None, error.faults


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


def _ended_well(child: int, deadline: float) -> bool:
    """Say whether a process ends by itself, with exit code 0; end it at the deadline."""
    pause = 0.001
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.WIFEXITED(status) and os.WEXITSTATUS(status) == 0
        time.sleep(pause)
        pause = min(2.0 * pause, 0.02)
    _end(child)
    return False


def _end(child: int) -> None:
    """End a process and take its status."""
    with suppress(OSError):
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
