"""Numbers of a case and its rig that are a default times the factor of a unit: nobody states 0.4536 of it by chance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pydantic import BaseModel

from rths_cli.case.unit_comparison import GRAVITY, INCH_MM, POUND_KG, Comparison

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case

FACTORS = (GRAVITY, 9.81, INCH_MM, POUND_KG)  # without powers of ten, which people choose
EXACT = 5e-5  # relative difference from a factor


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
    if any(abs(ratio / factor - 1.0) <= EXACT for size in FACTORS for factor in (size, 1.0 / size)):
        yield Comparison(key, value, "", "its default", default, 0.99, 1.01)
