"""What a fit may use of a record: series made up of what is known."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.error_budget import (
    FADE_PERIODS,
    MARGIN_PERIODS,
    at_full_rate,
    bursts,
    inside,
    mended,
    scatter,
    weighted_in_time,
)
from rths_cli.analysis.fourier_lines import Lines, lines_for

DT_S = 1e-3
LINES = lines_for(8000, DT_S, 2.0)
TIME_S = DT_S * np.arange(8000)


def hump(hz: float) -> np.ndarray:
    """Return a series that begins and ends at zero, smoothly."""
    return np.sin(2 * np.pi * hz * TIME_S) * np.sin(np.pi * TIME_S / 8.0) ** 4


def gaps(*ranges: tuple[int, int]) -> np.ndarray:
    lost = np.zeros(8000, dtype=bool)
    for first, last in ranges:
        lost[first:last] = True
    return lost


def test_lines_come_back_as_series_at_the_records_own_rate() -> None:
    assert np.abs(at_full_rate(LINES, LINES.of(hump(3.0))) - hump(3.0)).max() < 1e-9


@pytest.mark.parametrize("width", [1, 21])
def test_lost_samples_follow_the_prediction_and_join_their_neighbours(width: int) -> None:
    truth, lost = hump(3.0), gaps((100, 104), (4000, 4030), (7990, 8000))
    predicted = 0.98 * truth + 0.2 + 0.01 * TIME_S  # wrong by a little, slowly
    seen = np.where(lost, 99.0, truth)
    found = mended(np.vstack([seen, seen]), np.vstack([predicted, predicted]), lost, width)
    assert np.array_equal(found[:, ~lost], np.vstack([truth, truth])[:, ~lost])
    assert np.abs(found - truth).max() < 0.02 * 0.3 + 1e-3  # what the prediction misses changes by less than that


def test_a_burst_is_what_stands_near_a_gap_beyond_a_straight_line() -> None:
    lost = gaps((4000, 4010))
    calm = 0.5 * hump(0.3)
    extra = np.exp(-0.5 * ((TIME_S - 4.005) / 0.01) ** 2)
    found = at_full_rate(LINES, bursts(LINES, LINES.of(calm + extra), lost))
    near = np.abs(TIME_S - 4.005) < 0.03
    assert np.abs(found - extra)[near].max() < 0.06
    assert np.abs(found[np.abs(TIME_S - 4.005) > 0.15]).max() < 0.02


def test_the_record_fades_out_before_its_end() -> None:
    weight, time_s = inside(LINES), LINES.reduced_dt_s * np.arange(inside(LINES).size)
    assert weight[time_s < 8.0 - (MARGIN_PERIODS + FADE_PERIODS) / LINES.highest_hz].min() == 1.0
    assert weight[time_s > 8.0 - MARGIN_PERIODS / LINES.highest_hz].max() == 0.0
    found = at_full_rate(LINES, weighted_in_time(LINES, LINES.of(hump(3.0)), weight))
    assert found[2000] == pytest.approx(hump(3.0)[2000], abs=1e-6)
    assert np.abs(found[-20:]).max() < 1e-3


def test_the_scatter_is_that_of_fits_to_other_noise() -> None:
    """Known factors with noise, again and again: the mean uncertainty is the spread of what is found."""
    lines, random = Lines(8000, 16000, DT_S), np.random.default_rng(1)
    rows = np.vstack([lines.of(hump(3.0)), lines.of(hump(5.0))])
    shapes = lines.series(rows)
    found, told = [], []
    for _ in range(60):
        noisy = rows.T @ [2.0, -1.0] + lines.of(random.normal(0.0, 0.3, 8000))
        found.append(np.linalg.lstsq(shapes.T, lines.series(noisy), rcond=None)[0])
        told.append(scatter(lines, rows, noisy))
    assert np.mean(found, axis=0) == pytest.approx([2.0, -1.0], abs=4e-3)
    assert np.mean(told, axis=0) == pytest.approx(np.std(found, axis=0), rel=0.35)
