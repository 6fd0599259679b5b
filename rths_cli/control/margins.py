"""Stability margins of a loop from its frequency response: sensitivity peak, gain, phase, delay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.interpolation import Curve, monotone_curve
from rths_cli.numerics.lti import Array, ComplexArray, Integers

FINER = 8  # points between two of the response at which the sensitivity is looked at
HALVINGS = 30
LEAST_GAIN = 1e-12  # less is no loop at all, and zero has no logarithm
REAL = 1e-12  # a last point whose cosine of the phase is -1 within this is real and negative: it counts as a crossing


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


@dataclass(frozen=True)
class LoopCurve:
    """A loop gain L between its points: log |L| (`size`) and its angle in rad (`phase`) over log f."""

    size: Curve
    phase: Curve


def loop_curve(loop: ComplexArray, frequency_hz: Array) -> LoopCurve:
    """Return a loop gain L (n,) at ascending frequencies > 0 (n,) in Hz as curves.

    Between the points log L runs over log f as a monotone cubic, so the phase must change by less than half a turn
    from one to the next.
    """
    log_f = np.log(frequency_hz)
    gain = np.log(np.maximum(np.abs(loop), LEAST_GAIN))
    return LoopCurve(monotone_curve(log_f, gain), monotone_curve(log_f, np.unwrap(np.angle(loop))))


def margins(loop: ComplexArray, frequency_hz: Array) -> Margins:
    """Return the margins of a loop gain L (n,) with negative feedback at ascending frequencies > 0 (n,) in Hz.

    The margins are distances from L = -1: that the loop is stable must be known from elsewhere. Between the points L
    is as in `loop_curve`. Source: K. J. Astrom and R. M. Murray, Feedback Systems, section 9.3.
    """
    return margins_of(loop_curve(loop, frequency_hz))


def margins_of(curve: LoopCurve) -> Margins:
    """Return the margins of a loop gain given as curves."""
    stretch, share = _unity(curve)
    unity = curve.size.place(stretch, share)
    away = np.mod(curve.phase.at(stretch, share) + np.pi, 2.0 * np.pi)  # rad of further lag to -1, [0, 2 pi)
    crossed = curve.size.at(*_half_turns(curve.phase))
    if np.cos(curve.phase.y[-1]) < REAL - 1.0:  # at half the sample rate L is real, to a rounding of its phase
        crossed = np.append(crossed, curve.size.y[-1])
    factors = 1.0 / np.exp(crossed)
    peak, peak_hz = sensitivity_peak(curve)
    return Margins(
        gain_margin=_smallest(factors[factors > 1.0]),
        gain_reduction_margin=_smallest(1.0 / factors[factors < 1.0]),
        phase_margin_deg=float(np.rad2deg(_smallest(np.minimum(away, 2.0 * np.pi - away)))),
        delay_margin_s=_smallest(away / (2.0 * np.pi * np.exp(unity))),
        sensitivity_peak=peak,
        peak_hz=peak_hz,
        bandwidth_hz=bandwidth_hz(curve),
    )


def bandwidth_hz(curve: LoopCurve) -> float:
    """Return the highest frequency in Hz at which the loop gain is one, 0 when there is none."""
    return float(np.exp(curve.size.place(*_unity(curve))).max(initial=0.0))


def sensitivity_peak(curve: LoopCurve) -> tuple[float, float]:
    """Return the largest |S| = |1 / (1 + L)| and its frequency in Hz."""
    shares = np.arange(FINER) / FINER
    gain = np.exp(curve.size.on(shares))
    squared = 1.0 + gain * (gain + 2.0 * np.cos(curve.phase.on(shares)))  # |1 + L|^2
    stretch, part = divmod(int(squared.argmin()), FINER)
    last = np.abs(1.0 + np.exp(curve.size.y[-1] + 1j * curve.phase.y[-1]))
    size, phase = (float(each.at(stretch, shares[part])) for each in (curve.size, curve.phase))
    nearest = np.abs(1.0 + np.exp(size + 1j * phase))
    place = curve.size.place(stretch, shares[part]) if nearest <= last else curve.size.x[-1]
    return float(1.0 / min(nearest, last)), float(np.exp(place))


def worst_sensitivity_peak(loop: ComplexArray, relative_error: Array) -> float:
    """Return max |S| when each point of L (n,) is off by two relative standard errors (n,) towards -1.

    Infinite when L = -1 is within reach of a point.
    """
    left = np.abs(1.0 + loop) - 2.0 * relative_error * np.abs(loop)
    return float(1.0 / left.min()) if left.min() > 0.0 else float("inf")


def _unity(curve: LoopCurve) -> tuple[Integers, Array]:
    """Return where the gain is one: stretches of the curve and shares of them, (m,)."""
    return _crossings(curve.size, np.zeros(curve.size.x.size - 1))


def _half_turns(phase: Curve) -> tuple[Integers, Array]:
    """Return where a phase is half a turn, or that and whole turns: stretches and shares of them, (m,)."""
    turns = np.floor(phase.y / (2.0 * np.pi) - 0.5)
    return _crossings(phase, 2.0 * np.pi * (np.maximum(turns[:-1], turns[1:]) + 0.5))


def _crossings(curve: Curve, levels: Array) -> tuple[Integers, Array]:
    """Return where a curve, monotone between its points, passes the level of that stretch (n - 1,): stretches and
    shares of them, (m,)."""
    left, right = curve.y[:-1] < levels, curve.y[1:] < levels
    passed = np.flatnonzero(left != right)
    start, first, second, third = curve.cubic(passed)
    start, rises = start - levels[passed], left[passed]
    low, width = np.zeros(passed.size), 1.0
    for _ in range(HALVINGS if passed.size else 0):
        width *= 0.5
        middle = low + width
        before = (start + middle * (first + middle * (second + middle * third)) < 0.0) == rises
        low = np.where(before, middle, low)
    return passed, low


def _smallest(values: Array) -> float:
    """Return the smallest value, infinity when there is none."""
    return float(values.min(initial=np.inf))
