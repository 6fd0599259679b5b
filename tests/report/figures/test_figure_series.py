"""Thinned series keep every peak at its instant; stretches for a closer look are where they should be."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rths_cli.report.figures.figure_data import busiest, known_part, points_of_lines, quietest, thinned, window_at


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 5000), st.integers(40, 900), st.integers(0, 1000), st.sampled_from(["noise", "sine", "steps"]))
def test_thinned_keeps_extremes_within_a_stretch(n, points, seed, kind):
    generator = np.random.default_rng(seed)
    time = np.cumsum(0.5 + generator.random(n))
    values = {
        "noise": generator.normal(size=n),
        "sine": np.sin(np.arange(n) / 37.0 + seed),
        "steps": np.round(np.sin(np.arange(n) / 90.0) * 3.0),
    }[kind]
    few_time, few = thinned(time, values, points)
    assert few.size <= max(points, 1) and (n > points or np.array_equal(few, values))
    places = np.searchsorted(time, few_time)
    assert np.array_equal(time[places], few_time) and np.array_equal(values[places], few)
    assert np.all(np.diff(few_time) > 0.0)
    assert (few.max(), few.min()) == (values.max(), values.min())
    stretch = -(-(n - 1) // (points // 2)) if n > points else 1
    for start in generator.integers(0, n, 20):
        inside = slice(start, start + stretch)
        near = few[(places >= start - stretch) & (places < start + 2 * stretch)]
        assert near.size and near.max() >= values[inside].max() and near.min() <= values[inside].min()


def test_a_smooth_series_uses_all_its_points():
    time = np.arange(10_000) / 2000.0
    assert 300 < thinned(time, np.sin(2.0 * time), 400)[1].size <= 400


def test_thinned_breaks_where_nothing_is_known():
    time, values = np.arange(9000.0), np.sin(np.arange(9000.0))
    values[3000:6000] = np.nan
    few_time, few = thinned(time, values, 300)
    unknown = few_time[np.isnan(few)]
    assert unknown.size and unknown.min() >= 3000.0 and unknown.max() < 6000.0
    assert np.nanmax(few) == np.nanmax(values)
    values[:] = np.nan
    assert np.isnan(thinned(time, values, 300)[1]).all()


def test_points_follow_the_weights_within_bounds():
    assert points_of_lines([2.0, 1.0, 1.0] * 10)[:3] == [375, 187, 187]
    assert points_of_lines([1.0]) == [2000]
    assert points_of_lines([1.0] * 1000)[0] == 40


@pytest.mark.parametrize(("peak", "first", "last"), [(500, 350, 650), (10, 0, 300), (1990, 1699, 1999)])
def test_busiest_is_around_the_peak_and_inside_the_record(peak, first, last):
    time, values = np.arange(2000) / 100.0, np.zeros(2000)
    values[peak] = -1.0
    part = busiest(time, values, 3.0)
    assert (part.start, part.stop) == (first, last + 1)


def test_quietest_is_where_the_sum_of_squares_is_least():
    values = np.random.default_rng(5).normal(size=2000)
    values[100], values[1200:1300] = 9.0, 0.1 * values[1200:1300]
    part = quietest(np.arange(2000) / 100.0, values, 1.0)
    sums = [np.sum(values[k : k + 100] ** 2) for k in range(100, 1899)]
    assert part == slice(100 + int(np.argmin(sums)), 100 + int(np.argmin(sums)) + 101) and 1195 < part.start < 1205


def test_short_records_are_shown_whole():
    time = np.arange(30) / 100.0
    assert window_at(time, 0.1, 3.0) == slice(0, 30)
    part = quietest(time, np.ones(30), 1.0)
    assert 0 <= part.start < part.stop <= 30


def test_known_part_ends_before_the_first_unknown():
    assert known_part(np.array([1.0, 2.0, np.nan, 3.0])) == 2
    assert known_part(np.array([1.0, np.inf])) == 1
    assert known_part(np.ones(4)) == 4
