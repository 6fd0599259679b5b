"""Open an HDF5 file for reading, and say in one sentence why it cannot be read: in use, cut off, damaged, foreign.

A file that only others read is read beside them; where the storage has no locks, it is read without one. A file that
another program has open for writing is not read: it may be half changed. Nobody is told to repeat a test on a real rig.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rths_cli.errors import InputError
from rths_cli.files.durable_files import open_regular
from rths_cli.files.hdf5_safety import LayoutError, attribute

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    import h5py

SIGNATURE = b"\x89HDF\r\n\x1a\n"
LAST_START = 1 << 20  # the signature is at byte 0, 512, 1024, 2048, ...
RESTORE = "take it from a copy, and keep this one until then"
VIRTUAL = "virtual"  # kind of rig whose data can be made anew
RECORDED = "recorded"  # kind of rig of a run that was made elsewhere: its result can be made anew from its recording
HELD = "is open for writing in another program; close it there, or read a copy of the file"
FAULTS = (OSError, RuntimeError, LookupError, ValueError, TypeError)  # what h5py raises on a damaged file
_HELD = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EACCES)
_UNLOCKED = "unable to lock file"
_TRUNCATED = re.compile(r"truncated file: eof = (\d+), .*stored_eof = (\d+)")


@dataclass(frozen=True)
class Wanted:
    """What a file should be, in the words of a sentence."""

    what: str  # "result file as rths run writes it"
    foreign: str  # the clause about a file that is not HDF5
    again: str  # how data of a virtual rig are made anew
    virtual: bool = False  # whether such files are of virtual rigs only


def is_hdf5(path: Path) -> bool:
    """Tell whether a file begins like HDF5, without the library, which locks it; raises OSError."""
    with open_regular(path) as file:
        place = 0
        while place <= LAST_START:
            file.seek(place)
            start = file.read(len(SIGNATURE))
            if start == SIGNATURE:
                return True
            if len(start) < len(SIGNATURE):
                return False
            place = max(512, 2 * place)
    return False


@contextmanager
def opened(path: Path, wanted: Wanted) -> Iterator[h5py.File]:
    """Yield an open HDF5 file; every fault of the file, also one that the body meets, is an InputError."""
    try:
        foreign = not is_hdf5(path)
    except (OSError, ValueError) as error:
        raise InputError(unreadable(path, error)) from error
    if foreign:
        empty = "is empty and " if path.stat().st_size == 0 else ""
        raise InputError(f"{path}: {empty}{wanted.foreign}")
    try:
        file = _open(path)
    except FAULTS as error:
        raise InputError(f"{path}: {_told(error)}; {RESTORE}") from error
    with file:
        try:
            yield file
        except LayoutError as error:
            raise InputError(f"{path}: {error}, so it is no {wanted.what}; {advice(file, wanted)}") from error
        except FAULTS as error:
            raise InputError(f"{path}: is damaged and cannot be read; {advice(file, wanted)}") from error


def is_held(path: Path) -> bool:
    """Tell whether another program has locked a file for writing, as the HDF5 library does."""
    if fcntl is None:
        return False
    try:
        with open_regular(path) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a storage without locks
        pass
    return False


def unreadable(path: Path, error: Exception) -> str:
    """Return the sentence for a file that the system does not open: missing, a folder, no permission."""
    if isinstance(error, FileNotFoundError):
        return f"{path}: no such file; check the path"
    told = getattr(error, "strerror", None) or str(error)
    advised = "; allow this user to read it" if isinstance(error, PermissionError) else ""
    return f"{path}: cannot read: {told}{advised}."


def advice(file: h5py.File, wanted: Wanted) -> str:
    """Return what to do about an open file that is of no use: to make it anew only if its rig is known as virtual."""
    rig: object = None
    with suppress(*FAULTS):
        rig = attribute(file, "rig_kind")
    return wanted.again if wanted.virtual or rig == VIRTUAL else RESTORE


def _open(path: Path) -> h5py.File:
    """Open a file for reading; raises InputError where another program writes it, OSError for a damaged one."""
    import h5py

    try:
        return h5py.File(path, "r")
    except OSError as error:
        if _UNLOCKED not in str(error):
            raise
        if error.errno in _HELD:
            raise InputError(f"{path}: {HELD}") from error
    try:
        return h5py.File(path, "r", locking=False)
    except OSError as error:
        if _UNLOCKED not in str(error):
            raise
        raise InputError(
            f"{path}: is on a storage without file locks, and HDF5_USE_FILE_LOCKING asks for them; unset that variable"
        ) from error


def _told(error: BaseException) -> str:
    """Return why a file cannot be opened, as a clause about it."""
    cut = _TRUNCATED.search(str(error))
    if cut is None:
        return "is damaged and cannot be opened"
    return f"is truncated: {int(cut[1])} of {int(cut[2])} bytes are there"
