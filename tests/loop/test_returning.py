"""Samples after a gap: gradually, at once where one alone was lost, and never hidden from the guard."""

from __future__ import annotations

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits

from rths_cli.clocks import IntArray
from rths_cli.compiled import entry
from rths_cli.loop import returning
from rths_cli.loop.blocks import NUMERICAL, Step, assemble
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.returning import MISSED, Returning
from rths_cli.lti import Array


@entry
def shares(r: Returning, came: IntArray, given: Array) -> None:
    for k in range(came.size):
        if came[k] == 0:
            returning.note_lost(r)
        else:
            given[k] = returning.share_of_measured(r)


@entry
def blended(r: Returning, s: Step, limits: GuardLimits, share: float) -> None:
    returning.blend(r, s, limits, share)


def shares_of(*came: int) -> Array:
    given = np.zeros(len(came))
    shares(returning.returning(rig_info(dt_s=1e-3)), np.array(came), given)
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


@pytest.mark.parametrize("bad", [np.nan, np.inf, 4.999, -4.7])
def test_what_the_guard_must_see_is_not_mixed(bad: float) -> None:
    """Not a number, saturated, or beyond 45 m/s^2 (4.59 V)."""
    info = rig_info(dt_s=1e-3)
    step, r = assemble(best_like(info), NUMERICAL), returning.returning(info)
    limits = open_limits(info)._replace(saturation_v=np.full(3, 4.995))
    r.gap[MISSED] = 3
    step.samples[:] = 1.0, bad, 4.0
    blended(r, step, limits, 0.25)
    assert step.samples[1] == pytest.approx(bad, nan_ok=True)
    assert step.samples[[0, 2]] == pytest.approx([0.25, 1.0])  # at rest, nothing else is expected than 0 V
