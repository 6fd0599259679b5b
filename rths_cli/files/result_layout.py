"""What a result file states, in which types, ranges and shapes: checked when it is read, before anything uses it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from rths_cli.files.hdf5_layout import LARGEST, LayoutError

STATUSES = ("complete", "aborted", "interrupted", "failed", "refused")
NUMBERS: dict[str, tuple[float, float]] = {
    "format_version": (1, 1e6),
    "seed": (0, 2.0**64),
    "sample_rate_hz": (1.0, 1e6),
    "scaling": (-1e9, 1e9),
    "damping_first_mode_ratio": (-10.0, 1e3),
}
"""Attributes of the root that are numbers, with the range of each."""
TEXTS = (
    "format", "status", "status_reason", "case_name", "created_utc", "rths_version", "method", "rig", "rig_kind",
    "driver_verified", "overrides", "command_line", "platform", "package_versions", "git_commit", "record_sha256",
    "model_sha256", "record_name", "damping_name", "controller", "reference_title", "reference_json", "warnings",
    "shake_table_status", "exp_rths_status", "shake_table_status_reason", "exp_rths_status_reason",
)  # fmt: skip
"""Attributes of the root that are texts; others may be texts or numbers."""
STOREYS, FLOORS, TIME = "storey", "experimental_storey", "time_s"
SERIES: dict[str, int] = {
    "time_s": 1, "frequency_hz": 1, "storey": 1, "ground_accel_m_s2": 1, "base_shear_n": 1, "command_v": 1,
    "interface_accel_desired_m_s2": 1, "interface_accel_measured_m_s2": 1, "table_accel_m_s2": 1, "table_disp_m": 1,
    "abs_accel_m_s2": 2, "rel_disp_m": 2, "rel_vel_m_s": 2, "floor_accel_measured_m_s2": 2,
    "floor_accel_estimated_m_s2": 2, "floor_accel_m_s2": 2, "sensor_drift_m_s2": 2, "samples_v": 2, "rest_time_s": 1,
}  # fmt: skip
"""Datasets outside /metrics and /controller by name, with the number of their axes; time or frequency is the last."""


def check_attributes(found: Mapping[str, str | int | float]) -> None:
    """Raise LayoutError for an attribute of the root of another type or beyond its range."""
    for name, (low, high) in NUMBERS.items():
        value = found.get(name, low)
        if isinstance(value, str) or not low <= value <= high:
            raise LayoutError(f"has the attribute {name} = {str(value)[:40]!r}, which must be {low:g} to {high:g}")
    for name in TEXTS:
        if not isinstance(found.get(name, ""), str):
            raise LayoutError(f"has the attribute {name} = {found[name]}, which must be a text")
    if found.get("status", "complete") not in STATUSES:
        raise LayoutError(f"has the status {str(found['status'])[:40]!r}, which is none of {', '.join(STATUSES)}")
    _check_figures(str(found.get("reference_json") or "{}"))
    _json_mapping("package_versions", str(found.get("package_versions") or "{}"))


def check_series(path: str, shape: Sequence[int], axes: Sequence[tuple[str, int]]) -> None:
    """Raise LayoutError for a dataset with another number of axes than declared, or whose scales do not fit it.

    `axes`: name and length of the scale of each axis that has one.
    """
    group, _, name = path.rpartition("/")
    free = group.startswith(("metrics", "controller"))
    if not free and len(shape) != SERIES.get(name, len(shape)):
        raise LayoutError(f"has {len(shape)} axes in {path}, which must have {SERIES[name]}")
    if axes and tuple(length for _, length in axes) != tuple(shape):
        raise LayoutError(f"has scales of other lengths than {path}")
    if any(axis in (TIME, "frequency_hz") for axis, _ in axes[:-1]):
        raise LayoutError(f"has the time on another axis than the last one of {path}")


def _check_figures(text: str) -> None:
    """Raise LayoutError for published figures that are not numbers by their paths."""
    for value in _json_mapping("reference_json", text).values():
        items = value if isinstance(value, list) else [value]
        if not all(item is None or _is_number(item) for item in items):
            raise LayoutError("has published figures in reference_json that are no numbers")


def _is_number(item: Any) -> bool:
    return isinstance(item, int | float) and not isinstance(item, bool) and abs(item) <= LARGEST


def _json_mapping(name: str, text: str) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise LayoutError(f"has no JSON in its attribute {name}") from error
    if not isinstance(found, dict):
        raise LayoutError(f"has no JSON mapping in its attribute {name}")
    return found
