"""Peaks are kept, whatever the width; what is packed is read back by another decoder."""

from __future__ import annotations

import numpy as np
import page_reader
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rths_cli.report.figures.figure_data import Pool, envelope, kept, pack, pack_floats, thinned_envelope, width_of

VALUES = st.floats(-1e3, 1e3, allow_nan=False) | st.just(float("nan"))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(arrays(float, st.integers(1, 200), elements=VALUES), st.integers(2, 40))
def test_every_bucket_keeps_its_extremes(values: np.ndarray, width: int) -> None:
    index = kept(values, width)
    assert list(index) == sorted(set(index))
    assert {0, values.size - 1} <= set(index)
    for start in range(0, values.size, width):
        bucket = [v for v in values[start : start + width] if v == v]
        shown = [values[i] for i in index if start <= i < start + width and values[i] == values[i]]
        assert (min(shown), max(shown)) == (min(bucket), max(bucket)) if bucket else not shown


def test_a_short_series_is_kept_whole() -> None:
    values = np.random.default_rng(0).standard_normal(500)
    found = envelope(values, 0.0, 0.001, width_of(500))
    assert np.array_equal(found.value, values)


def test_a_cut_stays_a_cut() -> None:
    values = np.sin(np.arange(1000.0))
    values[400:] = np.nan
    found = envelope(values, 0.0, 0.001, 20)
    assert np.isnan(found.value[found.index >= 400]).sum() >= 30
    assert not np.isnan(found.value[found.index < 400]).any()


@pytest.mark.parametrize("factor", [2, 4])
def test_thinning_an_envelope_is_the_envelope_of_the_series(factor: int) -> None:
    values = np.random.default_rng(1).standard_normal(9_999)
    fine = envelope(values, 0.0, 0.001, 10)
    assert np.array_equal(thinned_envelope(fine, 10 * factor).index, kept(values, 10 * factor))


@pytest.mark.parametrize("samples", [0, 1, 2, 3, 1001, 2_000_000])
def test_what_is_packed_is_read_back(samples: int) -> None:
    values = np.random.default_rng(2).standard_normal(samples)
    found = envelope(values, 0.0, 0.001, width_of(samples))
    places, read = page_reader.series(pack(found))
    peak = np.abs(values).max(initial=0.0)
    assert places == list(found.index)
    assert np.abs(np.array(read) - values[found.index]).max(initial=0.0) <= peak / 65534 * (1 + 1e-9)
    assert np.abs(read).max(initial=0.0) == pytest.approx(peak, rel=1e-15)


def test_far_places_and_lost_samples_are_read_back() -> None:
    values = np.full(200_000, np.nan)
    values[:3], values[150_000:] = [1.0, -2.0, 0.5], 0.25
    found = envelope(values, 0.0, 0.001, 70_000)
    packed = pack(found)
    places, read = page_reader.series(packed)
    assert packed["w"] == 4 and places == list(found.index)
    assert np.array_equal(np.isnan(read), np.isnan(values[places]))


def test_a_series_that_ran_away_is_still_told_where_it_is_small() -> None:
    values = np.exp(np.linspace(0.0, 20.0, 4000))
    found = envelope(values, 0.0, 0.001, 2)
    assert page_reader.series(pack(found))[1] == pytest.approx(list(values), rel=1e-6)


def test_floats_are_read_back() -> None:
    assert page_reader.floats(pack_floats(np.array([1.5, -2.25, 1e-3]))) == pytest.approx([1.5, -2.25, 1e-3], rel=1e-7)


def test_the_same_series_stands_once_and_all_fit() -> None:
    pool, random = Pool(), np.random.default_rng(3)
    many = [random.standard_normal(20_000) for _ in range(5)]
    found = [envelope(values, 0.0, 0.001, width_of(20_000)) for values in many]
    assert [pool.add(one) for one in [*found, found[2]]] == [0, 1, 2, 3, 4, 2]
    whole, small = pool.packed(), pool.packed(100_000)
    assert sum(len(str(one["i"])) + len(str(one["y"])) for one in small) <= 100_000
    assert len(small[0]["y"]) < len(whole[0]["y"])  # type: ignore[arg-type]
    for values, packed in zip(many, small, strict=True):
        read = page_reader.series(packed)[1]
        step = np.abs(values).max() / 65534
        assert (min(read), max(read)) == pytest.approx((values.min(), values.max()), abs=step)
