"""Stability margins of a loop known by its frequency response, measured or modelled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.lti import Array, ComplexArray

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

FINER = 8  # points between two of the response at which the sensitivity is looked at
HALVINGS = 30
LEAST_GAIN = 1e-12  # less is no loop at all, and zero has no logarithm


@dataclass(frozen=True)
class Margins:
    """What a stable loop with negative feedback can bear; infinite where nothing is crossed.

    `gain_margin`: smallest factor > 1 on the loop gain that makes it unstable; `gain_reduction_margin`: smallest
    factor > 1 by which the gain, divided by it, does. `phase_margin_deg`: smallest change of phase, lag or lead;
    `delay_margin_s`: smallest further delay. `sensitivity_peak` = max |S| at `peak_hz`, S = 1 / (1 + L);
    `bandwidth_hz`: highest frequency with a loop gain of one (0: none).
    """

    gain_margin: float
    gain_reduction_margin: float
    phase_margin_deg: float
    delay_margin_s: float
    sensitivity_peak: float
    peak_hz: float
    bandwidth_hz: float


def margins(loop: ComplexArray, frequency_hz: Array) -> Margins:
    """Return the margins of a loop gain L (n,) with negative feedback at ascending frequencies > 0 (n,) in Hz.

    Between the points log L runs over log f as a monotone cubic, so the phase must change by less than half a turn
    from one to the next. The margins are distances from L = -1: that the loop is stable must be known from elsewhere.
    Source: K. J. Astrom and R. M. Murray, Feedback Systems, section 9.3.
    """
    from scipy.interpolate import PchipInterpolator

    gain = np.log(np.maximum(np.abs(loop), LEAST_GAIN))
    size = PchipInterpolator(np.log(frequency_hz), gain)
    phase = PchipInterpolator(np.log(frequency_hz), np.unwrap(np.angle(loop)))
    unity = _crossings(size, np.zeros(size.x.size - 1))
    away = np.mod(phase(unity) + np.pi, 2.0 * np.pi)  # rad of further lag to -1, [0, 2 pi)
    factors = 1.0 / np.exp(size(_half_turns(phase)))
    peak, peak_hz = _peak(size, phase)
    return Margins(
        gain_margin=_smallest(factors[factors > 1.0]),
        gain_reduction_margin=_smallest(1.0 / factors[factors < 1.0]),
        phase_margin_deg=float(np.rad2deg(_smallest(np.minimum(away, 2.0 * np.pi - away)))),
        delay_margin_s=_smallest(away / (2.0 * np.pi * np.exp(unity))),
        sensitivity_peak=peak,
        peak_hz=peak_hz,
        bandwidth_hz=float(np.exp(unity).max(initial=0.0)),
    )


def worst_sensitivity_peak(loop: ComplexArray, relative_error: Array) -> float:
    """Return max |S| when each point of L (n,) is off by two relative standard errors (n,) towards -1.

    Infinite when L = -1 is within reach of a point.
    """
    left = np.abs(1.0 + loop) - 2.0 * relative_error * np.abs(loop)
    return float(1.0 / left.min()) if left.min() > 0.0 else float("inf")


def _crossings(curve: PPoly, levels: Array) -> Array:
    """Return where a curve over log f, monotone between its points, passes the level of that stretch (n - 1,)."""
    left, right = curve(curve.x[:-1]) - levels, curve(curve.x[1:]) - levels
    passed = (left < 0.0) != (right < 0.0)
    low, high, level, rises = curve.x[:-1][passed], curve.x[1:][passed], levels[passed], (left < 0.0)[passed]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        before = (curve(middle) < level) == rises
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return low


def _half_turns(phase: PPoly) -> Array:
    """Return where (log f) a phase is half a turn, or that and whole turns, (m,)."""
    turns = np.floor(phase(phase.x) / (2.0 * np.pi) - 0.5)
    return _crossings(phase, 2.0 * np.pi * (np.maximum(turns[:-1], turns[1:]) + 0.5))


def _peak(size: PPoly, phase: PPoly) -> tuple[float, float]:
    """Return the largest |S| and its frequency in Hz."""
    points = np.arange((size.x.size - 1) * FINER + 1) / FINER
    place = np.interp(points, np.arange(size.x.size), size.x)
    sensitivity = 1.0 / np.abs(1.0 + np.exp(size(place) + 1j * phase(place)))
    highest = int(sensitivity.argmax())
    return float(sensitivity[highest]), float(np.exp(place[highest]))


def _smallest(values: Array) -> float:
    """Return the smallest value, infinity when there is none."""
    return float(values.min(initial=np.inf))
