"""Oracle: a sum of sines within a smooth pulse, evaluated at the instants at which a recorder takes its samples."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from portfolio import parametrize_first

from rths_cli.analysis.recording_alignment import Alignment, align, moved_to_record

Array = NDArray[np.float64]
DT_S, LENGTH_S = 0.001, 24.0
RECORD_S = np.arange(0.0, LENGTH_S, DT_S)
RNG = np.random.default_rng(11)
HZ, SIZE, PHASE = np.geomspace(0.4, 14.0, 40), RNG.uniform(0.3, 1.0, 40), RNG.uniform(0.0, 6.28, 40)


def motion(time_s: Array, hz: Array = HZ) -> Array:
    inside = np.clip(time_s / LENGTH_S, 0.0, 1.0)
    waves = sum(a * np.sin(2.0 * np.pi * f * time_s + p) for a, f, p in zip(SIZE, hz, PHASE, strict=True))
    return np.asarray(waves * np.sin(np.pi * inside) ** 2)


RECORD = motion(RECORD_S)


def recorded(offset: float, step: float, samples: int) -> Array:
    """Return a recording whose sample k lies at sample `offset + step * k` of the record."""
    return motion((offset + step * np.arange(samples)) * DT_S)


def found(series: Array, stated: float = 1.0) -> Alignment:
    one = align(series, RECORD, stated, DT_S)
    assert one is not None
    return one


@pytest.mark.campaign
@parametrize_first(
    3,
    ("offset", "step", "stated"),
    [
        (0.0, 1.0, 1.0),
        (-731.0, 1.0, 1.0),
        (-300.37, 1.0, 1.0),
        (-40.5, 1.0 - 20e-6, 1.0),
        (-100.0, 1.0, 1.03),
        (-100.25, 1.0 + 8e-6, 0.97),
        (12.5, 1.0, 1.0),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_offset_and_rate_are_found_everywhere_within_a_hundredth_of_a_sample(
    offset: float, step: float, stated: float, sign: float
) -> None:
    samples = RECORD.size + 900
    one = found(sign * 0.7 * recorded(offset, step, samples), stated)
    ends = np.array([0.0, samples])
    assert_allclose(one.offset + one.step * ends, offset + step * ends, atol=0.01)
    assert one.gain == pytest.approx(sign * 0.7, rel=1e-4) and not one.lost and one.worst < 0.01
    assert one.whole(samples) == (offset if step == 1.0 and offset % 1.0 == 0.0 else None)
    moved = moved_to_record(recorded(offset, step, samples)[None], one, RECORD.size)[0]
    known = np.isfinite(moved)
    assert known.sum() >= RECORD.size - 14
    assert_allclose(moved[known], RECORD[known], atol=2e-4 * np.abs(RECORD).max())


def test_a_recording_of_the_record_itself_is_not_touched() -> None:
    one = found(RECORD.copy())
    assert one.whole(RECORD.size) == 0 and one.residual < 1e-9
    assert np.array_equal(moved_to_record(RECORD[None], one, RECORD.size)[0], RECORD)


@pytest.mark.parametrize(("at", "lost"), [(9000, 150), (15000, 7), (8000, -60)])
def test_a_block_that_was_lost_or_repeated_is_placed(at: int, lost: int) -> None:
    series = np.concatenate([np.zeros(333), RECORD[:at], RECORD[at + lost :]])
    one = found(series)
    (block,) = one.lost
    assert block.samples == lost and abs(block.before - (333 + at - 1)) <= 20 and abs(block.at - at) <= 20


def test_a_gap_that_the_file_states_is_no_lost_block() -> None:
    series = RECORD.copy()
    series[9000:9400] = np.nan
    one = found(series)
    assert not one.lost and abs(one.offset) < 1e-6
    assert np.isnan(moved_to_record(series[None], one, RECORD.size)[0]).sum() == 400


def test_another_motion_is_not_placed_and_the_uncertainty_covers_noise() -> None:
    other = align(motion(RECORD_S, HZ[::-1] * 1.13 + 0.2), RECORD, 1.0, DT_S)
    assert other is None or not np.isfinite(other.gain) or abs(other.correlation) < 0.9
    assert align(np.zeros(5000), RECORD, 1.0, DT_S) is None
    series = recorded(-200.3, 1.0 - 30e-6, RECORD.size + 500)
    noisy = found(series + 0.05 * series.std() * RNG.normal(size=series.size))
    assert abs(noisy.offset + 200.3) < 4.0 * noisy.offset_error + 1e-3 < 0.5
    assert abs(noisy.step - 1.0 + 30e-6) < 4.0 * noisy.step_error + 1e-7


def test_a_clock_that_is_not_even_is_told() -> None:
    one_less = found(np.delete(RECORD, 12000))
    assert one_less.worst > 0.1 or one_less.lost
    bent = motion(RECORD_S + 4e-4 * np.sin(2.0 * np.pi * RECORD_S / LENGTH_S))
    assert found(bent).worst > 0.1
