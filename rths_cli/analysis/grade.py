"""The grade of a test (good, usable, poor) from the bound of its true error, and accept limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.quantities import METRICS

GOOD, USABLE, POOR = "good", "usable", "poor"
BUDGET = "budget.rms_error_{}_m_s2"
PREDICTED = "check.rms_error_{}_m_s2"
OF_SAMPLES = ("noise", "quantisation")  # causes that are predicted alone
WITH_SAMPLES = ("specimen", "rest")  # measured causes that hold them
NO_CAUSE = "declared"  # in the budget: the true error does not hold what the specimen differs from its declaration by
CALIBRATION = "calibration"  # the cause of what sensors cannot show
LIMITING = 0.5  # smallest share of the squared error of a cause that is named alone
LEAST_SHARE = 0.02  # of the interface floor's inertia force: a specimen with less of it hardly matters
DECLARED = 2.0  # standard uncertainties from which the specimen is another one than declared
CHANGED = 3.0  # standard uncertainties from which it has changed since the identification


@dataclass(frozen=True)
class GradeLimits:
    """Largest 95 % bounds of the true error, of the worst storey in percent of SIM's RMS in the test band, and the
    largest error over SIM-DELAY's of a test whose compensation is worth it."""

    good_percent: float = 2.0
    good_ratio: float = 0.1
    usable_percent: float = 5.0


@dataclass(frozen=True)
class Grade:
    """A grade with the figures that it follows from: the true error in percent of SIM as identified."""

    grade: str  # GOOD, USABLE or POOR
    percent: float  # 95 % bound of the worst storey
    median: float  # of the same storey: as likely exceeded as not
    storey: int  # that storey, from 1
    cause: str  # the cause that makes most of it, CALIBRATION or by its name in the budget; "" if none does


@dataclass(frozen=True)
class Compensation:
    """What the compensation is worth: the median of the true error over SIM-DELAY's error, at its largest."""

    ratio: float
    storey: int  # from 1
    delayed_percent: float  # SIM-DELAY's own error of its worst storey, in percent of SIM

    def worth_it(self, limits: GradeLimits) -> bool:
        """Return whether it is."""
        return self.ratio <= self.limit(limits)

    def limit(self, limits: GradeLimits) -> float:
        """Return the largest ratio; where SIM-DELAY by itself is good, the compensation must only do no harm."""
        return limits.good_ratio if self.delayed_percent > limits.good_percent else 1.0


@dataclass(frozen=True)
class PhysicalPart:
    """How much the specimen matters to the computed storeys."""

    share: float  # of its base shear in the interface floor's inertia force
    without_percent: float  # largest change of a computed storey without it, in percent of SIM; NaN: not known

    def matters(self, limits: GradeLimits) -> bool:
        """Return whether a test without it would be another one."""
        return self.share >= LEAST_SHARE and not self.without_percent <= limits.good_percent


@dataclass(frozen=True)
class Deviation:
    """How far a property of the specimen is from what it is compared with."""

    what: str  # "stiffness of storey", "mass of floor", "damping ratio of the specimen's mode"
    place: int  # from 1
    percent: float
    error: float  # standard uncertainty in percent


def grade_of(values: Mapping[str, ArrayLike], limits: GradeLimits) -> Grade | None:
    """Return the grade of an EXP-RTHS by the metrics of its result; None without a bound of its true error.

    It follows from what every laboratory has, and on a simulated rig not from what only that one knows.
    """
    bounds, medians = (_of(values, f"exp_rths.true_error_{name}_percent") for name in ("bound", "median"))
    if not bounds.size or not np.isfinite(bounds).all():
        return None
    worst = _largest(bounds)
    percent = float(bounds[worst])
    good, usable = percent <= limits.good_percent, percent <= limits.usable_percent
    grade = GOOD if good else USABLE if usable else POOR
    return Grade(grade, percent, float(medians[worst]), worst + 1, _cause(values, worst))


def compensation_of(values: Mapping[str, ArrayLike]) -> Compensation | None:
    """Return what the compensation is worth; None without a SIM-DELAY that has finite errors."""
    median, delayed = _of(values, "exp_rths.true_error_median_percent"), _of(values, "sim_delay.nrmse_percent")
    if not median.size or median.shape != delayed.shape or not (np.isfinite(delayed) & (delayed > 0.0)).all():
        return None
    ratios = median / delayed
    worst = _largest(ratios)
    return Compensation(float(ratios[worst]), worst + 1, float(delayed.max()))


def physical_part_of(values: Mapping[str, ArrayLike]) -> PhysicalPart | None:
    """Return how much the specimen matters; None where a result does not say."""
    share, without = (_of(values, f"exp_rths.{name}") for name in ("specimen_share", "without_specimen_percent"))
    return PhysicalPart(float(share[0]), float(without[0]) if without.size else math.nan) if share.size else None


def deviations_of(values: Mapping[str, ArrayLike]) -> tuple[Deviation, ...]:
    """Return how the identified specimen differs from the declared one, by more than DECLARED uncertainties."""
    found = [
        *_beyond(values, "exp_rths.stiffness_over_declared", 1.0, DECLARED, "stiffness of storey"),
        *_beyond(values, "exp_rths.mass_over_declared", 1.0, DECLARED, "mass of floor"),
        *_beyond(values, "exp_rths.damping_over_declared", 1.0, DECLARED, "damping ratio of the specimen's mode"),
    ]
    return tuple(found)


def changes_of(values: Mapping[str, ArrayLike]) -> tuple[Deviation, ...]:
    """Return what changed in the specimen from its identification to the run, by more than CHANGED uncertainties."""
    if not _of(values, "exp_rths.specimen_changed").any():
        return ()
    return tuple(_beyond(values, "exp_rths.stiffness_change", 0.0, CHANGED, "stiffness of storey"))


def _beyond(values: Mapping[str, ArrayLike], path: str, usual: float, sigma: float, what: str) -> Iterator[Deviation]:
    found, errors = _of(values, path), _of(values, f"{path}_error")
    if found.shape != errors.shape:
        return
    for place, (value, error) in enumerate(zip(found - usual, errors, strict=True), 1):
        if abs(value) > sigma * error > 0.0:
            yield Deviation(what, place, 100.0 * float(value), 100.0 * float(error))


def _of(values: Mapping[str, ArrayLike], path: str) -> np.ndarray:
    return np.atleast_1d(np.asarray(values.get(path, ()), dtype=float))


def _largest(values: np.ndarray) -> int:
    """Return the place of the largest value; one that is not a number is larger than all."""
    return int(np.argmax(np.where(np.isnan(values), math.inf, values)))


def _cause(values: Mapping[str, ArrayLike], storey: int) -> str:
    """Return the name of the cause with at least LIMITING of the squares of a storey's true error, "" without one.

    What the loop's measured error leaves of the median is the calibration's, or that of samples whose rounding and
    noise move the table unseen. What the budget measures as the specimen's and as the rest holds noise and rounding of
    the samples, too. Where the check predicted at least LIMITING of it from these two, the larger one is the cause.
    """
    expected = {cause: _square(values.get(PREDICTED.format(cause), 0.0), storey) for cause in OF_SAMPLES}
    of_samples = max(expected, key=expected.__getitem__)
    loop, median, calibration = (
        values.get(f"exp_rths.{name}_m_s2")
        for name in ("measured_loop_rms_error", "true_error_median", "true_error_calibration")
    )
    if (
        loop is not None
        and median is not None
        and _square(loop, storey) < LIMITING * (whole := _square(median, storey))
    ):
        if calibration is not None and _square(calibration, storey) >= LIMITING * whole:
            return CALIBRATION
        return of_samples if sum(expected.values()) >= LIMITING * whole else ""
    first, last = BUDGET.split("{}")
    squares = {
        path.removeprefix(first).removesuffix(last): _square(value, storey)
        for path, value in values.items()
        if path.startswith(first) and path.endswith(last) and path != BUDGET.format(NO_CAUSE)
    }
    name = max(squares, key=squares.__getitem__, default="")
    if not name or not squares[name] >= LIMITING * sum(squares.values()) > 0.0:
        return ""
    holds_them = name in WITH_SAMPLES and sum(expected.values()) >= LIMITING * squares[name]
    return of_samples if holds_them else name


def _square(value: ArrayLike, storey: int) -> float:
    values = np.atleast_1d(np.asarray(value, dtype=float))
    return float(values[min(storey, values.size - 1)]) ** 2


@dataclass(frozen=True)
class Judged:
    """One limit of a case, judged."""

    path: str  # of the metric, as in the case's `accept`, with an index if stated
    limit: float  # in the metric's unit
    value: float | None  # value of the metric that was compared; None: not computed
    met: bool


def judge(path: str, limit: float, values: ArrayLike) -> Judged:
    """Judge a metric against its limit; `values`: one number, or one per storey (n_storeys,).

    If the path states an index, as in `a.b[2]`, that value is compared, else the one with the largest absolute value.
    The absolute value is compared, so a signed metric is limited in both directions. A limit is not met if the value is
    NaN or the index does not exist. Of a metric that not every storey has, those that have it count.
    """
    given = np.atleast_1d(np.asarray(values, dtype=float))
    declared = METRICS.get(figure(path))
    index = place(path)
    if index is not None:
        given = given[index - 1 : index] if index > 0 else given[:0]
    elif declared is not None and declared.partial and not np.isnan(given).all():
        given = given[~np.isnan(given)]
    if given.size == 0:
        return Judged(path, limit, None, False)
    value = float(given[np.argmax(np.abs(given))])
    return Judged(path, limit, value, abs(value) <= limit)


def figure(path: str) -> str:
    """Return the path of the metric that a limit's path names, without the index."""
    return path.partition("[")[0]


def place(path: str) -> int | None:
    """Return the index in a limit's path, counted from 1; None if it states none."""
    index = path.partition("[")[2]
    return int(index[:-1]) if index else None
