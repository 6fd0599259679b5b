"""Oracle: scipy.signal.sosfiltfilt."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

from rths_cli.numerics import filters
from rths_cli.numerics.lti import Array

RATE_HZ = 2000.0
SERIES = np.random.default_rng(5).normal(size=(7, 3000))


def filtered_in_tiles(sections: Array, series: Array, padding: int) -> Array:
    """Return series (m, n) filtered forward and backward, four beside each other."""
    m, n = series.shape
    tiles = filters.empty_tiles(m, n, padding)
    for row in range(m):
        tiles[row // filters.LANES, padding : padding + n, row % filters.LANES] = series[row]
    filters.filter_tiles_both_ways(sections, tiles, padding)
    return tiles.transpose(0, 2, 1).reshape(-1, n + 2 * padding)[:m, padding : padding + n]


@pytest.mark.parametrize("rows", [1, 4, 5, 7])
@pytest.mark.parametrize(
    ("order", "kind", "corner_hz"), [(4, "low", 12.0), (3, "low", 300.0), (4, "high", 12.0), (2, "low", 12.0)]
)
def test_series_in_tiles_are_filtered_as_scipy_does(order: int, kind: str, corner_hz: float, rows: int) -> None:
    sections = signal.butter(order, corner_hz, kind, fs=RATE_HZ, output="sos")
    expected = signal.sosfiltfilt(sections, SERIES[:rows], padlen=15)
    found = filtered_in_tiles(sections, SERIES[:rows], 15)
    assert_allclose(found, expected, rtol=0, atol=1e-12, equal_nan=False)


@pytest.mark.parametrize("samples", [1, 2, 3, 15, 16, 17])
def test_short_series_and_every_padding(samples: int) -> None:
    sections = signal.butter(4, 12.0, fs=RATE_HZ, output="sos")
    series = SERIES[:3, :samples]
    for padding in range(samples):
        expected = signal.sosfiltfilt(sections, series, padlen=padding)
        rounding = 1e-12 * max(1.0, np.abs(expected).max())
        found = filtered_in_tiles(sections, series, padding)
        assert_allclose(found, expected, rtol=0, atol=rounding, equal_nan=False)


def test_a_nan_makes_its_whole_series_nan_and_no_other() -> None:
    series = SERIES[:5].copy()
    series[1, 1500:] = series[4, 7] = np.nan
    both = filtered_in_tiles(signal.butter(4, 12.0, fs=RATE_HZ, output="sos"), series, 15)
    assert np.isnan(both[[1, 4]]).all() and np.isfinite(both[[0, 2, 3]]).all()
