"""Least squares: nonlinear by MINPACK's Levenberg-Marquardt method through scipy, linear by numpy; covariances.

MINPACK knows no bounds; here a function is constant beyond them. scipy's bounded method `trf` knows them, but its steps
are scaled by the distance to a bound, however far that is: two of the models of the paper that are fitted to 30 random
tables end in a worse minimum, one of them with three times the misfit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.lti import Array, ComplexArray

Function = Callable[[Array], tuple[Array, Array]]
"""Parameters (n,) -> residual (m,) and its slopes (n, m), a row per parameter."""

LOST = 1e-14  # smaller eigenvalues, relative to the largest one, cannot be distinguished from zero


def parts(values: ComplexArray) -> Array:
    """Return complex values (..., m) as real and imaginary parts side by side, (..., 2 m)."""
    return np.ascontiguousarray(values).view(float)


@dataclass(frozen=True)
class Solution:
    """Parameters (n,), residual (m,) and its slopes (n, m) there."""

    parameters: Array
    residual: Array
    slopes: Array

    @property
    def size(self) -> float:
        """Return the norm of the residual."""
        return float(np.linalg.norm(self.residual))


def least_squares(
    function: Function, start: Array, tolerance: float = 1e-8, evaluations: int = 100, reach: Array | float = np.inf
) -> Solution:
    """Minimise the sum of squares of a function's residual from a start (n,).

    No parameter moves farther from its start than `reach` (a number, or one for each parameter). The function must be
    finite there. A parameter that the data do not determine ends at this bound instead of diverging.

    The iteration ends if a step changes the sum of squares or the scaled parameters by less than `tolerance`
    (relative), if the residual is orthogonal to the slopes within `tolerance`, or after about `evaluations`
    evaluations. A step to a point with a residual that is not finite is rejected. Raises ValueError if the residual is
    not finite at the start.
    """
    from scipy import optimize

    start = np.asarray(start, dtype=float)
    within = _Within(function, start - reach, start + reach)
    if not np.isfinite(within.values(start)[0]).all():
        raise ValueError("least squares: the residual is not finite at the start")
    here, left = start, evaluations
    while True:
        found = optimize.least_squares(
            within.residual, here, within.slopes, method="lm", x_scale="jac", ftol=tolerance, xtol=tolerance,
            gtol=tolerance, max_nfev=left,
        )  # fmt: skip
        here, left = np.clip(found.x, within.low, within.high), left - found.nfev
        residual, slopes = within.values(here)
        back_inside = (slopes @ residual) * (found.x - here) > 0.0  # the sum of squares falls from the bound inwards
        if left <= 0 or not back_inside.any():
            return Solution(here, residual, slopes)


@dataclass
class _Within:
    """A function for MINPACK, constant beyond its bounds; a point is evaluated once for its residual and slopes."""

    function: Function
    low: Array  # (n,)
    high: Array  # (n,)
    _last: tuple[Array, tuple[Array, Array]] | None = None  # parameters; residual and slopes

    def values(self, parameters: Array) -> tuple[Array, Array]:
        """Return residual (m,) and slopes (n, m) at the nearest parameters within the bounds."""
        at = np.clip(parameters, self.low, self.high)
        if self._last is None or not np.array_equal(self._last[0], at):
            self._last = at, self.function(at)
        return self._last[1]

    def residual(self, parameters: Array) -> Array:
        """Return the residual (m,)."""
        return self.values(parameters)[0]

    def slopes(self, parameters: Array) -> Array:
        """Return the slopes (m, n), zero for parameters beyond their bounds."""
        beyond = (parameters < self.low) | (parameters > self.high)
        return np.where(beyond, 0.0, self.values(parameters)[1].T)


def linear(slopes: Array, wanted: Array) -> Array:
    """Return the factors (n,) with which the rows of `slopes` (n, m) approximate `wanted` (m,) in least squares.

    Of several wanted, (m, k), it returns the factors of each, (n, k).
    In a direction that the slopes do not determine the result is zero, each row taken in units of its own size.
    """
    size = np.linalg.norm(slopes, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray((np.linalg.lstsq((slopes / size[:, None]).T, wanted, rcond=LOST**0.5)[0].T / size).T)


def covariance(slopes: Array, variance: float) -> Array:
    """Return the covariance (n, n) of parameters if each residual has the given variance; `slopes` is (n, m).

    It is very large in directions that the data do not determine.
    """
    from scipy.linalg import eigh

    scale = np.linalg.norm(slopes, axis=1)
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = eigh((slopes @ slopes.T) / np.outer(scale, scale), driver="ev")  # divide and conquer may give up
    half = vectors / np.sqrt(np.maximum(values, LOST * values[-1])) / scale[:, None]
    return variance * (half @ half.T)
