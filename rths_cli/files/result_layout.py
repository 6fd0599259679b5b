"""What a result file states, in which types, ranges and shapes: checked when it is read, before anything uses it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

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
TIME, FREQUENCY, REST, ANY = "time_s", "frequency_hz", "rest_time_s", "*"
SCALES = (TIME, FREQUENCY, REST, "storey", "floor", "channel")
SERIES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(
        (
            "ground_accel_m_s2", "base_shear_n", "base_shear_unexplained_n", "command_v", "table_accel_m_s2",
            "interface_accel_desired_m_s2", "interface_accel_measured_m_s2", "table_disp_m", "compute_s",
        ),
        (TIME,),
    ),
    **dict.fromkeys(
        (
            "abs_accel_m_s2", "rel_disp_m", "rel_vel_m_s", "floor_accel_measured_m_s2", "floor_accel_estimated_m_s2",
            "floor_accel_m_s2", "sensor_drift_m_s2",
        ),
        (ANY, TIME),
    ),
    "samples_v": (ANY, REST),
    **dict.fromkeys(("frf_real", "frf_imag", "coherence"), (FREQUENCY,)),
    **dict.fromkeys(("poles_real", "poles_imag"), ("pole",)),
    **dict.fromkeys(("zeros_real", "zeros_imag"), ("zero",)),
    **dict.fromkeys(("natural_frequency_hz", "damping_ratio"), ("mode",)),
    **dict.fromkeys(("gain", "delay_s", "ripple_m_s2_per_v", "coupling_hz", "fit_error_rms", "fit_error_max"), ()),
}  # fmt: skip
"""Datasets outside /metrics and /controller by name, with the scale of each of their axes; time or frequency is the
last. The scale stands in the group of the dataset, so that what has the same scale has as many values."""
MATRICES = ("A", "B", "C", "D")
EXACT = ("sim", "sim_delay")
"""Groups that reach to the end of the record; a run on the table may be shorter."""


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


def check_series(
    path: str,
    shape: Sequence[int],
    scales: Sequence[tuple[str, int]],
    shape_of: Callable[[str], tuple[int, ...] | None],
) -> None:
    """Raise LayoutError for a dataset with other axes than declared, or whose scales do not fit it.

    `scales`: path and length of the scale of each axis that has one; `shape_of`: shape of another dataset by its
    path, None where there is none.
    """
    group = path.rpartition("/")[0]
    if scales and tuple(length for _, length in scales) != tuple(shape):
        raise LayoutError(f"has scales of other lengths than {path}")
    if any(scale.rpartition("/")[2] in (TIME, FREQUENCY, REST) for scale, _ in scales[:-1]):
        raise LayoutError(f"has the time on another axis than the last one of {path}")
    if group.startswith("controller"):
        _check_block(group, path, shape_of)
    elif not group.startswith("metrics"):
        _check_declared(path, shape, [scale for scale, _ in scales])
        _check_runs(group.partition("/")[0], path, shape, shape_of)


def check_values(path: str, values: Any) -> None:
    """Raise LayoutError for values that a declared dataset, a scale or a matrix of a block cannot have."""
    group, _, name = path.rpartition("/")
    matrix, axes = group.startswith("controller") and name in MATRICES, SERIES.get(name)
    declared = not group.startswith(("metrics", "controller")) and (axes is not None or name in SCALES)
    if not matrix and not declared:
        return
    found = np.asarray(values)
    if found.dtype.kind not in "iuf":
        raise LayoutError(f"holds no numbers in {path}")
    sampled = axes is not None and axes[-1:] in ((TIME,), (REST,))
    if not sampled and not np.all(np.isfinite(found)):
        raise LayoutError(f"holds a number that is not finite in {path}")
    if declared and name in (TIME, FREQUENCY, REST) and np.any(np.diff(found) <= 0.0):
        raise LayoutError(f"holds values that do not rise in {path}")
    if declared and name == FREQUENCY and np.any(found <= 0.0):
        raise LayoutError(f"holds a frequency that is not positive in {path}")


def _check_block(group: str, path: str, shape_of: Callable[[str], tuple[int, ...] | None]) -> None:
    """Raise LayoutError where the matrices of a block do not fit each other: A (n, n), B (n, m), C (p, n), D (p, m)."""
    if path.rpartition("/")[2] not in MATRICES:
        return
    shapes = [shape_of(f"{group}/{name}") for name in MATRICES]
    if any(shape is None or len(shape) != 2 for shape in shapes):
        raise LayoutError(f"has not the four matrices of a block in {group}")
    a, b, c, d = shapes
    if not (a and b and c and d) or (*a, b[0], c[1], *d) != (a[0],) * 4 + (c[0], b[1]):
        raise LayoutError(f"has matrices in {group} that do not fit each other")


def _check_declared(path: str, shape: Sequence[int], scales: Sequence[str]) -> None:
    """Raise LayoutError for a declared dataset or scale with other axes than its name says."""
    group, _, name = path.rpartition("/")
    axes = (ANY,) if name in SCALES else SERIES.get(name)
    if axes is None:
        return
    if len(shape) != len(axes):
        raise LayoutError(f"has {len(shape)} axes in {path}, which must have {len(axes)}")
    if name in SCALES:
        return
    for i, axis in enumerate(axes):
        scale = scales[i] if i < len(scales) else ""
        if scale.strip("/") != f"{group}/{scale.rpartition('/')[2] if axis == ANY else axis}":
            wanted = "a scale" if axis == ANY else f"the scale {axis}"
            raise LayoutError(f"has not {wanted} of its own group on axis {i} of {path}")


def _check_runs(run: str, path: str, shape: Sequence[int], shape_of: Callable[[str], tuple[int, ...] | None]) -> None:
    """Raise LayoutError where a run has more samples than the record, or other storeys than SIM."""
    name = path.rpartition("/")[2]

    def length_of(other: str) -> int | None:
        return (shape_of(other) or (None,))[0]

    on_time = SERIES.get(name, (name,))[-1:] == (TIME,)
    of_run, of_record = length_of(f"{run}/{TIME}"), length_of(f"record/{TIME}")
    if on_time and of_run is not None and shape[-1] != of_run:
        raise LayoutError(f"has {shape[-1]} samples of {path} and {of_run} of {run}/{TIME}")
    if on_time and of_record is not None and (shape[-1] > of_record or (run in EXACT and shape[-1] != of_record)):
        raise LayoutError(f"has {shape[-1]} samples of {path} and {of_record} of record/{TIME}")
    storeys = length_of("sim/storey")
    if name == "abs_accel_m_s2" and storeys is not None and shape[0] != storeys:
        raise LayoutError(f"has {shape[0]} storeys of {path} and {storeys} of SIM")


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
