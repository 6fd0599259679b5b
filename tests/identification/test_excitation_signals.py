"""Signals against their exact line spectra, instantaneous frequencies and slopes by independent estimates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import hilbert, welch

from rths_cli.identification.excitation import faded, multisine, repeated, steps, sweep

DT = 1.0 / 1000.0
LOW, HIGH, PERIOD_S = 0.3, 60.0, 20.0


def wanted(f: float) -> float:
    """Return the amplitude stated for all signals, written out piece by piece."""
    if f <= 0.7:
        return 1.0
    if f <= 12.0:
        return (0.7 / f) ** 1.5
    return (0.7 / 12.0) ** 1.5 * (12.0 / f) ** 3.5


def test_multisine_has_every_line_of_the_band_and_no_other() -> None:
    period = multisine(PERIOD_S, DT, LOW, HIGH, np.random.default_rng(0))
    lines = np.fft.rfft(period)
    expected = np.zeros(len(lines))
    for k in range(6, 1201):  # 0.3 to 60 Hz in steps of 0.05 Hz
        expected[k] = wanted(k * 0.05)
    assert len(period) == 20000
    np.testing.assert_allclose(np.abs(lines), expected, atol=1e-9)
    turns = np.angle(lines[6:1201])
    assert np.abs(np.exp(1j * turns).mean()) < 0.1
    assert turns.min() < -3.0
    assert turns.max() > 3.0


def test_multisine_repeats_with_its_stream() -> None:
    first, again, other = (multisine(PERIOD_S, DT, LOW, HIGH, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.6


def test_sweep_goes_up_and_down_logarithmically() -> None:
    # the second derivative has nearly the same size at all frequencies, which the analytic signal needs
    signal = sweep(PERIOD_S, DT, LOW, HIGH)
    analytic = hilbert((np.roll(signal, -1) - 2.0 * signal + np.roll(signal, 1)) / DT**2)
    found = np.diff(np.unwrap(np.angle(analytic))) / (2.0 * np.pi * DT)
    t = (np.arange(19999) + 0.5) * DT
    law = np.where(t < 10.0, LOW * 200.0 ** (t / 10.0), LOW * 200.0 ** (2.0 - t / 10.0))
    inside = (law > 4.0) & (law < 40.0)
    assert np.abs(found[inside] / law[inside] - 1.0).max() < 0.015
    assert 1.0 - 1.0 / 226.0 < np.mean(found[inside] / law[inside]) < 1.001  # less than one of 226 cycles lower
    expected = np.array([wanted(f) * (2.0 * np.pi * f) ** 2 for f in law[inside]])
    away = (law[inside] < 10.0) | (law[inside] > 14.5)  # from the kink that is rounded off
    assert np.abs(np.abs(analytic[1:])[inside] / expected - 1.0)[away].max() < 0.03


def test_sweep_is_periodic_with_nothing_above_its_band() -> None:
    period = sweep(PERIOD_S, DT, LOW, HIGH)
    lines = np.abs(np.fft.rfft(period))
    assert lines[1201:].max() < 1e-9
    assert lines[0] < 1e-9
    cycles = PERIOD_S * (HIGH - LOW) / np.log(HIGH / LOW)  # integral of the frequency
    rises = np.count_nonzero((period < 0.0) & (np.roll(period, -1) >= 0.0))
    assert rises == pytest.approx(np.floor(cycles), abs=1)
    accel = np.diff(np.tile(period, 2), 2)[18000:22000]  # across the seam, around the lowest frequency
    assert np.abs(accel).max() < 0.3 * np.abs(np.diff(period, 2)).max()


def test_steps_fall_as_stated() -> None:
    signal = faded(steps(400.0, DT, HIGH, np.random.default_rng(0)), 2.0, DT)
    f, density = welch(signal, 1.0 / DT, nperseg=10000)
    for low, high, slope in ((1.0, 10.0, -3.0), (14.0, 55.0, -7.0)):
        inside = (f >= low) & (f <= high)
        assert np.polyfit(np.log(f[inside]), np.log(density[inside]), 1)[0] == pytest.approx(slope, abs=0.2)
    assert density[f > 65.0].max() < 1e-6 * density[(f > 50.0) & (f < 58.0)].mean()


def test_steps_are_held_and_their_acceleration_is_bounded() -> None:
    signal = steps(200.0, DT, HIGH, np.random.default_rng(1))
    changes = np.flatnonzero(np.diff(np.sign(signal))) * DT
    holds = np.diff(changes[(changes > 5.0) & (changes < 195.0)])
    assert len(holds) > 60
    assert 0.9 < holds.min() < 1.3
    assert 3.7 < holds.max() < 4.1
    middles = np.abs(np.interp(changes[1:-1] + 0.5, np.arange(200000) * DT, signal))
    assert 0.4 < middles.min() < 0.65
    assert 0.9 < middles.max() < 1.1
    # the second derivative of a smoothed unit step is at most the integral of all its lines
    bound = 4.0 * np.pi * quad(lambda f: f * f * wanted(f) / min(f, 0.7), 0.0, HIGH, points=[0.7, 12.0])[0]
    accel = np.abs(np.diff(signal, 2)).max() / DT**2
    assert 0.3 * 2.0 * bound < accel < 2.0 * bound


def test_repeated_periods_are_equal_between_fades() -> None:
    period = multisine(PERIOD_S, DT, LOW, HIGH, np.random.default_rng(3))
    signal = repeated(period, 3, 2.0, DT)
    assert len(signal) == 4 * 20000 + 2000
    assert all(np.array_equal(signal[k * 20000 : (k + 1) * 20000], period) for k in (1, 2, 3))
    assert np.array_equal(signal[2000:20000], period[2000:])
    assert abs(signal[0]) < 1e-5
    assert abs(signal[-1]) < 1e-5
