"""`rths check --json`: verdict, reasons and metrics of a check; numbers that are not finite are null."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rths_cli.quantities import METRICS, intervals_of
from rths_cli.report.numbers import intervals_json, json_value

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
        "doubted": list(one.doubted),
        "reasons": list(one.reasons),
        "warnings": list(one.warnings),
        "metrics": {path: json_value(value) for path, value in one.metrics.items()},
        "units": {path: METRICS[path].units for path in one.metrics},
        "definitions": {path: METRICS[path].definition for path in one.metrics},
        **({"tangents": list(one.tangents)} if one.tangents else {}),
        **({"guard": list(one.of_guard)} if one.of_guard else {}),
        **({"intervals": intervals_json(intervals)} if (intervals := intervals_of(one.metrics)) else {}),
    }


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
