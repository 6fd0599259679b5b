"""The file object under HDF5: writes stay in memory until `commit`, so that a full disk is an error and no crash.

The HDF5 library cannot close a file whose last flush failed: h5py then crashes the process. Here the library meets
memory only, and a full disk, a quota or a size limit is an OSError of `commit`. `commit` takes the space it needs
before it changes a byte, so that a file on a full disk stays as the last `commit` left it.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import h5py

UNSUPPORTED = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)


@contextmanager
def new_hdf5(path: Path, **options: Any) -> Iterator[h5py.File]:
    """Create an HDF5 file, on the disk when the context is left; raises OSError where the disk refuses."""
    with new_large_hdf5(path, **options) as (file, _):
        yield file


@contextmanager
def new_large_hdf5(path: Path, **options: Any) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """Do what `new_hdf5` does, with a call that puts on the disk what was written so far; raises OSError."""
    import h5py

    with signals_held(), StagedFile(path) as staged:
        with h5py.File(staged, "w", **options) as file:

            def commit() -> None:
                file.flush()
                staged.commit()

            yield file, commit
        staged.commit()


@contextmanager
def signals_held() -> Iterator[None]:
    """Hold back SIGINT, SIGTERM and SIGHUP; what came meanwhile is delivered when the context is left.

    HDF5 calls the methods of a `StagedFile`, and Python runs a signal's handler in the first of them: an exception
    raised there passes through the library, which then breaks the file or the process.
    """
    if threading.current_thread() is not threading.main_thread():  # handlers run in the main thread alone
        yield
        return
    came: list[int] = []
    handlers = {}
    try:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not None:
                handlers[number] = signal.signal(number, lambda arrived, _: came.append(arrived))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in came[:1]:
            signal.raise_signal(number)


def allocate(file: int, start: int, size: int) -> None:
    """Take disk space for `size` bytes from `start` on; a system without such a call is left to refuse the write.

    Raises OSError where the disk has no such space.
    """
    if not hasattr(os, "posix_fallocate") or size <= 0:
        return
    try:
        os.posix_fallocate(file, start, size)
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise


class StagedFile(io.RawIOBase):
    """A binary file with the methods that h5py asks for; only opening, `commit` and `close` touch the disk to write.

    With `keep`, an existing file is continued, else a new one is made. Raises OSError where the disk refuses.
    """

    def __init__(self, path: Path, keep: bool = False) -> None:
        super().__init__()
        self._disk = open(path, "r+b" if keep else "w+b", buffering=0)  # noqa: SIM115
        self._committed = self._end = self._disk.seek(0, os.SEEK_END)
        self._staged: list[tuple[int, bytes]] = []  # place and bytes of each write since the last commit, in order
        self._place = 0

    def commit(self) -> None:
        """Put on the disk what was written; raises OSError, before a byte is changed where the space is missing."""
        allocate(self._disk.fileno(), self._committed, self._end - self._committed)
        for place, data in self._staged:
            self._disk.seek(place)
            rest = memoryview(data)
            while rest:
                rest = rest[self._disk.write(rest) :]
        if self._disk.seek(0, os.SEEK_END) != self._end:
            self._disk.truncate(self._end)
        self._committed, self._staged = self._end, []

    def write(self, data: Any) -> int:
        """Keep bytes until the next commit."""
        self._staged.append((self._place, bytes(data)))
        self._place += len(self._staged[-1][1])
        self._end = max(self._end, self._place)
        return len(self._staged[-1][1])

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer with what was written so far; zeros where nothing was."""
        view = memoryview(buffer).cast("B")
        start, stop = self._place, self._place + len(view)
        view[:] = self._from_disk(start, len(view))
        for place, data in self._staged:
            first, last = max(place, start), min(place + len(data), stop)
            if first < last:
                view[first - start : last - start] = data[first - place : last - place]
        self._place = stop
        return len(view)

    def _from_disk(self, place: int, size: int) -> bytes:
        self._disk.seek(place)
        found = b""
        while len(found) < size and (more := self._disk.read(size - len(found))):
            found += more
        return found.ljust(size, b"\0")

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to a place."""
        self._place = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._end}[whence]
        return self._place

    def tell(self) -> int:
        """Return the place."""
        return self._place

    def truncate(self, size: int | None = None) -> int:
        """Set the size that the file has after the next commit."""
        self._end = self._place if size is None else size
        self._staged = [(place, data[: self._end - place]) for place, data in self._staged if place < self._end]
        if self._end < self._committed:  # what is cut off is zero where the file grows again
            self._staged.append((self._end, bytes(self._committed - self._end)))
        return self._end

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def writable(self) -> bool:
        """Return that it can be written."""
        return True

    def seekable(self) -> bool:
        """Return that places in it can be chosen."""
        return True

    def close(self) -> None:
        """Close the file without what was not committed; raises OSError. Safe to call twice."""
        if not self.closed:
            super().close()
            self._disk.close()
