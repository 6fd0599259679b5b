"""Recorded ground accelerations from text files: our CSV, PEER .AT2, one or two columns; no guesses."""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import read_whole
from rths_cli.files.foreign_texts import format_of, is_date, lost_scans, rounded_times
from rths_cli.numerics.constants import FACTORS
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import MOST_DIGITS, shortened

FACTORS_M_S2 = FACTORS["acceleration"]
AMBIGUOUS = {"MV", "Mv", "MG", "Mg", "mG"}  # megavolt, megagram, milligauss

# Each is given a line with single spaces, so that none tries the ways to share a run of them.
_AT2_NEW = re.compile(r"NPTS ?= ?(\d+) ?,? ?DT ?= ?([\d.eE+-]+)", re.IGNORECASE)
_AT2_OLD = re.compile(r"^(\d+) ([\d.eE+-]+) NPTS ?, ?DT", re.IGNORECASE)
_AT2_UNIT = re.compile(r"UNITS? OF ([^ ,]+)", re.IGNORECASE)
_OTHER_RECORD = re.compile(r"^(VELOCITY|DISPLACEMENT)\b", re.IGNORECASE)
_AT2_LAST_LINE = 10
_KEY = re.compile(r"#\s*(units?|dt|samples|origin)\s*:\s*(.*)", re.IGNORECASE)
_ANY_KEY = re.compile(r"#\s*\w+\s*:")
_SUFFIX = re.compile(r"_((?:m|cm|mm|in|ft)_?s\^?2|gal|m?g)$", re.IGNORECASE)
_TIME_SUFFIX = re.compile(r"_(\w?s)$", re.IGNORECASE)


@dataclass(frozen=True)
class Header:
    """What a file states, None where it is silent; `first_line` counts the lines before the figures.

    The `_line` of a statement is its line number in the file, for messages.
    """

    layout: str
    first_line: int = 0
    title: str = ""
    origin: str = ""
    unit: str | None = None
    unit_line: int = 0
    dt_s: float | None = None
    dt_line: int = 0
    samples: int | None = None
    samples_line: int = 0


def find_unit(text: str) -> str | None:
    """Return the unit that a text such as `cm/s^2 (gal)` names, None if unknown or ambiguous."""
    parts = [part.strip() for part in re.split(r"[()\[\]=,]", text) if part.strip()]
    found = [_spelling(part) for part in parts if part not in AMBIGUOUS]
    factors = {FACTORS_M_S2.get(unit) for unit in found}
    return found[0] if len(found) == len(parts) and len(factors) == 1 and None not in factors else None


def _spelling(text: str) -> str:
    """Return one spelling of a unit: `M/SEC/SEC`, `m/s2` and `m/s²` are m/s^2."""
    unit = re.sub(r"\s", "", text).lower().rstrip(".").replace("²", "2")
    unit = unit.replace("sec", "s").replace("s/s", "s2")
    return re.sub(r"s(\*\*|\^)?2$", "s^2", unit)


def at2_header(path: Path, lines: list[str]) -> Header | None:
    """Return the header of a PEER .AT2 file, old or new, or None when no line states NPTS and DT."""
    for index, line in enumerate(map(_squeezed, lines[:_AT2_LAST_LINE])):
        match = _AT2_NEW.search(line) or _AT2_OLD.search(line)
        if match is None or line.startswith("#"):
            continue
        unit, unit_line = _at2_unit(path, lines[:index])
        return Header(
            "PEER AT2",
            first_line=index + 1,
            title=lines[1].strip() if index > 1 else "",
            origin=lines[0].strip() if index > 0 else "",
            unit=unit,
            unit_line=unit_line,
            dt_s=_interval(f"{path}:{index + 1}", match[2]),
            dt_line=index + 1,
            samples=_count(f"{path}:{index + 1}", match[1]),
            samples_line=index + 1,
        )
    return None


def _at2_unit(path: Path, lines: list[str]) -> tuple[str | None, int]:
    """Return the unit and its line from a header like `ACCELERATION TIME SERIES IN UNITS OF G`."""
    for number, line in enumerate(lines, 1):
        match = _AT2_UNIT.search(_squeezed(line))
        if match is not None:
            kind = _OTHER_RECORD.search(_squeezed(line))
            if kind is not None and find_unit(match[1]) is None:
                raise InputError(
                    f"{path}:{number}: is a {kind[1].lower()} record; give the acceleration record of the same station "
                    "(.AT2)"
                )
            return _known_unit(f"{path}:{number}", match[1]), number
    return None, 0


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
        None if unit is None else _known_unit(f"{path}:{unit_line}", unit),
        unit_line,
        None if dt is None else _interval(f"{path}:{dt_line}", dt),
        dt_line,
        None if samples is None else _count(f"{path}:{samples_line}", samples),
        samples_line,
    )


def _squeezed(line: str) -> str:
    """Return a line without spaces around it and with single ones in it."""
    return " ".join(line.split())


def _count(where: str, text: str) -> int:
    """Return a number of samples; raise InputError for any other text."""
    if not text.isdecimal() or len(text) > MOST_DIGITS:
        raise InputError(
            f"{where}: samples: {shortened(text, 40)!r} is not a whole number of at most {MOST_DIGITS} digits; "
            "correct it"
        )
    return int(text)


def bracketed(text: str) -> str | None:
    """Return what stands in the first brackets of a text, None where there are none."""
    start = min((place for place in (text.find("("), text.find("[")) if place >= 0), default=-1)
    ends = [place for place in (text.find(")", start), text.find("]", start)) if place >= 0]
    return text[start + 1 : min(ends)] if start >= 0 and ends else None


def _interval(where: str, text: str) -> float:
    """Return an interval in s, written with or without its unit."""
    match = re.fullmatch(r"([\d.eE+-]+) ?(s|sec|seconds)?", _squeezed(text))
    try:
        return float(match[1] if match else "")
    except ValueError:
        raise InputError(f"{where}: dt: {text[:40]!r} is not an interval in s; write for example 0.02 s") from None


def _known_unit(where: str, text: str) -> str:
    """Return the unit a text names, or raise InputError with the units understood."""
    unit = find_unit(text)
    if unit is None:
        raise InputError(f"{where}: {text[:40]!r} is not one of the units {', '.join(FACTORS_M_S2)}; correct it")
    return unit


def split_columns(line: str) -> list[str]:
    """Return the cells of a line, separated by commas, semicolons, tabs or spaces not before a bracket."""
    cells = re.split(r"[,;\t]", line) if re.search(r"[,;\t]", line) else re.split(r"\s+(?![(\[])", line.strip())
    return [cell.strip().strip("\"'") for cell in cells if cell.strip()]


def is_number(word: str) -> bool:
    """Say whether a word can be read as a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _is_names(line: str) -> bool:
    """Say whether a line names columns: one or two cells, none of them a number."""
    cells = split_columns(line)
    return 0 < len(cells) <= 2 and not any(is_number(cell) for cell in cells)


def _unit_of_names(where: str, line: str) -> str | None:
    """Return the unit in names like `time (s), acceleration (g)` or `time_s,accel_m_s2`, None if silent."""
    *time, accel = split_columns(line)
    if re.match(r"vel|disp", accel, re.IGNORECASE):
        raise InputError(
            f"{where}: the column {shortened(accel, 80)!r} is not an acceleration; give the acceleration record"
        )
    if time:
        suffix = _TIME_SUFFIX.search(time[0])
        unit = bracketed(time[0]) or (suffix[1] if suffix else "s")
        if unit.strip().lower() not in ("s", "sec", "seconds"):
            raise InputError(f"{where}: the column {shortened(time[0], 80)!r} is not a time in s; give the time in s")
    bracket, suffix = bracketed(accel), _SUFFIX.search(accel)
    if bracket is not None:
        return _known_unit(where, bracket)
    if suffix is None:
        return None
    return _known_unit(where, re.sub(r"(m|cm|mm|in|ft)_?s\^?2", r"\1/s^2", suffix[1].lower()))


MAX_BYTES = 60_000_000
MAX_LINES = 5_000_000
MAX_PEAK_M_S2 = 100.0
MAX_INTERVAL_S = 1.0
MAX_TIME_S = 1e12  # seconds since 1970 are below
_EVENNESS = 0.04
"""Time steps may differ by this part of the interval: files print few digits."""
_AGREEMENT = 1e-4
"""Relative difference up to which a stated interval agrees with the file's."""
_TEXT_LINES = 100  # above figures
IN_ROWS = "; if the rows are one series, written several values a line, write one value a line"
_SEPARATORS = str.maketrans(",;\t", "   ")


@dataclass(frozen=True)
class Accelerogram:
    """One recorded ground acceleration: `accel_m_s2` (n,) at the interval `dt_s`, as read and not yet scaled.

    `unit_read` is the unit of the file's figures, `format` their layout, `sha256` that of the file's bytes.
    """

    dt_s: float
    accel_m_s2: Array
    title: str
    origin: str
    unit_read: str
    format: str
    sha256: str


def read_accelerogram(path: str | Path, unit: str | None = None, dt_s: float | None = None) -> Accelerogram:
    """Read an accelerogram; `unit` and `dt_s` (in s) state what the file does not say.

    Raises InputError, with file and line, when the file is neither numbers in one or two columns nor PEER
    .AT2, when unit or interval is missing, unknown or contradicts the file, for uneven time steps, values not
    finite, fewer than three samples, a count other than the header's, and a peak above 100 m/s^2.
    """
    path = _from_here(Path(path))
    data = read_whole(path, MAX_BYTES, "an accelerogram", "name an accelerogram file")
    if (count := max(data.count(b"\n"), data.count(b"\r"))) > MAX_LINES:
        raise InputError(f"{path}: has {count} lines, the limit is {MAX_LINES}; cut or resample the record")
    lines = _decode(path, data).splitlines()
    if foreign := format_of(lines):
        raise InputError(f"{path}: {foreign}")
    header = at2_header(path, lines) or column_header(path, lines)
    values = _read_values(path, lines, header)
    if values.shape[1] == 2:
        interval = _even_interval(path, lines, header, values[:, 0])
        header = _with_interval(path, header, interval)
    unit_read, interval = _unit_and_interval(path, header, unit, dt_s)
    _check_peak(path, lines, header, values[:, -1], unit_read)
    accel = values[:, -1] * FACTORS_M_S2[unit_read]
    digest = hashlib.sha256(data).hexdigest()
    return Accelerogram(interval, accel, header.title or path.stem, header.origin, unit_read, header.layout, digest)


def _from_here(path: Path) -> Path:
    """Return a path as messages name it: relative to the current folder where the file lies below it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _decode(path: Path, data: bytes) -> str:
    """Return the text; headers of old files are not always UTF-8."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    if data.translate(None, bytes(range(32, 256)) + b"\t\n\r\f"):
        raise InputError(f"{path}: is a binary file; convert the accelerogram to CSV (time_s,accel_m_s2)")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _read_values(path: Path, lines: list[str], header: Header) -> Array:
    """Return the figures after the header, (n_samples, 1 or 2), finite and as many as the header states."""
    body = "\n".join(lines[header.first_line :]).translate(_SEPARATORS)
    if not any(_rows(lines, header)):
        raise InputError(f"{path}: holds no numbers; name an accelerogram file")
    try:
        is_table = header.layout != "PEER AT2"
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
    _check_count(path, header, len(values))
    if not values[:, -1].any():
        raise InputError(f"{path}: every acceleration is zero; name a record that moves the ground")
    return values


def _of_decimal_commas(line: str) -> str:
    """Return what to do where a line looks like numbers with decimal commas, "" where it does not."""
    if re.fullmatch(r"\s*[-+]?[0-9]+,[0-9]+(\s*;\s*[-+]?[0-9]+,[0-9]+)*\s*;?\s*", line):
        return f"; decimal commas? write {line.strip().replace(',', '.')}"
    if re.fullmatch(r"\s*[-+]?[0-9]+,[0-9]+,[-+]?[0-9]+,[0-9]+\s*", line):
        time, time_decimals, accel, decimals = line.strip().split(",")
        return f"; decimal commas? write {time}.{time_decimals},{accel}.{decimals}"
    return ""


def _check_count(path: Path, header: Header, count: int) -> None:
    """Raise InputError for too few samples or a number of samples other than stated."""
    if header.samples is not None and header.samples != count:
        raise InputError(
            f"{path}:{header.samples_line}: the header states {header.samples} samples, the file holds "
            f"{count}; complete the file or correct the header"
        )
    if count < 3:
        raise InputError(f"{path}: holds {count} samples, an accelerogram needs at least 3")


def _first_bad_line(path: Path, lines: list[str], header: Header) -> str:
    """Name the first line that is not made of numbers or has another number of columns than the first."""
    columns = 0
    for number, words in _rows(lines, header):
        for word in words:
            if is_date(word):
                return _dated(path, number, word)
            if not is_number(word):
                if columns == 0 and (above := _text_above(path, lines, header, number)):
                    return above
                return (
                    f"{path}:{number}: {word[:40]!r} is not a number; give CSV with one or two columns or "
                    "PEER .AT2, and convert other formats (COSMOS, SMC) to CSV (time_s,accel_m_s2)"
                )
        columns = columns or len(words)
        if len(words) != columns and header.layout != "PEER AT2":
            held = f"{path}:{number}: holds {len(words)} of {columns} numbers"
            return f"{held}{IN_ROWS}" if columns > 2 else f"{held}; complete the row or remove it"
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
            "with their names and units in the first line"
        )
    return (
        f"{path}:{number}: text above the figures, which begin in line {first[0]}; remove it or begin it with #, and "
        "let one line name the columns with their units (time_s,accel_m_s2)"
    )


def _rows(lines: list[str], header: Header) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and words of every line of figures, without comments and blank lines."""
    for number, line in enumerate(lines[header.first_line :], header.first_line + 1):
        words = line.partition("#")[0].translate(_SEPARATORS).split()
        if words:
            yield number, words


def _line_of(lines: list[str], header: Header, sample: int) -> int:
    """Return the line number of a sample counted from 0."""
    count = 0
    for number, words in _rows(lines, header):
        count += len(words) if header.layout == "PEER AT2" else 1
        if count > sample:
            return number
    return len(lines)


def _even_interval(path: Path, lines: list[str], header: Header, time_s: Array) -> float:
    """Return the interval of a time column (n,) in s; raise InputError where it falls back or is uneven."""
    beyond = int(np.argmax(np.abs(time_s)))
    if abs(time_s[beyond]) > MAX_TIME_S:
        where = f"{path}:{_line_of(lines, header, beyond)}"
        raise InputError(f"{where}: the time {time_s[beyond]:g} s is beyond {MAX_TIME_S:g} s; give the time in s")
    steps = np.diff(time_s)
    usual = float(np.median(steps))
    faulty = np.flatnonzero(steps <= 0.0)
    if len(faulty) == 0:
        faulty = np.flatnonzero(np.abs(steps - usual) > _EVENNESS * usual)
    if len(faulty):
        digit = rounded_times(time_s)
        if digit is not None:
            line = _line_of(lines, header, int(faulty[0]) + 1)
            raise InputError(
                f"{path}:{line}: the time (first column) has too few digits: it is even but rounded to {digit:g} s; "
                "write it with more, or remove the column and state the interval (record.dt_s, # dt:)"
            )
        line, step = _line_of(lines, header, int(faulty[0]) + 1), steps[faulty[0]]
        what = "does not increase here" if step <= 0.0 else f"steps by {step:.6g} s here, elsewhere by {usual:.6g} s"
        raise InputError(f"{path}:{line}: the time (first column) {what}; give samples at an even interval")
    return float(f"{(time_s[-1] - time_s[0]) / len(steps):.9g}")


def _with_interval(path: Path, header: Header, interval: float) -> Header:
    """Return the header with the interval of the time column, which must agree with a stated one."""
    if header.dt_s is not None and not math.isclose(header.dt_s, interval, rel_tol=_AGREEMENT):
        raise InputError(
            f"{path}:{header.dt_line}: the header states dt = {header.dt_s:g} s, the time column steps by "
            f"{interval:g} s; correct one of them"
        )
    line = header.dt_line or header.first_line + 1
    return replace(header, dt_s=interval, dt_line=line, layout="time and acceleration")


def _unit_and_interval(path: Path, header: Header, unit: str | None, dt_s: float | None) -> tuple[str, float]:
    """Return unit and interval in s from what is stated and what the file says, which must agree."""
    faults = _unit_faults(path, header, unit) + _interval_faults(path, header, dt_s)
    if faults:
        raise InputError(*faults)
    interval = header.dt_s if header.dt_s is not None else dt_s
    unit_read = header.unit or find_unit(unit or "")
    assert unit_read is not None and interval is not None  # no faults
    return unit_read, interval


def _unit_faults(path: Path, header: Header, unit: str | None) -> list[str]:
    """Return a sentence when the unit is missing, unknown or contradicts the file."""
    if unit is None and header.unit is None:
        return [
            f"{path}: states no unit of acceleration; state it in the case (record: {{file: {path.name}, "
            "unit: g}) or in the file (# units: g)"
        ]
    if unit is None:
        return []
    stated = find_unit(unit)
    if stated is None:
        return [f"record.unit: {unit!r} is not one of the units {', '.join(FACTORS_M_S2)}; correct it"]
    if header.unit is not None and FACTORS_M_S2[stated] != FACTORS_M_S2[header.unit]:
        return [
            f"{path}:{header.unit_line}: the file states the unit {header.unit}, the case "
            f"record.unit: {unit}; correct or remove one of them"
        ]
    return []


def _interval_faults(path: Path, header: Header, dt_s: float | None) -> list[str]:
    """Return a sentence when the interval is missing, out of range or contradicts the file."""
    interval = header.dt_s if header.dt_s is not None else dt_s
    if interval is None:
        return [
            f"{path}: states no sampling interval; state it in the case (record: {{file: {path.name}, "
            "dt_s: 0.01}) or in the file (# dt: 0.01 s)"
        ]
    if not 0.0 < interval <= MAX_INTERVAL_S:
        where = "record.dt_s" if header.dt_s is None else f"{path}:{header.dt_line}"
        return [f"{where}: the interval {interval:g} s must be above 0 and at most {MAX_INTERVAL_S:g} s"]
    if dt_s is not None and not math.isclose(dt_s, interval, rel_tol=_AGREEMENT):
        return [
            f"{path}:{header.dt_line}: the file states an interval of {interval:g} s, the case record.dt_s: "
            f"{dt_s:g}; correct or remove one of them"
        ]
    return []


def _check_peak(path: Path, lines: list[str], header: Header, figures: Array, unit: str) -> None:
    """Raise InputError for a peak among figures (n,) in their unit that no ground reached."""
    index = int(np.argmax(np.abs(figures)))
    lost = np.flatnonzero(lost_scans(figures))
    if lost.size:
        which = "1 sample reads" if lost.size == 1 else f"{lost.size} samples read"
        raise InputError(
            f"{path}:{_line_of(lines, header, int(lost[0]))}: {which} "
            "exactly -9999, which recorders write for a sample that was lost; mend or cut the record"
        )
    peak = abs(float(figures[index])) * FACTORS_M_S2[unit]
    if peak > MAX_PEAK_M_S2:
        raise InputError(
            f"{path}:{_line_of(lines, header, index)}: the peak of {peak:.4g} m/s^2 is above the limit of "
            f"{MAX_PEAK_M_S2:g} m/s^2, the unit {unit} is probably wrong; correct it where it "
            "stands (# units: in the file, record.unit in the case)"
        )
