"""One component of a record's file: what the file states of it, its figures, and what is checked of both."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import FACTORS_M_S2, find_unit
from rths_cli.files.foreign_texts import lost_scans
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import MOST_DIGITS, shortened

MAX_PEAK_M_S2 = 100.0
MAX_INTERVAL_S = 1.0
AGREEMENT = 1e-4
"""Relative difference up to which a stated interval agrees with the file's."""
PEAK_AGREEMENT = 5e-4
"""Relative difference, beside half of its last digit, up to which a stated peak agrees with the file's figures."""


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


@dataclass(frozen=True)
class Accelerogram:
    """One recorded ground acceleration: `accel_m_s2` (n,) at the interval `dt_s`, as read and not yet scaled.

    `unit_read` is the unit of the file's figures, `format` their layout, `sha256` that of the file's bytes. `corrected`
    is what its agency did to it; `station`, `component` and `corrected` are "" where the file does not say.
    """

    dt_s: float
    accel_m_s2: Array
    title: str
    origin: str
    unit_read: str
    format: str
    sha256: str
    station: str = ""
    component: str = ""
    corrected: str = ""


@dataclass(frozen=True)
class Stated:
    """A peak that a file states, in its unit; `digit` is the unit of its last printed digit, `line` where it stands."""

    peak: float
    digit: float
    line: int


@dataclass(frozen=True)
class Channel:
    """One component of a file, before its unit and interval are known: its figures (n,), in the file's unit.

    `names` are what `component` may call it, its label first. `corrected` is what its agency did to it. `line_of`
    returns the line of a sample counted from 0.
    """

    header: Header
    figures: Array
    line_of: Callable[[int], int]
    station: str = ""
    names: tuple[str, ...] = ()
    corrected: str = ""
    stated: Stated | None = None

    @property
    def component(self) -> str:
        """Return the component's label, "" where the file names none."""
        return self.names[0] if self.names else ""


def count_of(where: str, text: str) -> int:
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


def interval_of(where: str, text: str) -> float:
    """Return an interval in s, written with or without its unit."""
    match = re.fullmatch(r"([\d.eE+-]+) ?(s|sec|seconds)?", squeezed(text))
    try:
        return float(match[1] if match else "")
    except ValueError:
        raise InputError(f"{where}: dt: {text[:40]!r} is not an interval in s; write for example 0.02 s") from None


def known_unit(where: str, text: str) -> str:
    """Return the unit a text names, or raise InputError with the units understood."""
    unit = find_unit(text)
    if unit is None:
        raise InputError(f"{where}: {text[:40]!r} is not one of the units {', '.join(FACTORS_M_S2)}; correct it")
    return unit


def squeezed(line: str) -> str:
    """Return a line without spaces around it and with single ones in it."""
    return " ".join(line.split())


def check_count(path: Path, header: Header, count: int) -> None:
    """Raise InputError for too few samples or a number of samples other than stated."""
    if header.samples is not None and header.samples != count:
        raise InputError(
            f"{path}:{header.samples_line}: the header states {header.samples} samples, the file holds "
            f"{count}; complete the file or correct the header"
        )
    if count < 3:
        raise InputError(f"{path}: holds {count} sample{'s' * (count != 1)}, an accelerogram needs at least 3")


def check_moves(path: Path, figures: Array) -> None:
    """Raise InputError for a series (n,) of zeros."""
    if not figures.any():
        raise InputError(f"{path}: every acceleration is zero; name a record that moves the ground")


def with_interval(path: Path, header: Header, interval: float) -> Header:
    """Return the header with the interval of the time column, which must agree with a stated one."""
    if header.dt_s is not None and not math.isclose(header.dt_s, interval, rel_tol=AGREEMENT):
        raise InputError(
            f"{path}:{header.dt_line}: the header states dt = {header.dt_s:g} s, the time column steps by "
            f"{interval:g} s; correct one of them"
        )
    line = header.dt_line or header.first_line + 1
    return replace(header, dt_s=interval, dt_line=line, layout="time and acceleration")


def unit_and_interval(path: Path, header: Header, unit: str | None, dt_s: float | None) -> tuple[str, float]:
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
            f"{place(path, header.unit_line)}: the file states the unit {header.unit}, the case "
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
        where = "record.dt_s" if header.dt_s is None else place(path, header.dt_line)
        return [f"{where}: the interval {interval:g} s must be above 0 and at most {MAX_INTERVAL_S:g} s"]
    if dt_s is not None and not math.isclose(dt_s, interval, rel_tol=AGREEMENT):
        return [
            f"{place(path, header.dt_line)}: the file states an interval of {interval:g} s, the case record.dt_s: "
            f"{dt_s:g}; correct or remove one of them"
        ]
    return []


def place(path: Path | str, line: int) -> str:
    """Return where a line stands, as messages name it; 0 is a line of no text."""
    return f"{path}:{line}" if line else f"{path}"


def check_peak(path: Path, channel: Channel, unit: str) -> None:
    """Raise InputError for a peak among the figures, in their unit, that no ground reached or the file contradicts."""
    figures = channel.figures
    index = int(np.argmax(np.abs(figures)))
    lost = np.flatnonzero(lost_scans(figures))
    if lost.size:
        which = "1 sample reads" if lost.size == 1 else f"{lost.size} samples read"
        raise InputError(
            f"{place(path, channel.line_of(int(lost[0])))}: {which} "
            "exactly -9999, which recorders write for a sample that was lost; mend or cut the record"
        )
    peak = abs(float(figures[index])) * FACTORS_M_S2[unit]
    if peak > MAX_PEAK_M_S2:
        raise InputError(
            f"{place(path, channel.line_of(index))}: the peak of {peak:.4g} m/s^2 is above the limit of "
            f"{MAX_PEAK_M_S2:g} m/s^2, the unit {unit} is probably wrong; correct it where it "
            "stands (# units: in the file, record.unit in the case)"
        )
    stated = channel.stated
    if stated is None:
        return
    found, allowed = abs(float(figures[index])), 0.5 * stated.digit + PEAK_AGREEMENT * abs(stated.peak)
    if abs(found - abs(stated.peak)) > allowed:
        raise InputError(
            f"{place(path, stated.line)}: the header states a peak of {abs(stated.peak):g} {unit}, the samples "
            f"reach {found:.6g} {unit} (sample {index + 1}); take a file that is whole, or correct "
            "the header"
        )


def stated_peak(text: str, line: int, factor: float = 1.0) -> Stated | None:
    """Return the peak that a header's text states, times `factor`; None for other texts and -999 (unknown)."""
    match = re.fullmatch(r"[-+]?(?=\.?\d)\d*\.?(\d*)(?:[eE]([-+]?\d{1,2}))?", text.strip())
    if match is None or float(text) in (0.0, -999.0):
        return None
    return Stated(float(text) * factor, 10.0 ** (int(match[2] or 0) - len(match[1])) * factor, line)


def component_names(label: str, *more: str) -> tuple[str, ...]:
    """Return all that names a component: its label, further names, and NS, EW or UD where its direction is one."""
    plain = label.strip().replace("-", "").upper()
    azimuths = {"0": "NS", "360": "NS", "000": "NS", "90": "EW", "090": "EW"}
    letters = {"N": "NS", "E": "EW", "Z": "UD"}
    usual = azimuths.get(plain) or {"UP": "UD", "NS": "NS", "EW": "EW", "UD": "UD"}.get(plain)
    if usual is None and re.fullmatch(r"[A-Z]{2}[NEZ]", plain):
        usual = letters[plain[2]]
    first = usual if plain == usual else label.strip()
    return tuple(dict.fromkeys(filter(None, (first, *more, usual))))


def check_duration(where: str, duration_s: float, samples: int, dt_s: float) -> None:
    """Raise InputError where the file holds another number of samples than its duration."""
    if abs(samples * dt_s - duration_s) > 1.5 * dt_s:
        raise InputError(
            f"{where}: the header states {duration_s:g} s, which are {duration_s / dt_s:.0f} samples, the file holds "
            f"{samples}; take a file that is whole"
        )
