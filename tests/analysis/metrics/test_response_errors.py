"""Oracles: shifts made in the frequency domain, sines through the closed-form gain of the filter, an offset."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rths_cli.analysis import metrics
from rths_cli.analysis.metrics import error_figures, fitted_delay_s, fitted_delays_s, peak, rms
from rths_cli.errors import InputError

DT_S = 1 / 2000
TIME_S = DT_S * np.arange(40_000)


def gain(frequency_hz: float, dt_s: float = DT_S) -> float:
    """Squared Butterworth gain, with the bilinear transform's warping, of a 4th-order filter at 12 Hz."""
    warped = np.tan(np.pi * frequency_hz * dt_s) / np.tan(np.pi * 12.0 * dt_s)
    return float(1.0 / (1.0 + warped**8))


def structure_like(seed: int = 0) -> np.ndarray:
    """Decaying motion at the paper's three frequencies over a quiet start and end."""
    random = np.random.default_rng(seed)
    motion = np.zeros_like(TIME_S)
    for frequency_hz in (2.306, 6.467, 9.345):
        for start_s in random.uniform(2, 8, 5):
            later = np.clip(TIME_S - start_s, 0, None)
            motion += later * np.exp(-2 * later) * np.sin(2 * np.pi * frequency_hz * later)
    return motion


def shifted(series: np.ndarray, delay_s: float) -> np.ndarray:
    size = 2 * len(series)
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(size, DT_S) * delay_s)
    return np.fft.irfft(np.fft.rfft(series, size) * turn, size)[: len(series)]


@pytest.mark.parametrize("frequency_hz", [1.0, 9.3, 12.0, 15.0, 30.0])
def test_sine_passes_with_the_closed_form_gain_and_no_phase(frequency_hz: float) -> None:
    sine = np.sin(2 * np.pi * frequency_hz * TIME_S)
    filtered = metrics.test_band(sine, DT_S)
    middle = slice(10_000, 30_000)
    assert_allclose(filtered[middle], gain(frequency_hz) * sine[middle], rtol=0, atol=1e-6)


def test_gain_is_half_at_the_corner_and_sixteenth_order_beyond() -> None:
    sine = np.sin(2 * np.pi * 12.0 * TIME_S)
    assert rms(metrics.test_band(sine, DT_S)) == pytest.approx(0.5 * rms(sine), rel=2e-3)
    assert gain(24.0) == pytest.approx(1 / 257, rel=0.02)


def test_band_keeps_the_shape_and_filters_along_time() -> None:
    rows = np.stack([np.sin(2 * np.pi * 3 * TIME_S), np.ones_like(TIME_S)])[None]
    filtered = metrics.test_band(rows, DT_S)
    assert filtered.shape == rows.shape
    assert np.array_equal(filtered[0, 1], metrics.test_band(rows[0, 1], DT_S))
    assert_allclose(filtered[0, 1], np.ones_like(TIME_S), rtol=1e-6)


@pytest.mark.parametrize("samples", [1, 2, 7, 15, 16, 17])
def test_short_records_work_and_keep_a_constant(samples: int) -> None:
    assert metrics.test_band(np.full(samples, 2.5), DT_S) == pytest.approx(np.full(samples, 2.5))


@pytest.mark.parametrize("dt_s", [0.0, -0.1, 1 / 24, 1.0, float("nan")])
def test_band_refuses_a_step_that_cannot_hold_it(dt_s: float) -> None:
    with pytest.raises(InputError, match=r"dt_s is .* 12 Hz test band"):
        metrics.test_band(np.ones(100), dt_s)


def test_rms_and_peak_by_hand() -> None:
    series = [[3.0, -4.0, 0.0, 0.0], [1.0, 1.0, -1.0, -1.0]]
    assert rms(series) == pytest.approx([2.5, 1.0])
    assert peak(series) == pytest.approx([4.0, 1.0])


def test_constant_offset_shows_in_every_figure() -> None:
    reference = np.stack([structure_like(0), structure_like(1)])
    figures = error_figures(reference, reference + np.array([[0.02], [-0.5]]), DT_S)
    for figure in (figures.rms, figures.maximum, figures.rms_full, figures.maximum_full):
        assert figure == pytest.approx([0.02, 0.5], rel=1e-9)
    assert not figures.diverged.any()


def test_pure_delay_shows_and_is_not_fitted_away() -> None:
    """A late sine differs by 2 sin(w delay / 2) times its amplitude."""
    sine, late = (np.sin(2 * np.pi * 3.0 * (TIME_S - delay_s)) for delay_s in (0.0, 0.001))
    figures = error_figures(sine, late, DT_S)
    expected = 2 * np.sin(np.pi * 3.0 * 0.001)
    assert figures.maximum_full == pytest.approx(expected, rel=1e-5)
    assert figures.rms_full == pytest.approx(expected / np.sqrt(2), rel=1e-5)
    assert figures.rms == pytest.approx(gain(3.0) * expected / np.sqrt(2), rel=1e-3)


def test_error_out_of_band_counts_in_full_band_only() -> None:
    reference = structure_like()
    figures = error_figures(reference, reference + 0.1 * np.sin(2 * np.pi * 60 * TIME_S), DT_S)
    assert figures.rms_full == pytest.approx(0.1 / np.sqrt(2), rel=1e-9)
    assert figures.rms < 5e-3 * figures.rms_full  # what is left stands at the two ends


def test_cut_storey_has_no_figures_and_is_flagged() -> None:
    reference = np.stack([structure_like(0), structure_like(1)])
    value = reference + 0.01
    value[1, 30_000:] = np.nan
    figures = error_figures(reference, value, DT_S)
    assert figures.diverged.tolist() == [False, True]
    for figure in (figures.rms, figures.maximum, figures.rms_full, figures.maximum_full):
        assert figure[0] == pytest.approx(0.01)
        assert np.isnan(figure[1])


def test_infinite_values_are_flagged_without_a_warning() -> None:
    value = np.zeros(100)
    value[50] = np.inf
    figures = error_figures(np.zeros(100), value, DT_S)
    assert figures.diverged
    assert np.isnan([figures.rms, figures.maximum, figures.rms_full, figures.maximum_full]).all()


def test_different_shapes_are_named() -> None:
    with pytest.raises(InputError, match=r"value has shape \(2, 5\), but the reference has \(3, 5\)"):
        error_figures(np.zeros((3, 5)), np.zeros((2, 5)), DT_S)


@pytest.mark.parametrize("delay_s", [0.0, 0.00004, -0.00013, 0.0005, 0.00521, -0.0072, 0.0613, -0.11])
def test_known_delay_is_recovered_below_a_sample(delay_s: float) -> None:
    desired = structure_like()
    measured = 0.8 * shifted(desired, delay_s) + 5.0
    assert fitted_delay_s(desired + 2.0, measured, DT_S) == pytest.approx(delay_s, rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("delay_s", [0.0003, -0.0003])
def test_delay_is_recovered_under_noise(delay_s: float) -> None:
    """Bound of the estimator: noise over the rms slope and the square root of the samples, here 2 us; allow four."""
    desired = structure_like()
    noise = 0.01 * np.random.default_rng(2).normal(size=len(desired))
    bound = 0.01 / (rms(np.gradient(desired, DT_S)) * np.sqrt(len(desired)))
    found = fitted_delay_s(desired, shifted(desired, delay_s) + noise, DT_S)
    assert abs(found - delay_s) < 4 * bound < 2e-4


def test_delay_of_a_sine_cut_off_at_both_ends() -> None:
    for delay_s in (0.002, -0.002):
        desired, measured = (np.cos(2 * np.pi * 2.3 * (TIME_S - late)) for late in (0.0, delay_s))
        assert fitted_delay_s(desired, measured, DT_S) == pytest.approx(delay_s, rel=2e-3)


def test_no_delay_is_told_of_a_constant_or_a_cut_series() -> None:
    cut = structure_like()
    cut[-1] = np.nan
    assert np.isnan(fitted_delay_s(np.ones(100), np.arange(100.0), DT_S))
    assert np.isnan(fitted_delay_s(structure_like(), cut, DT_S))
    with pytest.raises(InputError, match=r"measured has shape \(3,\)"):
        fitted_delay_s(np.arange(4.0), np.arange(3.0), DT_S)


def test_a_delay_beyond_half_the_record_does_not_come_round() -> None:
    pulse = np.exp(-0.5 * ((TIME_S - 2.5) / 0.05) ** 2)
    late = np.exp(-0.5 * ((TIME_S - 16.5) / 0.05) ** 2)
    assert fitted_delay_s(pulse, late, DT_S) == pytest.approx(14.0, rel=1e-4)


def test_the_fitted_delay_is_where_the_correlation_is_level() -> None:
    """The slope of sum Re(conj(X) Y exp(j w delay)) over its curvature, one exponential per line, is nothing there."""
    desired = structure_like()
    noise = np.random.default_rng(2).normal(0, 0.02, (2, len(desired)))
    measured = shifted(desired, 0.00321) + noise[1]
    found = fitted_delay_s(desired + noise[0], measured, DT_S)
    n = len(desired)
    taper = np.minimum(np.arange(n), np.arange(n)[::-1]) / (0.05 * (n - 1))
    taper = 0.5 - 0.5 * np.cos(np.pi * np.minimum(taper, 1.0))
    X, Y = (np.fft.rfft((z - z.mean()) * taper, 80_000) for z in (desired + noise[0], measured))
    rate = 2 * np.pi * np.fft.rfftfreq(80_000, DT_S)
    turned = X.conj() * Y * np.exp(1j * rate * found)
    assert abs(np.sum(rate * turned.imag) / np.sum(rate**2 * turned.real)) < 1e-11
    assert found == pytest.approx(0.00321, abs=2e-4)


def test_delays_of_several_series_are_those_of_each_alone() -> None:
    desired = structure_like()
    values = [shifted(desired, 0.003), np.ones_like(desired), shifted(desired, -0.002)]
    found = fitted_delays_s(desired, values, DT_S)
    assert found[::2] == [fitted_delay_s(desired, each, DT_S) for each in values[::2]]
    assert found[::2] == pytest.approx([0.003, -0.002], rel=1e-3) and np.isnan(found[1])
    assert np.isnan(fitted_delays_s(np.ones(50), [np.arange(50.0), np.ones(50)], DT_S)).tolist() == [True, True]
