"""Oracle: scipy.signal, which the commands do not import; closed forms of the Butterworth gain."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

from rths_cli.numerics import filters

RATE_HZ = 2000.0
SERIES = np.random.default_rng(5).normal(size=(7, 3000))


@pytest.mark.parametrize("rows", [1, 2, 4, 5, 7])
@pytest.mark.parametrize("order", [1, 2, 5, 8])
def test_any_number_of_series_is_filtered_as_scipy_does(order: int, rows: int) -> None:
    sections = signal.butter(order, 60.0, fs=RATE_HZ, output="sos")
    series = SERIES[:rows]
    both = signal.sosfiltfilt(sections, series, padlen=15)
    assert_allclose(filters.filtered_both_ways(sections, series, 15), both, rtol=0, atol=1e-12, equal_nan=False)


def test_high_pass_and_other_corners_both_ways() -> None:
    for corner_hz in (0.25, 12.0, 300.0):
        sections = signal.butter(3, corner_hz, "high", fs=RATE_HZ, output="sos")
        expected = signal.sosfiltfilt(sections, SERIES, padlen=9)
        assert_allclose(filters.filtered_both_ways(sections, SERIES, 9), expected, rtol=0, atol=1e-12, equal_nan=False)


@pytest.mark.parametrize("samples", [1, 2, 3, 15, 16, 17])
def test_short_series_and_every_padding(samples: int) -> None:
    sections = signal.butter(4, 12.0, fs=RATE_HZ, output="sos")
    series = SERIES[:3, :samples]
    for padding in range(samples):
        expected = signal.sosfiltfilt(sections, series, padlen=padding)
        rounding = 1e-12 * max(1.0, np.abs(expected).max())
        assert_allclose(
            filters.filtered_both_ways(sections, series, padding), expected, rtol=0, atol=rounding, equal_nan=False
        )
    for padding in (-1, samples):
        with pytest.raises(ValueError, match=f"padding {padding}"):
            filters.filtered_both_ways(sections, series, padding)


def test_shape_is_kept_and_the_series_is_left_alone() -> None:
    sections = signal.butter(4, 12.0, fs=RATE_HZ, output="sos")
    series = SERIES[:6].reshape(2, 3, -1)
    before = series.copy()
    both = filters.filtered_both_ways(sections, series, 15)
    assert both.shape == series.shape
    strided = filters.filtered_both_ways(sections, np.repeat(series, 2, axis=-1)[:, :, ::2], 15)
    assert np.array_equal(strided, both)
    assert both[1, 2] == pytest.approx(filters.filtered_both_ways(sections, series[1, 2], 15), rel=0, abs=0)
    assert np.array_equal(series, before)


def test_a_nan_makes_its_whole_series_nan_and_no_other() -> None:
    series = SERIES[:5].copy()
    series[1, 1500:] = series[4, 7] = np.nan
    both = filters.filtered_both_ways(signal.butter(4, 12.0, fs=RATE_HZ, output="sos"), series, 15)
    assert np.isnan(both[[1, 4]]).all() and np.isfinite(both[[0, 2, 3]]).all()


def test_modes_follow_their_recursion_from_rest() -> None:
    poles = np.exp(np.array([-0.01 + 0.3j, -1e-4 - 0.02j, -0.5, 2.0j, -0.003 + 1.0j]))
    now, before = np.array([1.0, 2.0j, 0.3, -1.0, 0.0]), np.array([0.5j, 0.0, 1.0 - 1.0j, 0.2, 3.0])
    modes = filters.driven_modes(poles, now, before, SERIES[0])
    assert modes.shape == (2, 5, 3000)
    expected = np.zeros((5, 3000), dtype=complex)
    for k in range(1, 3000):
        expected[:, k] = poles * expected[:, k - 1] + now * SERIES[0, k] + before * SERIES[0, k - 1]
    rounding = 1e-12 * np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(modes[0] + 1j * modes[1] - expected) <= rounding).all()
    assert filters.driven_modes(poles[0], now[0], before[0], SERIES[0])[:, 0] == pytest.approx(modes[:, 0])
