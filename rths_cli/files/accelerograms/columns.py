"""Accelerations in columns of text, with or without a time, and in rows of several values: our CSV, spreadsheets, paths
of OpenSees; units and interval from comments, names or the case."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import FACTORS_M_S2, find_unit
from rths_cli.files.accelerograms.record import (
    Channel,
    Header,
    bracketed,
    check_count,
    check_moves,
    count_of,
    interval_of,
    known_unit,
    with_interval,
)
from rths_cli.files.foreign_texts import is_date, rounded_times
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import shortened

_KEY = re.compile(r"#\s*(units?|dt|samples|origin)\s*:\s*(.*)", re.IGNORECASE)
_ANY_KEY = re.compile(r"#\s*\w+\s*:")
_SUFFIX = re.compile(r"_((?:m|cm|mm|in|ft)_?s\^?2|gal|m?g)$", re.IGNORECASE)
_TIME_SUFFIX = re.compile(r"_(\w?s)$", re.IGNORECASE)
MAX_TIME_S = 1e12  # seconds since 1970 are below
_EVENNESS = 0.04
"""Time steps may differ by this part of the interval: files print few digits."""
_SMOOTHER, _ALIKE = 0.8, 2.0
"""What rows of one series keep: real records have 0.22 to 0.60, and 0.66 to 1.3."""
_FALLS = 0.2  # of the steps of a column that is no time
_TEXT_LINES = 100  # above figures
COUNTED = ("PEER AT2", "K-NET ASCII", "DYNA")  # whose header states how many figures there are
ONE_SERIES = (*COUNTED, "rows of values")
IN_ROWS = (
    "; if the rows are one series, written several values a line, write one value a line, or, where every row runs on "
    "smoothly into the next, state its interval (record.dt_s, # dt:)"
)
_SEPARATORS = str.maketrans(",;\t", "   ")
_DOUBLE = re.compile(r"(?<=[\d.])[dD](?=[-+]?\d)")  # Fortran's exponent
_GROWN = re.compile(r"(?<=[\d.])(?=[-+])")  # fields of fixed width, of which a sign fills one


def column_header(path: Path, lines: list[str]) -> Header:
    """Return what comment lines (`# units: g`, `# dt: 0.02 s`, `# samples: N`) and column names state."""
    stated: dict[str, tuple[str, int]] = {}
    title, index = "", 0
    while index < len(lines) and (not lines[index].strip() or lines[index].lstrip().startswith("#")):
        line = lines[index].strip()
        index += 1
        match = _KEY.match(line)
        if match is not None:
            _state(path, stated, match[1].lower().rstrip("s"), match[2].strip(), index)
        elif line and not title and _ANY_KEY.match(line) is None:
            title = line.lstrip("# ")
    if index < len(lines) and _is_names(lines[index]):
        index += 1
        unit = _unit_of_names(f"{path}:{index}", lines[index - 1])
        if unit is not None:
            _state(path, stated, "unit", unit, index)
    return _from_keys(path, stated, title, index)


def _state(path: Path, stated: dict[str, tuple[str, int]], key: str, value: str, line: int) -> None:
    """Keep a statement; lines of origin add up, anything else may be said once."""
    if key == "origin" and key in stated:
        value = f"{stated[key][0]} {value}"
    elif key in stated:
        raise InputError(f"{path}:{line}: {key} is stated here and in line {stated[key][1]}; keep one of the two")
    stated[key] = value, line


def _from_keys(path: Path, stated: dict[str, tuple[str, int]], title: str, first_line: int) -> Header:
    """Check the values of the comment lines and put them into a header."""
    unit, unit_line = stated.get("unit", (None, 0))
    dt, dt_line = stated.get("dt", (None, 0))
    samples, samples_line = stated.get("sample", (None, 0))
    return Header(
        "one column",
        first_line,
        title,
        stated.get("origin", ("", 0))[0],
        None if unit is None else known_unit(f"{path}:{unit_line}", unit),
        unit_line,
        None if dt is None else interval_of(f"{path}:{dt_line}", dt),
        dt_line,
        None if samples is None else count_of(f"{path}:{samples_line}", samples),
        samples_line,
    )


def split_columns(line: str) -> list[str]:
    """Return the cells of a line, separated by commas, semicolons, tabs or spaces not before a bracket."""
    cells = re.split(r"[,;\t]", line) if re.search(r"[,;\t]", line) else re.split(r"\s+(?![(\[])", line.strip())
    return [cell.strip().strip("\"'") for cell in cells if cell.strip()]


def is_number(word: str) -> bool:
    """Say whether a word can be read as a number."""
    try:
        float(_DOUBLE.sub("E", word))
    except ValueError:
        return False
    return True


def _is_names(line: str) -> bool:
    """Say whether a line names columns: one or two cells, none of them a number, and no unnamed one before them."""
    cells = split_columns(line)
    return not re.match(r"\s*[,;]", line) and 0 < len(cells) <= 2 and not any(is_number(cell) for cell in cells)


def _unit_of_names(where: str, line: str) -> str | None:
    """Return the unit in names like `time (s), acceleration (g)` or `time_s,accel_m_s2`, None if silent."""
    *time, accel = split_columns(line)
    if re.match(r"vel|disp", accel, re.IGNORECASE):
        raise InputError(
            f"{where}: the column {shortened(accel, 80)!r} is not an acceleration; give the acceleration record"
        )
    if time and find_unit(bracketed(time[0]) or ""):
        return None  # two accelerations, each with its own unit
    if time:
        suffix = _TIME_SUFFIX.search(time[0])
        unit = bracketed(time[0]) or (suffix[1] if suffix else "s")
        if unit.strip().lower() not in ("s", "sec", "seconds"):
            raise InputError(f"{where}: the column {shortened(time[0], 80)!r} is not a time in s; give the time in s")
    bracket, suffix = bracketed(accel), _SUFFIX.search(accel)
    if bracket is not None:
        return known_unit(where, bracket)
    if suffix is None:
        return None
    return known_unit(where, re.sub(r"(m|cm|mm|in|ft)_?s\^?2", r"\1/s^2", suffix[1].lower()))


def read(path: Path, lines: list[str], dt_s: float | None) -> list[Channel]:
    """Return the accelerations of a text of columns or rows, one channel per column that holds one.

    `dt_s` is the interval in s that the case states; only with a stated interval can a series stand in rows. Raises
    InputError as `read_accelerogram` does.
    """
    header = column_header(path, lines)
    first = next((words for _, words in _rows(lines, header)), [])
    rows = lines[header.first_line : header.first_line + 9]  # a first one is often `0;0`
    motions = [name for name in _names_above(lines, header) if find_unit(bracketed(name) or "")]
    named = first and not all(map(is_number, first)) and _names_stand_above(lines)
    if any(map(_decimal_commas, rows)) or named or len(motions) == 2:
        return _of_table(path, lines, header)
    if _is_series(lines, header, dt_s or header.dt_s):
        header = replace(header, layout="rows of values")
        return [series(path, lines, header)]
    values = _read_values(path, lines, header)
    channel = Channel(header, values[:, -1], lambda sample: _line_of(lines, header, sample))
    if values.shape[1] == 2:
        _check_is_time(path, lines, header, values[:, 0])
        header = with_interval(path, header, _even_interval(path, channel.line_of, values[:, 0]))
        channel = replace(channel, header=header)
    return [channel]


def _check_is_time(path: Path, lines: list[str], header: Header, first: Array) -> None:
    """Raise InputError where the first of two columns (n,), not named a time, falls too often or does not move."""
    from rths_cli.files.measured_data.units import is_time

    steps = np.diff(first)
    falls = int((steps < 0.0).sum())
    stands = steps.size > 0 and float(np.median(steps)) <= 0.0 and rounded_times(first) is None
    if any(is_time(name) or _seconds(name, "") for name in _names_above(lines, header)[:1]):
        return
    if falls <= max(2, _FALLS * steps.size) and not stands:
        return
    what = f"it falls {falls} times" if falls else "it stands still"
    raise InputError(
        f"{path}:{header.first_line + 1}: two columns, and the first is no time ({what}); give one (acceleration), or "
        "name two accelerations with their units, for instance NS (g), EW (g)"
        f"{_of_decimal_commas(lines[header.first_line]) or IN_ROWS}"
    )


def series(path: Path, lines: list[str], header: Header) -> Channel:
    """Return the one series that stands in rows of any number of values below a header."""
    values = _read_values(path, lines, header)
    return Channel(header, values[:, -1], lambda sample: _line_of(lines, header, sample))


def _is_series(lines: list[str], header: Header, dt_s: float | None) -> bool:
    """Return whether rows of numbers between spaces are one series in its order: their interval is stated, no names
    stand above each column, the first column is no time, and every row runs on into the next."""
    rows = [words for _, words in _rows(lines, header)]
    marked = any(mark in line for line in lines[header.first_line :] for mark in ",;")
    named = len(rows) > 0 and len(_names_above(lines, header)) == len(rows[0]) > 1
    if (
        dt_s is None
        or marked
        or named
        or len(rows) < 2
        or not all(map(is_number, (word for row in rows for word in row)))
    ):
        return False
    widths = [len(row) for row in rows]
    if len(set(widths[:-1])) > 1 or widths[-1] > widths[0]:
        return max(widths) > 2
    table = np.array(rows if widths[-1] == widths[0] else rows[:-1], dtype=float)
    if widths[0] < 2 or not np.isfinite(table).all():
        return False
    if len(table) < 2:
        return widths[0] > 2
    steps = np.diff(table[:, 0])
    if (steps > 0.0).all() and np.ptp(steps) <= 2.0 * _EVENNESS * steps.mean():
        return False  # a time
    return _run_on(table)


def _run_on(table: Array) -> bool:
    """Return whether rows (n, m) continue each other: values step from row to row as they do within a row, and by less
    than down a column. Columns that resemble each other step less within a row."""
    within, between, down = np.diff(table, axis=1), table[1:, 0] - table[:-1, -1], np.diff(table, axis=0)
    step, last = float(np.abs(within).mean()), float(np.abs(between).mean())
    smooth = (step * within.size + last * between.size) / (table.size - 1) <= _SMOOTHER * float(np.abs(down).mean())
    return smooth and step <= _ALIKE * last <= _ALIKE**2 * step


def _names_above(lines: list[str], header: Header) -> list[str]:
    """Return the names of columns in the last line above the figures, [] where it holds none."""
    line = lines[header.first_line - 1] if header.first_line else "#"
    return [] if line.lstrip().startswith("#") or not _is_names(line) else split_columns(line)


def _names_stand_above(lines: list[str]) -> bool:
    """Return whether a row of numbers follows, within a header's length, on a line that is none."""
    found = False
    for line in lines[:_TEXT_LINES]:
        cells = split_columns(line)
        if cells and not line.lstrip().startswith("#"):
            if all(is_number(cell.replace(",", ".")) or is_date(cell) for cell in cells):
                return found
            found = len(cells) > 1 and not any(map(is_number, cells)) and any(map(_names_a_quantity, cells))
    return False


def _names_a_quantity(cell: str) -> bool:
    """Return whether a cell above a column is a name: of a time, a motion, or with a unit."""
    named = re.fullmatch(r"t|time|a|acc\w*|vel\w*|disp\w*", cell, re.IGNORECASE) or bracketed(cell)
    return bool(named or _SUFFIX.search(cell) or _TIME_SUFFIX.search(cell))


def _of_table(path: Path, lines: list[str], header: Header) -> list[Channel]:
    """Return the columns of a table that are accelerations by their unit or name; its time is even."""
    from rths_cli.files.measured_data.text_tables import text_contents
    from rths_cli.files.measured_data.units import is_time, time_factor, unit_of

    contents = text_contents(path, "\n".join(lines))
    line_of = contents.line_of or (lambda row: row + 1)
    columns = list(contents.columns)
    unnamed = all(re.fullmatch(r"column \d+", column.name) for column in columns)
    timed = [k for k, c in enumerate(columns) if is_time(c.name) or _seconds(c.name, c.unit)]
    timed = timed or ([0] if unnamed and len(columns) == 2 else [])
    names_line = line_of(0) - 1
    header = replace(header, layout="columns", first_line=names_line, unit_line=header.unit_line or names_line)
    if contents.intervals_s and header.dt_s is None:
        header = replace(header, dt_s=contents.intervals_s[0][1], dt_line=names_line)
    if timed:
        factor = time_factor(columns[timed[0]].name, columns[timed[0]].unit)
        if factor is None:
            raise InputError(
                f"{path}:{names_line}: the column {columns[timed[0]].name!r} is not a time in s; give it in s"
            )
        time_s = _whole(path, columns[timed[0]].values, line_of, "time") * factor
        header = with_interval(path, header, _even_interval(path, line_of, time_s))
    others = [c for k, c in enumerate(columns) if k not in timed]
    units = [unit_of(c.name, c.unit)[0] for c in others]
    found = [(c, u) for c, u in zip(others, units, strict=True) if u in FACTORS_M_S2]
    if not found:
        found = [(c, "") for c in others if re.match(r"\W*a(cc|$|\W|_)", c.name, re.IGNORECASE)]
    if not found and len(others) == 1 and not re.match(r"vel|disp", others[0].name, re.IGNORECASE):
        found = [(others[0], "")]
    if not found:
        told = ", ".join(shortened(c.name, 30) for c in columns[:8])
        raise InputError(
            f"{path}:{names_line}: none of the columns ({told}) is an acceleration by its unit or name; name it with "
            "its unit, for instance acceleration (g)"
        )
    for column, unit in found:
        if unit and header.unit and FACTORS_M_S2[unit] != FACTORS_M_S2[header.unit]:
            raise InputError(
                f"{path}:{header.unit_line}: the unit is stated as {header.unit}, the column "
                f"{shortened(column.name, 40)!r} (line {names_line}) states {unit}; correct or remove one of them"
            )
    several = len(found) > 1
    return [
        Channel(
            replace(header, unit=u or header.unit),
            _whole(path, c.values, line_of, c.name),
            line_of,
            names=(_without_unit(c.name), c.name) if several else (),
        )
        for c, u in found
    ]


def _without_unit(name: str) -> str:
    return re.split(r"[(\[]", name)[0].strip() or name


def _seconds(name: str, unit: str) -> bool:
    """Return whether a column in any language states s as its unit."""
    return (unit or bracketed(name) or "").strip(" []()").lower() in ("s", "sec", "ms")


def _whole(path: Path, values: Array, line_of: Callable[[int], int], name: str) -> Array:
    """Return a column (n,) of which no sample is missing; raises InputError."""
    missing = np.flatnonzero(~np.isfinite(values))
    if missing.size:
        raise InputError(
            f"{path}:{line_of(int(missing[0]))}: {missing.size} of {values.size} samples of {shortened(name, 40)!r} "
            "are missing; mend or cut the record"
        )
    check_moves(path, values)
    return values


def _read_values(path: Path, lines: list[str], header: Header) -> Array:
    """Return the figures after the header, (n_samples, 1 or 2), finite and as many as the header states."""
    body = _plain("\n".join(lines[header.first_line :]), header)
    if not any(_rows(lines, header)):
        raise InputError(f"{path}: holds no numbers; name an accelerogram file")
    try:
        is_table = header.layout not in ONE_SERIES
        values = np.loadtxt(io.StringIO(body), ndmin=2) if is_table else np.array([body.split()], dtype=float).T
    except ValueError:
        raise InputError(_first_bad_line(path, lines, header)) from None
    if values.shape[1] > 2:
        raise InputError(
            f"{path}:{header.first_line + 1}: {values.shape[1]} columns; give one (acceleration) or "
            f"two (time in s, acceleration){_of_decimal_commas(lines[header.first_line]) or IN_ROWS}"
        )
    faulty = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(faulty):
        line = _line_of(lines, header, int(faulty[0]))
        raise InputError(f"{path}:{line}: sample {faulty[0] + 1} is not a finite number; mend or cut the record")
    check_count(path, header, len(values))
    if (
        header.layout not in COUNTED
        and values.shape[1] == 1
        and len(values) > 50
        and len(values) - values[0, 0] in (1, 2)
    ):
        raise InputError(
            f"{path}:{_line_of(lines, header, 0)}: the first figure, {values[0, 0]:g}, is the number of those that "
            "follow it; begin its line with #, and state the interval as # dt: 0.01 s or record.dt_s"
        )
    check_moves(path, values[:, -1])
    return values


def _decimal_commas(line: str) -> bool:
    """Return whether a line is numbers, some with decimal commas, between semicolons or tabs."""
    number = r"\s*[-+]?\d+(,\d+)?([eE][-+]?\d+)?\s*"
    return "," in line and bool(re.fullmatch(rf"{number}([;\t]{number})+;?\s*", line))


def _of_decimal_commas(line: str) -> str:
    """Return what to do where a line looks like numbers with decimal commas, "" where it does not."""
    if re.fullmatch(r"\s*[-+]?[0-9]+,[0-9]+(\s*;\s*[-+]?[0-9]+,[0-9]+)*\s*;?\s*", line):
        return f"; decimal commas? write {line.strip().replace(',', '.')}"
    if re.fullmatch(r"\s*[-+]?[0-9]+,[0-9]+,[-+]?[0-9]+,[0-9]+\s*", line):
        time, time_decimals, accel, decimals = line.strip().split(",")
        return f"; decimal commas? write {time}.{time_decimals},{accel}.{decimals}"
    return ""


def _first_bad_line(path: Path, lines: list[str], header: Header) -> str:
    """Name the first line that is not made of numbers or has another number of columns than the first."""
    columns = 0
    for number, words in _rows(lines, header):
        for word in words:
            if is_date(word):
                return _dated(path, number, word)
            if not is_number(word):
                if (
                    columns == 0
                    and header.layout not in COUNTED
                    and (above := _text_above(path, lines, header, number))
                ):
                    return above
                return (
                    f"{path}:{number}: {word[:40]!r} is not a number; give columns of numbers or a record as its "
                    "agency writes it, and convert other formats to CSV (time_s,accel_m_s2)"
                )
        columns = columns or len(words)
        if len(words) != columns and header.layout not in ONE_SERIES:
            held = f"{path}:{number}: holds {len(words)} of {columns} numbers"
            return f"{held}{IN_ROWS}" if max(columns, len(words)) > 2 else f"{held}; complete the row or remove it"
    return f"{path}: the figures cannot be read; convert the file to CSV (time_s,accel_m_s2)"


def _dated(path: Path, number: int, word: str) -> str:
    return f"{path}:{number}: {word[:40]!r} is a date or a time of day; give the time in s from the start"


def _text_above(path: Path, lines: list[str], header: Header, number: int) -> str:
    """Return what a line of text is that stands above the figures, "" where no figures follow it."""
    rows = [(n, words) for n, words in _rows(lines[: number + _TEXT_LINES], header) if n > number]
    first = next(((n, words) for n, words in rows if all(is_number(word) or is_date(word) for word in words)), None)
    if first is None:
        return ""
    count = len(first[1])
    if dates := [word for word in first[1] if is_date(word)]:
        return _dated(path, first[0], dates[0])
    if count > 2:
        return (
            f"{path}:{first[0]}: {count} columns below text; give one (acceleration) or two (time in s, acceleration), "
            "with their names and units in the first line, or begin the text with # if the rows are one series"
        )
    return (
        f"{path}:{number}: text above the figures, which begin in line {first[0]}; remove it or begin it with #, and "
        "let one line name the columns with their units (time_s,accel_m_s2)"
    )


def _rows(lines: list[str], header: Header) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and words of every line of figures, without comments and blank lines."""
    for number, line in enumerate(lines[header.first_line :], header.first_line + 1):
        words = _plain(line.partition("#")[0], header).split()
        if words:
            yield number, words


def _plain(text: str, header: Header) -> str:
    """Return figures between spaces, with exponents that Python reads."""
    text = _DOUBLE.sub("E", text.translate(_SEPARATORS))
    return _GROWN.sub(" ", text) if header.layout in COUNTED else text


def _line_of(lines: list[str], header: Header, sample: int) -> int:
    """Return the line number of a sample counted from 0."""
    count = 0
    for number, words in _rows(lines, header):
        count += len(words) if header.layout in ONE_SERIES else 1
        if count > sample:
            return number
    return len(lines)


def _even_interval(path: Path, line_of: Callable[[int], int], time_s: Array) -> float:
    """Return the interval of a time column (n,) in s; raise InputError where it falls back or is uneven."""
    beyond = int(np.argmax(np.abs(time_s)))
    if abs(time_s[beyond]) > MAX_TIME_S:
        where = f"{path}:{line_of(beyond)}"
        raise InputError(f"{where}: the time {time_s[beyond]:g} s is beyond {MAX_TIME_S:g} s; give the time in s")
    steps = np.diff(time_s)
    if len(steps) == 0:
        raise InputError(f"{path}: holds 1 sample, an accelerogram needs at least 3")
    usual = float(np.median(steps))
    faulty = np.flatnonzero(steps <= 0.0)
    if len(faulty) == 0:
        faulty = np.flatnonzero(np.abs(steps - usual) > _EVENNESS * usual)
    if len(faulty):
        digit = rounded_times(time_s)
        if digit is not None:
            raise InputError(
                f"{path}:{line_of(int(faulty[0]) + 1)}: the time (first column) has too few digits: it is even but "
                f"rounded to {digit:g} s; "
                "write it with more, or remove the column and state the interval (record.dt_s, # dt:)"
            )
        line, step = line_of(int(faulty[0]) + 1), steps[faulty[0]]
        what = "does not increase here" if step <= 0.0 else f"steps by {step:.6g} s here, elsewhere by {usual:.6g} s"
        raise InputError(f"{path}:{line}: the time (first column) {what}{_gap(steps, usual)}; give samples at an even "
            "interval")  # fmt: skip
    return float(f"{(time_s[-1] - time_s[0]) / len(steps):.9g}")


def _gap(steps: Array, usual: float) -> str:
    """Return how many samples are missing where a time (its steps (n,) in s) leaves whole samples out, else ""."""
    if usual <= 0.0:
        return ""
    missing = steps / usual - 1.0
    whole = np.round(missing)
    left_out = whole[whole >= 1.0]
    if not left_out.size or (np.abs(missing - whole) > _EVENNESS * (whole + 1.0)).any():
        return ""
    count, places = int(left_out.sum()), left_out.size
    return f" ({count} sample{'s' * (count > 1)} missing at {places} place{'s' * (places > 1)})"
