"""Errors of many pairs at once against scipy's filter on each difference; room used again, a pair that is cut."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from rths_cli.analysis.metrics import error_figures, figures_of_pairs, room_for_pairs

DT_S = 1 / 500


def pairs(count: int, samples: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    random = np.random.default_rng(seed)
    return [(10.0 * random.standard_normal(samples), random.standard_normal(samples) + k) for k in range(count)]


@pytest.mark.parametrize("count", [1, 3, 4, 5, 8])
@pytest.mark.parametrize("samples", [2, 16, 257, 1000])
def test_each_pair_has_the_figures_of_its_difference(count: int, samples: int) -> None:
    given = pairs(count, samples, seed=count)
    found = figures_of_pairs(given, DT_S)
    errors = np.array([reference - value for reference, value in given])
    sections = butter(4, 12.0, fs=1 / DT_S, output="sos")
    banded = sosfiltfilt(sections, errors, padlen=min(15, samples - 1))
    for figure, series in ((found.rms, banded), (found.rms_full, errors)):
        assert figure == pytest.approx(np.sqrt(np.mean(series**2, axis=1)), rel=1e-12)
    for figure, series in ((found.maximum, banded), (found.maximum_full, errors)):
        assert figure == pytest.approx(np.abs(series).max(axis=1), rel=1e-12)
    assert found.maximum_full.tobytes() == np.abs(errors).max(axis=1).tobytes()
    assert not found.diverged.any()


def test_room_is_used_again_and_leaves_nothing_behind() -> None:
    room = room_for_pairs(3, 400)
    figures_of_pairs([(np.full(400, np.nan), np.ones(400))] * 3, DT_S, room)
    given = pairs(3, 400, seed=7)
    again, alone = figures_of_pairs(given, DT_S, room), figures_of_pairs(given, DT_S)
    for name in ("rms", "maximum", "rms_full", "maximum_full"):
        assert getattr(again, name).tobytes() == getattr(alone, name).tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_pair_that_is_cut_has_no_figures_and_the_others_have_theirs(value: float) -> None:
    given = pairs(5, 300, seed=1)
    whole = figures_of_pairs(given, DT_S)
    given[1][1][299] = value
    found = figures_of_pairs(given, DT_S)
    assert found.diverged.tolist() == [False, True, False, False, False]
    for name in ("rms", "maximum", "rms_full", "maximum_full"):
        figure = getattr(found, name)
        assert np.isnan(figure[1])
        assert np.delete(figure, 1).tobytes() == np.delete(getattr(whole, name), 1).tobytes()


def test_many_axes_are_the_same_pairs() -> None:
    given = pairs(6, 300, seed=2)
    reference, value = (np.array([pair[k] for pair in given]).reshape(2, 3, 300) for k in (0, 1))
    figures, flat = error_figures(reference, value, DT_S), figures_of_pairs(given, DT_S)
    assert figures.rms.shape == figures.diverged.shape == (2, 3)
    assert figures.rms.tobytes() == flat.rms.tobytes()
    assert np.ndim(error_figures(reference[0, 0], value[0, 0], DT_S).rms) == 0
