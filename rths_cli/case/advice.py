"""What to write instead of a wrong value: the end of a fault's sentence."""

from __future__ import annotations

import re

from rths_cli.unit_names import unit_of_name

_NUMBER = r"[-+]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][-+]?[0-9]+)?"
_LIMIT = rf"[<>]=? {_NUMBER}"
_OUT_OF_RANGE = re.compile(rf"(must be (?:0 \(off\) or )?{_LIMIT}(?: and {_LIMIT})*), got ({_NUMBER})")
IN_ANOTHER_UNIT = {"s": {"ms": 1e-3}, "m": {"mm": 1e-3}, "Hz": {"kHz": 1e3}}  # what a number is often stated in
_CHOICE = re.compile(r"must be (.+), got '(.*)'")


def with_advice(key: str, message: str) -> str:
    """Return the sentence on the value of a key with the key's unit, and with what to write where that is clear."""
    unit = unit_of_name(key, "")
    if out := _OUT_OF_RANGE.fullmatch(message):
        return _with_unit(key, unit, out[1], out[2])
    if not (choice := _CHOICE.fullmatch(message)):
        return message
    wanted, given = choice[1], choice[2].strip()
    if wanted == "a number":
        return message + _number(given, unit)
    words = re.split(r", | or ", wanted)
    same = [word for word in words if _plain(word) == _plain(given)]
    return f"{message}; write {same[0]}" if same else message


def _with_unit(key: str, unit: str, wanted: str, given: str) -> str:
    """Return the sentence on a number out of its range."""
    if key.endswith(("_ratio", "_ratios")) and 1.0 <= float(given) <= 100.0:
        return f"{wanted}, got {given}; a ratio, not percent: write {float(given) / 100.0:g}"
    told = f"{wanted}{f' {unit}' if unit else ''}, got {given}"
    for smaller, factor in IN_ANOTHER_UNIT.get(unit, {}).items():
        if _meets(wanted, factor * float(given)):
            return f"{told}; {given} {smaller} are {factor * float(given):g} {unit}"
    return f"{told}; a factor on the record, 1 plays it as it is" if key == "scaling" else told


def _meets(wanted: str, value: float) -> bool:
    """Return whether a number is within the limits of a sentence such as `must be >= 0 and <= 0.1`."""
    holds = {"<": value.__lt__, "<=": value.__le__, ">": value.__gt__, ">=": value.__ge__}
    limits = re.findall(rf"([<>]=?) ({_NUMBER})", wanted)
    return value > 0.0 and all(holds[sign](float(limit)) for sign, limit in limits)


def _number(given: str, unit: str) -> str:
    """Return how to write a number that came with a decimal comma, a percent sign or a unit."""
    found = re.fullmatch(rf"({_NUMBER})\s*(\D*)", given)
    if found is None:
        return f"; in {unit}" if unit else ""
    text, after = found[1].replace(",", "."), found[2]
    if after == "%":
        return f"; write {float(text) / 100.0:g}"
    if not after or after == unit:
        return f"; write {text}"
    return f"; write the number alone{f', in {unit}' if unit else ''}"


def _plain(word: str) -> str:
    return word.casefold().replace("_", "").replace("-", "").replace(" ", "")
