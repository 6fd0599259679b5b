"""Fragility: a known truth recovered with the stated errors, another optimiser, what is not determined."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from portfolio import parametrize_first
from scipy.optimize import minimize
from scipy.stats import norm

from rths_cli.analysis.fragility import Fragility, of_capacities, of_stripes
from rths_cli.errors import InputError

THETA, BETA, RECORDS, REPEATS, WANTED = 2.0, 0.4, 20, 200, 184
LEVELS = THETA * np.exp(BETA * np.linspace(-2.0, 2.0, 8))
NONE = np.empty(0)


def the_same_records_in_every_stripe(rng: np.random.Generator) -> Fragility:
    capacity = THETA * np.exp(BETA * rng.standard_normal(RECORDS))
    return of_stripes(LEVELS, (capacity[:, None] < LEVELS).astype(float))


def other_records_in_every_stripe(rng: np.random.Generator) -> Fragility:
    return of_stripes(LEVELS, (rng.random((RECORDS, 8)) < norm.cdf(np.log(LEVELS / THETA) / BETA)).astype(float))


def observed_capacities(rng: np.random.Generator) -> Fragility:
    return of_capacities(THETA * np.exp(BETA * rng.standard_normal(RECORDS)), NONE)


def capacities_known_up_to_a_level(rng: np.random.Generator) -> Fragility:
    capacity, top = THETA * np.exp(BETA * rng.standard_normal(RECORDS)), 1.2 * THETA
    return of_capacities(capacity[capacity <= top], np.full(int((capacity > top).sum()), top))


@parametrize_first(
    0,
    "fitted",
    [
        the_same_records_in_every_stripe, other_records_in_every_stripe, observed_capacities,
        capacities_known_up_to_a_level,
    ],
)  # fmt: skip
def test_truth_is_within_two_standard_errors(fitted: Callable[[np.random.Generator], Fragility]) -> None:
    rng = np.random.default_rng(7)
    found = [fitted(rng) for _ in range(REPEATS)]
    errors = np.array([one.errors for one in found])
    off = np.abs(np.log([(one.theta / THETA, one.beta / BETA) for one in found]))
    assert np.all((off <= 2.0 * errors).sum(axis=0) >= WANTED)
    assert np.all((off <= 1.0 * errors).sum(axis=0) <= 0.8 * REPEATS)  # not by errors that are too large


def test_the_stripes_have_the_greatest_likelihood() -> None:
    rng = np.random.default_rng(3)
    exceeded = (rng.random((12, 6)) < norm.cdf(np.log(LEVELS[1:7] / THETA) / BETA)).astype(float)
    exceeded[[0, 5], [1, 4]] = np.nan  # as where the check refuses a point

    def negative(p: np.ndarray) -> float:
        chance = norm.cdf((np.log(LEVELS[1:7]) - p[0]) / np.exp(p[1]))
        return -float(
            np.nansum(np.where(exceeded == 1, np.log(chance), np.where(exceeded == 0, np.log1p(-chance), np.nan)))
        )

    best = minimize(negative, [np.log(1.5), np.log(0.5)], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    found = of_stripes(LEVELS[1:7], exceeded)
    assert np.log([found.theta, found.beta]) == pytest.approx(best.x, abs=1e-6)


def test_capacities_give_median_and_deviation_of_their_logarithms() -> None:
    found = of_capacities(np.exp([0.0, 0.1, 0.5, 0.6]), NONE)
    assert found.theta == pytest.approx(np.exp(0.3)) and found.beta == pytest.approx(np.sqrt(0.26 / 3.0))
    assert found.errors[0] == pytest.approx(found.beta / 2.0, rel=1e-4)
    middle, low, high = (float(one[0]) for one in found.probability(np.array([found.theta])))
    assert middle == 0.5 and (low, high) == pytest.approx(norm.cdf([-1.96 / 2.0, 1.96 / 2.0]), rel=1e-3)


@pytest.mark.parametrize(
    ("exceeded", "told"),
    [
        ([[0, 0, 0]] * 5, "no record exceeds the limit up to 3; raise the levels"),
        ([[1, 1, 1]] * 5, "every record exceeds the limit from 1 on; lower the levels"),
        ([[0, 0, 1]] * 5, "fewer than two levels lie between no and every exceedance, 2 to 3"),
        ([[0, np.nan, 1], [0, np.nan, 1], [0, 1, 1], [1, 0, 1], [0, 0, 1]], "2 of 5 points at 2 are missing"),
        ([[0, 1, 1], [1, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 1]], "do not become more frequent"),
        ([[0, 1, 1], [0, 1, 1], [0, 0, 1], [0, 0, 1], [1, 0, 1]], "the fit hangs on a single record"),
        ([[0, 1, 1], [0, 0, 1]], "2 records are too few"),
    ],
)  # fmt: skip
def test_what_is_not_determined_is_not_stated(exceeded: list[list[float]], told: str) -> None:
    with pytest.raises(InputError, match=told):
        of_stripes(np.array([1.0, 2.0, 3.0]), np.array(exceeded, dtype=float))


def test_a_fifth_of_the_records_may_be_missing() -> None:
    capacity = np.exp(np.linspace(0.0, 1.0, 8))
    assert of_capacities(capacity, np.array([1.0, 1.1]), missing=2).theta > of_capacities(capacity, NONE).theta
    with pytest.raises(InputError, match="3 of 10 records were refused or stopped before the limit"):
        of_capacities(capacity, np.array([1.0, 1.1]), missing=3)
