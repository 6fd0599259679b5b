"""The table of a sweep: its columns with unit and definition, and one row of figures per run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.metrics import figures_of_pairs
from rths_cli.quantities import METRICS, Quantity

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.numerics.lti import Array

    Pairs = Sequence[tuple[Array, Array]]

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


def error_values(
    table: Pairs, storeys: Pairs, true_storeys: Pairs, dt_s: float, room: Array, high_pass_hz: float
) -> dict[str, Array]:
    """Return tracking errors and errors to SIM by their paths, in one pass over all series.

    Pairs of reference and value (n,) in m/s^2: the table's measured and true acceleration against the desired, each
    storey's measured and true absolute acceleration against SIM. `room` as `room_for_pairs` gives it.
    """
    errors = figures_of_pairs([*table, *storeys, *true_storeys], dt_s, room, high_pass_hz)
    count = len(storeys)
    values: dict[str, Array] = {}
    for kind, place, rows in (("", 0, slice(2, 2 + count)), ("_true", 1, slice(2 + count, None))):
        for band, maximum, rms in (("", errors.maximum, errors.rms), ("_full", errors.maximum_full, errors.rms_full)):
            for which, found in (("max", maximum), ("rms", rms)):
                values[f"{RUN}.tracking_{which}_m_s2{kind}{band}"] = found[place]
                values[f"{RUN}.{which}_error_m_s2{kind}{band}"] = found[rows]
    return values


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
