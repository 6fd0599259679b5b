"""Statistics against numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from rths_cli.report.group_comparison import statistics, student

SAME = 1e-9  # scipy 1.13 errs by 1e-10


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 7, 10, 31, 100, 999])
def test_student_is_that_of_scipy(freedom: int) -> None:
    assert student(freedom) == pytest.approx(scipy.stats.t.ppf(0.975, freedom), rel=SAME)


@pytest.mark.parametrize("n", [2, 3, 8, 30])
def test_mean_spread_and_interval(n: int) -> None:
    values = np.random.default_rng(n).normal(3.0, 0.5, n)
    found = statistics(values.tolist())
    low, high = scipy.stats.t.interval(0.95, n - 1, loc=values.mean(), scale=scipy.stats.sem(values))
    expected = (n, values.mean(), values.std(ddof=1), values.min(), values.max(), low, high)
    told = (found.n, found.mean, found.std, found.minimum, found.maximum, found.low, found.high)
    assert told == pytest.approx(expected, rel=SAME)


def test_one_run_has_no_spread() -> None:
    found = statistics([0.25])
    assert (found.n, found.mean, found.minimum, found.maximum) == (1, 0.25, 0.25, 0.25)
    assert np.isnan([found.std, found.low, found.high]).all()
