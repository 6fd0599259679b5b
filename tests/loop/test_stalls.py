"""What a stall of the runner costs, in simulated time: little, as long as the rig knows the commands to come."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from disturbed_runs import Disturbed
from stalling import MEMORY, Laboratory, laboratory_of, logged

from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.one_table_run import HYBRID_TEST, plan_run
from rths_cli.loop.fallback_commands import OFF_V
from rths_cli.loop.guard import END, STOPPED, GuardLimits
from rths_cli.loop.realtime_run import Performance
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.lti import Array

pytestmark = pytest.mark.campaign

RECORD = 20_000  # samples: 20 s of El Centro, its strong part
STALLED_AT = 1000 + np.array([2_113, 4_871, 7_490, 11_006])  # after the ramp


@pytest.fixture(scope="module")
def laboratory() -> Laboratory:
    return laboratory_of(RECORD)


@pytest.fixture(scope="module")
def calm(laboratory: Laboratory) -> Performance:
    return laboratory.run(STALLED_AT, 0)[0]


@pytest.mark.parametrize("length", [1, 7, 18, 30, 50])
def test_a_stall_within_the_time_foreseen_costs_next_to_no_accuracy(
    laboratory: Laboratory, calm: Performance, length: int
) -> None:
    run, apart = laboratory.run(STALLED_AT, length)
    assert (logged(run).lost == 2).sum() == length * len(STALLED_AT) and apart == 0.0
    ratio = laboratory.errors(run) / laboratory.errors(calm)
    assert ratio.max() < 1.3, ratio


def test_a_rig_that_is_told_nothing_holds_and_that_shakes_the_building(
    laboratory: Laboratory, calm: Performance
) -> None:
    run, apart = laboratory.run(STALLED_AT, 18, told=False)
    assert apart == 0.0 and (laboratory.errors(run) / laboratory.errors(calm)).min() > 5.0


def test_in_a_stall_longer_than_what_was_told_the_rig_stops_and_comes_back_within_the_limits(
    laboratory: Laboratory, calm: Performance
) -> None:
    """It slows down as hard as the guard brakes, and half as hard again between points.

    Without a stall the command never bends that hard, its rounding and the sensors' noise in the feedback included.
    """
    run, apart = laboratory.run(STALLED_AT, 150)
    limits, here = run.limits, slice(0, run.course.ramp + RECORD)
    metres = limits.gain_m_per_v * np.array([logged(one).command_v[here] for one in (run, calm)])
    jolts = np.abs(np.diff(metres, 2)) / limits.dt_s**2
    for at in STALLED_AT:
        assert jolts[0, at : at + 148].max() < 1.5 * 0.45 * limits.acceleration_m_s2
        assert (metres[0, at + 115 : at + 150] == metres[0, at + 115]).all()
    assert np.abs(np.diff(metres)).max() / limits.dt_s < limits.velocity_m_s
    assert apart == 0.0 and run.guard.flags[1] == END
    assert np.sort(np.abs(metres[0] - metres[1])[STALLED_AT + 149])[1] > 1e-4  # there was a way to come back
    assert run.course.drift[OFF_V] == 0.0 and jolts[1].max() < 0.45 * limits.acceleration_m_s2


@dataclass(frozen=True)
class Coasting(Laboratory):
    """A laboratory on the plain link: the table goes on by the last step while no command comes."""

    limits: GuardLimits

    def run(self, at: IntArray, length: int, *_: object, **__: object) -> tuple[Performance, Array]:  # type: ignore[override]
        """Return the run under the guard of the planned motion, and what the table was given."""
        run, apart = Laboratory.run(self, at, length, told=False, limits=self.limits, coasts=True)
        assert apart == 0.0
        return run, logged(run).command_v


@pytest.fixture(scope="module")
def coasting(laboratory: Laboratory) -> Coasting:
    setup = laboratory.setup
    found = verdict_on(setup, MEMORY.at_rest(setup, lambda _: None), table_test=False)
    assert found.design is not None
    limits = plan_run(setup, found.design, HYBRID_TEST, planned=found.planned[HYBRID_TEST.name]).limits
    return Coasting(setup, found.design, laboratory.served, RECORD, limits)


@pytest.mark.parametrize("length", [1, 2, 5])
def test_on_the_plain_link_a_run_that_misses_some_intervals_goes_on_within_its_stated_error(
    coasting: Coasting, length: int
) -> None:
    """In strong and weak parts of the record, under the guard of the planned motion."""
    lost = np.random.default_rng(length).choice(np.arange(2000, RECORD), (4, 4), replace=False)
    disturbed = Disturbed(coasting, MEMORY)  # type: ignore[arg-type]
    for at in np.sort(lost):
        told = disturbed.told(at, length, 0)
        assert told is not None, f"stopped: {at}"
        assert (told.true < told.bound).all()


def test_on_the_plain_link_a_long_loss_leads_the_table_to_rest(coasting: Coasting, laboratory: Laboratory) -> None:
    """A rig that only holds is stopped by a few missed intervals of the strong part: what rule 7 of the page is for."""
    run, commands = coasting.run(STALLED_AT[:1], 60)
    assert run.guard.flags[0] == STOPPED and run.guard.flags[1] != END
    assert commands[run.log.done[0] - 1] == 0.0
    holds, _ = laboratory.run(STALLED_AT, 5, told=False, limits=coasting.limits)
    assert holds.guard.flags[1] != END
