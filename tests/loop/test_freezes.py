"""A target that freezes or loses packets for less than `lost_samples`: the test goes on, and how well."""

from __future__ import annotations

import numpy as np
import pytest
from freezing import ANSWERS_LOST, GOES_ON, HOLDS, Freezing, freezing_of
from ideal_table import storeys_of

from rths_cli.loop.guard import END, LOST
from rths_cli.metrics import error_figures

RATE_HZ, RECORD = 500, 3_600
FROZEN_AT = RATE_HZ + np.array([1_290, 2_050])  # after the ramp; the table moves at 0.12 and 0.1 m/s
LAG = 7  # intervals: the table follows its command by 14 ms, and so does the freeze


@pytest.fixture(scope="module")
def laboratory() -> Freezing:
    return freezing_of(RECORD, RATE_HZ)


def ideal_errors(laboratory: Freezing, length: int) -> np.ndarray:
    motion, dt_s = laboratory.setup.motion, laboratory.setup.rig.dt_s
    ground = np.array([motion.displacement_m, motion.velocity_m_s])[:, :RECORD]
    lead = laboratory.design.blocks.lead_samples
    frozen = {int(at) - RATE_HZ - lead + LAG: float(length) for at in FROZEN_AT}
    found = storeys_of(laboratory.setup.building, ground, dt_s, frozen, 0.9)
    return error_figures(laboratory.sim[:, :RECORD], found, dt_s).rms


def test_the_ideal_table_gives_sim_where_it_is_never_frozen(laboratory: Freezing) -> None:
    """Within 1 %: its steps are of first order. Not the interface storey, which is differentiated twice."""
    motion, dt_s = laboratory.setup.motion, laboratory.setup.rig.dt_s
    ground = np.array([motion.displacement_m, motion.velocity_m_s])[:, :RECORD]
    found = storeys_of(laboratory.setup.building, ground, dt_s, {}, 0.9)
    sim = laboratory.sim[:, :RECORD]
    assert (error_figures(sim, found, dt_s).rms < 0.01 * sim.std(axis=1))[1:].all()


@pytest.mark.parametrize("length", [11, 24])
def test_a_target_that_froze_and_jumps_to_the_newest_command_costs_about_what_the_freeze_itself_does(
    laboratory: Freezing, length: int
) -> None:
    """22 ms, and 48: 60 samples may be lost. All storeys together; the freeze itself costs 30 times a calm test."""
    run, table_v = laboratory.run(FROZEN_AT, length, HOLDS)
    assert run.guard.flags[1] == END
    calm = laboratory.errors(laboratory.run(FROZEN_AT, 0, HOLDS)[0])
    ideal = np.hypot(ideal_errors(laboratory, length), calm)
    assert np.linalg.norm(laboratory.errors(run)) < 1.3 * np.linalg.norm(ideal)
    assert np.linalg.norm(ideal) > 5.0 * np.linalg.norm(calm)
    own = np.delete(np.diff(table_v), np.add.outer(FROZEN_AT, [length - 1, length]).ravel())
    assert np.abs(own).max() * run.limits.gain_m_per_v / run.limits.dt_s < 0.5  # but for the jump the target makes


@pytest.mark.parametrize("mode", [GOES_ON, ANSWERS_LOST])
def test_a_target_that_goes_on_as_told_or_loses_answers_only_costs_next_to_nothing(
    laboratory: Freezing, mode: int
) -> None:
    run, _ = laboratory.run(FROZEN_AT, 11, mode)
    calm = laboratory.errors(laboratory.run(FROZEN_AT, 0, mode)[0])
    assert run.guard.flags[1] == END and (laboratory.errors(run) / calm).max() < 1.5


@pytest.mark.parametrize("lost", [60, 61])
def test_as_many_samples_as_may_be_lost_may_be_lost_and_not_one_more(laboratory: Freezing, lost: int) -> None:
    run, _ = laboratory.run(FROZEN_AT[:1], lost, GOES_ON, lost_samples=60)
    assert run.guard.flags[1] == (END if lost == 60 else LOST)
    if lost == 61:
        assert run.guard.seen[0] == 61.0
