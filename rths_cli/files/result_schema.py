"""Check what a result file states when it is read: types, ranges, axes and shapes, against quantities/."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.files.hdf5_safety import LARGEST, LayoutError
from rths_cli.quantities import ATTRIBUTES, AXES, LATENCIES, AttributeDeclaration, metric, stored_dataset
from rths_cli.quantities.axes import RISING, SAMPLED
from rths_cli.quantities.datasets import SOLUTIONS

MATRICES = ("A", "B", "C", "D")
SUMS = ("total", "compensated", "left", "predicted", "declared")
TOGETHER = {
    "latency.total_s": (
        "latency.frequency_hz",
        *(f"latency.{name}_s" for name in (*LATENCIES, *SUMS)),
        *(f"latency.{name}_left_s" for name in LATENCIES),
    ),
    "latency.identified_s": ("latency.identified_error_s",),
    "budget.rms_error_coupling_m_s2": ("budget.table_gain_error", "budget.table_delay_error_s", "budget.friction_v"),
}
"""Figures without which the one that names them says nothing."""


def check_attributes(found: Mapping[str, str | int | float]) -> None:
    """Raise LayoutError for an attribute of the root of another type or beyond its range."""
    for name, value in found.items():
        if (declared := ATTRIBUTES.get(name)) is not None:
            _check_attribute(declared, value)
    _check_figures(str(found.get("reference_json") or "{}"))
    _json_mapping("package_versions", str(found.get("package_versions") or "{}"))


def _check_attribute(declared: AttributeDeclaration, value: str | int | float) -> None:
    """Raise LayoutError for an attribute of another kind than declared, or beyond its limits."""
    name, limits = declared.name, declared.limits
    if declared.kind == "text":
        if not isinstance(value, str):
            raise LayoutError(f"has the attribute {name} = {value}, which must be a text")
        if limits and value not in limits:
            raise LayoutError(f"has the {name} {value[:40]!r}, which is none of {', '.join(map(str, limits))}")
        return
    low, high = limits or (-LARGEST, LARGEST)
    if isinstance(value, str) or not low <= value <= high:  # type: ignore[operator]
        raise LayoutError(f"has the attribute {name} = {str(value)[:40]!r}, which must be {low:g} to {high:g}")


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
    if any(scale.rpartition("/")[2] in RISING for scale, _ in scales[:-1]):
        raise LayoutError(f"has the time on another axis than the last one of {path}")
    if group.startswith("controller"):
        _check_block(group, path, shape_of)
    elif not group.startswith("metrics"):
        axes = [scale for scale, _ in scales]
        _check_declared(path, shape, axes)
        _check_runs(path, shape, axes, shape_of)


def check_values(path: str, values: Any) -> None:
    """Raise LayoutError for values that a declared dataset, a scale or a matrix of a block cannot have."""
    group, _, name = path.rpartition("/")
    matrix, declared = group.startswith("controller") and name in MATRICES, stored_dataset(path)
    scale = _is_scale(path)
    if not matrix and not scale and (declared is None or declared.kind == "text"):
        return
    found = np.asarray(values)
    if found.dtype.kind not in "iuf":
        raise LayoutError(f"holds no numbers in {path}")
    sampled = declared is not None and declared.axes[-1:] in [(axis,) for axis in SAMPLED]
    if not sampled and not np.all(np.isfinite(found)):
        raise LayoutError(f"holds a number that is not finite in {path}")
    if scale and name in RISING and np.any(np.diff(found) <= 0.0):
        raise LayoutError(f"holds values that do not rise in {path}")
    if scale and name == "frequency_hz" and np.any(found <= 0.0):
        raise LayoutError(f"holds a frequency that is not positive in {path}")


def figure_fault(figures: Mapping[str, ArrayLike]) -> str:
    """Return what is wrong with the shapes of figures, as a clause about their file; "" where nothing is."""
    sizes: dict[str, tuple[int, str]] = {}
    for path, value in figures.items():
        found = metric(path)
        if found is None:
            continue
        if np.ndim(value) != (1 if found.over else 0):
            wanted = f"one value per {found.over}" if found.over else "one value"
            return f"has a figure {path} of {np.size(value)} values, which must have {wanted}"
        axis = found.over if found.over in ("", "storey") else f"{path.partition('.')[0]}.{found.over}"
        size, first = sizes.setdefault(axis, (np.size(value), path))
        if axis and size != np.size(value):
            return f"has {np.size(value)} values of {path} and {size} of {first}"
    missing = [name for path, names in TOGETHER.items() if path in figures for name in names if name not in figures]
    return f"has no figure {missing[0]}" if missing else ""


def _is_scale(path: str) -> bool:
    """Return whether a path is the scale of an axis, outside /metrics and /controller."""
    group, _, name = path.rpartition("/")
    return name in AXES and stored_dataset(path) is None and not group.startswith(("metrics", "controller"))


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
    """Raise LayoutError for a dataset or scale with other axes than declared."""
    group, declared = path.rpartition("/")[0], stored_dataset(path)
    if declared is None:
        if _is_scale(path) and len(shape) != 1:
            raise LayoutError(f"has {len(shape)} axes in {path}, which must have 1")
        return
    if len(shape) != len(declared.axes):
        raise LayoutError(f"has {len(shape)} axes in {path}, which must have {len(declared.axes)}")
    for i, axis in enumerate(declared.axes):
        if i >= len(scales) or scales[i].strip("/") != f"{group}/{axis}":
            raise LayoutError(f"has not the scale {axis} of its own group on axis {i} of {path}")


def _check_runs(
    path: str, shape: Sequence[int], scales: Sequence[str], shape_of: Callable[[str], tuple[int, ...] | None]
) -> None:
    """Raise LayoutError where a run has more samples than the record, or other storeys than SIM."""
    run, name, declared = path.partition("/")[0], path.rpartition("/")[2], stored_dataset(path)

    def length_of(other: str) -> int | None:
        return (shape_of(other) or (None,))[0]

    last = declared.axes[-1:] if declared else tuple(scale.rpartition("/")[2] for scale in scales[-1:])
    on_time = last == ("time_s",) or name == "time_s"
    of_run, of_record = length_of(f"{run}/time_s"), length_of("record/time_s")
    if on_time and of_run is not None and shape[-1] != of_run:
        raise LayoutError(f"has {shape[-1]} samples of {path} and {of_run} of {run}/time_s")
    if on_time and of_record is not None and (shape[-1] > of_record or (run in SOLUTIONS and shape[-1] != of_record)):
        raise LayoutError(f"has {shape[-1]} samples of {path} and {of_record} of record/time_s")
    storeys = length_of("sim/storey")
    if declared is not None and declared.axes[:1] == ("storey",) and storeys is not None and shape[0] != storeys:
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
