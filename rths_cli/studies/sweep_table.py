"""The table of a sweep: which metrics it keeps of each run, with unit and definition, and the rows that are there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.field_types import near
from rths_cli.errors import InputError
from rths_cli.files.sweep_file import NEEDED
from rths_cli.quantities import METRICS, Quantity, metrics_of
from rths_cli.quantities.sweep_datasets import TEXTS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from rths_cli.numerics.lti import Array

RUN = "exp_rths"
CHECKED = (
    "spectral_radius", "sensitivity_peak", "gain_margin", "phase_margin_deg", "delay_margin_s", "critical_delay_s",
    "largest_scaling", "peak_displacement_m", "peak_command_v", "tracking_rms_m_s2", "rms_error_m_s2",
)  # fmt: skip
OF_LAWS = tuple(
    f"{RUN}.{name}" for name in ("ductility", "residual_drift_m", "residual_drift_uncertainty_m", "restoring_work_j")
)
OF_TRUTH = tuple(f"{RUN}.true_reference_{name}" for name in ("rms_error_m_s2", "nrmse_percent", "ratio"))
RESPONSES = (
    "peak_inter_storey_drift_m", "peak_drift_ratio", "peak_abs_accel_m_s2", "peak_rel_disp_m",
    "peak_building_base_shear_n", "building_base_shear_ratio",
)  # fmt: skip
ON_REQUEST = (
    *(f"{run}.{name}" for run in ("sim", RUN) for name in RESPONSES), "sim.ductility", "sim.residual_drift_m",
    *metrics_of("ground"),
)  # fmt: skip
"""Metrics that a sweep computes where a study names them."""
Column = Quantity
"""One metric of a sweep: one number per run, or one per run and storey."""


@dataclass(frozen=True)
class Row:
    """One run of a sweep: its number, how it ended and why, the check's verdict, the hash of the model it was driven
    with, the processor that computed it, and its figures one after another.

    `figures` (width,) in the order of the columns, NaN where there is none.
    """

    variant: int
    status: str
    reason: str
    exit_code: int
    verdict: str
    model_sha256: str
    processor: str
    figures: Array


def columns() -> tuple[Column, ...]:
    """Return the metrics that a sweep keeps of each run: errors of EXP-RTHS, the response of storeys with laws, errors
    against the true reference, then what its check foretold."""
    errors = ("tracking_{}_m_s2", "{}_error_m_s2")
    kinds = ("", "_full", "_true", "_true_full")
    played = [f"{RUN}.{of.format(which)}{kind}" for of in errors for kind in kinds for which in ("max", "rms")]
    return tuple(METRICS[path] for path in (*played, *OF_LAWS, *OF_TRUTH, *(f"check.{name}" for name in CHECKED)))


def computable() -> tuple[Column, ...]:
    """Return the metrics that a sweep can keep: those of every table, and those on request."""
    return (*columns(), *(METRICS[path] for path in ON_REQUEST))


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


def kept_columns(
    metrics: Sequence[str] | None, study: Path | None, has_laws: bool = False, has_truth: bool = False
) -> tuple[Column, ...]:
    """Return the metrics that a sweep keeps when a study chooses some (None: all), and those that every table has.

    `has_laws`: whether computed storeys of a run have laws, `has_truth`: whether a specimen is another than declared;
    without them all does not contain what would be NaN or the same as other metrics. Raises InputError for a metric
    that a sweep does not compute.
    """
    of_none = (*(() if has_laws else OF_LAWS), *(() if has_truth else OF_TRUTH))
    known = {column.path: column for column in computable()}
    unknown = [path for path in metrics or () if path not in known]
    if unknown:
        computed = "a sweep does not compute it"
        raise InputError(*(f"{study}: metrics: {path}: {computed}{near(path, known)}" for path in unknown))
    of_none = (*of_none, *ON_REQUEST)
    kept = (*metrics, *NEEDED) if metrics is not None else [path for path in known if path not in of_none]
    return tuple(column for path, column in known.items() if path in kept)


class Table:
    """The rows of the runs `variants` (n,) of a sweep, in ascending order, as they arrive; a million of them take what
    their numbers take."""

    def __init__(self, of: Sequence[Column], storeys: int, variants: NDArray[np.int64]) -> None:
        runs = len(variants)
        self._of, self._storeys, self._variants = of, storeys, variants
        self._numbers = np.full((runs, width(of, storeys)), np.nan)
        self._texts = {name: np.full(runs, "", dtype=object) for name in TEXTS}
        self._codes = np.zeros(runs, dtype=np.int16)
        self._spelt: dict[str, str] = {}
        self._done = np.zeros(runs, dtype=bool)
        self._wanted = np.ones(runs, dtype=bool)

    def want(self, variants: NDArray[np.int64]) -> None:
        """Have only these runs lack where they are not there: the others are not played now."""
        self._wanted[:] = False
        self._wanted[np.searchsorted(self._variants, variants)] = True

    @property
    def played(self) -> NDArray[np.int64]:
        """Return the runs (m,) that are there, in ascending order."""
        return self._variants[self._done]

    def of_played(self) -> Table:
        """Return the table of the runs that are there."""
        found = Table(self._of, self._storeys, self.played)
        found._numbers, found._codes = self._numbers[self._done], self._codes[self._done]
        found._texts = {name: column[self._done] for name, column in self._texts.items()}
        found._done[:] = True
        return found

    def add(self, row: Row) -> None:
        """Put a row in its place."""
        place = self._place(row.variant)
        self._numbers[place] = row.figures
        self._codes[place] = row.exit_code
        for name, column in self._texts.items():
            text = getattr(row, name)
            column[place] = self._spelt.setdefault(text, text)
        self._done[place] = True

    @property
    def left(self) -> int:
        """Return how many rows are not there yet."""
        return int(np.count_nonzero(~self._done))

    @property
    def width(self) -> int:
        """Return how many numbers a row has."""
        return self._numbers.shape[1]

    def has(self, variant: int) -> bool:
        """Tell whether a run belongs to the table."""
        place = self._place(variant)
        return place < len(self._variants) and bool(self._variants[place] == variant)

    def _place(self, variant: int) -> int:
        return int(np.searchsorted(self._variants, variant))

    def lacks(self, variant: int) -> bool:
        """Tell whether a run belongs to the table and is not there yet."""
        place = self._place(variant)
        return self.has(variant) and bool(self._wanted[place] and not self._done[place])

    @property
    def texts(self) -> dict[str, tuple[str, ...]]:
        """Return how each run ended, its verdict and its model, (n_variants,) each."""
        return {name: tuple(column.tolist()) for name, column in self._texts.items()}

    @property
    def exit_codes(self) -> frozenset[int]:
        """Return the exit codes that occurred."""
        return frozenset(np.unique(self._codes).tolist())

    @property
    def figures(self) -> dict[str, Array]:
        """Return the figures of all runs by path, (n_variants,) or (n_variants, n_storeys)."""
        found: dict[str, Array] = {}
        start = 0
        for column in self._of:
            size = self._storeys if column.over else 1
            part = self._numbers[:, start : start + size]
            found[column.path] = part if column.over else part[:, 0]
            start += size
        return found
