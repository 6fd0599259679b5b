"""Two numbers of a user's files that must agree (`Comparison`), the sentence of doubt where they do not, and
defaults times a unit's factor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import isfinite, log
from typing import TYPE_CHECKING

from pydantic import BaseModel

from rths_cli.findings import Finding

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case

POUND_KG, GRAVITY, INCH_MM = 0.45359237, 9.80665, 25.4
SLIPS = {
    1e3: "1000 (k or m before a unit)",
    1e6: "1e6 (M or u before a unit, or k for m)",
    GRAVITY: "9.81 (g for m/s^2, kgf for N)",
    INCH_MM: "25.4 (inch for mm)",
    1.0 / POUND_KG: "2.205 (lb for kg)",
}
"""The factors by which a wrong unit or prefix changes a number, each with its usual reason."""
ONLY_OF = {
    GRAVITY: ("m/s^2", "kg", "N", "N/m", "N s/m"),
    INCH_MM: ("m", "mm", "m/s", "mm/s", "N/m", "N s/m", "N/mm"),
    1.0 / POUND_KG: ("kg",),
}
"""The units for which the usual reason of a factor of SLIPS can be true; the others are prefixes, of any unit."""
ALIKE = 1.05  # greatest over least of numbers that are equal by design
EXACT = 0.02  # relative difference from a factor of SLIPS that makes a number of such a list suspicious

FACTORS = (GRAVITY, 9.81, INCH_MM, POUND_KG)  # without powers of ten, which people choose
EXACT_DEFAULT = 5e-5  # relative difference from a factor


@dataclass(frozen=True)
class Comparison:
    """A number `value` of a file, what it must agree with, and the plausible ratio of the two, from `low` to `high`.

    `key` is that of the number as in a case file, `others` are the keys that `figure` is computed from. `value` and
    `figure` are in `unit`. `quantity` says what of the key `value` is, where it is not the number itself.
    """

    key: str
    value: float
    unit: str
    against: str
    figure: float
    low: float
    high: float
    others: tuple[str, ...] = ()
    quantity: str = ""
    asked: str = ""  # the question; default: whether it is in its unit
    suspect: str = ""  # the one of `others` that disagrees with further numbers, too
    power: float = 1.0  # of the key's number in `value`: 0.5 for a frequency that follows from a mass

    @property
    def ratio(self) -> float:
        """Return the number over what it is compared with."""
        return self.value / self.figure if self.figure else float("inf")

    @property
    def doubtful(self) -> bool:
        """Return whether the two do not agree."""
        return not self.low * (1.0 - 1e-9) <= self.ratio <= self.high * (1.0 + 1e-9)

    @property
    def slip(self) -> tuple[float, str] | None:
        """Return the factor of SLIPS, or its inverse, without which the ratio is nearest to the middle of what is
        plausible, with its name; None where none explains it."""
        high = self.high if isfinite(self.high) else 1e4 * self.low
        middle = 0.5 * log(max(self.low, 1e-4 * high) * high)
        factors = [(power, reason_of(size, self.unit)) for size in SLIPS for power in (size, 1.0 / size)]
        fitting = [one for one in factors if self.low <= self.ratio / one[0] ** self.power <= self.high]
        if not (self.ratio > 0.0 and isfinite(self.ratio)):
            return None
        return min(fitting, key=lambda one: abs(log(self.ratio / one[0] ** self.power) - middle), default=None)

    @property
    def finding(self) -> Finding:
        """Return the doubt: both figures, their ratio, what is usual, the likely slip, and the question."""
        usual = {"low": self.low, "high": self.high}
        if self.low == 0.0:
            usual = {"at_most": self.high}
        elif not isfinite(self.high):
            usual = {"at_least": self.low}
        slip = self.slip if self.quantity or not self.suspect else None
        fitting = "would_fit" if self.unit else "fitting_ratio"
        fits = {} if slip is None or self.quantity else {fitting: self.value / slip[0]}
        stated = {"key": self.key, "quantity": self.quantity, "value": self.value, "units": self.unit, **usual, **fits}
        stated |= {"slip": slip[1] if slip else None, "suspect": self.suspect}
        stated["question"] = self.asked or (f"is it in {self.unit}?" if self.unit else "is it right?")
        if self.against == f"1 {self.unit}".rstrip():
            return Finding("units.unusual", stated)
        compared = {"ratio": self.ratio, "against": self.against, "others": self.others, "expected": self.figure}
        return Finding("units.doubt", {**stated, **compared})

    @property
    def sentence(self) -> str:
        """Return the doubt in words."""
        return str(self.finding)


def reason_of(size: float, unit: str) -> str:
    """Return a factor of SLIPS with its usual reason, alone where that cannot be true of a number in `unit`."""
    return SLIPS[size] if not unit or unit in ONLY_OF.get(size, (unit,)) else f"{size:.3g}"


def doubts_of(comparisons: Iterable[Comparison]) -> Iterator[Comparison]:
    """Yield the comparisons that do not agree: the first one of each key, and none with a number that is doubted
    already, from which it would follow. A number that more of them have in common is the suspect of the first."""
    doubtful = [one for one in comparisons if one.doubtful]
    common = Counter(key for one in doubtful for key in {one.key, *one.others})
    doubted: set[str] = set()
    for one in doubtful:
        if doubted & {one.key, *one.others}:
            continue
        suspect = max(one.others, key=lambda key: common[key], default=one.key)
        suspect = suspect if common[suspect] > common[one.key] else ""
        doubted |= {one.key, suspect}
        yield replace(one, suspect=suspect)


def among_equals(values: dict[str, list[float]], unit: str) -> Iterator[Comparison]:
    """Yield a comparison for each number, and each list, that differs from all other numbers of a kind by a factor of
    SLIPS where these are equal by design; `values` by key."""
    for key, of_key in values.items():
        others = [one for other, each in values.items() if other != key for one in each]
        names = tuple(other for other in values if other != key)
        if len(of_key) > 1 and max(of_key) <= ALIKE * min(of_key):
            yield from _off_by_a_slip(key, sum(of_key) / len(of_key), others, names, unit, "the mean")
        for i, value in enumerate(of_key):
            rest = [*of_key[:i], *of_key[i + 1 :], *others]
            place = f"entry {i + 1}" if len(of_key) > 1 else ""
            yield from _off_by_a_slip(key, value, rest, names if others else (), unit, place)


def _off_by_a_slip(
    key: str, value: float, rest: list[float], names: tuple[str, ...], unit: str, place: str
) -> Iterator[Comparison]:
    if not rest or min(rest) <= 0.0 or value <= 0.0 or max(rest) > ALIKE * min(rest):
        return
    mean = sum(rest) / len(rest)
    if any(abs(value / mean / factor - 1.0) <= EXACT for size in SLIPS for factor in (size, 1.0 / size)):
        yield Comparison(
            key, value, unit, "that of all others, which are equal", mean, 1.0 / ALIKE, ALIKE, names, place
        )


def of_defaults(case: Case) -> Iterator[Comparison]:
    """Yield a comparison for each number that is its default times or over one of FACTORS.

    The virtual rig's physics is compared as it stands in its file, nothing follows from it.
    """
    yield from _of_model(case.table, "table")
    for key in type(case).model_fields:
        if key not in ("table", "structure", "reference", "limits"):
            value, default = getattr(case, key, None), type(case).model_fields[key].default
            yield from _of_number(key, value, default)
            if isinstance(value, BaseModel):
                yield from _of_model(value, key)


def _of_model(model: BaseModel, above: str) -> Iterator[Comparison]:
    for key, field in type(model).model_fields.items():
        value = getattr(model, key, None)
        if isinstance(value, BaseModel):
            yield from _of_model(value, f"{above}.{key}")
        else:
            yield from _of_number(f"{above}.{key}", value, field.default)


def _of_number(key: str, value: object, default: object) -> Iterator[Comparison]:
    if not isinstance(value, float) or not isinstance(default, float) or value <= 0.0 or default <= 0.0:
        return
    ratio = value / default
    if any(abs(ratio / factor - 1.0) <= EXACT_DEFAULT for size in FACTORS for factor in (size, 1.0 / size)):
        yield Comparison(key, value, "", "its default", default, 0.99, 1.01)
