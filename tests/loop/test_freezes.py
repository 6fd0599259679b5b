"""A target that freezes or loses packets for less than `lost_samples`: the test goes on, and how well."""

from __future__ import annotations

import numpy as np
import pytest
from freezing import ANSWERS_LOST, APPROACHES, GOES_ON, HOLDS, Freezing, freezing_of, ideal_errors
from ideal_table import storeys_of
from portfolio import parametrize_first

from rths_cli.analysis.metrics import error_figures
from rths_cli.loop.guard import END, LOST

RATE_HZ, RECORD = 500, 3_600
FROZEN_AT = RATE_HZ + np.array([1_290, 2_050])  # after the ramp; the table moves at 0.12 and 0.1 m/s
FAST_HZ, FAST_AT = 1000, 1000 + np.array([2_829, 4_356])  # at 0.14 m/s, once in each direction
LAG_S = 14e-3  # the table follows its command by this, and so does the freeze


@pytest.fixture(scope="module")
def laboratory() -> Freezing:
    return freezing_of(RECORD, RATE_HZ)


@pytest.fixture(scope="module")
def fast() -> Freezing:
    return freezing_of(5_000, FAST_HZ)


@pytest.mark.campaign
def test_the_ideal_table_gives_sim_where_it_is_never_frozen(laboratory: Freezing) -> None:
    """Within 1 %: its steps are of first order. Not the interface storey, which is differentiated twice."""
    motion, dt_s = laboratory.setup.motion, laboratory.setup.rig.dt_s
    ground = np.array([motion.displacement_m, motion.velocity_m_s])[:, :RECORD]
    found = storeys_of(laboratory.setup.building, ground, dt_s, {}, 0.9)
    sim = laboratory.sim[:, :RECORD]
    assert (error_figures(sim, found, dt_s).rms < 0.01 * sim.std(axis=1))[1:].all()


@pytest.mark.campaign
@parametrize_first(1, "length", [11, 24])
def test_a_target_that_froze_and_jumps_to_the_newest_command_costs_about_what_the_freeze_itself_does(
    laboratory: Freezing, length: int
) -> None:
    """22 ms, and 48: 60 samples may be lost. All storeys together; the freeze itself costs 30 times a calm test."""
    run, table_v = laboratory.run(FROZEN_AT, length, HOLDS)
    assert run.guard.flags[1] == END
    calm = laboratory.errors(laboratory.run(FROZEN_AT, 0, HOLDS)[0])
    ideal = np.hypot(ideal_errors(laboratory, FROZEN_AT, length, LAG_S), calm)
    assert np.linalg.norm(laboratory.errors(run)) < 1.3 * np.linalg.norm(ideal)
    assert np.linalg.norm(ideal) > 5.0 * np.linalg.norm(calm)
    own = np.delete(np.diff(table_v), np.add.outer(FROZEN_AT, [length - 1, length]).ravel())
    assert np.abs(own).max() * run.limits.gain_m_per_v / run.limits.dt_s < 0.5  # but for the jump the target makes


@pytest.mark.campaign
@parametrize_first(1, "length", [5, 11])
def test_samples_after_a_jump_of_a_fast_table_are_not_taken_for_motion_of_the_building(
    fast: Freezing, length: int
) -> None:
    """5 ms and 11 at 1 kHz cost less than on the ideal table; samples taken in at once cost three times as much."""
    run, _ = fast.run(FAST_AT, length, HOLDS)
    calm = fast.errors(fast.run(FAST_AT, 0, HOLDS)[0])
    ideal = np.hypot(ideal_errors(fast, FAST_AT, length, LAG_S), calm)
    assert run.guard.flags[1] == END
    assert np.linalg.norm(fast.errors(run)) < 1.3 * np.linalg.norm(ideal)


@pytest.mark.campaign
@parametrize_first(1, "length", [5, 22, 34])
def test_a_target_that_approaches_late_commands_is_not_stopped_by_its_own_jump(fast: Freezing, length: int) -> None:
    """22 ms and 34 at 0.14 m/s: the jump of one that holds is beyond the acceleration limit."""
    run, _ = fast.run(FAST_AT[:1], length, APPROACHES)
    calm = fast.errors(fast.run(FAST_AT, 0, HOLDS)[0])
    ideal = np.hypot(ideal_errors(fast, FAST_AT[:1], length, LAG_S), calm)
    assert run.guard.flags[1] == END
    assert np.linalg.norm(fast.errors(run)) < 1.3 * np.linalg.norm(ideal)


@pytest.mark.campaign
@pytest.mark.parametrize("mode", [GOES_ON, ANSWERS_LOST])
def test_a_target_that_goes_on_as_told_or_loses_answers_only_costs_next_to_nothing(
    laboratory: Freezing, mode: int
) -> None:
    run, _ = laboratory.run(FROZEN_AT, 11, mode)
    calm = laboratory.errors(laboratory.run(FROZEN_AT, 0, mode)[0])
    assert run.guard.flags[1] == END
    assert np.linalg.norm(laboratory.errors(run)) < 1.4 * np.linalg.norm(calm) < 0.006  # of SIM-DELAY's


@pytest.mark.parametrize("lost", [60, 61])
def test_as_many_samples_as_may_be_lost_may_be_lost_and_not_one_more(laboratory: Freezing, lost: int) -> None:
    run, _ = laboratory.run(FROZEN_AT[:1], lost, GOES_ON, lost_samples=60)
    assert run.guard.flags[1] == (END if lost == 60 else LOST)
    if lost == 61:
        assert run.guard.seen[0] == 61.0
