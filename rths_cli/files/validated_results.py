"""A result as it was read, once its figures have the shapes that are declared: what reports are made of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result, read_result
from rths_cli.quantities import LATENCIES, metric

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


def read_checked(path: Path, whole: bool = False) -> Result:
    """Read a result file as `read_result` does; raises InputError for figures of other shapes than declared, too."""
    found = read_result(path, whole)
    fault = figure_fault(found.metrics)
    if fault:
        raise InputError(f"{path}: {fault}, so it is no result file as rths run writes it; run the case again.")
    return found


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
