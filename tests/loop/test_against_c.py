"""The compiled step against the same blocks written a second time, in C (tests/helpers/campaigns/step.c): shipped cases
as they are, then blocks of the bench at the guard's limits. benchmarks/step_mutants.py shows what it notices."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import numpy as np
import pytest
from bench import LINEAR, rig_info, specimen
from campaigns import step_in_c, step_run
from campaigns.step_comparison import SHIPPED, both, differences
from hybrid import best_like, ground, open_limits, paper_like
from portfolio import parametrize_first

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.experiment.model_choice import Memory
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.virtual.virtual_rig import build_plant

STEPS = 2000
FRICTION, FORCE_LIMIT = VirtualPhysics(), VirtualPhysics(force_limit_n=12.0)
pytestmark = pytest.mark.skipif(step_in_c.compiler() is None, reason="no C compiler here")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return step_in_c.compiled(tmp_path_factory.mktemp("c"))


def given(
    physics: VirtualPhysics, info: RigInfo, drive: Array, noise_rms: float = 3e-4, best: bool = True
) -> step_run.Inputs:
    """Return blocks of the bench with shaped commands on a table with this physics."""
    blocks = replace((best_like if best else paper_like)(info), shaping_step_v=info.converters.step_v)
    noise = np.random.default_rng(5).standard_normal((len(drive) + 1, len(info.channels)))
    return step_run.Inputs(build_plant(info, physics, specimen(), noise_rms), blocks, open_limits(info), drive, noise)


def played(library: ctypes.CDLL, inputs: step_run.Inputs) -> tuple[step_run.State, step_run.State, int]:
    """Play the inputs by both, which must do the same; return both states and the steps done."""
    ours, theirs, done, done_in_c = both(library, inputs)
    assert list(differences(ours, theirs, done, done_in_c)) == []
    return ours, theirs, done


@pytest.mark.campaign
@parametrize_first(1, "case", SHIPPED)
def test_a_shipped_case_is_the_one_of_c(library: ctypes.CDLL, memory: Memory, case: str) -> None:
    """The whole record with all defaults, among them the feedforward of the specimen's reaction and of friction."""
    setup, blocks = step_run.prepared(memory, case)
    inputs = step_run.inputs(setup, blocks)
    ours, theirs, done = played(library, inputs)
    forward = ours.step.feedforward
    assert done == len(inputs.drive) and forward.friction_v > 0.0
    assert forward.block.given.size == forward.block.states + 3 + len(setup.rig.channels)
    assert np.array_equal(ours.signals.command_v, theirs.signals.command_v)


@pytest.mark.parametrize(
    ("physics", "latency", "scale", "best"),
    [(FRICTION, 1, 8.0, True), (FRICTION, 2, 0.1, True), (FORCE_LIMIT, 1, 8.0, True), (FRICTION, 0, 1.0, False)],
    ids=["friction", "two samples of latency, mostly sticking", "force limit", "printed method"],
)
def test_every_signal_is_the_one_of_c(
    library: ctypes.CDLL, physics: VirtualPhysics, latency: int, scale: float, best: bool
) -> None:
    inputs = given(physics, rig_info(latency_samples=latency), scale * ground(STEPS), best=best)
    assert played(library, inputs)[2] == STEPS


@pytest.mark.parametrize("scale", [8.0, -8.0])
def test_the_feedback_is_clipped_as_in_c(library: ctypes.CDLL, scale: float) -> None:
    inputs = given(FRICTION, rig_info(), scale * ground(STEPS))
    tight = replace(inputs, blocks=replace(inputs.blocks, feedback_limit_v=1e-3))
    ours = played(library, tight)[0]
    free = played(library, inputs)[0]
    assert not np.array_equal(ours.signals.command_v, free.signals.command_v)


TIGHT = {
    "stroke_m": (0.002, 1),
    "velocity_m_s": (0.01, 2),
    "abort": (np.full(3, 0.05), 3),
    "command_rate_v_s": (1.0, 10),
    "energy_ratio": (1e-3, 11),
}


@pytest.mark.parametrize("limit", TIGHT)
def test_the_guard_stops_as_in_c(library: ctypes.CDLL, limit: str) -> None:
    inputs = given(FRICTION, rig_info(), np.vstack([ground(STEPS), np.zeros((6000, 3))]))
    limits = inputs.limits._replace(
        stroke_m=0.079, velocity_m_s=1.0, acceleration_m_s2=45.0, command_v=10.0, energy_floor_j=1e-5
    )
    tight, reason = TIGHT[limit]
    ours = played(library, replace(inputs, limits=limits._replace(**{limit: tight})))[0]
    assert ours.guard.flags[1] == reason


def test_a_linear_table_is_the_one_of_c(library: ctypes.CDLL) -> None:
    inputs = given(LINEAR, rig_info(low_pass_hz=0.0), ground(STEPS), noise_rms=0.0)
    played(library, inputs)


def test_a_structure_of_another_size_is_refused(library: ctypes.CDLL) -> None:
    inputs = given(FRICTION, rig_info(), ground(STEPS))
    state = step_run.fresh(inputs)
    with pytest.raises(ValueError, match="GuardState has"):
        step_in_c.bound(library, inputs, replace(state, log=state.guard))  # type: ignore[arg-type]
