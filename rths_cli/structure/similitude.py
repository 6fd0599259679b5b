"""Similitude of a model in the laboratory and its prototype: the factor of every quantity from three independent ones.

Factors are the prototype's value over the model's. Length, acceleration and mass are independent; the factor of any
mechanical quantity is a product of their powers (Harris and Sabnis, Structural Modeling and Experimental Techniques,
2nd ed., 1999, chapter 2). docs/background/similitude.md derives them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rths_cli.case.structure_schema import ScaleSpec

DIMENSIONS = {
    "1": (0, 0, 0), "%": (0, 0, 0), "kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "Hz": (0, 0, -1),
    "N": (1, 1, -2), "J": (1, 2, -2),
}  # fmt: skip
"""Exponents of mass, length and time in each unit that has a factor; volts have none."""
UNITS = {
    "length": "m", "time": "s", "velocity": "m/s", "acceleration": "m/s^2", "frequency": "Hz", "mass": "kg",
    "force": "N", "stiffness": "N/m", "dashpot": "N*s/m", "energy": "J", "stress": "N/m^2",
}  # fmt: skip
"""The quantities whose factors are printed and stored, each with its unit."""
PART = re.compile(r"([*/]?)(1|%|[A-Za-z]+)(?:\^(\d+))?")


@dataclass(frozen=True)
class Similitude:
    """The three independent scale factors, prototype over model."""

    length: float
    acceleration: float
    mass: float

    def factor(self, units: str) -> float:
        """Return the prototype's value over the model's of a quantity in these units (`N*s/m`).

        Raises ValueError for units without mechanical dimensions (`V`).
        """
        mass, length, time = dimensions(units)
        # time = sqrt(length / acceleration); an exponent of zero gives 1.0 exactly
        return float(self.mass**mass * self.length ** (length + 0.5 * time) * self.acceleration ** (-0.5 * time))

    @property
    def factors(self) -> dict[str, float]:
        """Return the factor of each of UNITS by its name."""
        return {name: self.factor(units) for name, units in UNITS.items()}


def factors_text(factors: Mapping[str, float]) -> str:
    """Return scale factors as a list in one line."""
    return ", ".join(f"{name} {value:.4g}" for name, value in factors.items())


def dimensions(units: str) -> tuple[int, int, int]:
    """Return the exponents of mass, length and time in units such as `m^2/s^4`; raises ValueError for others."""
    mass = length = time = end = 0
    for found in PART.finditer(units):
        sign, name, power = found[1], found[2], int(found[3] or 1)
        if found.start() != end or bool(sign) == (end == 0) or name not in DIMENSIONS:
            break
        end, power = found.end(), -power if sign == "/" else power
        mass, length, time = (e + power * own for e, own in zip((mass, length, time), DIMENSIONS[name], strict=True))
    if not units or end != len(units):
        raise ValueError(f"{units!r} has no mechanical dimensions, so no scale factor.")
    return mass, length, time


def similitude_of(scale: ScaleSpec) -> Similitude:
    """Return the independent factors of a case's `scale`; without `mass` that of mass follows from `stress` (or 1).

    force = stress length^2 and mass = force / acceleration.
    """
    if scale.mass is not None:
        return Similitude(scale.length, scale.acceleration, scale.mass)
    stress = 1.0 if scale.stress is None else scale.stress
    return Similitude(scale.length, scale.acceleration, stress * scale.length**2 / scale.acceleration)
