"""The interval of a metric: the range over equally likely samples, and how often such a range holds a further one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rths_cli.quantities import Interval, intervals_of, over_samples


def test_the_range_holds_every_sample_and_the_value_stays() -> None:
    found = over_samples({"a": 2.0, "b": np.array([1.0, 5.0])}, [{"a": 3.0, "b": [0.5, 6.0]}, {"a": 1.5, "b": [2, 4]}])
    a, b = found["a"], found["b"]
    assert isinstance(a, Interval) and isinstance(b, Interval)
    assert (a.value, a.low, a.high) == (2.0, 1.5, 3.0)
    np.testing.assert_array_equal([b.value, b.low, b.high], [[1.0, 5.0], [0.5, 4.0], [2.0, 6.0]])
    assert a.probability == b.probability == pytest.approx(1.0 / 3.0)
    assert intervals_of(found | {"c": 1.0}) == {"a": a, "b": b}


def test_an_interval_is_its_value_where_an_array_is_asked_for() -> None:
    found = Interval(np.array([1.0, 2.0]), np.zeros(2), np.full(2, 3.0), 0.9)
    assert np.size(found) == 2 and np.ndim(found) == 1
    np.testing.assert_array_equal(np.asarray(found, dtype=float), [1.0, 2.0])


def test_a_value_that_all_samples_share_stays_as_it_is() -> None:
    values = {"limit": 0.1, "none": math.nan, "storeys": np.array([1.0, math.nan])}
    found = over_samples(values, [dict(values), dict(values)])
    assert all(found[path] is values[path] for path in values)
    assert over_samples(values, []) == values


def test_what_is_not_known_of_a_sample_is_not_known_of_the_range() -> None:
    found = over_samples({"a": 1.0, "b": 1.0}, [{"a": math.nan, "b": math.inf}])
    assert math.isnan(found["a"].low) and math.isnan(found["a"].high)
    assert (found["b"].low, found["b"].high) == (1.0, math.inf)


@pytest.mark.parametrize("count", [2, 9, 39])
def test_the_stated_probability_is_how_often_the_range_of_samples_holds_one_more(count: int) -> None:
    """Skewed numbers, and a value that is the least likely of all: the range without it is the shortest."""
    drawn = np.random.default_rng(7).lognormal(size=(20_000, count + 1))
    samples, further = drawn[:, :-1], drawn[:, -1]
    held = np.mean((samples.min(axis=1) <= further) & (further <= samples.max(axis=1)))
    stated = over_samples({"a": samples[0, 0]}, [{"a": value} for value in samples[0]])["a"].probability
    assert held == pytest.approx(stated, abs=0.01)
