"""Rounding of made-up signals, done sample by sample, against what it is said to add at low frequencies."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.quantisation import rounding_power, zero_error

DT_S, SAMPLES = 1e-3, 200_000


def narrow_band(rms: float, seed: int = 0, low_hz: float = 2.0, high_hz: float = 3.0) -> np.ndarray:
    """Return Gaussian noise (n,) in a band."""
    lines = np.fft.rfft(np.random.default_rng(seed).standard_normal(SAMPLES))
    f = np.fft.rfftfreq(SAMPLES, DT_S)
    signal = np.fft.irfft(np.where((f >= low_hz) & (f <= high_hz), lines, 0.0), SAMPLES)
    return rms * signal / signal.std()


def below(values: np.ndarray, high_hz: float) -> float:
    """Return the variance that a series (n,) has below a frequency."""
    power = 2.0 * np.abs(np.fft.rfft(values - values.mean()) / len(values)) ** 2
    return float(power[np.fft.rfftfreq(len(values), DT_S) <= high_hz].sum())


@pytest.mark.parametrize("rms", [1.5, 3.0, 10.0, 100.0])
@pytest.mark.parametrize("noise", [0.0, 0.2, 1.0])
def test_variance_at_low_frequencies(rms: float, noise: float) -> None:
    """In steps: a motion of 3 rms crosses 50 a second, and 12 Hz of noise take a tenth of its power, not a fortieth."""
    signal = narrow_band(rms)
    noisy = signal + noise * np.random.default_rng(1).standard_normal(SAMPLES)
    made = below(np.round(noisy) - noisy, 12.0)
    f = np.arange(0.0, 12.0, 0.05)
    found = rounding_power(f, signal, DT_S, 1.0, noise, DT_S).mean() * 12.0 / 500.0
    assert found == pytest.approx(made, rel=0.25)


@pytest.mark.parametrize("rms", [0.1, 0.2, 0.4, 1.0])
@pytest.mark.parametrize("band_hz", [(19.0, 21.0), (40.0, 150.0)])
def test_a_fast_random_motion_spreads_the_power(rms: float, band_hz: tuple[float, float]) -> None:
    """As a floor does that a noise-shaped command shakes: at its resonance, or above the lines. One below
    a fifth of a step spreads less than is said: a sixth of the rms."""
    signal, fast = narrow_band(3.0), narrow_band(rms, 1, *band_hz)
    made = below(np.round(signal + fast) - signal - fast, 12.0)
    f = np.arange(0.0, 12.0, 0.05)
    shaken = rms, float(np.std(np.gradient(fast, DT_S)))
    found, slow = (
        rounding_power(f, signal, DT_S, 1.0, 0.0, DT_S, each).mean() * 12.0 / 500.0 for each in (shaken, (0.0, 0.0))
    )
    assert found == pytest.approx(made, rel=0.35)
    assert rms < 0.4 or found < 0.6 * slow


def test_a_motion_smaller_than_a_step_is_lost_and_no_more() -> None:
    signal = narrow_band(0.05)
    f = np.arange(0.0, 40.0, 0.05)
    found = rounding_power(f, signal, DT_S, 1.0, 0.0, DT_S).mean() * 40.0 / 500.0
    assert found == pytest.approx(0.05**2, rel=0.4)


def test_no_converter_no_rounding() -> None:
    assert np.all(rounding_power(np.arange(5.0), narrow_band(1.0), DT_S, 0.0, 0.0, DT_S) == 0.0)


@pytest.mark.campaign
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 0.5, 0.8])
def test_the_zero_of_samples_at_rest_is_as_uncertain_as_is_said(noise: float) -> None:
    """Means of many samples of 400 zeros between two steps. What a channel shows at rest is as much as the noise and
    half a step: then the figure is exact. It is never too small."""
    random, zeros = np.random.default_rng(7), np.linspace(-0.5, 0.5, 400, endpoint=False) + 0.5 / 400
    shown = np.round(zeros[:, None] + noise * random.standard_normal((400, 20_000)))
    means = shown.mean(axis=1)
    error = float(np.sqrt(np.mean((means - zeros) ** 2)))
    assert zero_error(1.0, np.hypot(noise, 0.5)) == pytest.approx(error, rel=0.02, abs=0.01)
    stds = shown.std(axis=1)
    assert np.mean([zero_error(1.0, float(std)) for std in stds]) > 0.99 * error - 0.01
    assert zero_error(2.5e-3, 2.5e-3 * np.hypot(noise, 0.5)) == pytest.approx(
        2.5e-3 * zero_error(1.0, np.hypot(noise, 0.5)), rel=1e-9
    )
