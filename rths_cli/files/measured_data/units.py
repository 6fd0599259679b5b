"""Parse units and names of measured channels: `table (g)`, `table [m/s^2]`, `table_accel_m_s2`, `command_v`."""

from __future__ import annotations

import re

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import AMBIGUOUS, find_unit
from rths_cli.numerics.constants import FACTORS as OF_QUANTITY

FACTORS: dict[str, tuple[float, str]] = {
    **{unit: (factor, "V") for unit, factor in OF_QUANTITY["voltage"].items()},
    **{unit: (factor, "m/s^2") for unit, factor in OF_QUANTITY["acceleration"].items()},
}
"""Units of a channel: the factor to V or m/s^2, and which of the two."""
OF_A_RUN: dict[str, tuple[float, str]] = {
    **FACTORS,
    **{unit: (factor, "N") for unit, factor in OF_QUANTITY["force"].items()},
    **{unit: (factor, "m") for unit, factor in OF_QUANTITY["displacement"].items()},
}
"""The same with the units of forces and displacements, which a run has beside what identifies a table."""

_TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "usecs", "microsecond", "microseconds"), 1e-6),
}
_TEMPERATURES = ("degc", "deg c", "celsius", "c", "degf", "deg f", "fahrenheit", "f", "k", "kelvin")
_PER_SECOND = ("hz", "s/s", "sa/s", "sps", "1/s", "samples/s", "samples/sec", "samples/second", "samples per second")
_RATE_UNITS = {**dict.fromkeys(_PER_SECOND, 1.0), **dict.fromkeys(("khz", "ks/s", "ksa/s", "ksps", "1/ms"), 1e3)}
_VOLT = {"v": "V", "volt": "V", "volts": "V", "mv": "mV", "millivolt": "mV", "millivolts": "mV"}
_EXACT = {"N": "N", "kN": "kN", "m": "m", "mm": "mm", "newton": "N", "Newton": "N"}
_PER_S2 = re.compile(r"(m|cm|mm|in|ft)[_ ·*.]?s(?:\^|\*\*)?(?:-?2|²|⁻²)", re.IGNORECASE)
_BRACKETS = re.compile(r"\s*[(\[]([^()\[\]:]*)[)\]]\s*$")  # `data(:,1)` is a column of a matrix
_SUFFIX = re.compile(r"[_\s]+((?:m|cm|mm|in|ft)[_/]?s\^?2|m?v|m?g|gal)$", re.IGNORECASE)
_FORCE_SUFFIX = re.compile(r"(?<=shear|force)[_\s]+(k?n)$", re.IGNORECASE)
_TIME_SUFFIX = re.compile(r"[_\s]+(s|sec|ms|us)$", re.IGNORECASE)
_TIME_NAMES = {
    "time",
    "t",
    "timestamp",
    "elapsedtime",
    "relativetime",
    "xvalue",
    "tout",
    "zeit",
    "temps",
    "tiempo",
    "tempo",
}
_FILLERS = {"accel", "acceleration", "accelerometer", "acc", "abs", "absolute", "measured", "signal"}
_ALIASES = {"cmd": "command", "drive": "command", "u": "command", "base": "table", "shaketable": "table"}
_ALIASES_OF_A_RUN = {"groundmotion": "ground", "baseshear": "base_shear", "tabledesired": "desired"}
_PLACES = {*_ALIASES, *_ALIASES.values(), "floor", "storey", "story"}


def canonical_unit(text: str) -> str:
    """Return the one spelling of a unit (a key of OF_A_RUN), "" where it is unknown or its case leaves a doubt."""
    word = text.strip().removeprefix("[").removeprefix("(").removesuffix("]").removesuffix(")").strip()
    if word in AMBIGUOUS:
        return ""
    if word in _EXACT:
        return _EXACT[word]
    match = _PER_S2.fullmatch(word)
    return _VOLT.get(word.lower()) or find_unit(f"{match[1]}/s2" if match else word) or ""


def split_name(name: str) -> tuple[str, str]:
    """Return a channel's name without its unit, and the unit's text: in brackets, after `_`, or "" if there is none."""
    match = _BRACKETS.search(name) or _SUFFIX.search(name)
    if match and match.start():
        return name[: match.start()], match[1].strip()
    force = _FORCE_SUFFIX.search(name)
    return (name[: force.start()], {"n": "N", "kn": "kN"}[force[1].lower()]) if force else (name, "")


def unit_of(name: str, stated: str) -> tuple[str, str]:
    """Return the canonical unit of a channel ("" if unknown), and a sentence where the file leaves a doubt.

    `stated` is what the file says of the unit beside the name.
    """
    in_name = split_name(name)[1]
    units = [canonical_unit(text) for text in (stated, in_name) if text]
    unknown = [text for text in (stated, in_name) if text and not canonical_unit(text)]
    if len(set(units)) == 2 and "" not in units:
        return "", f"channel {name!r}: its name says {in_name}, its unit is stated as {stated}; neither is taken"
    if stated and unknown:
        return "", f"channel {name!r}: the unit {unknown[0]!r} is not known"
    return (units[0] if units else ""), ""


def time_factor(name: str, stated: str) -> float | None:
    """Return what a time column's figures are in s (1 where no unit is stated), None for an unknown unit."""
    match = _BRACKETS.search(name) or _TIME_SUFFIX.search(name)
    text = stated or (match[1] if match else "") or "s"
    return _TIME_UNITS.get(text.strip(" []()").partition(" ")[0].lower())


def abscissa_factor(where: str, stated: str) -> float:
    """Return what the figures of a channel's abscissa are in s (1 where no unit is stated); raise InputError for an
    unknown unit. `where` names the file and the channel."""
    factor = time_factor("", stated)
    if factor is None:
        raise InputError(f"{where}: the unit {stated!r} of its abscissa is not s, ms or us; export it over time in s")
    return factor


def rate_factor(stated: str) -> float | None:
    """Return what a rate's figure is in Hz (1 where no unit is stated), None for an unknown unit."""
    return _RATE_UNITS.get(" ".join(stated.lower().strip(" []()").split()) or "hz")


def is_time(name: str) -> bool:
    """Say whether a column's name is that of the time, of all channels or of one (`table time (s)`, `time_command`)."""
    bracket = _BRACKETS.search(name)
    if bracket and bracket[1].strip(" °º").lower() in _TEMPERATURES:
        return False
    words = _words(_TIME_SUFFIX.sub("", _BRACKETS.sub("", name)))
    of_one = len(words) > 1 and (words[-1] == "time" or (words[0] == "time" and words[1] in _PLACES))
    return "".join(words) in _TIME_NAMES or of_one


def is_unit(text: str) -> bool:
    """Say whether a cell is a unit, of a channel or of the time, or is left blank."""
    word = text.strip(" -[]()\"'")
    return not word or bool(canonical_unit(word)) or word.lower() in _TIME_UNITS


def role_of(name: str) -> str:
    """Return the role a channel's name speaks of (`Floor 2 accel (g)`: floor_2), else its plain form."""
    words = [word for word in _words(split_name(name)[0]) if word not in _FILLERS]
    plain = "".join(words)
    floor = re.fullmatch(r"(?:floor|storey|story)0*(\d+)", plain)
    moved = re.fullmatch(r"floor0*(\d+)(?:displacement|disp)", plain)
    if moved:
        return f"floor_{moved[1]}_displacement"
    return f"floor_{floor[1]}" if floor else (_ALIASES | _ALIASES_OF_A_RUN).get(plain, plain)


def _words(name: str) -> list[str]:
    """Return the words and numbers of a name in lower case; `tableAccel` has two."""
    return re.findall(r"[^\W\d_]+|\d+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name).lower())
