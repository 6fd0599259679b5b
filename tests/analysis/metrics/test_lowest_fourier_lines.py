"""Oracle: the whole transform of the zero-padded series."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.metrics import low_lines


@pytest.mark.parametrize("n", [1, 2, 64, 997, 1995])
@pytest.mark.parametrize("share", [2, 3, 8, 9, 40])
@pytest.mark.parametrize("padded", [1.0, 1.37, 4.0])
def test_low_lines_are_those_of_the_whole_transform(n: int, share: int, padded: float) -> None:
    """Whatever the length's factors, thinned (from an eighth of the lines down) or not."""
    series, period = np.random.default_rng(n).standard_normal(n), int(padded * n)
    count = period // share + 1
    exact = np.fft.rfft(series, period)[:count]
    assert np.abs(low_lines(series, count, period) - exact).max() < 3e-14 * np.abs(series).sum()


def test_what_lies_far_above_the_lines_does_not_leak_into_them() -> None:
    """A strong sine anywhere above, the alias of each line included, leaves lines 1e12 times weaker as they are."""
    n, count = 6007, 101
    time = np.arange(n) / n
    for line in (count + 20, 14 * 101, n // 14 - 50, n // 14, n // 14 + 50, n // 2 - 3):
        strong = np.cos(2 * np.pi * line * time)
        assert np.abs(low_lines(strong, count, n)).max() < 1e-13 * n


def test_rows_are_transformed_each_for_itself() -> None:
    rows = np.random.default_rng(5).standard_normal((2, 3, 1200))
    rows[1, 2, 7] = np.nan
    found = low_lines(rows, 20, 1500)
    assert found.shape == (2, 3, 20)
    assert np.array_equal(found[0, 1], low_lines(rows[0, 1], 20, 1500))
    assert np.isfinite(found).all(axis=-1).tolist() == [[True, True, True], [True, True, False]]
    assert low_lines(rows[0, :0], 20, 1500).shape == (0, 20)
