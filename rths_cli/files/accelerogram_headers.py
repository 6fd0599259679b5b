"""What the head of an accelerogram file states: unit, interval, number of samples, title, origin."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.printed import shortened

STANDARD_GRAVITY_M_S2 = 9.80665
FACTORS_M_S2 = {
    "m/s^2": 1.0,
    "cm/s^2": 0.01,
    "gal": 0.01,
    "g": STANDARD_GRAVITY_M_S2,
    "mm/s^2": 0.001,
    "in/s^2": 0.0254,
}
"""Units of acceleration, each in m/s^2."""

# Each is given a line with single spaces, so that none tries the ways to share a run of them.
_AT2_NEW = re.compile(r"NPTS ?= ?(\d+) ?,? ?DT ?= ?([\d.eE+-]+)", re.IGNORECASE)
_AT2_OLD = re.compile(r"^(\d+) ([\d.eE+-]+) NPTS ?, ?DT", re.IGNORECASE)
_AT2_UNIT = re.compile(r"UNITS? OF ([^ ,]+)", re.IGNORECASE)
_AT2_LAST_LINE = 10
_KEY = re.compile(r"#\s*(units?|dt|samples|origin)\s*:\s*(.*)", re.IGNORECASE)
_ANY_KEY = re.compile(r"#\s*\w+\s*:")
_SUFFIX = re.compile(r"_((?:m|cm|mm|in)_?s\^?2|gal|g)$", re.IGNORECASE)
_TIME_SUFFIX = re.compile(r"_(\w?s)$", re.IGNORECASE)
_MOST_DIGITS = 18


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
    found = [_spelling(part) for part in re.split(r"[()\[\]=,]", text) if part.strip()]
    factors = {FACTORS_M_S2.get(unit) for unit in found}
    return found[0] if len(factors) == 1 and None not in factors else None


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
    if not text.isdecimal() or len(text) > _MOST_DIGITS:
        raise InputError(
            f"{where}: samples: {shortened(text, 40)!r} is not a whole number of at most {_MOST_DIGITS} digits; "
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
    return _known_unit(where, re.sub(r"(m|cm|mm|in)_?s\^?2", r"\1/s^2", suffix[1].lower()))
