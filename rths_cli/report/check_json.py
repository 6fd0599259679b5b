"""`rths check --json`: verdict, reasons and metrics of a check; numbers that are not finite are null."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.quantities import METRICS

if TYPE_CHECKING:
    from rths_cli.experiment.check_command import Checked


def as_document(checked: Sequence[Checked]) -> dict[str, Any]:
    """Return checked cases as plain numbers, texts and lists for JSON."""
    return {"cases": [_case(one) for one in checked]}


def _case(one: Checked) -> dict[str, Any]:
    about = {name: _plain(value) for name, value in vars(one.about).items()}
    return {
        **about,
        "verdict": one.verdict,
        "reasons": list(one.reasons),
        "warnings": list(one.warnings),
        "metrics": {path: _number(value) for path, value in one.metrics.items()},
        "units": {path: METRICS[path].units for path in one.metrics},
        "definitions": {path: METRICS[path].definition for path in one.metrics},
    }


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _number(value: Any) -> Any:
    """Return a number or a list of numbers, with None for each that is not finite."""
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim:
        return [_number(item) for item in numbers]
    return float(numbers) if np.isfinite(numbers) else None
