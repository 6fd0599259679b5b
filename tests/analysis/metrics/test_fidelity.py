"""Oracles: sinusoids of known gain and delay, sums of them weighted by hand, the area of a sampled ellipse."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rths_cli.analysis.metrics import frequency_evaluation, tracking_indicator
from rths_cli.analysis.metrics.fidelity import frequency_evaluations
from rths_cli.errors import InputError

DT_S = 1 / 2000
TIME_S = DT_S * np.arange(20_000)
DELAYS_S = [0.0, 0.00013, -0.00013, 0.0005, 0.0123, -0.0305]  # fractions of a sample, early and late


def sine(frequency_hz: float, amplitude: float = 1.0, delay_s: float = 0.0) -> np.ndarray:
    """Return a sine of a whole number of cycles."""
    return amplitude * np.sin(2 * np.pi * frequency_hz * (TIME_S - delay_s))


@pytest.mark.parametrize("delay_s", DELAYS_S)
@pytest.mark.parametrize("gain", [0.7, 1.0, 1.3])
def test_gain_and_delay_of_a_sine_are_recovered(gain: float, delay_s: float) -> None:
    found = frequency_evaluation(sine(3.2, 2.0) + 0.5, sine(3.2, 2.0 * gain, delay_s) - 1.0, DT_S)
    assert found.amplitude == pytest.approx(gain, rel=1e-9)
    assert found.delay_s == pytest.approx(delay_s, rel=1e-9, abs=1e-12)
    assert found.frequency_hz == pytest.approx(3.2, rel=1e-9)


def test_lines_are_weighted_with_the_desired_power() -> None:
    """Two lines: FEI = (a1^2 g1 e1 + a2^2 g2 e2) / (a1^2 + a2^2), at their mean frequency weighted alike."""
    (a1, a2), (g1, g2), (d1, d2), (f1, f2) = (1.0, 3.0), (1.1, 0.8), (0.004, -0.002), (2.3, 9.4)
    desired = sine(f1, a1) + sine(f2, a2)
    measured = sine(f1, g1 * a1, d1) + sine(f2, g2 * a2, d2) + sine(5.0, 0.5)  # 5 Hz was not desired
    turned = [a * a * g * np.exp(-2j * np.pi * f * d) for a, g, d, f in ((a1, g1, d1, f1), (a2, g2, d2, f2))]
    index, frequency_hz = sum(turned) / 10, (2.3 + 9 * 9.4) / 10
    found = frequency_evaluation(desired, measured, DT_S)
    assert found.frequency_hz == pytest.approx(frequency_hz, rel=1e-9)
    assert found.amplitude == pytest.approx(abs(index), rel=1e-9)
    assert found.delay_s == pytest.approx(-np.angle(index) / (2 * np.pi * frequency_hz), rel=1e-9)


def test_lines_above_the_range_do_not_count() -> None:
    desired = sine(3.0) + sine(20.0, 5.0)
    measured = sine(3.0, 0.9, 0.001) + sine(20.0, 1.0, 0.01)
    found = frequency_evaluation(desired, measured, DT_S)
    assert (found.amplitude, found.delay_s) == pytest.approx((0.9, 0.001), rel=1e-9)
    wide = frequency_evaluation(desired, measured, DT_S, high_hz=50.0)
    assert wide.amplitude < 0.3


def test_noise_of_the_sensor_leaves_the_index_unbiased() -> None:
    """The measured power enters nowhere: noise as large as the signal costs the random part only."""
    noise = np.random.default_rng(3).normal(size=len(TIME_S))
    found = frequency_evaluation(sine(3.2), sine(3.2, 1.0, 0.001) + noise, DT_S)
    scatter = np.sqrt(2 / len(TIME_S))  # of a line, relative to the sine's amplitude, in each component
    assert found.amplitude == pytest.approx(1.0, abs=3 * scatter)
    assert found.delay_s == pytest.approx(0.001, abs=3 * scatter / (2 * np.pi * 3.2))


def test_nothing_desired_or_a_cut_series_has_no_index() -> None:
    cut = sine(3.2)
    cut[-1] = np.nan
    for desired, measured in ((0 * TIME_S, sine(3.2)), (cut, sine(3.2)), (sine(3.2), cut)):
        with np.errstate(invalid="raise"):
            found = frequency_evaluation(desired, measured, DT_S)
        assert np.isnan([found.amplitude, found.delay_s, found.frequency_hz]).all()
    with pytest.raises(InputError, match=r"measured has shape \(3,\), but desired has \(4,\)"):
        frequency_evaluation(np.arange(4.0), np.arange(3.0), DT_S)


@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_indicator_of_a_sine_is_the_area_swept_by_its_chords(delay_s: float) -> None:
    """Every step adds half of a b sin(w dt) sin(w delay), whatever the phase: late is positive."""
    found = tracking_indicator(sine(3.2, 2.0), sine(3.2, 1.5, delay_s))
    step = 0.5 * 2.0 * 1.5 * np.sin(2 * np.pi * 3.2 * DT_S) * np.sin(2 * np.pi * 3.2 * delay_s)
    assert_allclose(found, step * np.arange(len(TIME_S)), rtol=1e-7, atol=1e-10)


def test_indicator_is_blind_to_a_gain_and_needs_equal_lengths() -> None:
    motion = np.cumsum(np.random.default_rng(4).normal(size=1000))
    assert tracking_indicator(motion, 1.4 * motion) == pytest.approx(np.zeros(1000), abs=1e-7)
    with pytest.raises(InputError, match="compare two series of equal length"):
        tracking_indicator(np.arange(4.0), np.arange(3.0))


def test_several_series_are_evaluated_like_each_alone() -> None:
    draw = np.random.default_rng(4).standard_normal
    desired, values = draw(997), draw((2, 997))
    together = frequency_evaluations(desired, list(values), 0.01)
    assert together == [frequency_evaluation(desired, each, 0.01) for each in values]
    assert together[0].amplitude != together[1].amplitude
