"""Samples after a gap: gradually, at once where one alone was lost, and as they came for the guard."""

from __future__ import annotations

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits
from test_realtime_loop import conducted

from rths_cli.loop import fallback_commands
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.fallback_commands import Returning
from rths_cli.loop.guard import ACCELERATION
from rths_cli.loop.lost_samples import MIXED, NO_ANSWER
from rths_cli.loop.realtime_run import prepare
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step import sense
from rths_cli.loop.step_arrays import NUMERICAL, Step, assemble
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array


@entry
def shares(r: Returning, came: IntArray, given: Array) -> None:
    for k in range(came.size):
        if came[k] == 0:
            fallback_commands.note_lost(r)
        else:
            given[k] = fallback_commands.share_of_measured(r)


@entry
def returned(r: Returning, s: Step, samples: Array, given: Array, heard: Array) -> None:
    """Lose three samples, then take samples (n, c) in V; note what the step is given and what was heard, (n, c)."""
    r, s, samples, given, heard = borrowed((r, s, samples, given, heard))
    for _ in range(3):
        fallback_commands.note_lost(r)
    for k in range(len(samples)):
        for c in range(s.samples.size):
            s.samples[c] = samples[k, c]
        mixed = fallback_commands.give_back(r, s)
        sense(s)
        for c in range(s.samples.size):
            given[k, c] = s.samples[c]
            heard[k, c] = r.accel[c] if mixed else s.corrected[c]


def shares_of(*came: int) -> Array:
    given = np.zeros(len(came))
    shares(fallback_commands.returning(rig_info(dt_s=1e-3)), np.array(came), given)
    return given


@pytest.mark.parametrize(("lost", "over"), [(1, 1), (2, 9), (5, 33), (60, 101)])
def test_the_longer_the_gap_the_slower_samples_come_back(lost: int, over: int) -> None:
    given = shares_of(*[1] * 3, *[0] * lost, *[1] * 120)[3 + lost :]
    assert (np.diff(given) >= 0.0).all() and (given[over - 1 :] == 1.0).all()
    assert (given[: over - 1] < 1.0).all() and given[0] > 0.0


def test_one_lost_in_two_is_not_taken_for_one_long_gap() -> None:
    given = shares_of(*[0, 0, 0, *[1, 0] * 20])
    assert (given[4::2] == 0.0).all()
    assert (np.diff(given[3::2]) >= 0.0).all() and (given[3::2][16:] == 1.0).all()  # over 17 samples, as without


@pytest.mark.parametrize("came_before", [1, 10, 60])
def test_a_sample_that_is_lost_during_the_return_does_not_end_it_at_once(came_before: int) -> None:
    given = shares_of(*[0] * 22, *[1] * came_before, 0, *[1] * 120)
    after = given[23 + came_before :]
    assert after[0] - given[21 + came_before] < 0.03  # no step in what the loop is given
    assert (np.diff(after) >= 0.0).all() and after[-1] == 1.0


def test_a_second_gap_during_the_return_is_returned_from_anew() -> None:
    given = shares_of(*[0] * 10, *[1] * 8, *[0] * 3, *[1] * 120)[21:]
    assert given[0] < 0.01 and (given[72:] == 1.0).all()  # 9 of the 10 are still to be returned from: 65 samples


def test_the_step_is_given_a_mix_and_what_came_is_corrected_as_it_came() -> None:
    """After three lost samples a share grows over 17. The oracle of what came: the correction block on these samples
    alone, the first of them for those before it, too."""
    info = rig_info(dt_s=1e-3)
    blocks = best_like(info)
    step = assemble(blocks, NUMERICAL)
    r = fallback_commands.returning(info)
    came = 0.5 + np.random.default_rng(4).normal(0.0, 0.1, (12, 3))
    given, heard = np.zeros_like(came), np.zeros_like(came)
    returned(r, step, came, given, heard)
    assert np.abs(given[0]).max() < 0.02 * np.abs(came[0]).max()  # at rest, nothing else is expected than 0 V
    assert (np.abs(given[-1]) > 0.6 * np.abs(came[-1])).all()
    oracle = run_block(blocks.correction, np.vstack([came[:1], came[:1], came]).T)[:, 2:].T
    np.testing.assert_allclose(heard, oracle, rtol=1e-9)


def test_a_sample_beyond_its_limit_stops_the_test_however_small_its_share_is() -> None:
    """Two samples after a gap of five, channel 1 shows 46 m/s^2; the step is given a hundredth of it."""
    info = rig_info(dt_s=1e-3)
    samples, lost = np.zeros((40, 3)), np.zeros(40, dtype=np.int64)
    lost[20:25], samples[26, 1] = NO_ANSWER, 46.0 * info.channels[1].sensitivity_v_per_unit
    limits = open_limits(info)._replace(abort=np.full(3, 45.0), acceleration_m_s2=45.0, stroke_m=0.1)
    limits = limits._replace(velocity_m_s=1.0, command_v=10.0)
    run = prepare(info, best_like(info), NUMERICAL, np.zeros((100, 3)), limits)
    whole = (run.course, run.step, run.limits, run.guard, run.drive, run.log)
    for k in range(lost.size):
        conducted(*whole, samples[k], int(lost[k]), k)
        run.log.done[0] = k + 1
    named = signals(run.log, sizes_of(run.step))
    assert tuple(run.guard.flags[1:]) == (ACCELERATION, 1, 26)
    np.testing.assert_array_equal(named.lost[18:40], [0.0] * 2 + [NO_ANSWER] * 5 + [MIXED] * 15)
    assert abs(named.corrected[1, 26]) < 1.0
    assert named.samples_v[1, 26] == samples[26, 1]
