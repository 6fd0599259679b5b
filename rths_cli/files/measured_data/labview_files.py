"""LabVIEW measurement files (.lvm): segments of rows, each below its own header or all below the first one.

Source: NI, "Specification for the LabVIEW Measurement File (.lvm)": the file's header and each segment's end with
***End_of_Header***; X_Columns is One (of the first channel), Multi or No; Date, Time, X0, Delta_X and Y_Unit_Label of
a segment have a cell for each channel, with Multi in every second column; the last column, Comment, belongs to no
channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.measured_data.recording import Column, Contents, half_digit
from rths_cli.files.measured_data.time_stamps import stamps_ns
from rths_cli.numerics.lti import Array

_END = "***End_of_Header***"
_SPECIAL = ("***Start_Special***", "***End_Special***")
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}
_LONGEST_HEADER = 100  # lines of a segment's header
_BY_CHANNEL = ("samples", "date", "time", "y_unit_label", "x_dimension", "x0", "delta_x")
_NEAR = 0.2  # of a sample, within which a segment begins at a whole sample after the one before
_DIGITS = 5  # of a Delta_X: fewer leave the rate in doubt where no X values are saved

Header = Mapping[str, list[str]]


@dataclass(frozen=True)
class _Segment:
    """A segment: what its header states (key in lower case -> a cell per channel), its names, the line of the names
    and of each row (from 1), its rows as cells."""

    header: Header
    names: tuple[str, ...]
    line: int
    lines: list[int]
    rows: list[list[str]]


@dataclass(frozen=True)
class _File:
    """What the header of the file states: its mark of decimals, how many X columns there are, whether X is absolute."""

    path: Path
    mark: str
    x_columns: str
    absolute: bool


def is_labview(lines: Sequence[str]) -> bool:
    """Say whether a text is a LabVIEW measurement file."""
    return bool(lines) and lines[0].startswith("LabVIEW Measurement")


def labview_contents(path: Path, lines: Sequence[str]) -> Contents:
    """Return the channels of a .lvm file with their units, each with the times that its header and X values state.

    Raises InputError, with the line, for a file without rows, a cell that is no number, a channel without any time, and
    segments of other channels or that do not follow each other by whole samples.
    """
    separator = next(
        (mark for word, mark in _SEPARATORS.items() if f"Separator{mark}{word.title()}" in lines[:10]), "\t"
    )
    lines = _without_special(lines)
    header, first = _header(lines, 0, separator)
    told = _File(
        path,
        _cell(header, "decimal_separator") or ".",
        _cell(header, "x_columns").lower() or "one",
        _cell(header, "time_pref").lower() == "absolute",
    )
    segments = _segments(path, lines, first, separator)
    parts = [_channels(told, segment) for segment in segments]
    joined = parts[0]
    for segment, before, after in zip(segments[1:], segments, parts[1:], strict=False):
        joined = _joined(told, segments[0], before, segment, joined, after)
    every = [line for segment in segments for line in segment.lines]
    return Contents(joined, notes=_doubts(told, segments[0]), line_of=lambda row: every[row], format="LabVIEW .lvm")


def _without_special(lines: Sequence[str]) -> list[str]:
    """Return the lines, blank ones in place of the blocks from ***Start_Special*** to ***End_Special***."""
    kept: list[str] = []
    special = False
    for line in lines:
        special = special or line.startswith(_SPECIAL[0])
        kept.append("" if special else line)
        special = special and not line.startswith(_SPECIAL[1])
    return kept


def _header(lines: Sequence[str], first: int, separator: str) -> tuple[dict[str, list[str]], int]:
    """Return what a header states that begins at a line (from 0), and the line after its end."""
    stated: dict[str, list[str]] = {}
    for place in range(first, len(lines)):
        key, *cells = (cell.strip() for cell in lines[place].split(separator))
        if key == _END:
            return stated, place + 1
        stated.setdefault(key.lower(), cells)
    return stated, len(lines)


def _of_channels(header: Header) -> Header:
    """Return a segment's header with the cells of the channels alone: with Multi each stands above its Y column."""
    every = [cells for key, cells in header.items() if key in _BY_CHANNEL]
    spread = any(cells[2:3] != [""] for cells in every if len(cells) > 2) and not any(
        cell for cells in every for cell in cells[1::2]
    )
    return {key: cells[::2] if spread and key in _BY_CHANNEL else cells for key, cells in header.items()}


def _cell(header: Header, key: str, channel: int = 0) -> str:
    """Return the cell of a channel behind a key, "" without one."""
    cells = header.get(key, [])
    return cells[channel] if channel < len(cells) else ""


def _segments(path: Path, lines: Sequence[str], first: int, separator: str) -> list[_Segment]:
    """Return the segments of a file that have rows; rows end where a word begins a header, whose end follows."""
    segments: list[_Segment] = []
    place = first
    while place < len(lines):
        stated, start = _header(lines, place, separator)
        header = _of_channels(stated)
        start += next((k for k, line in enumerate(lines[start : start + _LONGEST_HEADER]) if line.strip()), 0)
        names = tuple(cell.strip() for cell in lines[start].split(separator)) if start < len(lines) else ()
        place = start + 1
        rows: list[list[str]] = []
        where: list[int] = []
        while place < len(lines) and not _begins_header(lines, place, separator):
            if lines[place].strip():
                rows.append(lines[place].split(separator))
                where.append(place + 1)
            place += 1
        if rows:
            segments.append(_Segment(header, names, start + 1, where, rows))
    if not segments:
        raise InputError(f"{path}: is a LabVIEW measurement without rows of numbers; save the measurement again")
    return segments


def _begins_header(lines: Sequence[str], place: int, separator: str) -> bool:
    """Say whether a header begins at a line (from 0): words up to its end; NaN and Inf are samples."""
    for line in lines[place : place + _LONGEST_HEADER] if lines[place].strip() else ():
        word = line.partition(separator)[0].strip()
        if word == _END:
            return True
        if line.strip() and (not word[:1].isalpha() or word.lower() in ("nan", "inf", "infinity")):
            return False
    return False


def _channels(told: _File, segment: _Segment) -> tuple[Column, ...]:
    """Return the channels of a segment, each with its times as the segment alone states them."""
    names = [name for name in segment.names if name.lower() != "comment"]
    is_x = [name.lower().replace(" ", "_") == "x_value" for name in names]
    shift = 1 if told.x_columns == "no" and not any(is_x) and segment.rows[0][0] == "" else 0  # a blank first column
    values = _numbers(told, segment, names, shift)
    columns: list[Column] = []
    for place in (k for k, x in enumerate(is_x) if not x):
        channel = len(columns)
        count = _count(told, segment, channel)
        x_place = max((k for k, x in enumerate(is_x) if x and k < place), default=None)
        x = values[:count, x_place] if x_place is not None and told.x_columns != "no" else np.zeros(0)
        time = Column("X_Value", _times(told, segment, channel, x, count))
        unit = _cell(segment.header, "y_unit_label", channel)
        columns.append(Column(names[place] or f"channel {channel + 1}", values[:count, place], unit, time=time))
    if not columns:
        raise InputError(f"{told.path}:{segment.line}: names no channel beside X_Value; save the measurement again")
    return tuple(columns)


def _count(told: _File, segment: _Segment, channel: int) -> int:
    """Return the number of samples of a channel: as stated where the longest channel fills the rows, else all rows;
    raise InputError where there are fewer rows than that."""
    stated = [int(cell) for cell in segment.header.get("samples", []) if cell.isdecimal()]
    whole = len(segment.rows)
    if whole < max(stated, default=0):
        raise InputError(
            f"{told.path}:{segment.lines[-1]}: the rows end here, {whole} of the {max(stated)} samples that the header "
            "states; the file is cut off, save the measurement again"
        )
    return stated[channel] if channel < len(stated) and max(stated) == whole else whole


def _numbers(told: _File, segment: _Segment, names: Sequence[str], shift: int) -> Array:
    """Return the figures of a segment (n, c), NaN for empty cells; raise InputError with the first faulty cell."""
    values = np.full((len(segment.rows), len(names)), np.nan)
    for row, (line, cells) in enumerate(zip(segment.lines, segment.rows, strict=True)):
        for place, cell in enumerate(cells[shift : len(names) + shift]):
            if word := cell.strip():
                values[row, place] = _number(f"{told.path}:{line}: {names[place]}", word, told.mark)
    return values


def _number(where: str, word: str, mark: str) -> float:
    """Return a number with its mark of decimals; raise InputError for anything else."""
    try:
        return float(word.replace(mark, "."))
    except ValueError:
        raise InputError(f"{where}: {word[:40]!r} is not a number; correct the cell or leave it empty") from None


def _stated(told: _File, segment: _Segment, key: str, channel: int) -> float | None:
    """Return the number that a segment states for a channel, None without one."""
    word = _cell(segment.header, key, channel)
    return _number(f"{told.path}: {key} above line {segment.line}", word, told.mark) if word else None


def _times(told: _File, segment: _Segment, channel: int, x: Array, count: int) -> Array:
    """Return the times (n,) in s of a channel, on the clock of the segment's first channel.

    An X column is the channel's own (Multi), or the first channel's (One): then start and interval of the others are
    the stated ones. Raises InputError where X values and Delta_X differ by more than the digits of Delta_X allow.
    """
    step, start = _stated(told, segment, "delta_x", channel), _stated(told, segment, "x0", channel) or 0.0
    first_step, first_start = _stated(told, segment, "delta_x", 0), _stated(told, segment, "x0", 0) or 0.0
    late = 1e-9 * (_moment(told, segment, channel) - _moment(told, segment, 0))
    if told.x_columns == "multi" and x.size:
        _check_step(told, segment, channel, x)
        return x + (0.0 if told.absolute else late)
    if told.absolute and start != first_start:
        late = 0.0  # the date is in X0
    if x.size and (step is None or step == first_step):
        _check_step(told, segment, 0, x)
        return x + (start - first_start) + late
    if step is None:
        raise InputError(
            f"{told.path}:{segment.line}: neither X values nor Delta_X of channel {channel + 1} are there; save them"
        )
    if x.size:
        start += float(x[0]) - first_start
    return np.asarray(np.arange(count) * step + (start + late), dtype=np.float64)


def _check_step(told: _File, segment: _Segment, channel: int, x: Array) -> None:
    """Raise InputError where the usual step of X values (n,) is not Delta_X within the last digit of either."""
    word = _cell(segment.header, "delta_x", channel)
    step = _stated(told, segment, "delta_x", channel)
    finite = x[np.isfinite(x)]
    if step is None or finite.size < 3:
        return
    steps = np.diff(finite)
    if not np.median(steps) > 0.0:
        return  # which the clock's reader tells with its line
    usual = float(np.mean(steps[np.abs(steps - np.median(steps)) <= 0.5 * abs(np.median(steps))]))
    if abs(usual - step) > half_digit(word, told.mark) + 1e-4 * abs(step):
        raise InputError(
            f"{told.path}:{segment.line}: Delta_X of channel {channel + 1} is {step:.9g} s, X_Value steps by "
            f"{usual:.9g} s; correct or remove one of them"
        )


def _moment(told: _File, segment: _Segment, channel: int) -> int:
    """Return date and time of a channel's segment in ns, 0 where none are stated."""
    date, time = (_cell(segment.header, key, channel) for key in ("date", "time"))
    if not (date and time):
        return 0
    found = stamps_ns([f"{date} {time}"])
    if found is None:
        raise InputError(
            f"{told.path}: date {date!r} and time {time!r} above line {segment.line} are none; correct them"
        )
    return int(found[0])


def _joined(
    told: _File,
    first: _Segment,
    before: _Segment,
    segment: _Segment,
    joined: tuple[Column, ...],
    after: tuple[Column, ...],
) -> tuple[Column, ...]:
    """Return the channels with those of the next segment behind them, its times on the clock of the first one.

    Its X values count where they continue those before; else date and time do, too.
    """
    where = f"{told.path}:{segment.line}"
    if [column.name for column in joined] != [column.name for column in after]:
        raise InputError(
            f"{where}: a segment of other channels begins here; save each measurement to a file of its own"
        )
    for old, new in zip(joined, after, strict=True):
        if old.unit != new.unit:
            raise InputError(
                f"{where}: the segment that begins here states the unit {new.unit!r} of {new.name}, the one before "
                f"{old.unit!r}; save each segment to a file of its own"
            )
    late = 1e-9 * (_moment(told, segment, 0) - _moment(told, first, 0))
    continued: list[Column] = []
    for old, new in zip(joined, after, strict=True):
        assert old.time is not None and new.time is not None  # made by `_channels`
        past, coming = old.time.values, new.time.values
        step = float(np.median(np.diff(past))) if past.size > 1 else np.nan
        gaps = [(coming[0] + shift - past[-1]) / step for shift in (0.0, late)]
        fits = [gap > 0.5 and abs(gap - np.rint(gap)) <= _NEAR for gap in gaps]
        follows = fits[0] and np.rint(gaps[0]) == 1.0
        if not (follows or fits[1]):
            raise InputError(
                f"{where}: the segment that begins here starts {gaps[1]:.6g} samples after the last one of the segment "
                f"in line {before.line}, which is no whole number above 0; save each segment to a file of its own"
            )
        times = np.concatenate([past, coming + (0.0 if follows else late)])
        values = np.concatenate([old.values, new.values])
        continued.append(replace(old, values=values, time=replace(old.time, values=times)))
    return tuple(continued)


def _doubts(told: _File, segment: _Segment) -> tuple[str, ...]:
    """Return a sentence where only a Delta_X of few digits states the rate."""
    word = _cell(segment.header, "delta_x")
    digits = len(word.lower().partition("e")[0].replace(told.mark, "").strip("+-0"))
    exact = digits >= _DIGITS or not word
    rate = 1.0 / (_stated(told, segment, "delta_x", 0) or np.nan)
    if told.x_columns != "no" or exact or abs(rate - np.rint(rate)) <= 1e-6 * rate:
        return ()
    return (
        f"Delta_X is written with {digits} digits and no X values are saved: the rate is {rate:.6g} Hz if it is exact",
    )
