"""Write a raw log: its space is taken before the table moves, and every frame is one write."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.durable import sync
from rths_cli.files.raw_log import CHECK, FRAME, VALUE, RawHeader, fcntl, packed_frame, packed_header
from rths_cli.files.result_writer import check_writable, refusal
from rths_cli.files.staged_file import allocate
from rths_cli.lti import Array

SYNC_S = 0.25
FRAMES_PER_S = 20
SPARE_BYTES = 1 << 16


class RawLogWriter:
    """Append frames to a new raw log; use as a context manager until the result holds the samples, too: as long as it
    is open, nobody recovers it. One without frames is removed when it is closed.

    Raises InputError, before anything moves, where the file exists or the disk does not hold the whole run.
    `append` and `sync` raise OSError.
    """

    def __init__(self, path: Path, header: RawHeader, clock: Callable[[], float] = time.monotonic) -> None:
        self.path, self.header = Path(path), header
        self._clock = clock
        self._frames = 0
        self._unsynced, self._synced_s = False, clock()
        start = packed_header(header)
        self._end = len(start)
        self._file = _begun(self.path, start, len(start) + _frames_bytes(header))

    def __enter__(self) -> RawLogWriter:
        """Return the open log."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the log."""
        self.close()

    def append(self, first: int, columns: Array) -> None:
        """Write columns (w, m) of the steps `first` to `first + m - 1`; after an OSError the next call writes to the
        same place."""
        frame = packed_frame(first, columns)
        _write(self._file, frame, self._end)
        self._end += len(frame)
        self._frames += 1
        self._unsynced = True

    def sync(self, at_once: bool = False) -> None:
        """Have what was appended on the disk itself, unless that was asked less than 0.25 s ago."""
        now = self._clock()
        if self._unsynced and (at_once or now - self._synced_s >= SYNC_S):
            getattr(os, "fdatasync", os.fsync)(self._file)
            self._unsynced, self._synced_s = False, now

    def close(self) -> None:
        """Give back the space that was not used; safe to call twice."""
        if self._file < 0:
            return
        with suppress(OSError):
            os.ftruncate(self._file, self._end)
            os.fsync(self._file)
        with suppress(OSError):
            os.close(self._file)
        self._file = -1
        if not self._frames:
            self.remove()

    def leave(self) -> None:
        """Touch the file no more: a call to a dead disk may still hold it."""
        self._file = -1

    def remove(self) -> None:
        """Remove the file: its samples stand in the result."""
        with suppress(OSError):
            self.path.unlink()


def _frames_bytes(header: RawHeader) -> int:
    """Return how many bytes the frames of a whole run take, at 20 or fewer a second."""
    frames = int(FRAMES_PER_S * header.steps * header.dt_s)
    return VALUE.itemsize * len(header.names) * header.steps + frames * (FRAME.size + CHECK.size) + SPARE_BYTES


def _begun(path: Path, start: bytes, size: int) -> int:
    """Return the descriptor of a new, locked file that begins with `start` and has space for `size` bytes; raise
    InputError where there is none."""
    if path.exists():
        advice = "rths recover makes a result of it; then remove it, or choose another --output folder."
        raise InputError(f"{path}: exists and may hold the samples of an interrupted run; {advice}")
    check_writable(path.parent, size)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        file = os.open(part, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise InputError(refusal(path, "cannot write the raw log", error)) from error
    try:
        _lock(file)
        _write(file, start, 0)
        os.fsync(file)
        os.rename(part, path)  # whoever sees the log sees its header
        allocate(file, 0, size)
        sync(path.parent)
    except BaseException as error:  # a signal too must leave no empty log
        os.close(file)
        for left in (part, path):
            left.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(refusal(path, f"cannot take {size / 1e6:.1f} MB for the raw log", error)) from error
        raise
    return file


def _lock(file: int) -> None:
    if fcntl is not None:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _write(file: int, data: bytes, place: int) -> None:
    """Write all of `data` at a place of the file; raises OSError."""
    rest = memoryview(data)
    while rest:
        written = os.pwrite(file, rest, place)
        rest, place = rest[written:], place + written
