"""Play a table run on the identified model of a rig instead of the rig: the compiled step, the guard and the block of
analysis/identified_rig_block.py. The check simulates buildings with laws by it, and what a run needs of the table;
nothing moves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.control.sensor_correction import correction
from rths_cli.control.state_space import discretise
from rths_cli.loop.diagnosis import cause_of
from rths_cli.loop.guard import NO_FURTHER, STOPPED, GuardLimits, GuardState, fresh_guard
from rths_cli.loop.run_log import Log, empty_log, signals, sizes_of
from rths_cli.loop.simulated_time_run import Outcome, check_commands, think
from rths_cli.loop.step_arrays import NUMERICAL, Step, assemble
from rths_cli.loop.stop_reasons import stop_of
from rths_cli.numerics.compiled import borrowed, entry, part, part_class
from rths_cli.numerics.lti import Array, Block
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Specimen


class Disturbed(NamedTuple):
    """What disturbs a simulated test."""

    added_v: Array  # (n, c) added to the samples in V
    sample_step_v: float = 0.0  # bit to which samples are rounded; 0: they are not
    command_step_v: float = 0.0  # bit to which the rig rounds commands; 0: it does not
    of_desired: bool = False  # whether the rig is given the desired acceleration in m/s^2 instead of the command


@part_class
class Sampled(NamedTuple):
    """The sampled model of a rig, n states and c samples."""

    A: Array  # (n, n)
    B: Array  # (n,)
    C: Array  # (c, n)
    D: Array  # (c,)
    state: Array  # (n,)
    following: Array  # (n,) the next state
    sent: Array  # (1,) the last command

    def read(self, samples: Array) -> None:
        """Write the samples (c,) in V of this instant. A direct path shows the command of the instant before."""
        for i in range(samples.size):
            value = self.D[i] * self.sent[0]
            for j in range(self.state.size):
                value += self.C[i, j] * self.state[j]
            samples[i] = value

    def hold(self, command_v: float) -> None:
        """Go on by one sample with a held command."""
        for i in range(self.state.size):
            value = self.B[i] * command_v
            for j in range(self.state.size):
                value += self.A[i, j] * self.state[j]
            self.following[i] = value
        for i in range(self.state.size):
            self.state[i] = self.following[i] + 0.0
        self.sent[0] = command_v


@part
def rounded(value: float, step: float) -> float:
    """Return a value rounded to steps; a step of zero does not round."""
    return value if step == 0.0 else math.floor(value / step + 0.5) * step


@entry
def run_identified(
    rig: Sampled, s: Step, limits: GuardLimits, g: GuardState, drive: Array, disturbed: Disturbed, log: Log
) -> int:
    """Play a drive (n, 3) on a rig's sampled model; return the number of steps until the end or the guard's stop."""
    rig, s, limits, g, drive, disturbed, log = borrowed((rig, s, limits, g, drive, disturbed, log))
    steps = 0
    while steps < drive.shape[0] and g.flags[0] != STOPPED:
        rig.read(s.samples)
        for c in range(s.samples.size):
            s.samples[c] = rounded(s.samples[c] + disturbed.added_v[steps, c], disturbed.sample_step_v)
        think(s, limits, g, drive[steps], log, steps, 1.0, True, s.samples, s.corrected)
        rig.hold(s.motion[0, 0] if disturbed.of_desired else rounded(s.command[0], disturbed.command_step_v))
        steps += 1
    log.done[0] = steps
    return steps


def play_identified(
    plant: Block,
    info: RigInfo,
    blocks: Blocks,
    drive: Array,
    limits: GuardLimits,
    disturbed: Disturbed,
    source: int = NUMERICAL,
) -> Outcome:
    """Play `drive` (n, 3) on a rig's sampled model from rest, without noise other than that of `disturbed`.

    `plant`: command in V to samples (c,) in V, as IdentifiedRig.plant or `perfect_table`, with blocks as from
    `seen_by_model` or `on_perfect_table`. True signals are not known.
    """
    check_commands(info, blocks)
    blocks = replace(blocks, further=None, cell=None)  # the model has the accelerometers alone
    limits = limits._replace(further=NO_FURTHER)
    state = assemble(blocks, source)
    sizes = sizes_of(state)
    guard_state = fresh_guard(sizes.channels, sizes.actuators, sizes.axes)
    log = empty_log(len(drive), sizes, truths=sizes.channels)
    drive = np.ascontiguousarray(drive, dtype=float)
    try:
        steps = int(run_identified(_sampled(plant), state, limits, guard_state, drive, disturbed, log))
    finally:
        blocks.finish()
    blocks.raise_interruption()
    named = signals(log, sizes)
    cause = cause_of(info, blocks, limits, guard_state, named)
    stop = stop_of(info, limits, guard_state, source, cause, blocks.fault())
    played = bool(guard_state.flags[3] >= len(drive))
    stopped_at_s = float(guard_state.flags[3] * info.dt_s)
    return Outcome(named, steps, stop, "", stopped_at_s, int(guard_state.flags[1]), None, played, logs=blocks.logs)


def seen_by_model(rig: IdentifiedRig, blocks: Blocks, info: RigInfo, removes_sensors: bool) -> Blocks:
    """Return the blocks of a test on the identified rig, which has no AC coupling and no alias of its own.

    The step leaves as much of the alias as on the rig.
    """
    change, total = rig.alias_left(blocks)
    channels = tuple(replace(channel, high_pass_hz=0.0) for channel in info.channels)
    fixed = correction(channels, info.dt_s, removes_sensors)
    return replace(blocks, correction=fixed, ripple_m_s2_per_v=-change, ripple_sum_m_s2_per_v=-total)


def perfect_table(specimen: Specimen, info: RigInfo, lead_samples: int) -> Block:
    """Return the block from desired acceleration at k + n_p in m/s^2 to samples (c,) in V of a table that follows it
    without delay; n_p = `lead_samples` is at least one."""
    floors = discretise(specimen_state_space(specimen), info.dt_s, "foh", "floors", ("table",), ())
    n, size = len(floors.A), len(floors.A) + lead_samples
    a, b, c = np.zeros((size, size)), np.zeros((size, 1)), np.zeros((1 + len(floors.C), size))
    a[:n, :n], a[:n, -1] = floors.A, floors.B[:, 0]
    a[n + 1 :, n:-1] = np.eye(lead_samples - 1)
    b[n, 0] = 1.0
    c[0, -1], c[1:, :n], c[1:, -1] = 1.0, floors.C, floors.D[:, 0]
    scale = np.array([channel.sensitivity_v_per_unit for channel in info.channels])[:, None]
    return Block("perfect_table", a, b, scale * c, np.zeros((len(c), 1)), info.dt_s, ("desired_accel_m_s2",), ())


def on_perfect_table(blocks: Blocks, info: RigInfo) -> Blocks:
    """Return the blocks of a test on `perfect_table`, whose samples need no correction."""
    fixed = correction(info.channels, info.dt_s, corners=False)
    return replace(blocks, correction=fixed, ripple_m_s2_per_v=0.0, ripple_sum_m_s2_per_v=0.0)


def _sampled(plant: Block) -> Sampled:
    """Return a rig's sampled model at rest."""
    n = len(plant.A)
    matrices = np.ascontiguousarray(plant.A), plant.B[:, 0].copy(), np.ascontiguousarray(plant.C), plant.D[:, 0].copy()
    return Sampled(*matrices, np.zeros(n), np.zeros(n), np.zeros(1))
