"""Universal files: time histories of dataset 58, in text and in binary (58b).

Source: SDRC, "Universal file dataset 58: function at nodal DOF", and its binary form 58b (University of Cincinnati).
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.measured_data.recording import (
    JITTER,
    WHOLE,
    Column,
    Contents,
    differ,
    half_digit,
    listed,
    shifts,
    simplest,
)
from rths_cli.files.measured_data.units import abscissa_factor
from rths_cli.numerics.lti import Array

_BEGINS = re.compile(rb"[ \t]*-1[ \t]*\r?\n[ \t]*\d+(b|[ \t]*\r?\n)")
_HOLDS = re.compile(rb"^[ \t]*-1[ \t]*\r?\n[ \t]*58(b|[ \t]*\r?\n)", re.MULTILINE)
_HEAD_LINES = 11
_REAL = {2: np.float32, 4: np.float64}
_TIME = (0, 17)  # abscissa: unknown, time
_HISTORY = (0, 1)  # function: general, time response
_DIRECTIONS = {1: "X+", 2: "Y+", 3: "Z+", -1: "X-", -2: "Y-", -3: "Z-"}
_DX_DIGITS = 5.1e-6  # relative rounding of an interval that is written as E13.5


@dataclass(frozen=True)
class _Dataset:
    """A dataset 58: its name, node and direction, its column; "" in `other`, or what kind of function it is;
    `doubt_s` is half the last digit of its start."""

    name: str
    node: str
    column: Column
    other: str
    doubt_s: float = 0.0


def is_universal(data: bytes) -> bool:
    """Say whether bytes are a universal file that holds a dataset 58 or 58b, perhaps behind others (151, 164)."""
    return _BEGINS.match(data) is not None and _HOLDS.search(data) is not None


def universal_contents(path: Path, data: bytes) -> Contents:
    """Return the time histories of a universal file, each with unit, start and interval; others are named in a note.

    Raises InputError for a dataset that is damaged, complex or of unknown numbers, and a file without time histories.
    """
    datasets: list[_Dataset] = []
    skipped: list[str] = []
    place = 0
    while (line := _line(data, place)) is not None:
        word, place = line
        if word.strip() != b"-1":
            continue
        line = _line(data, place)
        if line is None:
            break
        kind, place = line
        if kind[:7].strip().lower() in (b"58", b"58b"):
            dataset, place = _dataset(path, data, kind, place)
            datasets.append(dataset)
        else:
            skipped.append(f"dataset {kind.split()[0].decode('latin-1') if kind.split() else '?'}")
            place = _behind_end(data, place)
    skipped += [f"{each.name} ({each.other})" for each in datasets if each.other]
    used = [each for each in datasets if not each.other]
    if not used:
        raise InputError(
            f"{path}: is a universal file without time histories ({listed(skipped)}); export time responses"
        )
    count = Counter(each.name for each in used)
    columns = [
        replace(each.column, name=each.name if count[each.name] == 1 else f"{each.name} {each.node}") for each in used
    ]
    steps = [column.dt_s for column in columns if column.dt_s is not None]
    stated = (("the abscissa increment", max(steps)),) if steps else ()
    notes = (f"not used, because they are no time histories: {listed(skipped)}",) if skipped else ()
    notes = (*notes, *_doubtful_starts(path, used))
    return Contents(tuple(columns), stated, notes, format="universal file 58")


def _doubtful_starts(path: Path, used: list[_Dataset]) -> list[str]:
    """Return a sentence where channels start at different times written with few digits; raise InputError where these
    leave more of an interval open than `JITTER`."""
    worst = max(used, key=lambda each: each.doubt_s)
    doubt = worst.doubt_s / min(each.column.dt_s or np.inf for each in used)
    columns = [each.column for each in used]
    if doubt <= WHOLE or not differ(columns):
        return []
    told = (
        f"the channels start at different times ({shifts(columns)}), that of {worst.name} is written to "
        f"{2.0 * worst.doubt_s:.3g} s, {2.0 * doubt:.3g} of an interval"
    )
    if doubt > JITTER:
        raise InputError(f"{path}: {told}; export the channels with starts counted from the first one")
    return [told]


def _line(data: bytes, place: int) -> tuple[bytes, int] | None:
    """Return the line at a byte and the byte after it; None at the end."""
    if place >= len(data):
        return None
    end = data.find(b"\n", place)
    end = len(data) if end < 0 else end
    return data[place:end].rstrip(b"\r"), end + 1


def _behind_end(data: bytes, place: int) -> int:
    """Return the byte behind the line `-1` that ends a dataset."""
    while (line := _line(data, place)) is not None:
        word, place = line
        if word.strip() == b"-1":
            break
    return place


def _dataset(path: Path, data: bytes, kind: bytes, place: int) -> tuple[_Dataset, int]:
    """Return a dataset 58 whose head begins at a byte, and the byte behind its end."""
    line_number = data.count(b"\n", 0, place)
    where = f"{path}:{line_number}"
    head: list[str] = []
    while len(head) < _HEAD_LINES and (line := _line(data, place)) is not None:
        head.append(line[0].decode("latin-1"))
        place = line[1]
    try:
        function, (stored, count, even) = int(head[5][:5]), (int(head[6][k : k + 10]) for k in (0, 10, 20))
        first, step = float(head[6][30:43]), float(head[6][43:56])
        abscissa, axes = int(head[7][:10]), (head[7], head[8])
        binary = b"b" in kind[:7].lower()
        order, size = (int(kind[7:13]), int(kind[31:43])) if binary else (1, 0)
    except (ValueError, IndexError):
        raise InputError(f"{where}: the head of this dataset 58 is damaged; export the file again") from None
    name = next((text.strip() for text in head[:1] if text.strip().upper() not in ("", "NONE")), "")
    node, direction = head[5][41:51].strip(), head[5][51:55].strip()
    facing = _DIRECTIONS.get(int(direction) if re.fullmatch(r"[+-]?\d+", direction) else 0, direction)
    label = f"{node}{facing}"
    other = "" if function in _HISTORY and abscissa in _TIME else f"function type {function}"
    if stored not in _REAL and not other:
        raise InputError(f"{where}: {name or label} holds complex or unknown numbers ({stored}); export real samples")
    x_unit, unit = ("" if (word := line[47:67].strip()).upper() == "NONE" else word for line in axes)
    if binary:
        raw, place = data[place : place + size], _behind_end(data, place + size)
        numbers = _binary(raw, _REAL.get(stored, np.float64), order) if not other else np.zeros(0)
    else:
        end = _behind_end(data, place)
        numbers = _text(where, data[place:end]) if not other else np.zeros(0)
        place = end
    column = Column(name or label, numbers, unit)
    if not other:
        factor = abscissa_factor(f"{where}: {column.name}", x_unit)
        column = _over_time(where, column, numbers, count, (factor * first, factor * step) if even else None)
        column = replace(column, time=column.time and replace(column.time, unit=x_unit))
    doubt = 0.0 if other or not first else factor * half_digit(head[6][30:43].replace("D", "E"))
    return _Dataset(name or label, label, column, other, doubt), place


def _binary(raw: bytes, kind: type, order: int) -> Array:
    """Return the numbers of a binary dataset; `order` 1: little endian, 2: big endian."""
    dtype = np.dtype(kind).newbyteorder("<" if order == 1 else ">")
    return np.frombuffer(raw[: len(raw) - len(raw) % dtype.itemsize], dtype).astype(np.float64)


def _text(where: str, raw: bytes) -> Array:
    """Return the numbers of a dataset in text, without the line that ends it."""
    words = raw.decode("latin-1").replace("D", "E").rstrip().removesuffix("-1").split()
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        raise InputError(f"{where}: the samples of this dataset 58 are damaged; export the file again") from None


def _over_time(where: str, column: Column, numbers: Array, count: int, even: tuple[float, float] | None) -> Column:
    """Return a channel over its abscissa: even (start, interval), or stored before each sample."""
    if numbers.size != (count if even else 2 * count):
        raise InputError(
            f"{where}: {column.name} states {count} samples and holds {numbers.size if even else numbers.size // 2}; "
            "the file is cut off or damaged, export it again"
        )
    if even is None:
        time = Column("time", numbers[::2])
        return replace(column, values=numbers[1::2], time=time)
    if not even[1] > 0.0:
        raise InputError(f"{where}: {column.name} states an interval of {even[1]:g} s; export the file again")
    return replace(column, start_s=even[0], dt_s=simplest(even[1], _DX_DIGITS))
