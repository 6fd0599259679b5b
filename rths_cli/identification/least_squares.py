"""Nonlinear least squares (Levenberg-Marquardt in a scaled trust region).

J. J. More, The Levenberg-Marquardt algorithm: implementation and theory, Lecture Notes in Mathematics 630 (1978) 105,
with its constants. A step of given length comes from the eigenvalues of the scaled normal equations: with a few
parameters and thousands of residuals that costs next to nothing beside the residuals themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.numerics.matrix_equations import symmetric_eigenvectors

Function = Callable[[Array], tuple[Array, Array]]
"""Parameters (n,) -> residual (m,) and its slopes (n, m), a row per parameter."""

FIRST_RADIUS = 100.0  # first trust radius over the scaled length of the start
SAME_LENGTH, MOST_DAMPINGS = 0.1, 10  # relative tolerance of a step's length to the radius; iterations to reach it
LEAST_GAIN = 1e-4  # a step that achieves less than this fraction of the predicted reduction is rejected
POOR, GOOD = 0.25, 0.75  # achieved over predicted reduction below which the region shrinks, above which it grows
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


@dataclass(frozen=True)
class _Linear:
    """Scaled normal equations at a point, in their eigenvectors."""

    values: Array  # (n,) eigenvalues
    vectors: Array  # (n, n) eigenvectors, a column each
    gradient: Array  # (n,) along the eigenvectors
    scale: Array  # (n,) of the parameters

    def along(self, damping: float) -> Array:
        """Return the scaled step (n,) along the eigenvectors, zero in directions that the data do not determine."""
        known = self.values > LOST * self.values[-1]
        return np.where(known, -self.gradient, 0.0) / np.where(known, self.values + damping, 1.0)

    def step(self, damping: float) -> Array:
        """Return the step (n,) of the parameters."""
        return self.vectors @ self.along(damping) / self.scale

    def promised(self, damping: float, size: float) -> tuple[float, float, float]:
        """Return the predictions of the linear model for a step.

        These are the relative reduction of the sum of squares for a residual of norm `size`, minus half the slope of
        the relative sum of squares along the step, and the length of the scaled step.
        """
        along = self.along(damping)
        linear, damped = float(along**2 @ self.values) / size**2, damping * float(along @ along) / size**2
        return linear + 2.0 * damped, linear + damped, float(np.linalg.norm(along))

    def damping(self, radius: float, before: float) -> float:
        """Return the damping for which the step is as long as the radius, 0 if the undamped step is shorter."""
        if float(np.linalg.norm(self.along(0.0))) <= (1.0 + SAME_LENGTH) * radius:
            return 0.0
        most = float(np.linalg.norm(self.gradient)) / radius
        damping = before if 0.0 < before < most else 1e-3 * most
        for _ in range(MOST_DAMPINGS):
            step = self.along(damping)
            length = float(np.linalg.norm(step))
            if abs(length - radius) <= SAME_LENGTH * radius:
                break
            shrinks = float(step @ (step / np.maximum(self.values + damping, 1e-300))) / length
            damping = min(max(damping + (length - radius) / radius * length / shrinks, 1e-3 * damping), most)
        return damping


def least_squares(
    function: Function, start: Array, tolerance: float = 1e-8, evaluations: int = 100, reach: Array | float = np.inf
) -> Solution:
    """Minimise the sum of squares of a function's residual from a start (n,).

    No parameter moves farther from its start than `reach` (a number, or one for each parameter). The function must be
    finite there. A parameter that the data do not determine ends at this bound instead of diverging.

    The iteration ends if a step changes the sum of squares or the scaled parameters by less than `tolerance`
    (relative), if the residual is orthogonal to the slopes within `tolerance`, or after `evaluations` evaluations. A
    step to a point with a residual that is not finite is rejected. Raises ValueError if the residual is not finite at
    the start.
    """
    start = np.asarray(start, dtype=float)
    low, high = start - reach, start + reach
    here = Solution(start, *function(start))
    if not np.isfinite(here.size):
        raise ValueError("least squares: the residual is not finite at the start")
    normal = _linear(_inside(here, low, high), here.residual, np.zeros(len(start)))
    radius = FIRST_RADIUS * (float(np.linalg.norm(normal.scale * here.parameters)) or 1.0)
    damping = 0.0
    for count in range(1, evaluations):
        if float(np.linalg.norm(normal.gradient)) <= tolerance * here.size:
            break
        damping = normal.damping(radius, damping)
        foreseen, slope, length = normal.promised(damping, here.size)
        radius = min(radius, length) if count == 1 else radius
        at = np.clip(here.parameters + normal.step(damping), low, high)
        there = Solution(at, *function(at))
        gain = _gain(here.size, there.size)
        ratio = gain / foreseen if foreseen > 0.0 else 0.0
        radius, damping = _adapted(radius, damping, length, ratio, gain, slope)
        if ratio >= LEAST_GAIN:
            here = there
            normal = _linear(_inside(here, low, high), here.residual, normal.scale)
        small = abs(gain) <= tolerance and foreseen <= tolerance and ratio <= 2.0
        if small or radius <= tolerance * float(np.linalg.norm(normal.scale * here.parameters)):
            break
    return here


def _inside(here: Solution, low: Array, high: Array) -> Array:
    """Return the slopes (n, m), set to zero for parameters at a bound whose descent direction leads beyond it."""
    uphill = here.slopes @ here.residual
    held = ((here.parameters <= low) & (uphill > 0.0)) | ((here.parameters >= high) & (uphill < 0.0))
    return np.where(held[:, None], 0.0, here.slopes)


def _linear(slopes: Array, residual: Array, scale: Array) -> _Linear:
    """Return the normal equations at a point, each parameter scaled by the largest effect it has had so far."""
    normal = slopes @ slopes.T
    scale = np.maximum(scale, np.sqrt(np.diag(normal)))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = symmetric_eigenvectors(normal / np.outer(scale, scale))
    return _Linear(values, vectors, vectors.T @ (slopes @ residual / scale), scale)


def _gain(before: float, after: float) -> float:
    """Return the relative reduction of the sum of squares; -1 if it increased much or is not a number."""
    return 1.0 - (after / before) ** 2 if 0.1 * after < before else -1.0


def _adapted(
    radius: float, damping: float, length: float, ratio: float, gain: float, slope: float
) -> tuple[float, float]:
    """Return radius and damping for the next step.

    `ratio` is the achieved over the predicted reduction, `gain` the achieved one, `slope` the predicted initial slope.
    """
    if ratio <= POOR:
        share = 0.5 if gain >= 0.0 else max(0.5 * slope / (slope - 0.5 * gain), 0.1) if gain > -1.0 else 0.1
        return share * min(radius, 10.0 * length), damping / share
    if damping == 0.0 or ratio >= GOOD:
        return 2.0 * length, 0.5 * damping
    return radius, damping


def linear(slopes: Array, wanted: Array) -> Array:
    """Return the factors (n,) with which the rows of `slopes` (n, m) approximate `wanted` (m,) in least squares.

    In a direction that the slopes do not determine the result is zero, each row taken in units of its own size.
    """
    size = np.linalg.norm(slopes, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(np.linalg.lstsq((slopes / size[:, None]).T, wanted, rcond=LOST**0.5)[0] / size)


def covariance(slopes: Array, variance: float) -> Array:
    """Return the covariance (n, n) of parameters if each residual has the given variance; `slopes` is (n, m).

    It is very large in directions that the data do not determine.
    """
    scale = np.linalg.norm(slopes, axis=1)
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = symmetric_eigenvectors((slopes @ slopes.T) / np.outer(scale, scale))
    half = vectors / np.sqrt(np.maximum(values, LOST * values[-1])) / scale[:, None]
    return variance * (half @ half.T)
