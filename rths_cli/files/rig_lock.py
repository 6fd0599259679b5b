"""The lock by which one process at a time has a rig."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from rths_cli.case.resolve import VARIED
from rths_cli.errors import RigError
from rths_cli.user_cache import user_cache

try:
    import fcntl
except ImportError:  # Windows: real rigs need Linux
    fcntl = None  # type: ignore[assignment]


@contextmanager
def locked_rig(name: str) -> Iterator[None]:
    """Hold a rig for this process; raise RigError where another one holds it. The system frees it when we die."""
    if fcntl is None:
        yield
        return
    path = user_cache() / "locks" / f"{re.sub(r'[^A-Za-z0-9._-]', '_', name.removesuffix(VARIED))}.lock"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise RigError(f"rig {name}: cannot be locked, {path}: {error.strerror}; set XDG_CACHE_HOME") from error
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RigError(f"rig {name}: is in use by process {_holder(file)}; wait until that has ended") from None
        with suppress(OSError):
            os.ftruncate(file, 0)
            os.pwrite(file, str(os.getpid()).encode(), 0)
        yield
    finally:
        os.close(file)


def _holder(file: int) -> str:
    return os.pread(file, 20, 0).decode(errors="replace") or "unknown"
