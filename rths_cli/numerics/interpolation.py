"""Monotone cubic interpolation: curves that rise and fall only where their points do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.lti import Array, Integers


@dataclass(frozen=True)
class Curve:
    """A cubic on each stretch between points x (n,) ascending, y (n,), with slopes dy/dx (n,) there."""

    x: Array
    y: Array
    slope: Array

    def place(self, stretch: Integers | int, share: Array | float) -> Array:
        """Return x (m,) at shares (m,) in [0, 1] of stretches (m,)."""
        return np.asarray(self.x[stretch] + share * (self.x[np.add(stretch, 1)] - self.x[stretch]))

    def at(self, stretch: Integers | int, share: Array | float) -> Array:
        """Return y (m,) at shares (m,) in [0, 1] of stretches (m,)."""
        t = np.asarray(share)
        start, first, second, third = self.cubic(stretch)
        return np.asarray(start + t * (first + t * (second + t * third)))

    def cubic(self, stretch: Integers | int) -> tuple[Array, Array, Array, Array]:
        """Return the coefficients of y in powers 0 to 3 of the share of stretches (m,), each (m,)."""
        end = np.add(stretch, 1)
        width, rise = self.x[end] - self.x[stretch], self.y[end] - self.y[stretch]
        first, last = width * self.slope[stretch], width * self.slope[end]
        return self.y[stretch], first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise

    def on(self, shares: Array) -> Array:
        """Return y (n - 1, m) at the same shares (m,) of every stretch."""
        width = np.diff(self.x)
        parts = np.stack([self.y[:-1], self.y[1:], width * self.slope[:-1], width * self.slope[1:]], axis=1)
        t = np.asarray(shares)
        whole = t * t * (3.0 - 2.0 * t)
        return parts @ np.array([1.0 - whole, whole, t * (1.0 - t) ** 2, t * t * (t - 1.0)])


def monotone_curve(x: Array, y: Array) -> Curve:
    """Return the monotone cubic through points x (n,) ascending and y (n,), n >= 3.

    Slopes are weighted harmonic means of the neighbouring secants, zero where these differ in sign. Source: Fritsch and
    Butland, SIAM J. Sci. Stat. Comput. 5 (1984); the ends by a one-sided formula that keeps the shape.
    """
    width = np.diff(x)
    secant = np.diff(y) / width
    before, after = secant[:-1], secant[1:]
    with_after, with_before = 2.0 * width[1:] + width[:-1], width[1:] + 2.0 * width[:-1]
    turns = before * after <= 0.0
    safe_before, safe_after = np.where(turns, 1.0, before), np.where(turns, 1.0, after)
    mean = (with_after / safe_before + with_before / safe_after) / (with_after + with_before)
    slope = np.zeros(len(x))
    slope[1:-1] = np.where(turns, 0.0, 1.0 / mean)
    slope[0] = _end_slope(width[0], width[1], secant[0], secant[1])
    slope[-1] = _end_slope(width[-1], width[-2], secant[-1], secant[-2])
    return Curve(x, y, slope)


def _end_slope(width: float, next_width: float, secant: float, next_secant: float) -> float:
    """Return the slope at an end: of the parabola through three points, no steeper than keeps the shape."""
    slope = ((2.0 * width + next_width) * secant - width * next_secant) / (width + next_width)
    if slope * secant <= 0.0:
        return 0.0
    if secant * next_secant < 0.0 and abs(slope) > 3.0 * abs(secant):
        return 3.0 * secant
    return float(slope)
