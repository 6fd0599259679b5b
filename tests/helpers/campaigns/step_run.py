"""The inputs of one EXP-RTHS on the virtual rig, and the arrays it changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rths_cli.case.load import load_cases
from rths_cli.control.designed_blocks import Blocks
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, guard_limits, open_rig
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.loop.guard import GuardLimits, GuardState, fresh_guard
from rths_cli.loop.run_log import Log, Signals, empty_log, signals, sizes_of
from rths_cli.loop.simulated_time_run import run_virtual
from rths_cli.loop.step_arrays import NUMERICAL, Step, assemble
from rths_cli.numerics.lti import Array
from rths_cli.rigs.virtual.plant_kernel import Plant, PlantState, fresh_state

CASE = "el_centro_low_ff_fb"


@dataclass(frozen=True)
class Inputs:
    """What a run reads: `drive` (n, 3), `noise` (n + 1, c) standard normal."""

    plant: Plant
    blocks: Blocks
    limits: GuardLimits
    drive: Array
    noise: Array


@dataclass(frozen=True)
class State:
    """What a run changes."""

    table: PlantState
    step: Step
    guard: GuardState
    log: Log

    @property
    def signals(self) -> Signals:
        """Return what the log holds, by name."""
        return signals(self.log, sizes_of(self.step))


Bind = Callable[[Inputs, State], Callable[[], int]]  # what plays a run


def prepared(memory: Memory, case: str = CASE, settings: tuple[str, ...] = ()) -> tuple[Setup, Blocks]:
    """Return a case as set up, and the blocks of its step; the model is identified unless the memory has it."""
    setup = make_setup(load_cases([case], settings)[0])
    return setup, design_blocks(setup, memory.identify(setup, lambda _: None)).blocks


def inputs(setup: Setup, blocks: Blocks) -> Inputs:
    """Return what EXP-RTHS of a case reads."""
    motion = setup.motion
    drive = np.column_stack([motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m])
    drive = np.vstack([drive, np.repeat(drive[-1:], blocks.lead_samples, axis=0)])
    rig = open_rig(setup, (EXP_RTHS,), setup.case.seed)
    noise = rig.noise(len(drive) + 1)
    return Inputs(rig.plant, blocks, guard_limits(setup), np.ascontiguousarray(drive), np.ascontiguousarray(noise))


def fresh(given: Inputs) -> State:
    """Return table, step and guard at rest, and an empty log."""
    step = assemble(given.blocks, NUMERICAL)
    sizes = sizes_of(step)
    log, guard = (
        empty_log(len(given.drive), sizes, truths=sizes.channels),
        fresh_guard(sizes.channels, further=sizes.further),
    )
    return State(fresh_state(given.plant, given.blocks.latency_samples), step, guard, log)


def bound(given: Inputs, state: State) -> Callable[[], int]:
    """Return a function that plays the run by our compiled step and returns the number of steps done."""
    scratch, after_v = np.zeros(2, dtype=np.int64), np.zeros((0, given.noise.shape[1]))
    return run_virtual.bind(
        given.plant, state.table, state.step, given.limits, state.guard, given.drive, len(given.drive), given.noise,
        state.log, after_v, np.zeros(given.noise.shape[1]), scratch,
    )  # fmt: skip
