"""The table of a sweep: its columns with unit and definition, and one row of figures per run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.metrics import figures_of_pairs
from rths_cli.workflows import figures

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.lti import Array

    Pairs = Sequence[tuple[Array, Array]]

RUN = "exp_rths"
CHECKED = (
    ("spectral_radius", "1", "largest |eigenvalue| of the sampled closed loop (1: limit)"),
    ("sensitivity_peak", "1", "largest |1 / (1 + loop)| of the hybrid loop broken at the command"),
    ("gain_margin", "1", "smallest factor > 1 on the hybrid loop's gain that makes it unstable"),
    ("phase_margin_deg", "deg", "smallest change of phase that makes the hybrid loop unstable"),
    ("delay_margin_s", "s", "smallest further delay that makes the hybrid loop unstable"),
    ("critical_delay_s", "s", "pure delay of the base shear at which the building loses stability on a perfect table"),
    ("largest_scaling", "1", "scaling of the record up to which the check finds the test safe"),
    ("peak_displacement_m", "m", "predicted peak displacement of the table, with room to brake"),
    ("peak_command_v", "V", "predicted peak command"),
    ("tracking_rms_m_s2", "m/s^2", "predicted RMS tracking error in the test band"),
    ("rms_error_m_s2", "m/s^2", "predicted RMS error of each storey to SIM in the test band"),
)


@dataclass(frozen=True)
class Column:
    """One figure of a sweep by its path; `per_storey`: it has one value per storey, else it is one number."""

    path: str
    units: str
    definition: str
    per_storey: bool


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
    """Return the figures that a sweep keeps of each run: errors of EXP-RTHS, then what its check foretold."""
    still, dt_s = np.zeros(64), 1e-3
    played = figures.tracking(RUN, still, still, still, dt_s, 0.0)
    played |= figures.against_sim(RUN, still[None], still[None], still[None], dt_s, 0.0)
    kept = {path: metric for path, metric in played.items() if "delay" not in path}
    found = [Column(path, one.units, one.definition, np.ndim(one.value) > 0) for path, one in kept.items()]
    foretold = [
        Column(f"check.{name}", units, about, name == "rms_error_m_s2") for name, units, about in CHECKED
    ]  # fmt: skip
    return (*found, *foretold)


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
    return sum(storeys if column.per_storey else 1 for column in of)


def flat(of: Sequence[Column], storeys: int, values: Mapping[str, ArrayLike]) -> Array:
    """Return the figures of one run (width,), NaN for what it has not and for storeys it has not."""
    row = np.full(width(of, storeys), np.nan)
    start = 0
    for column in of:
        if column.path in values:
            found = np.atleast_1d(np.asarray(values[column.path], dtype=float))
            row[start : start + found.size] = found
        start += storeys if column.per_storey else 1
    return row


def table(of: Sequence[Column], storeys: int, rows: Sequence[Array]) -> dict[str, Array]:
    """Return the figures of all runs by path, (n_variants,) or (n_variants, n_storeys)."""
    stacked = np.array(rows).reshape(len(rows), width(of, storeys))
    found: dict[str, Array] = {}
    start = 0
    for column in of:
        size = storeys if column.per_storey else 1
        part = stacked[:, start : start + size]
        found[column.path] = part if column.per_storey else part[:, 0]
        start += size
    return found
