"""Samples against what is known of them: strata, quantiles, rank correlations, and the same seed twice."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from rths_cli.case.study_schema import LognormalAxis, Method, NormalAxis, Strict, TruncatedNormalAxis, UniformAxis
from rths_cli.errors import InputError
from rths_cli.studies.study_plan import chosen, correlated, normal_correlation, quantiles, unit_samples


@pytest.mark.parametrize(("method", "count"), [("latin_hypercube", 100), ("sobol", 128)])
def test_each_axis_has_one_sample_in_each_of_as_many_strata(method: Method, count: int) -> None:
    samples = unit_samples(method, count, 5, seed=3)
    assert samples.shape == (count, 5)
    for column in samples.T:
        assert sorted((column * count).astype(int)) == list(range(count))


@pytest.mark.parametrize("method", ["latin_hypercube", "sobol", "sobol_indices"])
def test_the_seed_alone_decides(method: Method) -> None:
    one, same, other = (unit_samples(method, 64, 3, seed) for seed in (5, 5, 6))
    assert one.tobytes() == same.tobytes() and not np.any(one == other)


def test_the_rows_of_sobol_indices_take_one_axis_at_a_time_from_the_second_sample() -> None:
    rows = unit_samples("sobol_indices", 16, 3, seed=0)
    assert rows.shape == (16 * 5, 3)
    first, *mixed, second = rows.reshape(16, 5, 3).transpose(1, 0, 2)
    assert not np.any(first == second)
    for axis, block in enumerate(mixed):
        assert np.array_equal(block[:, axis], second[:, axis])
        others = [k for k in range(3) if k != axis]
        assert np.array_equal(block[:, others], first[:, others])


@pytest.mark.parametrize(
    ("of", "shares", "wanted"),
    [
        (NormalAxis(distribution="normal", mean=2, std=3), [0.5, 0.841344746], [2.0, 5.0]),
        (LognormalAxis(distribution="lognormal", median=2, cov=0.5), [0.5], [2.0]),
        (UniformAxis(distribution="uniform", low=-1, high=3), [0.25, 1.0], [0.0, 3.0]),
        (
            TruncatedNormalAxis(distribution="truncated_normal", mean=1, std=1, low=0, high=2),
            [0.0, 0.5, 1.0],
            [0.0, 1.0, 2.0],
        ),
    ],
)
def test_quantiles(of: Strict, shares: list[float], wanted: list[float]) -> None:
    assert quantiles(of, np.array(shares)) == pytest.approx(wanted, rel=1e-8, abs=1e-12)


def test_a_lognormal_sample_has_its_coefficient_of_variation() -> None:
    axis = LognormalAxis(distribution="lognormal", median=3.0, cov=0.4)
    values = quantiles(axis, unit_samples("sobol", 1 << 14, 1, seed=1)[:, 0])
    assert np.median(values) == pytest.approx(3.0, rel=1e-3)
    assert np.std(values) / np.mean(values) == pytest.approx(0.4, rel=5e-3)
    assert np.mean(values) == pytest.approx(3.0 * np.sqrt(1 + 0.4**2), rel=2e-3)  # of a lognormal variable


def test_rank_correlations_are_those_asked_for_and_the_distributions_stay() -> None:
    samples = unit_samples("sobol", 1 << 14, 3, seed=2)
    pairs = {(0, 1): normal_correlation(0.7), (1, 2): normal_correlation(-0.4)}
    mixed = correlated(samples, pairs)
    found = stats.spearmanr(mixed).statistic
    assert found[0, 1] == pytest.approx(0.7, abs=0.01)
    assert found[1, 2] == pytest.approx(-0.4, abs=0.01)
    assert found[0, 2] == pytest.approx(0.0, abs=0.01)
    assert max(stats.kstest(column, "uniform").statistic for column in mixed.T) < 0.005
    assert mixed.min() > 0 and mixed.max() < 1


def test_correlations_that_no_variables_have_are_refused() -> None:
    with pytest.raises(InputError, match=r"smallest eigenvalue of the matrix is -0\.8"):
        correlated(unit_samples("latin_hypercube", 4, 3, 0), {(0, 1): 0.9, (0, 2): 0.9, (1, 2): -0.9})


def test_observed_values_are_each_as_likely() -> None:
    assert chosen(4, np.array([0.0, 0.24, 0.25, 0.74, 0.9999999999, 1.0])).tolist() == [0, 0, 1, 2, 3, 3]
