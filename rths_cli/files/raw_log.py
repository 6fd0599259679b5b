"""Raw logs: the format in which a running loop's samples are appended, frame by frame; readable wherever cut.

A raw log begins with magic, version and length of a JSON header, the header, and a CRC-32 of all that. Frames follow:
magic, number of steps, first step, the values of those steps column by column (float64), and a CRC-32 of all that.
All numbers are little-endian. Space for the whole run is taken at the start, so zeros may follow the last frame.
"""

from __future__ import annotations

import json
import os
import struct
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import open_regular, part_of, sync
from rths_cli.files.hdf5_opening import unreadable
from rths_cli.files.result_writer import Attribute, check_writable, refusal
from rths_cli.files.staged_file import allocate
from rths_cli.numerics.lti import Array

try:
    import fcntl
except ImportError:  # Windows: there a log under way is not told from one left behind
    fcntl = None  # type: ignore[assignment]

SUFFIX = ".rthslog"
MAGIC = b"RTHSLOG\n"
VERSION = 1
START = struct.Struct("<8sII")  # magic, version, bytes of the JSON header
FRAME_MAGIC = b"RTHF"
FRAME = struct.Struct("<4sIQ")  # magic, steps in the frame, first step
CHECK = struct.Struct("<I")
VALUE = np.dtype("<f8")
MOST_COLUMNS, MOST_STEPS, LEAST_DT_S = 1000, 10**9, 1e-6
MOST_LOST = 4  # a run takes at most this many times the bytes of the frames that are there
SPARE_BYTES = 1 << 20


@dataclass(frozen=True)
class RawHeader:
    """What the log of one run says of itself: all that its result file is made of, save the samples.

    `names` and `units`: of the w columns; `steps`: how many the run has at most, the first `ramp_steps` of them before
    the record, at rest for the first `still_steps`; `lead_samples`: by how many the hybrid clock runs ahead of the
    table; `result`: name of the result file, in the folder of the log; `attributes`: those of its root; `expected`:
    what the samples are compared with to find drift, as sensor_drift_report writes it (None: an earlier version);
    `logs`: name and unit of each column `logged_I`, and whether it is on the hybrid clock.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    dt_s: float
    steps: int
    lead_samples: int
    run: str
    result: str
    case_path: str
    case_yaml: str
    resolved_yaml: str
    attributes: Mapping[str, Attribute]
    ramp_steps: int = 0
    still_steps: int = 0
    expected: Mapping[str, Any] | None = None
    logs: tuple[tuple[str, str, bool], ...] = ()


@dataclass(frozen=True)
class RawLog:
    """A log as read: `columns` (w, n) up to the last step that is there, NaN where one is missing; `samples` of these n
    steps are there."""

    header: RawHeader
    columns: Array
    samples: int


def raw_log_path(result: Path, run: str) -> Path:
    """Return where the samples of one run stand until its result file holds them."""
    return result.with_name(f"{result.stem}.{run}{SUFFIX}")


def still_in(log: Path) -> str:
    """Return what a result says of how its run ended while the samples are in a log alone."""
    return f"the process ended before the run did; its samples are in {log.name}: rths recover {log.name}"


def read_header(path: Path) -> RawHeader:
    """Read what a log says of itself; raise InputError when it is no raw log, or a running process writes it."""
    try:
        with open_regular(path) as file:
            if _is_locked(file.fileno()):
                raise InputError(f"{path}: is being written by a run under way; wait until that has ended.")
            start = file.read(START.size)
            length = START.unpack(start)[2] if start.startswith(MAGIC) and len(start) == START.size else 0
            return _header(path, start + file.read(length + CHECK.size))[0]
    except (OSError, ValueError) as error:
        raise InputError(unreadable(path, error)) from error


def read_raw_log(path: Path) -> RawLog:
    """Read every whole frame of a log, wherever it is cut or damaged; raise InputError as `read_header`."""
    header = read_header(path)
    try:
        with open_regular(path) as file:
            data = file.read()
    except (OSError, ValueError) as error:
        raise InputError(unreadable(path, error)) from error
    frames = list(_frames(data, _header(path, data)[1], len(header.names), header.steps))
    shape = len(header.names), max((first + part.shape[1] for first, part in frames), default=0)
    if VALUE.itemsize * shape[0] * shape[1] > len(data) * MOST_LOST + SPARE_BYTES:
        raise InputError(f"{path}: its frames lie too far apart to be of one run; nothing can be recovered.")
    columns = np.full(shape, np.nan)
    there = np.zeros(columns.shape[1], dtype=bool)
    for first, part in frames:
        columns[:, first : first + part.shape[1]] = part
        there[first : first + part.shape[1]] = True
    return RawLog(header, columns, int(there.sum()))


def packed_header(header: RawHeader) -> bytes:
    """Return the start of a log."""
    text = json.dumps(asdict(header)).encode()
    start = START.pack(MAGIC, VERSION, len(text)) + text
    return start + CHECK.pack(zlib.crc32(start))


def packed_frame(first: int, columns: Array) -> bytes:
    """Return the frame of the steps `first` to `first + m - 1`, columns (w, m)."""
    frame = FRAME.pack(FRAME_MAGIC, columns.shape[1], first) + columns.astype(VALUE, copy=False).tobytes()
    return frame + CHECK.pack(zlib.crc32(frame))


def _header(path: Path, data: bytes) -> tuple[RawHeader, int]:
    """Return the header and where the frames begin."""
    if not data.startswith(MAGIC) or len(data) < START.size:
        raise InputError(f"{path}: is no raw log of rths; give a file NAME{SUFFIX} that an interrupted run left.")
    _, version, length = START.unpack_from(data)
    if version > VERSION:
        raise InputError(f"{path}: has version {version}, this rths reads up to {VERSION}; update rths.")
    end = START.size + length
    with suppress(struct.error, ValueError, TypeError, KeyError, RecursionError):
        if CHECK.unpack_from(data, end)[0] == zlib.crc32(memoryview(data)[:end]):
            told = json.loads(data[START.size : end])
            told |= {key: tuple(told[key]) for key in ("names", "units")}
            told["logs"] = tuple(tuple(one) for one in told.get("logs", ()))
            header = RawHeader(**told)
            _check_header(header)
            return header, end + CHECK.size
    raise InputError(f"{path}: its header is cut or damaged, so its samples have no names; nothing can be recovered.")


def _check_header(header: RawHeader) -> None:
    """Raise ValueError where a header is not of the types and ranges that `RawLogWriter` writes."""
    texts = (header.run, header.result, header.case_path, header.case_yaml, header.resolved_yaml)
    counts = (header.steps, header.lead_samples, header.ramp_steps)
    named = (*header.names, *header.units)
    whole = all(isinstance(count, int) and 0 <= count <= MOST_STEPS for count in counts)
    typed = all(isinstance(text, str) for text in (*texts, *named)) and len(set(header.names)) == len(header.names)
    about = all(isinstance(value, str | int | float) for value in dict(header.attributes).values())
    fits = (
        len(header.units) == len(header.names) <= MOST_COLUMNS
        and header.lead_samples + header.ramp_steps <= header.steps
    )
    whole = whole and isinstance(header.still_steps, int) and 0 <= header.still_steps <= header.ramp_steps
    typed = typed and isinstance(header.expected, dict | None)
    typed = typed and all(tuple(map(type, one)) == (str, str, bool) for one in header.logs)
    in_range = isinstance(header.dt_s, int | float) and LEAST_DT_S <= header.dt_s <= 1.0
    if not (whole and typed and about and fits and in_range and Path(header.result).suffix == ".h5"):
        raise ValueError("not what a raw log states")


def _frames(data: bytes, at: int, width: int, steps: int) -> Iterator[tuple[int, Array]]:
    """Yield first step and values (w, m) of every whole frame from a place on; what lies between is passed over."""
    while (at := data.find(FRAME_MAGIC, at)) >= 0:
        end = _frame_end(data, at, width, steps)
        if end:
            _, count, first = FRAME.unpack_from(data, at)
            yield first, np.frombuffer(data, VALUE, width * count, at + FRAME.size).reshape(width, count)
        at = end or at + 1


def _frame_end(data: bytes, at: int, width: int, steps: int) -> int:
    """Return where a whole frame at a place ends, 0 where there is none."""
    if at + FRAME.size > len(data):
        return 0
    _, count, first = FRAME.unpack_from(data, at)
    end = at + FRAME.size + VALUE.itemsize * width * count
    if first + count > steps or end + CHECK.size > len(data):
        return 0
    whole = CHECK.unpack_from(data, end)[0] == zlib.crc32(memoryview(data)[at:end])
    return end + CHECK.size if whole else 0


def _is_locked(file: int) -> bool:
    """Tell whether a running process writes the log open under this descriptor."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.flock(file, fcntl.LOCK_UN)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    return False


SYNC_S = 0.25
FRAMES_PER_S = 20
RESERVED_BYTES = 1 << 16


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
    return VALUE.itemsize * len(header.names) * header.steps + frames * (FRAME.size + CHECK.size) + RESERVED_BYTES


def _begun(path: Path, start: bytes, size: int) -> int:
    """Return the descriptor of a new, locked file that begins with `start` and has space for `size` bytes; raise
    InputError where there is none."""
    if path.exists():
        advice = "rths recover makes a result of it; then remove it, or choose another --output folder."
        raise InputError(f"{path}: exists and may hold the samples of an interrupted run; {advice}")
    check_writable(path.parent, size)
    part = part_of(path)
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
