"""Read and write plain files safely: checked before reading, written whole or not at all, leftovers removed."""

from __future__ import annotations

import errno
import glob
import os
import platform
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from rths_cli.errors import InputError

MOST_NEW = 100  # new folders, one inside the other, for a file


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk itself; raises OSError."""
    if path.is_dir() and os.name != "posix":
        return
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def part_of(path: Path, process: int | None = None) -> Path:
    """Return the name under which a process of this machine, None: this one, writes a file before it is whole:
    `.NAME.HOST-PID.part`."""
    return path.with_name(f".{path.name}.{_host()}-{process or os.getpid()}.part")


def _host() -> str:
    """Return the name of this machine without dots: folders are shared by several, which count processes anew."""
    return re.sub("[^A-Za-z0-9-]", "-", platform.node())


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield the name of a part that becomes `path` when the context is left; where that fails, no part stays, and parts
    that killed processes left are removed.

    Raises OSError where the part cannot be renamed.
    """
    remove_leftovers(path)
    part = part_of(path)
    try:
        yield part
        os.replace(part, path)
    finally:
        with suppress(OSError):
            part.unlink()


def remove_leftovers(path: Path) -> None:
    """Remove what killed processes of this machine left of this file: parts whose process is gone. Whether one of
    another machine still writes cannot be known here."""
    for part in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        host, _, number = part.name.split(".")[-2].rpartition("-")
        if host == _host() and re.fullmatch("[0-9]{1,9}", number) and not _is_alive(int(number)):
            with suppress(OSError):
                part.unlink()


def _is_alive(process: int) -> bool:
    """Tell whether a process of this number runs; in doubt it does.

    Elsewhere than on POSIX it is taken for gone: Windows removes no file that a process has open, and sends a signal
    of number 0 to the process instead of asking for it.
    """
    if os.name != "posix":
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading; raise OSError for what is none: a folder, a device, a pipe, which would not end.

    A pipe is opened without waiting for somebody at its other end.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "is no regular file", str(path))
    except OSError:
        os.close(handle)
        raise
    return os.fdopen(handle, "rb")


def read_whole(path: Path, most_bytes: int, what: str, advice: str) -> bytes:
    """Return the file's bytes; raise InputError where it cannot be read, or is larger than `what` may be."""
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size <= most_bytes:
                return file.read(most_bytes)
    except (OSError, ValueError) as fault:
        raise InputError(f"{path}: cannot be read ({getattr(fault, 'strerror', None) or fault}); {advice}") from None
    raise InputError(f"{path}: {size / 1e6:.0f} MB; {what} may have {most_bytes / 1e6:.0f} MB, cut it")


def write_new(path: Path, text: str) -> None:
    """Write a text to a file that does not exist yet; raise InputError where there is one, or the disk refuses.

    Nothing is left behind where the text cannot be written whole.
    """
    try:
        with open(path, "x", encoding="utf-8") as file:
            try:
                file.write(text)
                file.flush()
            except BaseException:  # a signal too must leave no half file
                path.unlink()
                raise
    except FileExistsError:
        raise InputError(f"{path}: exists; choose another name") from None
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or str(fault)
        raise InputError(f"{path}: cannot be written: {reason}") from None


def make_folder(folder: Path) -> list[Path]:
    """Make a folder and those that it stands in; return the new ones, the innermost first.

    Raises OSError, also where more than MOST_NEW of them are missing.
    """
    new = [one for one in (folder, *folder.parents) if not one.exists()]
    if len(new) > MOST_NEW:
        raise OSError(errno.ENAMETOOLONG, f"{len(new)} new folders, one inside the other; {MOST_NEW} is the most")
    folder.mkdir(parents=True, exist_ok=True)
    return new
