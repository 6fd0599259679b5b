"""Units as typeset in a figure, and the unit in a name's ending."""

from __future__ import annotations

from rths_cli.unit_names import ENDINGS, unit_of_name

__all__ = ["ENDINGS", "typeset", "unit_of_name"]


def typeset(units: str) -> str:
    """Return units with raised exponents: m/s²."""
    return units.replace("^2", "²").replace("^4", "⁴")
