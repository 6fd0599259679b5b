"""Measured time histories in text: one row per sample, columns separated by comma, semicolon, tab or spaces."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, repeat
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.foreign_texts import format_of, is_date
from rths_cli.files.measured_data.labview_files import is_labview, labview_contents
from rths_cli.files.measured_data.recording import Column, Contents, stated_interval, states_start
from rths_cli.files.measured_data.time_stamps import stamps_ns
from rths_cli.files.measured_data.units import is_time, is_unit, rate_factor, time_factor
from rths_cli.numerics.lti import Array

MISSING = frozenset({"", "nan", "-", "--", "---", "na", "n/a", "#n/a", "null", "none"})
"""Cells, in lower case, that stand for a missing sample."""
_HEADER_LINES = 200
_CHUNK_ROWS = 8192
_FAULTS = 12
_COMMENT = ("#", "%")
_LONGEST_LINE = 100_000
_STATED = re.compile(r"[a-z_ ]*[a-z_] ?\"? ?(?:[(\[][^()\[\]]*[)\]])? ?", re.IGNORECASE)  # of a line with single spaces
_VALUE = re.compile(r"[\s\"]*([\d.,]*\d\.?(?:e[+-]?\d+)?)(.*)", re.IGNORECASE)
_THOUSANDS = re.compile(r"[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?")
_NO_NAME = '#%" \t\r\f\v'


@dataclass(frozen=True)
class Layout:
    """How the rows of a text are written: separator (None: spaces), first row's index, and the header's statements."""

    separator: str | None
    first: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    intervals_s: tuple[tuple[str, float], ...]
    starts_s: tuple[float | None, ...]  # of each column, None where no line above states any


def text_contents(path: Path, text: str) -> Contents:
    """Return the columns of a text.

    Raises InputError, with the line, for a text without rows of numbers, a header that does not fit them, rows of
    different length, two decimal marks, and cells that are neither numbers nor missing.
    """
    lines = text.splitlines()
    long = next((k for k, line in enumerate(lines, 1) if len(line) > _LONGEST_LINE), None)
    if long is not None:
        raise InputError(f"{path}:{long}: {len(lines[long - 1])} characters in a line, at most {_LONGEST_LINE}; cut it")
    if is_labview(lines):
        return labview_contents(path, lines)
    foreign = format_of(lines)
    if foreign:
        raise InputError(f"{path}: {foreign}")
    while lines and not lines[-1].strip(" ,;\t"):
        lines.pop()
    layout = _layout(path, lines)
    kept = [k for k in range(layout.first, len(lines)) if lines[k] and lines[k][0] not in _COMMENT]
    kept = _one_table(path, lines, kept, layout)
    rows, stamps = _without_stamps(path, [lines[k] for k in kept], kept, layout.separator)
    rows = _one_decimal_mark(path, rows, kept, layout.separator)
    _check_quotes(path, rows, kept, layout.separator)
    _check_lengths(path, rows, kept, layout)
    values = _numbers(path, rows, kept, layout)
    columns = [Column(*each) for each in zip(layout.names, values.T, layout.units, layout.starts_s, strict=True)]
    columns, notes = _with_stamps(columns, stamps)
    columns = [c for c in columns if c.name or not np.isnan(c.values).all()]
    named = [c if c.name else replace(c, name=f"column {k}") for k, c in enumerate(columns, 1)]
    return Contents(tuple(named), layout.intervals_s, notes, line_of=lambda row: kept[row] + 1, format="text")


def _one_table(path: Path, lines: list[str], kept: list[int], layout: Layout) -> list[int]:
    """Return the rows without repeated heads; raise InputError where another table begins below the rows."""
    above = {line.strip() for line in lines[: layout.first] if line.strip()}
    heads = [k for k in kept if lines[k].strip() in above]
    behind = [after for k, after in pairwise(kept) if not all(lines[k + 1 : after])]
    heads = heads or (behind if len(behind) < len(kept) - 1 else [])  # else every row has a blank line behind it
    if (
        heads
        and not any(map(is_time, layout.names))
        and not any(map(is_date, _cells(lines[kept[0]], layout.separator)))
    ):
        raise InputError(
            f"{path}:{heads[0] + 1}: another block of rows begins here, and no time says how it follows the rows "
            "above; add a time column, or give each block in a file of its own"
        )
    kept = [k for k in kept if lines[k].strip() not in above]
    for k in kept:
        cells = _cells(lines[k], layout.separator) if lines[k][:1].isalpha() or lines[k][:1] == '"' else []
        words = [cell for cell in cells if cell.lower() not in MISSING and not is_date(cell)]
        if len(words) > 1 and not any(map(_is_number, words)):
            raise InputError(
                f"{path}:{k + 1}: another table begins below the rows of the first one ({words[0][:40]!r}, "
                f"{words[1][:40]!r}); give each table in a file of its own"
            )
    return kept


def _without_stamps(
    path: Path, rows: list[str], kept: Sequence[int], separator: str | None
) -> tuple[list[str], dict[int, Array]]:
    """Return the rows with empty cells in place of dates and times of day, and the seconds of each such column (n,).

    Raises InputError with the first cell that is none.
    """
    first = _cells(rows[0], separator) if separator else []
    places = [k for k, cell in enumerate(first) if is_date(cell)]
    if not places:
        return rows, {}
    split = [row.split(separator) for row in rows]
    seconds: dict[int, Array] = {}
    stamps = {k: [cells[k].strip(" \"'") if k < len(cells) else "" for cells in split] for k in places}
    if len(places) == 2 and ":" not in first[places[0]]:  # a date, and the time of that day
        stamps = {places[1]: [" ".join(pair) for pair in zip(*stamps.values(), strict=True)]}
    for place, words in stamps.items():
        found = stamps_ns(words)
        if found is None:
            bad = next(k for k, word in enumerate(words) if stamps_ns([word]) is None)
            raise InputError(
                f"{path}:{kept[bad] + 1}: column {place + 1} holds dates or times of day, {words[bad][:40]!r} is none; "
                "write 2026-02-03T10:00:00.002, 03.02.2026 10:00:00.002 or 10:00:00.002, or the time in s"
            )
        seconds[place] = (found - found[0]) / 1e9
    blank = [(separator or ",").join("" if k in places else c for k, c in enumerate(cells)) for cells in split]
    return blank, {place: seconds.get(place, np.zeros(len(rows))) for place in places}


def _with_stamps(columns: list[Column], stamps: dict[int, Array]) -> tuple[list[Column], tuple[str, ...]]:
    """Return the columns with one time in s from the stamps (a date and a time of day are added), and a sentence where
    they are not used, because the file has another time."""
    rest = [column for k, column in enumerate(columns) if k not in stamps]
    if not stamps:
        return columns, ()
    if any(is_time(column.name) for column in rest):
        return rest, ("its dates and times of day are not used, because it has a time column",)
    time = Column("time (s)", np.sum(list(stamps.values()), axis=0))
    return [time, *rest], ()


def _layout(path: Path, lines: list[str]) -> Layout:
    """Find the first row of numbers and read what stands above it."""
    index = next((k for k, line in enumerate(lines[:_HEADER_LINES]) if _is_row(line)), None)
    if index is None:
        raise InputError(
            f"{path}: no row of numbers in the first {_HEADER_LINES} lines; give names in the first line, then one row "
            "of numbers per sample, time in s"
        )
    separator = _separator(lines[index])
    count = len(_cells(lines[index], separator))
    above = [(number, line) for number, line in enumerate(lines[:index], 1) if line.strip()]
    alone = {number: stated for number, line in above if (stated := interval_in_line(path, number, line))}
    intervals = list(alone.values())
    intervals += [each for number, line in above for each in _intervals_of_columns(path, number, line, separator)]
    stating = [(number, line) for number, line in above if _of_columns(line, separator)[1]]
    above = [(number, line) for number, line in above if number not in alone]
    _check_above(path, above, separator, count)
    names, units = _names(path, above, separator, count)
    times = [is_time(n) or is_date(cell) for n, cell in zip(names, _cells(lines[index], separator), strict=True)]
    found = (starts for number, line in stating if (starts := _starts(path, number, line, separator, times)))
    return Layout(separator, index, names, units, tuple(intervals), next(found, (None,) * count))


def _of_columns(line: str, separator: str | None) -> tuple[str, list[float | None]]:
    """Return the name of a line such as `X0 <tab> 0,0 <tab> 0,0015` and a number for each column after the first, None
    for a cell that is none; no numbers where the line states fewer than two."""
    name, *cells = _cells(line.lstrip("#% "), separator) or [""]
    numbers = [_number(text) if _is_number(text := cell.replace(",", ".")) else None for cell in cells]
    numbers = [None if number is None or np.isnan(number) else number for number in numbers]
    return name, numbers if sum(number is not None for number in numbers) > 1 else []


def _intervals_of_columns(path: Path, number: int, line: str, separator: str | None) -> list[tuple[str, float]]:
    """Return the intervals in s that a line such as LabVIEW's `Delta_X` states, one per column."""
    stated, values = _of_columns(line, separator)
    name, unit = _name_and_unit(stated)
    key = "dt" if name.lower().replace("_", "") == "deltax" else name
    if not values or stated_interval(key, 1.0) is None:
        return []
    factor = _stated_factor(path, number, key, unit)
    found = [stated_interval(key, value * factor) for value in values if value is not None]
    return [(f"line {number} ({name})", interval) for interval in found if interval is not None]


def _starts(
    path: Path, number: int, line: str, separator: str | None, times: Sequence[bool]
) -> tuple[float | None, ...]:
    """Return the starts in s of the columns, None for the `times`, that a line such as LabVIEW's `X0` states for each
    column or each channel; () for any other line. Raises InputError where their numbers do not fit."""
    stated, values = _of_columns(line, separator)
    name, unit = _name_and_unit(stated)
    if not values or not states_start(name):
        return ()
    factor = _stated_factor(path, number, name, unit)
    starts = [None if value is None else value * factor for value in values]
    while starts and starts[-1] is None:
        starts.pop()
    channels = times.count(False)
    if len(starts) not in (channels, len(times)):
        raise InputError(
            f"{path}:{number}: {name} states {len(starts)} starts above rows of {channels} channels; give one for each"
        )
    if len(starts) == len(times):
        return tuple(None if is_x else start for is_x, start in zip(times, starts, strict=True))
    each = iter(starts)
    return tuple(None if is_x else next(each) for is_x in times)


def _is_row(line: str) -> bool:
    """Say whether every cell of a line is a number or missing, and one at least is a number."""
    cells = [cell for cell in _cells(line, _separator(line)) if not is_date(cell)]
    return not line.lstrip().startswith(_COMMENT) and _all_numbers(cells)


def _separator(line: str) -> str | None:
    """Return what separates the cells of a row."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def _cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, quotes and spaces around them removed; a bracket belongs to the word before it."""
    if separator is None:
        return [cell.strip("\"'") for cell in re.split(r"\s+(?![(\[])", line.strip())]
    return [cell.strip().strip("\"'").strip() for cell in next(csv.reader([line], delimiter=separator))]


def _all_numbers(cells: list[str]) -> bool:
    """Say whether every cell is a number or missing, and one at least is a number."""
    numbers = [cell for cell in cells if cell.lower() not in MISSING]
    return bool(numbers) and all(_is_number(cell) for cell in numbers)


def _is_number(cell: str) -> bool:
    """Say whether a cell is a number, with a decimal point or comma."""
    try:
        _number(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _check_above(path: Path, above: list[tuple[int, str]], separator: str | None, count: int) -> None:
    """Raise InputError where the line above the first row looks like a row with a faulty cell."""
    if not above or above[-1][1].lstrip().startswith(_COMMENT):
        return
    number, line = above[-1]
    cells = _cells(line, separator)
    bad = [cell for cell in cells if cell.lower() not in MISSING and not _is_number(cell)]
    if bad and len(cells) == count and any(_is_number(cell) and cell.lower() not in MISSING for cell in cells):
        raise InputError(f"{path}:{number}: {bad[0][:40]!r} is not a number; correct the cell or leave it empty")


def _names(
    path: Path, above: list[tuple[int, str]], separator: str | None, count: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of the columns from the lines above the first row, blank where there are none."""
    split = [(number, line, _cells(line.lstrip("#% "), separator)) for number, line in above]
    fitting = [cells for _, _, cells in split if len(cells) == count and any(cells) and not _all_numbers(cells)]
    plain = [(number, cells) for number, line, cells in split if not line.lstrip().startswith(_COMMENT)]
    if plain and len(plain[-1][1]) not in (1, count):
        number, cells = plain[-1]
        raise InputError(f"{path}:{number}: {len(cells)} names above rows of {count} cells; name every column once")
    blank = ("",) * count
    if not fitting:
        return blank, blank
    if len(fitting) > 1 and _are_units(fitting[-1], fitting[-2]):
        return tuple(fitting[-2]), tuple(cell.strip(" -[]()") for cell in fitting[-1])
    return tuple(fitting[-1]), blank


def _are_units(cells: list[str], above: list[str]) -> bool:
    """Say whether a row of cells holds the units of the names above: half of them are known, or that of the time is."""
    of_time = any(is_time(name) and cell and time_factor("", cell) for name, cell in zip(above, cells, strict=True))
    return of_time or 2 * sum(map(is_unit, cells)) >= len(cells)


def interval_in_line(path: Path, number: int, line: str) -> tuple[str, float] | None:
    """Return the place and the sampling interval in s that a line such as `# dt: 0.5 ms` or `fs (kHz),2` states.

    None for any other line; `number` is the line's own, from 1. Raises InputError for a unit that is not known, and a
    comma that may stand between thousands.
    """
    told = line.lstrip(_NO_NAME)
    mark = re.search(r"[:=,;\t]", told)
    if mark is None:
        return None
    name, value = " ".join(told[: mark.start()].split()), told[mark.end() :].lstrip(" ")
    value = value[1:].lstrip() if mark[0] == "\t" and value[:1] in (":", "=", ",", ";") else value
    match = _VALUE.match(value) if _STATED.fullmatch(name) else None
    plain, unit = _name_and_unit(name)
    if match is None or stated_interval(plain, 1.0) is None:
        return None
    if _THOUSANDS.fullmatch(match[1]):
        raise InputError(
            f"{path}:{number}: {plain} is {match[1]!r}, in which the comma may stand between thousands or before a "
            "fraction; write it without comma"
        )
    per_column = mark[0] == "," and "," in match[1] and not match[1].startswith("0,")  # one number for each column
    cell = match[1].replace(",", ".")
    if per_column or not _is_number(cell):
        return None
    factors = {_stated_factor(path, number, plain, text) for text in (unit, _unit_behind(match[2])) if text} or {1.0}
    if len(factors) > 1:
        raise InputError(f"{path}:{number}: {plain} has two units that differ; correct or remove one of them")
    interval = stated_interval(plain, float(cell) * factors.pop())
    return None if interval is None else (f"line {number} ({plain})", interval)


def _name_and_unit(text: str) -> tuple[str, str]:
    """Return a name such as `Sample rate (kHz)` without its brackets, and what stands in them."""
    name, _, unit = re.sub(r"[\"\[\])]", lambda mark: "(" if mark[0] == "[" else "", text).partition("(")
    return name.strip(), unit.strip()


def _unit_behind(rest: str) -> str:
    """Return the unit in what follows a stated number: a word, or the next cell where it is the last; "" if none."""
    same, *cells = (cell.strip(' ".') for cell in re.split(r"[;,\t]", rest))
    filled = [cell for cell in cells if cell]
    word = same or (filled[0] if len(filled) == 1 else "")
    word = re.sub(r"^[(\[]([^()\[\]]*)[)\]].*", r"\1", word).strip()
    if rate_factor(word):
        return word
    word = word.partition(" ")[0]
    return word if re.fullmatch(r"[^\W\d_][^=:]*", word) else ""


def _stated_factor(path: Path, number: int, name: str, unit: str) -> float:
    """Return what a figure in a stated unit is in Hz for a rate, else in s."""
    is_rate = stated_interval(name, 2.0) == 0.5
    factor = rate_factor(unit) if is_rate else time_factor("", unit)
    if factor is None:
        known = "Hz or kHz" if is_rate else "s, ms or us"
        raise InputError(f"{path}:{number}: {name} is stated in {unit[:40]!r}, which is not known; give it in {known}")
    return factor


def _one_decimal_mark(path: Path, rows: list[str], kept: Sequence[int], separator: str | None) -> list[str]:
    """Return the rows with decimal points; raise InputError where points and commas are mixed."""
    if separator not in (";", "\t"):
        return rows
    comma = next((k for k, row in enumerate(rows) if "," in row), None)
    if comma is None:
        return rows
    point = next((k for k, row in enumerate(rows) if "." in row), None)
    if point is not None:
        raise InputError(
            f"{path}:{kept[max(comma, point)] + 1}: decimal points and commas are mixed (the other stands in line "
            f"{kept[min(comma, point)] + 1}); write one of them throughout"
        )
    return [row.replace(",", ".") for row in rows]


def _check_quotes(path: Path, rows: list[str], kept: Sequence[int], separator: str | None) -> None:
    """Raise InputError with the first quoted cell that has a comma between commas."""
    for k, row in zip(kept, rows, strict=True) if separator == "," else ():
        cell = next((cell for cell in next(csv.reader([row])) if "," in cell), "") if '"' in row else ""
        if cell:
            raise InputError(
                f"{path}:{k + 1}: {cell[:40]!r} has a comma, before a fraction or between thousands, where commas "
                "separate the cells; save it with decimal points, or with semicolons between the cells"
            )


def _check_lengths(path: Path, rows: list[str], kept: Sequence[int], layout: Layout) -> None:
    """Raise InputError with the first row whose number of cells differs from the header's."""
    count, mark = len(layout.names), layout.separator
    cells = [len(row.split()) for row in rows] if mark is None else [n + 1 for n in map(str.count, rows, repeat(mark))]
    if set(cells) == {count}:
        return
    faulty = [k for k, number in enumerate(cells) if number != count]
    raise InputError(
        f"{path}:{kept[faulty[0]] + 1}: {cells[faulty[0]]} cells in this row ({len(faulty)} such rows), {count} in the "
        "first; give every row the same, empty cells for missing samples"
    )


def _numbers(path: Path, rows: list[str], kept: Sequence[int], layout: Layout) -> Array:
    """Return the figures, (n, c), NaN where missing; raise InputError with the first faulty cell of each column."""
    values = np.empty((len(rows), len(layout.names)))
    faults: dict[int, str] = {}
    for start in range(0, len(rows), _CHUNK_ROWS):
        part = slice(start, start + _CHUNK_ROWS)
        try:
            values[part] = _quick(rows[part], layout)
        except ValueError:  # cells that only `_number` understands, or nobody
            values[part] = [
                _row(f"{path}:{k + 1}", row, layout, faults) for k, row in zip(kept[part], rows[part], strict=True)
            ]
    if faults:
        raise InputError(*list(faults.values())[:_FAULTS])
    return values


def _quick(rows: list[str], layout: Layout) -> Array:
    """Return the figures of rows, NaN for empty cells; raise ValueError for any other cell that is no number."""
    mark = layout.separator
    if mark is None or not any(mark + mark in row or row[-1] == mark or row[0] == mark for row in rows):
        return np.loadtxt(rows, delimiter=mark, comments=None, ndmin=2)
    joined = mark.join(rows)
    if "_" in joined:
        raise ValueError(joined)
    return np.reshape([float(cell) if cell else np.nan for cell in joined.split(mark)], (len(rows), -1))


def _row(where: str, row: str, layout: Layout, faults: dict[int, str]) -> list[float]:
    """Return the figures of a row, NaN where missing; add a sentence to `faults` for the first bad cell of a column."""
    cells = row.split(layout.separator)
    values = [float("nan")] * len(cells)
    for k, cell in enumerate(cells):
        try:
            values[k] = _number(cell)
        except ValueError:
            name, bad = layout.names[k] or f"column {k + 1}", cell.strip()[:40]
            faults.setdefault(k, f"{where}: {name}: {bad!r} is not a number; correct the cell or leave it empty")
    return values


def _number(cell: str) -> float:
    """Return the number a cell holds, NaN for a missing one; raise ValueError for anything else."""
    word = cell.strip().strip("\"'").strip()
    if word.lower() in MISSING:
        return float("nan")
    if "_" in word:
        raise ValueError(word)
    return float(word)
