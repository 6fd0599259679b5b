"""Stability margins of a loop from its frequency response: sensitivity peak, gain, phase, delay.

`control.stability_margins` gives the same margins of a `control.FRD` (tests/control compare them). It takes thirty
times as long for each loop, and its import takes longer than a whole check: the margins here need neither.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from rths_cli.numerics.lti import Array, ComplexArray

FINER = 8  # points between two of the response at which the sensitivity is looked at
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
    """A loop gain L at log f (n,) and between: log |L| (n,) and its angle in rad (n,), each with a monotone cubic."""

    log_f: Array
    log_gain: Array
    angle: Array
    gain_curve: PchipInterpolator
    angle_curve: PchipInterpolator


def loop_curve(loop: ComplexArray, frequency_hz: Array) -> LoopCurve:
    """Return a loop gain L (n,), finite, at ascending frequencies > 0 (n,) in Hz as curves.

    Between the points log L runs over log f as a monotone cubic, so the phase must change by less than half a turn
    from one to the next.
    """
    log_f = np.log(frequency_hz)
    log_gain, angle = np.log(np.maximum(np.abs(loop), LEAST_GAIN)), np.unwrap(np.angle(loop))
    return LoopCurve(log_f, log_gain, angle, PchipInterpolator(log_f, log_gain), PchipInterpolator(log_f, angle))


def margins(loop: ComplexArray, frequency_hz: Array) -> Margins:
    """Return the margins of a loop gain L (n,) with negative feedback at ascending frequencies > 0 (n,) in Hz.

    The margins are distances from L = -1: that the loop is stable must be known from elsewhere. Between the points L
    is as in `loop_curve`; all margins are NaN where L is not finite. Source: K. J. Astrom and R. M. Murray, Feedback
    Systems, section 9.3.
    """
    if not np.isfinite(loop).all():
        return Margins(*[float("nan")] * len(fields(Margins)))
    curve = loop_curve(loop, frequency_hz)
    unity = _unity(curve)
    away = np.mod(curve.angle_curve(unity) + np.pi, 2.0 * np.pi)  # rad of further lag to -1, [0, 2 pi)
    crossed = curve.gain_curve(_half_turns(curve))
    if np.cos(curve.angle[-1]) < REAL - 1.0:  # at half the sample rate L is real, to a rounding of its phase
        crossed = np.append(crossed, curve.log_gain[-1])
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
    return float(np.exp(_unity(curve)).max(initial=0.0))


def sensitivity_peak(curve: LoopCurve) -> tuple[float, float]:
    """Return the largest |S| = |1 / (1 + L)| and its frequency in Hz."""
    between = curve.log_f[:-1, None] + np.diff(curve.log_f)[:, None] * np.arange(FINER) / FINER
    log_f = np.append(between, curve.log_f[-1])
    gain, angle = np.exp(curve.gain_curve(log_f)), curve.angle_curve(log_f)
    nearest = int((gain * (gain + 2.0 * np.cos(angle))).argmin())  # |1 + L|^2 - 1
    distance = np.abs(1.0 + gain[nearest] * np.exp(1j * angle[nearest]))
    return float(1.0 / distance), float(np.exp(log_f[nearest]))


def worst_sensitivity_peak(loop: ComplexArray, relative_error: Array) -> float:
    """Return max |S| when each point of L (n,) is off by two relative standard errors (n,) towards -1.

    Infinite when L = -1 is within reach of a point.
    """
    left = np.abs(1.0 + loop) - 2.0 * relative_error * np.abs(loop)
    return float(1.0 / left.min()) if left.min() > 0.0 else float("inf")


def _unity(curve: LoopCurve) -> Array:
    """Return where the gain is one, log f (m,)."""
    return _crossings(curve.log_f, curve.log_gain, curve.gain_curve, np.zeros(len(curve.log_f) - 1))


def _half_turns(curve: LoopCurve) -> Array:
    """Return where the phase is half a turn, or that and whole turns, log f (m,)."""
    turns = np.floor(curve.angle / (2.0 * np.pi) - 0.5)
    levels = 2.0 * np.pi * (np.maximum(turns[:-1], turns[1:]) + 0.5)
    return _crossings(curve.log_f, curve.angle, curve.angle_curve, levels)


def _crossings(x: Array, y: Array, curve: PchipInterpolator, levels: Array) -> Array:
    """Return where a curve through points (n,), monotone between them, passes the level of that stretch (n - 1,)."""
    passed = np.flatnonzero((y[:-1] < levels) != (y[1:] < levels))
    return np.array([_crossing({x[k]: y[k], x[k + 1]: y[k + 1]}, curve, levels[k]) for k in passed])


def _crossing(ends: dict[float, float], curve: PchipInterpolator, level: float) -> float:
    """Return where a curve passes a level between two points, x to y; at the points it is y to the last bit."""
    return float(brentq(lambda x: ends.get(x, curve(x)) - level, *ends))


def _smallest(values: Array) -> float:
    """Return the smallest value, infinity when there is none."""
    return float(values.min(initial=np.inf))
