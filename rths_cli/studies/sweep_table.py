"""The columns of a sweep's table: which metrics it keeps of each run, with unit and definition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.quantities import METRICS, Quantity

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.numerics.lti import Array

RUN = "exp_rths"
CHECKED = (
    "spectral_radius", "sensitivity_peak", "gain_margin", "phase_margin_deg", "delay_margin_s", "critical_delay_s",
    "largest_scaling", "peak_displacement_m", "peak_command_v", "tracking_rms_m_s2", "rms_error_m_s2",
)  # fmt: skip
Column = Quantity
"""One metric of a sweep: one number per run, or one per run and storey."""


@dataclass(frozen=True)
class Row:
    """One run of a sweep: its number, how it ended and why, the check's verdict, the hash of the model it was driven
    with, and its figures one after another.

    `figures` (width,) in the order of the columns, NaN where there is none.
    """

    variant: int
    status: str
    reason: str
    exit_code: int
    verdict: str
    model_sha256: str
    figures: Array


def columns() -> tuple[Column, ...]:
    """Return the metrics that a sweep keeps of each run: errors of EXP-RTHS, then what its check foretold."""
    errors = ("tracking_{}_m_s2", "{}_error_m_s2")
    kinds = ("", "_full", "_true", "_true_full")
    played = [f"{RUN}.{of.format(which)}{kind}" for of in errors for kind in kinds for which in ("max", "rms")]
    return tuple(METRICS[path] for path in (*played, *(f"check.{name}" for name in CHECKED)))


def width(of: Sequence[Column], storeys: int) -> int:
    """Return how many numbers a row has."""
    return sum(storeys if column.over else 1 for column in of)


def flat(of: Sequence[Column], storeys: int, values: Mapping[str, ArrayLike]) -> Array:
    """Return the figures of one run (width,), NaN for what it has not and for storeys it has not."""
    row = np.full(width(of, storeys), np.nan)
    start = 0
    for column in of:
        if column.path in values:
            found = np.atleast_1d(np.asarray(values[column.path], dtype=float))
            row[start : start + found.size] = found
        start += storeys if column.over else 1
    return row


def table(of: Sequence[Column], storeys: int, rows: Sequence[Array]) -> dict[str, Array]:
    """Return the figures of all runs by path, (n_variants,) or (n_variants, n_storeys)."""
    stacked = np.array(rows).reshape(len(rows), width(of, storeys))
    found: dict[str, Array] = {}
    start = 0
    for column in of:
        size = storeys if column.over else 1
        part = stacked[:, start : start + size]
        found[column.path] = part if column.over else part[:, 0]
        start += size
    return found
