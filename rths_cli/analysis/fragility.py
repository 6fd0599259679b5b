"""Fragility: how likely a limit is exceeded at an intensity, by a lognormal distribution of capacities.

P(x) = Phi(ln(x / theta) / beta): theta is the median capacity, beta the dispersion. From stripes both maximise the
binomial likelihood of the exceedances (Baker, Earthquake Spectra 31, 2015, 579, eq. 11); from capacities that were
observed they are median and standard deviation of their logarithms, where some lie above what was run the maximum of
the censored likelihood. The same records stand in every stripe, so their outcomes are not independent of each other:
the standard errors of stripes are those of the jackknife that leaves out one record after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

CONFIDENCE = 1.96  # standard errors, 95 % of a normal distribution
MOST_MISSING = 0.2  # of a stripe, or of the records of a hunt
FEWEST = 3  # records, or capacities that were observed
STEPS, SMALL_STEP, LARGEST_STEP, FARTHEST = 100, 1e-9, 2.0, 8.0  # of the scoring; FARTHEST: place of a level, in beta


@dataclass(frozen=True)
class Fragility:
    """A fitted fragility: median `theta` in the unit of the intensity, dispersion `beta`, and the covariance (2, 2) of
    the estimates of ln theta and ln beta."""

    theta: float
    beta: float
    covariance: Array

    @property
    def errors(self) -> tuple[float, float]:
        """Return the standard errors of ln theta and ln beta, which are the relative ones of theta and beta."""
        first, second = np.sqrt(np.diag(self.covariance))
        return float(first), float(second)

    def interval(self, which: int) -> tuple[float, float]:
        """Return the 95 % confidence interval of theta (0) or beta (1)."""
        value, error = (self.theta, self.beta)[which], self.errors[which]
        return value * float(np.exp(-CONFIDENCE * error)), value * float(np.exp(CONFIDENCE * error))

    def probability(self, intensity: Array) -> tuple[Array, Array, Array]:
        """Return the probability at intensities (n,), and the ends of its pointwise 95 % confidence interval."""
        from scipy.special import ndtr

        place = np.log(np.asarray(intensity, dtype=float) / self.theta) / self.beta
        slopes = np.stack([np.full(place.shape, -1.0 / self.beta), -place])
        error = CONFIDENCE * np.sqrt(np.einsum("in,ij,jn->n", slopes, self.covariance, slopes))
        return ndtr(place), ndtr(place - error), ndtr(place + error)


def of_stripes(levels: Array, exceeded: Array) -> Fragility:
    """Return the fragility of outcomes (records, levels) at intensities (levels,): 1 exceeded, 0 not, NaN missing.

    Raises InputError, with the reason as its sentence, where it is not determined: too few records, too many missing in
    a stripe, no level between no and every exceedance, or exceedances that do not grow with the intensity.
    """
    present = np.isfinite(exceeded)
    count = present.sum(axis=0)
    if len(exceeded) < FEWEST:
        raise InputError(f"{len(exceeded)} records are too few; give at least {FEWEST}")
    missing = len(exceeded) - count
    if np.any(missing > MOST_MISSING * len(exceeded)):
        first = int(np.argmax(missing > MOST_MISSING * len(exceeded)))
        raise InputError(
            f"{missing[first]} of {len(exceeded)} points at {levels[first]:.4g} are missing, more than a fifth of the "
            "stripe"
        )
    share = np.where(present, exceeded, 0.0).sum(axis=0) / count
    _check_overlap(levels, share)
    estimate = _fit(levels, exceeded)
    try:
        left_out = np.array([_fit(levels, np.delete(exceeded, k, axis=0)) for k in range(len(exceeded))])
    except InputError as error:
        raise InputError(f"the fit hangs on a single record, without which {error}") from error
    apart = left_out - left_out.mean(axis=0)
    covariance = (len(exceeded) - 1.0) / len(exceeded) * apart.T @ apart
    return Fragility(float(np.exp(estimate[0])), float(np.exp(estimate[1])), covariance)


def _fit(levels: Array, exceeded: Array) -> Array:
    """Return ln theta and ln beta (2,) of greatest likelihood of outcomes (records, levels); raises InputError."""
    present = np.isfinite(exceeded)
    count = present.sum(axis=0)
    share = np.where(present, exceeded, 0.0).sum(axis=0) / count
    _check_overlap(levels, share)
    x = np.log(levels)
    middle = float(x @ count / count.sum())
    a, b = _probit(np.stack([np.ones(x.size), x - middle]), share, count)
    if b <= 0.0:
        raise InputError("exceedances do not become more frequent with the intensity")
    return np.array([middle - a / b, -np.log(b)])


def _check_overlap(levels: Array, share: Array) -> None:
    """Raise InputError unless some level with exceedances lies below one without some (Albert and Anderson,
    Biometrika 71, 1984, 1): without it every steepness fits."""
    some, not_all = np.flatnonzero(share > 0.0), np.flatnonzero(share < 1.0)
    if some.size == 0:
        raise InputError(f"no record exceeds the limit up to {levels.max():.4g}; raise the levels")
    if not_all.size == 0:
        raise InputError(f"every record exceeds the limit from {levels.min():.4g} on; lower the levels")
    if levels[some].min() >= levels[not_all].max():
        raise InputError(
            f"fewer than two levels lie between no and every exceedance, {levels[not_all].max():.4g} to "
            f"{levels[some].min():.4g}; add levels there"
        )


def _probit(design: Array, share: Array, count: Array) -> tuple[float, float]:
    """Return intercept and slope of P = Phi(a + b x), design (2, n), by Fisher scoring."""
    from scipy.special import ndtr

    found = np.zeros(2)
    for _ in range(STEPS):
        place = np.clip(found @ design, -FARTHEST, FARTHEST)
        density, chance = np.exp(-0.5 * place**2) / np.sqrt(2.0 * np.pi), ndtr(place)
        weight = count * density**2 / (chance * ndtr(-place))
        step = np.linalg.solve((design * weight) @ design.T, design @ (weight * (share - chance) / density))
        size = float(np.abs(step).max())
        found = found + step * min(1.0, LARGEST_STEP / max(size, SMALL_STEP))
        if size < SMALL_STEP:
            return float(found[0]), float(found[1])
    raise InputError("the likelihood of the exceedances has no maximum; add records or levels")


def of_capacities(capacity: Array, above: Array, missing: int = 0) -> Fragility:
    """Return the fragility of intensities (m,) at which records reached the limit, and of those (k,) up to which others
    were run and did not; `missing` of these were refused or stopped there.

    Without the latter these are median and standard deviation (with m - 1) of the logarithms. Raises InputError, with
    the reason as its sentence, for too few capacities and more than a fifth of the records missing.
    """
    records = len(capacity) + len(above)
    if missing > MOST_MISSING * records:
        raise InputError(f"{missing} of {records} records were refused or stopped before the limit, more than a fifth")
    if len(capacity) < FEWEST:
        told = f"{len(capacity)} of {records} records reach the limit, {FEWEST} are needed; raise the levels"
        raise InputError(told)
    x, held = np.log(capacity), np.log(above)
    mean, spread = float(x.mean()), float(x.std(ddof=1))
    if spread == 0.0:
        raise InputError("every record reaches the limit at the same intensity; give other records or levels")
    if held.size:
        mean, spread = _censored(x, held, mean, spread)
    return Fragility(
        float(np.exp(mean)), spread, np.asarray(np.linalg.inv(_curvature(x, held, mean, spread)), dtype=np.float64)
    )


def _censored(x: Array, held: Array, mean: float, spread: float) -> tuple[float, float]:
    """Return mean and standard deviation of greatest likelihood of values (m,) and of others above `held` (k,)."""
    from scipy.optimize import minimize

    found = minimize(lambda p: _negative(x, held, p[0], np.exp(p[1])), [mean, np.log(spread)], method="Nelder-Mead",
                     options={"xatol": 1e-9, "fatol": 1e-11, "maxiter": 2000})  # fmt: skip
    bias = np.sqrt(x.size / (x.size - 1.0))  # as without censored ones
    return float(found.x[0]), float(bias * np.exp(found.x[1]))


def _negative(x: Array, held: Array, mean: float, spread: float) -> float:
    from scipy.special import log_ndtr

    z = (x - mean) / spread
    return float(0.5 * z @ z + x.size * np.log(spread) - log_ndtr((mean - held) / spread).sum())


def _curvature(x: Array, held: Array, mean: float, spread: float) -> Array:
    """Return the observed information (2, 2) of mean and ln spread, by central differences."""
    steps = np.array([1e-3 * spread, 1e-3])

    def at(i: float, j: float) -> float:
        return _negative(x, held, mean + i * steps[0], spread * float(np.exp(j * steps[1])))

    middle = at(0, 0)
    first, second = at(1, 0) - 2 * middle + at(-1, 0), at(0, 1) - 2 * middle + at(0, -1)
    mixed = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4.0
    return np.asarray(np.array([[first, mixed], [mixed, second]]) / np.outer(steps, steps), dtype=np.float64)
