"""Spellings of the units of acceleration, as files of records and recordings write them."""

from __future__ import annotations

import re

from rths_cli.numerics.constants import FACTORS

FACTORS_M_S2 = FACTORS["acceleration"]
AMBIGUOUS = {"MV", "Mv", "MG", "Mg", "mG"}  # megavolt, megagram, milligauss


def find_unit(text: str) -> str | None:
    """Return the unit that a text such as `cm/s^2 (gal)` names, None if unknown or ambiguous."""
    parts = [part.strip() for part in re.split(r"[()\[\]=,]", text) if part.strip()]
    found = [_spelling(part) for part in parts if part not in AMBIGUOUS]
    factors = {FACTORS_M_S2.get(unit) for unit in found}
    return found[0] if len(found) == len(parts) and len(factors) == 1 and None not in factors else None


def _spelling(text: str) -> str:
    """Return one spelling of a unit: `M/SEC/SEC`, `m/s2`, `m s-2` and `m/s²` are m/s^2."""
    unit = re.sub(r"\s", "", text).lower().rstrip(".").replace("²", "2")
    unit = re.sub(r"^([a-z]+)[·.*]?s(?:\^|\*\*)?[-⁻]2$", r"\1/s2", unit)
    unit = unit.replace("sec", "s").replace("s/s", "s2")
    return re.sub(r"s(\*\*|\^)?2$", "s^2", unit)
