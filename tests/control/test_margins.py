"""Margins against loops whose crossings are known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from rths_cli.control.margins import Margins, margins, worst_sensitivity_peak
from rths_cli.numerics.lti import Array, ComplexArray

F = np.geomspace(1e-3, 1e3, 600)
S = 2j * np.pi * F


def of(loop: ComplexArray) -> Margins:
    return margins(loop, F)


@pytest.mark.parametrize("late_s", [1e-3, 0.01, 0.05])
def test_an_integrator_with_a_delay(late_s: float) -> None:
    """L = k exp(-s T) / s crosses one at k rad/s, and half a turn at pi / (2 T)."""
    k = 10.0
    short, far = (F[: np.searchsorted(F, reach / late_s)] for reach in (0.2, 0.4))
    found, whole = (margins(k * np.exp(-2j * np.pi * f * late_s) / (2j * np.pi * f), f) for f in (short, far))
    for one in (found, whole):
        assert one.phase_margin_deg == pytest.approx(90.0 - np.rad2deg(k * late_s), rel=1e-4)
        assert one.delay_margin_s == pytest.approx(np.pi / (2.0 * k) - late_s, rel=1e-4)
        assert one.bandwidth_hz == pytest.approx(k / (2.0 * np.pi), rel=1e-5)
    assert found.gain_margin == np.inf  # half a turn is at 0.25 / T
    assert whole.gain_margin == pytest.approx(np.pi / (2.0 * k * late_s), rel=1e-4)
    assert whole.gain_reduction_margin == np.inf


def test_three_lags_and_the_gain_that_makes_them_swing() -> None:
    """L = k / ((s + 1)(s + 2)(s + 3)): the Routh array of s^3 + 6 s^2 + 11 s + 6 + k gives k = 60."""
    found = of(20.0 / ((S + 1.0) * (S + 2.0) * (S + 3.0)))
    assert found.gain_margin == pytest.approx(3.0, rel=1e-4)
    assert found.gain_reduction_margin == np.inf


LOOPS: dict[str, Callable[[ComplexArray], ComplexArray]] = {
    "integrator with delay": lambda s: 10.0 * np.exp(-0.01 * s) / s,
    "three lags": lambda s: 20.0 / ((s + 1.0) * (s + 2.0) * (s + 3.0)),
    "conditionally stable": lambda s: 0.8 * (s + 1.0) ** 2 / s**3,
    "rises through one": lambda s: 10.0 * s**2 / (s + 1.0) ** 3,
    "resonance with delay": lambda s: np.exp(-0.05 * s) / s * (1.0 + 0.5 * s**2 / (s**2 + 2.0 * s + 400.0)),
}


@pytest.mark.parametrize("name", LOOPS)
def test_margins_are_those_of_python_control(name: str) -> None:
    """Its FRD runs through the same points as splines; crossings of a fine response agree to 1e-9, the peak on a grid
    to the square of its step."""
    f = np.geomspace(1e-2, 20.0, 4000)
    loop = LOOPS[name](2j * np.pi * f)
    found = margins(loop, f)
    factors, phases, distances, _, crossed, _ = control.stability_margins(
        control.FRD(loop, 2.0 * np.pi * f), returnall=True
    )
    factors, phases, crossed = (np.asarray(each) for each in (factors, phases, crossed))
    above, below = factors[factors > 1.0], 1.0 / factors[factors < 1.0]
    assert found.gain_margin == pytest.approx(above.min(initial=np.inf), rel=1e-9)
    assert found.gain_reduction_margin == pytest.approx(below.min(initial=np.inf), rel=1e-9)
    assert found.phase_margin_deg == pytest.approx(np.abs(phases).min(), rel=1e-9)
    assert found.delay_margin_s == pytest.approx((np.deg2rad(phases % 360.0) / crossed).min(), rel=1e-9)
    assert found.bandwidth_hz == pytest.approx(crossed.max() / (2.0 * np.pi), rel=1e-9)
    assert found.sensitivity_peak == pytest.approx(1.0 / np.min(distances), rel=1e-6)


def test_a_conditionally_stable_loop_fails_with_less_gain_and_with_more_lead() -> None:
    """L = k (s + 1)^2 / s^3: s^3 + k (s + 1)^2 is stable for k > 1 / 2 alone."""
    found = of(0.8 * (S + 1.0) ** 2 / S**3)
    assert found.gain_reduction_margin == pytest.approx(1.6, rel=1e-4)
    assert found.gain_margin == np.inf


def test_a_lead_that_ends_stability_is_a_phase_margin_too() -> None:
    """With L = -k / (s + 1) + ..., that is 1 + L = 0 nearest by lead: L = 3 / (1 - s / 5) is stable in closed loop."""
    loop = -3.0 * 5.0 / (5.0 - S)  # an unstable pole at 5 held by a gain of 3: 1 + L = (-10 - s) / (5 - s)
    found = of(loop)
    crossing = 5.0 * np.sqrt(8.0)
    lag_left = np.angle(-3.0 / (1.0 - 1j * crossing / 5.0)) + np.pi
    assert found.phase_margin_deg == pytest.approx(np.rad2deg(min(lag_left, 2.0 * np.pi - lag_left)), rel=1e-4)
    assert found.delay_margin_s == pytest.approx(lag_left / crossing, rel=1e-4)
    assert found.gain_reduction_margin == np.inf


def test_a_loop_that_rises_through_one_is_nearest_by_lead() -> None:
    """L = k s^2 / (s + 1)^3 is stable for every k > 0; at its lower crossing 3 atan(w) of lead make it half a turn."""
    k = 10.0
    found = of(k * S**2 / (S + 1.0) ** 3)
    w = brentq(lambda x: k * x**2 - (1.0 + x**2) ** 1.5, 0.1, 1.0)
    upper = brentq(lambda x: k * x**2 - (1.0 + x**2) ** 1.5, 2.0, 100.0)
    assert found.phase_margin_deg == pytest.approx(
        np.rad2deg(min(3.0 * np.arctan(w), 2.0 * np.pi - 3.0 * np.arctan(upper))), rel=1e-4
    )
    lag = np.array([2.0 * np.pi - 3.0 * np.arctan(w), 2.0 * np.pi - 3.0 * np.arctan(upper)])
    assert found.delay_margin_s == pytest.approx((lag / [w, upper]).min(), rel=1e-4)
    assert np.rad2deg(3.0 * np.arctan(w)) < 60.0


def test_of_several_crossings_the_tightest_counts() -> None:
    """An integrator of 1 rad/s, and a resonance of damping 0.5 % at 20 rad/s that crosses one twice more."""
    w, zeta = 20.0, 0.005

    def loop_at(f: Array) -> ComplexArray:
        s = 2j * np.pi * f
        return np.exp(-0.05 * s) / s * (1.0 + 0.5 * s**2 / (s**2 + 2.0 * zeta * w * s + w**2))

    dense = np.union1d(F[F < 10.0], w / (2.0 * np.pi) * (1.0 + zeta * np.linspace(-8.0, 8.0, 65)))
    fine = np.linspace(0.05, 8.0, 400_000)
    found, loop = margins(loop_at(dense), dense), loop_at(fine)
    at = np.flatnonzero(np.diff(np.sign(np.abs(loop) - 1.0)))
    assert at.size == 3
    away = np.mod(np.angle(loop[at]) + np.pi, 2.0 * np.pi)
    assert found.delay_margin_s == pytest.approx((away / (2.0 * np.pi * fine[at])).min(), rel=2e-3)
    assert found.phase_margin_deg == pytest.approx(np.rad2deg(np.abs(np.angle(-loop[at])).min()), rel=2e-3)
    assert found.bandwidth_hz == pytest.approx(fine[at[-1]], rel=1e-4)
    peaks = 1.0 / np.abs(1.0 + loop)
    assert found.sensitivity_peak == pytest.approx(peaks.max(), rel=1e-3)
    assert found.peak_hz == pytest.approx(fine[peaks.argmax()], rel=1e-3)


def test_the_peak_is_found_between_the_points() -> None:
    """|S| of L = w^2 / (s (s + 2 z w)) with z = 0.1, from a response of 60 points only."""
    w, z = 5.0, 0.1
    coarse = np.geomspace(0.05, 20.0, 60)
    s, x = 2j * np.pi * coarse, np.linspace(0.5, 1.5, 200_001)
    found = margins(w**2 / (s * (s + 2.0 * z * w)), coarse)
    exact = np.abs((-(x**2) + 2j * z * x) / (1.0 - x**2 + 2j * z * x))
    assert found.sensitivity_peak == pytest.approx(exact.max(), rel=5e-3)
    on_points = np.abs(1.0 / (1.0 + w**2 / (s * (s + 2.0 * z * w)))).max()
    assert found.sensitivity_peak > on_points


def test_without_a_loop_nothing_is_crossed() -> None:
    found = of(np.zeros(F.size, dtype=complex))
    assert found.gain_margin == found.gain_reduction_margin == np.inf
    assert found.phase_margin_deg == found.delay_margin_s == np.inf
    assert found.sensitivity_peak == pytest.approx(1.0, abs=1e-11)
    assert found.bandwidth_hz == 0.0


def test_a_loop_that_is_not_finite_has_no_margins() -> None:
    found = of(np.where(F > 10.0, np.nan, 1.0 / S))
    assert all(np.isnan(value) for value in astuple(found))


@pytest.mark.parametrize("seed", range(40))
def test_a_gain_that_is_one_at_the_last_point_is_crossed_there(seed: int) -> None:
    """Computed from the cubic the last gain may be below one by a rounding; it is what the point says."""
    gain = np.sort(np.random.default_rng(seed).uniform(0.01, 0.9, F.size))
    gain[-1] = 1.0
    assert of(gain * np.exp(-1j)).bandwidth_hz == pytest.approx(F[-1], rel=1e-9)


def test_the_worst_peak_is_that_of_the_worst_turn() -> None:
    loop, error = 1.0 / (S * (S + 1.0)), np.full(F.size, 0.03)
    turned = loop[:, None] * (1.0 + 0.06 * np.exp(2j * np.pi * np.arange(720) / 720))
    assert worst_sensitivity_peak(loop, error) == pytest.approx(np.abs(1.0 / (1.0 + turned)).max(), rel=1e-4)
    assert worst_sensitivity_peak(-np.ones(3) + 0.01j, np.full(3, 0.01)) == np.inf


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 1024.0, 2000.0, 2048.0, 3000.0, 4096.0])
@pytest.mark.parametrize("late", [1, 3])
def test_a_negative_loop_at_half_the_sample_rate_is_a_crossing(rate_hz: float, late: int) -> None:
    """L = 0.42 z^-n / (1 - 0.3 z^-2) is -0.6 at z = -1, whichever side of half a turn the rounding puts its angle."""
    f = np.geomspace(0.05, 0.5, 3000) * rate_hz
    z = np.exp(2j * np.pi * f / rate_hz)
    found = margins(0.42 * z**-late / (1.0 - 0.3 * z**-2), f)
    assert found.gain_margin <= (1.0 / 0.6) * (1.0 + 1e-9)
    if late == 1:  # its only crossing
        assert found.gain_margin == pytest.approx(1.0 / 0.6, rel=1e-9)
