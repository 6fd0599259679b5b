"""Read and write plain files safely: checked before reading, written whole or not at all, leftovers removed.

Two programs that want one name do not overwrite each other: a name is claimed before the work begins (`claimed`), and a
whole file takes the place of nothing but what was seen there at the start (`publish`).
"""

from __future__ import annotations

import errno
import glob
import os
import platform
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path
from typing import BinaryIO, Literal

from rths_cli.errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

MOST_NEW = 100  # new folders, one inside the other, for a file
NO_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EXDEV)
Stamp = tuple[int, int, int, int] | None
"""What tells a file from one that took its place; None: there is none."""


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
    that killed processes left are removed. A stream (`is_stream`) stays what it is, and gets the bytes of the part.

    Raises OSError where the part cannot be renamed, or the stream takes nothing.
    """
    if is_stream(path):
        with tempfile.TemporaryDirectory(prefix="rths-") as folder:
            part = Path(folder) / "part"
            yield part
            _pour(part, path)
        return
    remove_leftovers(path)
    part = part_of(path)
    try:
        yield part
        os.replace(part, path)
    finally:
        with suppress(OSError):
            part.unlink()


def is_stream(path: Path) -> bool:
    """Tell whether a name stands for something that takes bytes and is no file: a device, a pipe, a socket, or what
    this process has open (`/dev/stdout`)."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)) or _is_descriptor(path)


def _is_descriptor(path: Path) -> bool:
    """Tell whether a name is one of /proc/self/fd or /dev/fd, or a link to one."""
    with suppress(OSError):
        for name in (path, path.parent / os.readlink(path)):
            if re.fullmatch(r"/proc/[^/]+(/task/[^/]+)?/fd", os.path.realpath(name.parent)):
                return True
    return False


def stream_fault(path: Path) -> str:
    """Return why a stream cannot take a text, as a clause about it; "" where it can."""
    mode = os.stat(path).st_mode
    if stat.S_ISBLK(mode):
        return "is a disk"
    if stat.S_ISSOCK(mode):
        return "is a socket"
    return ""


def _pour(part: Path, stream: Path) -> None:
    """Write the bytes of a file to a stream; raises OSError, InputError for a pipe that nobody reads."""
    try:  # a pipe that nobody reads is not waited for
        handle = os.open(stream, os.O_WRONLY | os.O_APPEND | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise InputError(f"{stream}: nobody reads this pipe; start its reader first") from error
        raise
    if hasattr(os, "set_blocking"):
        os.set_blocking(handle, True)
    with open(part, "rb") as source, os.fdopen(handle, "wb") as target:
        shutil.copyfileobj(source, target)


def stamp(path: Path) -> Stamp:
    """Return what tells a file from one that takes its place later, None where there is none."""
    try:
        about = os.lstat(path)
    except OSError:
        return None
    return about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns


def further_names(path: Path) -> Iterator[Path]:
    """Yield the names beside a taken one: NAME-2, NAME-3, ..."""
    return (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in count(2))


def taken_sentence(path: Path, name: Path) -> str:
    """Return the sentence on a file that did not get the name that was asked for."""
    return f"{path}: was written by another process meanwhile, and stays; this one is {name}"


def publish(part: Path, path: Path, seen: Stamp | Literal["any"]) -> Path:
    """Give a whole file its name, and return the name that it got; raises OSError.

    It takes the place of the file with the stamp `seen` alone. Any other that stands there came from another process
    since then and stays: the file then gets the next free of `further_names`. "any": it takes the place of whatever
    stands there.
    """
    if seen == "any" or (seen is not None and stamp(path) == seen):
        os.replace(part, path)
        return path
    for name in chain((path,), further_names(path)):
        with suppress(FileExistsError):
            _rename_to_new(part, name)
            return name
    raise AssertionError


def _rename_to_new(part: Path, path: Path) -> None:
    """Rename a file; raises FileExistsError where the new name is taken, which a plain rename would overwrite."""
    if os.name != "posix":
        os.rename(part, path)  # refuses by itself
        return
    try:
        os.link(part, path)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL))  # a storage without hard links
        os.replace(part, path)
        return
    os.unlink(part)


@contextmanager
def claimed(path: Path) -> Iterator[bool]:
    """Claim a name for this process; yield whether it is ours, False: another process has it.

    The system frees the name when we die. A storage without locks, or a folder that takes no file, refuses nobody:
    `publish` overwrites nothing in any case. A folder that is made for the claim goes with it if it is empty.
    """
    new: list[Path] = []
    with suppress(OSError):
        new = make_folder(path.parent)
    file = _claim(path)
    try:
        yield file != _TAKEN
    finally:
        if file is not None and file >= 0:
            with suppress(OSError):
                os.unlink(_claim_of(path))
            os.close(file)
        with suppress(OSError):
            for folder in new:
                folder.rmdir()


_TAKEN = -1


def _claim_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock")


def _claim(path: Path) -> int | None:
    """Return the locked descriptor of a claim, _TAKEN where another has it, None where nothing can be locked."""
    if fcntl is None:
        return None
    while True:
        try:
            file = os.open(_claim_of(path), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError:
            return None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            return _TAKEN
        except OSError:
            os.close(file)
            with suppress(OSError):
                os.unlink(_claim_of(path))
            return None
        with suppress(OSError):
            if os.path.samestat(os.fstat(file), os.stat(_claim_of(path))):
                return file
        os.close(file)  # removed by the one before us, between our opening and locking it


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
