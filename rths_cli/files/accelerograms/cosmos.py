"""COSMOS and CSMIP files of CESMD: uncorrected (V1) and corrected (V2) acceleration, one channel after the other.

Sources: COSMOS, "Strong-motion data format" (version 1.20); CSMIP, "Standard tape format for CSMIP strong-motion data
tapes", OSMS 85-03 (the older layout, whose lines on data say `points of accel data`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import FACTORS_M_S2, find_unit
from rths_cli.files.accelerograms.fixed_columns import Layout, layout_of, layout_of_rows, numbers
from rths_cli.files.accelerograms.others import CONVERT
from rths_cli.files.accelerograms.record import Channel, Header, component_names, stated_peak
from rths_cli.numerics.lti import Array

_COSMOS = re.compile(
    r"\s*(\d{1,8})\s+(\S.{0,40}?)\s*pts?,?\s*approx\.?\s*(\d+\.?\d*|\.\d+)\s*secs?,\s*units\s*=\s*([^(,]*?)\s*"
    r"(?:\(\s*(\d+)\s*\))?\s*,?\s*Format\s*=\s*\(([^)]*)",
    re.IGNORECASE,
)
_CSMIP = re.compile(
    r"\s*(\d{1,8})\s+points of (accel|veloc|displ)\w* data equally spaced at\s*([\d.]+)\s*sec", re.IGNORECASE
)
_CSMIP_V1 = re.compile(
    r"\s*(\d{1,8})\s+accelerogram points at\s*([\d.]+)\s*pts/sec in units of ([^.]+?)\s*\.", re.IGNORECASE
)
_HEADER_BLOCK = re.compile(
    r"\s*(\d+)\s+(Integer|Real)-header values follow on\s*(\d+)\s*lines?\s*,\s*Format\s*=\s*\(([^)]*)", re.I
)
_UNITS = {2: "g", 4: "cm/s^2", 7: "in/s^2", 10: "gal", 11: "mg"}  # COSMOS table 2
_COUNTS = 50
_UNKNOWN = (-999.0, -99.0)
_PER_LINE = 8
_ABOUT = 0.02  # of a duration that is stated as approximate
_CHANNEL = r"(?:Sta )?Cha[n:]?\s*(\d+)\s*:\s*([^(\n]*)"


@dataclass(frozen=True)
class _Data:
    """The line that announces figures: what they are, in which layout, and where their header begins (from 0)."""

    kind: str  # accel, veloc, displ
    count: int
    dt_s: float | None
    about_s: str  # duration, "" where it states none
    unit_text: str
    code: int | None
    layout: Layout | None
    line: int
    begins: int


def read(path: Path, lines: list[str]) -> list[Channel] | None:
    """Return the accelerations of a COSMOS or CSMIP file, None for any other text; raises InputError."""
    head = " ".join(lines[:2]).lower()
    cosmos = "(format v" in head and ("accel" in head or "raw" in head or "veloc" in head or "displ" in head)
    if not cosmos and not ("corrected accelerogram" in head and "gns science" not in head):
        return None
    found, channels, begins, index = False, [], 0, 0
    while index < len(lines):
        data = _announced(lines, index, begins)
        index += 1
        if data is None:
            continue
        found = True
        layout = data.layout or layout_of_rows(lines[index] if index < len(lines) else "", _PER_LINE)
        if layout is None:
            raise InputError(f"{path}:{index}: states no format of its figures; take the file as its agency gives it")
        figures, after = numbers(path, lines, index, data.count, layout)
        _check_end(path, lines, after, data)
        if data.kind == "accel":
            channels.append(_channel(path, lines, data, figures, layout, _ending(lines, after)))
        index = begins = after
    if not found:
        raise InputError(f"{path}: {_without_data(lines)}")
    if any(line.strip() and not re.match(r"/&|End-of-data", line, re.IGNORECASE) for line in lines[begins:]):
        raise InputError(f"{path}: ends within the header of a further channel; take a file that is whole")
    if not channels:
        raise InputError(f"{path}: holds velocity or displacement only; give the acceleration file of the same station")
    return channels


def _announced(lines: list[str], index: int, begins: int) -> _Data | None:
    """Return what a line announces, None for any other line."""
    line = lines[index]
    if match := _COSMOS.match(line):
        text = match[2].lower()
        kind = "veloc" if "vel" in text else "displ" if "disp" in text else "accel"
        code = int(match[5]) if match[5] else None
        return _Data(kind, int(match[1]), None, match[3], match[4], code, layout_of(match[6]), index, begins)
    if match := _CSMIP.match(line):
        unit = re.search(r"units?\s*:\s*([^)]*)|in\s+(\S+?)\.?\s*(?:\(|$)", line[match.end() :], re.IGNORECASE)
        stated = re.search(r"\(\s*(\d+[fe]\d+\.\d+)\s*\)", line, re.IGNORECASE)
        text = (unit[1] or unit[2]) if unit else ""
        layout = layout_of(stated[1]) if stated else None
        return _Data(match[2].lower(), int(match[1]), float(match[3]), "", text, None, layout, index, begins)
    if (match := _CSMIP_V1.match(line)) and float(match[2]) > 0.0:
        stated = re.search(r"format\s*:\s*\(([^)]*)", line, re.IGNORECASE)
        layout = layout_of(stated[1]) if stated else None
        return _Data("accel", int(match[1]), 1.0 / float(match[2]), "", match[3], None, layout, index, begins)
    return None


def _check_end(path: Path, lines: list[str], after: int, data: _Data) -> None:
    """Raise InputError where figures follow on those that a line announced."""
    following = next((line for line in lines[after : after + 1] if line.strip()), "")
    if re.fullmatch(r"[\s\d.+\-Ee]+", following) and "." in following:
        raise InputError(
            f"{path}:{data.line + 1}: the header states {data.count} samples, more follow in line {after + 1}; correct "
            "the header, or take the file as its agency gives it"
        )


def _ending(lines: list[str], after: int) -> str:
    """Return what the line at the end of a channel says, "" where it is none."""
    line = lines[after] if after < len(lines) else ""
    return line if line.lower().startswith("end-of-data") else ""


def _channel(path: Path, lines: list[str], data: _Data, figures: Array, layout: Layout, ending: str) -> Channel:
    head = lines[data.begins : data.line]
    unit = _unit(path, data)
    integers, reals = _blocks(path, lines, data)
    _check_code(path, data, integers)
    dt_s, dt_line = _interval(path, data, head, reals)
    where = data.line + 1
    station, place = _station(head)
    label, names = _component(head, ending)
    header = Header(
        "COSMOS" if reals is not None else "CSMIP",
        first_line=where,
        title=f"{station} {place}, {label}".strip(", "),
        origin=head[1].strip() if len(head) > 1 else "",
        unit=unit,
        unit_line=where,
        dt_s=dt_s,
        dt_line=dt_line,
        samples=data.count,
        samples_line=where,
    )
    stated = _peak(head, data.begins)
    unit_of_peak = find_unit(stated[1]) if stated else None
    ratio = FACTORS_M_S2[unit_of_peak] / FACTORS_M_S2[unit] if unit_of_peak else 1.0
    peak = stated_peak(stated[0], stated[2], ratio) if stated and unit_of_peak else None
    return Channel(
        header, figures, lambda sample: where + 1 + sample // layout.per_line, station, names, _corrected(head), peak
    )


def _same(one: str, other: str) -> bool:
    return {one, other} <= {"cm/s^2", "gal"} or one == other


def _unit(path: Path, data: _Data) -> str:
    """Return the unit that a line on data states; raises InputError for counts and unknown units."""
    if data.code == _COUNTS or "count" in data.unit_text.lower():
        raise InputError(
            f"{path}:{data.line + 1}: holds raw counts (V0), which its sensor's sensitivity alone makes accelerations; "
            "take the V1 or V2 file of the same station, or convert it with gmprocess (USGS)"
        )
    named, coded = find_unit(data.unit_text), _UNITS.get(data.code or 0)
    if named and coded and not _same(named, coded):
        raise InputError(
            f"{path}:{data.line + 1}: the unit {data.unit_text.strip()} contradicts its code {data.code:02d} ({coded})"
            "; take the file as its agency gives it"
        )
    if named is None and coded is None:
        raise InputError(
            f"{path}:{data.line + 1}: {data.unit_text.strip()[:30]!r} is no unit of acceleration; correct it"
        )
    return named or coded or ""


def _blocks(path: Path, lines: list[str], data: _Data) -> tuple[Array | None, Array | None]:
    """Return the integers and reals of a COSMOS header, None where there are none."""
    found: dict[str, Array] = {}
    for index in range(data.begins, data.line):
        match = _HEADER_BLOCK.match(lines[index])
        layout = layout_of(match[4]) if match else None
        if match and layout and int(match[1]) <= 1000:
            found[match[2].lower()], _ = numbers(path, lines, index + 1, int(match[1]), layout)
    return found.get("integer"), found.get("real")


def _check_code(path: Path, data: _Data, integers: Array | None) -> None:
    """Raise InputError where the unit's code in the header is another than that of the data."""
    stated = int(integers[2]) if integers is not None and integers.size > 2 else -999
    if stated in _UNITS and data.code in _UNITS and not _same(_UNITS[stated], _UNITS[data.code]):
        raise InputError(
            f"{path}:{data.line + 1}: the unit's code {data.code:02d} contradicts that of the header, {stated:02d} "
            "(third integer); take the file as its agency gives it"
        )


def _interval(path: Path, data: _Data, head: list[str], reals: Array | None) -> tuple[float | None, int]:
    """Return the interval in s and its line; raises InputError where count, interval and duration contradict."""
    line = data.line + 1
    if reals is None:
        _check_said(path, data, head)
        return data.dt_s, line
    known = [reals[k] * factor for k, factor in ((61, 1e-3), (33, 1.0)) if reals.size > k and reals[k] > 0.0]
    if not known:
        raise InputError(f"{path}:{line}: the header states no sampling interval (real 62); take the file as given")
    dt_s, length_s = float(f"{known[0]:.9g}"), reals[62] if reals.size > 62 else -999.0
    if length_s > 0.0 and abs(data.count * dt_s - length_s) > max(1.5 * dt_s, 2e-3 * length_s):
        raise InputError(
            f"{path}:{line}: {data.count} samples every {dt_s:g} s are {data.count * dt_s:g} s, the header states "
            f"{length_s:g} s (real 63); take the file as its agency gives it"
        )
    about_s, digit_s = float(data.about_s or 0.0), 10.0 ** -len(data.about_s.partition(".")[2])
    if about_s > 0.0 and abs(data.count * dt_s - about_s) > max(1.5 * dt_s, digit_s, _ABOUT * about_s):
        raise InputError(
            f"{path}:{line}: {data.count} samples every {dt_s:g} s (real 62 or 34 of the header) are "
            f"{data.count * dt_s:g} s, this line states about {about_s:g} s; take the file as its agency gives it"
        )
    return dt_s, line


def _check_said(path: Path, data: _Data, head: list[str]) -> None:
    """Raise InputError where the text above states other points or another interval than the data's line."""
    for number, line in enumerate(head, data.begins + 1):
        points = re.match(r"\s*(?:No\. of points\s*=\s*(\d+)|(\d+) points of instrument)", line, re.IGNORECASE)
        stated = int(points[1] or points[2]) if points else data.count
        rate = re.search(r"intervals of\s*([\d.]+)|at\s+(\d+)\s*samples/sec", line, re.IGNORECASE)
        dt_s = data.dt_s or 0.0
        said = (float(rate[1]) if rate[1] else 1.0 / max(float(rate[2]), 1e-9)) if rate else dt_s
        length = re.search(r"record length\s*=\s*([\d.]+) ?sec.*samples/sec", line, re.IGNORECASE)
        if length and abs(float(length[1].strip(".") or 0.0) - data.count * dt_s) > max(1.5 * dt_s, 0.01):
            raise InputError(
                f"{path}:{number}: states a length of {length[1]} s, {data.count} samples every {dt_s:g} s are "
                f"{data.count * dt_s:g} s; take the file as its agency gives it"
            )
        if stated != data.count or abs(said - dt_s) > 1e-3 * dt_s:
            raise InputError(
                f"{path}:{number}: states {stated} points every {said:g} s, line {data.line + 1} {data.count} every "
                f"{dt_s:g} s; take the file as its agency gives it"
            )


def _station(head: list[str]) -> tuple[str, str]:
    """Return the station's number or code, and its place."""
    for index, line in enumerate(head[:16]):
        if match := re.match(r"Statn No:\s*(\S+(?:\s*-\s*\d+)?)\s+Code:\s*(\S+)\s*(.*)", line, re.IGNORECASE):
            return match[2].strip(), match[3].strip()
        if match := re.match(r"Station (?:No\.|Id\.|#)?\s*(\S+)", line, re.IGNORECASE):
            return match[1].strip(","), head[index + 1][:40].strip() if index + 1 < len(head) else ""
    return "", ""


def _component(head: list[str], ending: str) -> tuple[str, tuple[str, ...]]:
    """Return a channel's label and all that names it: direction, code, number."""
    code = re.search(r"\.?([A-Z]{2}[A-Z0-9])(?:\.|\s|$)", ending.partition("for ")[2].removeprefix("Chan"))
    for line in head[:16]:
        if match := re.match(_CHANNEL, line, re.IGNORECASE):
            label = re.sub(r"\s*deg\w*\.?$", "", re.split(r"\s{3,}", match[2].strip())[0], flags=re.IGNORECASE)
            more = [code[1]] if code else []
            names = component_names(label, *more, f"channel {match[1]}", match[1])
            return names[0], names
    names = component_names(code[1]) if code else ()
    return (names[0] if names else ""), names


def _peak(head: list[str], begins: int) -> tuple[str, str, int] | None:
    """Return number, unit and line of the peak acceleration that a header states."""
    number = r"([-+\d.]+(?:E[-+]?\d+)?)"
    patterns = (
        rf"Peak acceleration\s*=\s*{number}\s*(\S+)", rf"Processed:.*?\bMax\s*=\s*{number}\s*(\S+)",
        rf"Units of uncor.*?\bMax\s*=\s*{number}\s*([^\s,]+)",
    )  # fmt: skip
    for index, line in enumerate(head, begins + 1):
        for pattern in patterns:
            if match := re.match(rf"\s*{pattern}", line, re.IGNORECASE):
                return match[1], match[2].rstrip(",."), index
    return None


def _corrected(head: list[str]) -> str:
    """Return what the agency did, in its words."""
    told = [
        " ".join(line.split())
        for line in head[:26]
        if re.search(r"filtered|baseline-?\s*corrected", line, re.IGNORECASE)
    ]
    if told:
        return "; ".join(told)
    return "nothing (uncorrected)" if any(line.lower().startswith("uncor") for line in head[:3]) else ""


def _without_data(lines: list[str]) -> str:
    """Return what a file is that announces no equally spaced accelerations."""
    head = " ".join(lines[:16]).lower()
    if "of volume i" in head:
        return f"is a file of USC, which is not read; {CONVERT}"
    if "sec and g/10" in head:
        return (
            "is an uncorrected record (V1) of pairs of time and acceleration at uneven steps; take the corrected file "
            "(V2) of the same station"
        )
    return (
        "announces no acceleration data (`points of accel data`, `acceleration pts`); take the file as its agency "
        "gives it"
    )
