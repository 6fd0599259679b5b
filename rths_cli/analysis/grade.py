"""The grade of a hybrid test: good, usable or poor, by its errors to SIM and to SIM-DELAY, and what limits it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

GOOD, USABLE, POOR = "good", "usable", "poor"
BUDGET = "budget.rms_error_{}_m_s2"
PREDICTED = "check.rms_error_{}_m_s2"
OF_SAMPLES = ("noise", "quantisation")  # causes that are predicted alone
WITH_SAMPLES = ("specimen", "rest")  # measured causes that hold them
LIMITING = 0.5  # smallest share of the squared error of a cause that is named alone


@dataclass(frozen=True)
class GradeLimits:
    """Largest errors of the worst storey, RMS in the test band: in percent of SIM's RMS, and over SIM-DELAY's error."""

    good_percent: float = 2.0
    good_ratio: float = 0.1
    usable_percent: float = 5.0


@dataclass(frozen=True)
class Grade:
    """A grade with the figures that it follows from."""

    grade: str  # GOOD, USABLE or POOR
    percent: float  # RMS error of the worst storey in percent of SIM's RMS
    storey: int  # that storey, from 1
    ratio: float | None  # largest RMS error over SIM-DELAY's; None where there is no SIM-DELAY to compare with
    ratio_storey: int | None
    missed: str  # the limit that a better grade misses: "percent", "ratio" or ""
    cause: str  # the cause that makes most of the worst storey's error, by its name in the budget; "" if none does


def grade_of(values: Mapping[str, ArrayLike], limits: GradeLimits) -> Grade | None:
    """Return the grade of an EXP-RTHS by the metrics of its result; None without its errors.

    Measured errors are graded, as on a real rig, where there are no others.
    """
    if "exp_rths.nrmse_percent" not in values:
        return None
    percents = np.atleast_1d(np.asarray(values["exp_rths.nrmse_percent"], dtype=float))
    worst = _largest(percents)
    percent, ratios = float(percents[worst]), _ratios(values)
    ratio_storey = None if ratios is None else _largest(ratios)
    ratio = None if ratios is None or ratio_storey is None else float(ratios[ratio_storey])
    if not percent <= limits.usable_percent:
        grade, missed = POOR, "percent"
    elif not percent <= limits.good_percent:
        grade, missed = USABLE, "percent"
    elif ratio is not None and not ratio <= limits.good_ratio:
        grade, missed = USABLE, "ratio"
    else:
        grade, missed = GOOD, ""
    at = ratio_storey if missed == "ratio" and ratio_storey is not None else worst
    number = None if ratio_storey is None else ratio_storey + 1
    return Grade(grade, percent, worst + 1, ratio, number, missed, _cause(values, at))


def _largest(values: np.ndarray) -> int:
    """Return the place of the largest value; one that is not a number is larger than all."""
    return int(np.argmax(np.where(np.isnan(values), math.inf, values)))


def _ratios(values: Mapping[str, ArrayLike]) -> np.ndarray | None:
    """Return the errors over those of SIM-DELAY (n_storeys,), None without a SIM-DELAY that has finite ones."""
    if "sim_delay.rms_error_m_s2" not in values or "exp_rths.rms_error_m_s2" not in values:
        return None
    above, below = (
        np.atleast_1d(np.asarray(values[f"{run}.rms_error_m_s2"], dtype=float)) for run in ("exp_rths", "sim_delay")
    )
    return above / below if np.isfinite(below).all() and (below > 0.0).all() else None


def _cause(values: Mapping[str, ArrayLike], storey: int) -> str:
    """Return the name of the cause with at least LIMITING of the squares of a storey's errors, "" without one.

    What the budget measures as the specimen's and as the rest holds the noise and the rounding of the samples. Where
    the check predicted at least LIMITING of it from these two, the larger one is the cause.
    """
    first, last = BUDGET.split("{}")
    squares = {
        path.removeprefix(first).removesuffix(last): _square(value, storey)
        for path, value in values.items()
        if path.startswith(first) and path.endswith(last)
    }
    name = max(squares, key=squares.__getitem__, default="")
    if not name or not squares[name] >= LIMITING * sum(squares.values()) > 0.0:
        return ""
    expected = {cause: _square(values.get(PREDICTED.format(cause), 0.0), storey) for cause in OF_SAMPLES}
    holds_them = name in WITH_SAMPLES and sum(expected.values()) >= LIMITING * squares[name]
    return max(expected, key=expected.__getitem__) if holds_them else name


def _square(value: ArrayLike, storey: int) -> float:
    values = np.atleast_1d(np.asarray(value, dtype=float))
    return float(values[min(storey, values.size - 1)]) ** 2
