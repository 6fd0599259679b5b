"""Play a source through step, guard and rig, and keep every sample: one drive for every kind of run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rths_cli.clocks import IntArray, monotonic_ns
from rths_cli.compiled import entry, part
from rths_cli.control.blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.loop.blocks import Step, assemble
from rths_cli.loop.guard import NO_CHANNEL, REASONS, STOPPED, GuardLimits, GuardState, fresh_guard, guard
from rths_cli.loop.step import note_sent, step
from rths_cli.lti import Array
from rths_cli.rigs.interface import Rig, RigInfo
from rths_cli.rigs.virtual import kernel
from rths_cli.rigs.virtual.plant import Plant
from rths_cli.rigs.virtual.rig import VirtualRig

STAMPED = 16  # steps on the counted clock of a virtual rig per look at the time: looking costs a quarter of a step


class Log(NamedTuple):
    """Every signal of every step k; n steps, c channels, e estimator outputs. NaN after the last step.

    A lean log keeps accelerations alone: (1, n) of `desired`, all of `corrected` and `true_velocity_m_s`, none of the
    rest (size 0).
    """

    command_v: Array  # (n,) as it left the guard
    desired: Array  # (3, n) acceleration, velocity, displacement at k + n_p
    corrected: Array  # (c, n) corrected accelerations at k
    estimated: Array  # (e, n) estimator outputs at k
    base_shear_n: Array  # (n,) at k + n_p
    true_velocity_m_s: Array  # (c, n) in the middle between t_k and t_k+1 (virtual rigs)
    true_displacement_m: Array  # (n,) of the table at t_k (virtual rigs)
    compute_ns: Array  # (n,) duration of step and guard; on a virtual rig, of the rig as well, mean of 16 steps


@dataclass(frozen=True)
class Outcome:
    """How a run went: log on the loop's own clock, steps done, and why it stopped early (empty when it did not).

    `stopped_at_s`: when the guard took over, on the loop's clock.
    """

    log: Log
    steps: int
    stopped_by_limit: str
    rig_fault: str
    stopped_at_s: float


def play(
    rig: Rig, info: RigInfo, blocks: Blocks, source: int, drive: Array, limits: GuardLimits, log: Log | None = None
) -> Outcome:
    """Play `drive` (n, 3) through the rig: open, arm, exchange every step, rest, close.

    `log`: that of an earlier run of the same sizes, which is written over; what a stopped run leaves stays.
    """
    drive = np.ascontiguousarray(drive, dtype=float)  # any other layout would be compiled anew
    state, guard_state = assemble(blocks, source), fresh_guard(len(info.channels))
    log = log or empty_log(len(drive), len(info.channels), state.estimated.size)
    rig.open()
    try:
        if isinstance(rig, VirtualRig):
            steps, fault = _play_virtual(rig, state, limits, guard_state, drive, log)
        else:
            steps, fault = _play_exchanging(rig, state, limits, guard_state, drive, log)
    finally:
        rig.rest()
        rig.close()
    return Outcome(log, steps, _reason(info, guard_state), fault, float(guard_state.flags[3] * info.dt_s))


def _play_virtual(
    rig: VirtualRig, state: Step, limits: GuardLimits, guard_state: GuardState, drive: Array, log: Log
) -> tuple[int, str]:
    rig.restart()
    noise = rig.noise(len(drive) + 1)
    scratch = np.zeros(2, dtype=np.int64)
    steps = run_virtual(rig.plant, rig.state, state, limits, guard_state, drive, noise, log, scratch)
    whole = steps // STAMPED * STAMPED
    log.compute_ns[whole:steps] = log.compute_ns[whole - 1] if 0 < whole <= log.compute_ns.size else 0.0
    fault = "the table ran into its end stop" if rig.state.fault[0] == kernel.END_STOP else ""
    return steps, fault


def _play_exchanging(
    rig: Rig, state: Step, limits: GuardLimits, guard_state: GuardState, drive: Array, log: Log
) -> tuple[int, str]:
    """Play through `exchange`, one call per step; true signals stay NaN."""
    samples = rig.arm()
    think = think_once.bind(state, limits, guard_state, drive, log, np.zeros(3, dtype=np.int64))
    for k in range(len(drive)):
        state.samples[:] = samples
        command = think()
        try:
            samples = rig.exchange(command)
        except RigError as fault:
            return k + 1, str(fault)
        if guard_state.flags[0] == STOPPED:
            return k + 1, ""
    return len(drive), ""


@part
def think(s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, k: int) -> float:
    """Run step and guard on the samples in `s.samples`, note every signal, return the command in V."""
    command = guard(limits, g, step(s, drive), s.samples, s.corrected, s.interface[0], s.error[0])
    note_sent(s, command)
    if k < log.command_v.size:
        log.command_v[k] = command
        log.base_shear_n[k] = s.base_shear[0]
    for i in range(log.desired.shape[0]):
        log.desired[i, k] = s.interface[i]
    for i in range(s.corrected.size):
        log.corrected[i, k] = s.corrected[i]
    for i in range(log.estimated.shape[0]):
        log.estimated[i, k] = s.estimated[i]
    return command


@entry
def think_once(s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, at: IntArray) -> float:
    """Run `think` on row at[0] of the drive (n, 3), count at[0] up, note the time it took; at[1:3] is scratch."""
    k = at[0]
    at[0] += 1
    start = monotonic_ns(at[1:])
    command = think(s, limits, g, drive[k], log, k)
    log.compute_ns[k] = monotonic_ns(at[1:]) - start
    return command


@part
def stamp(log: Log, k: int, before: int, now: int) -> int:
    """Note the mean time of the last steps up to k; return the time they ended."""
    for i in range(STAMPED):
        log.compute_ns[k - i] = (now - before) / STAMPED
    return now


@entry
def run_virtual(
    plant: Plant,
    table: kernel.PlantState,
    s: Step,
    limits: GuardLimits,
    g: GuardState,
    drive: Array,
    noise: Array,
    log: Log,
    scratch: IntArray,
) -> int:
    """Play a whole run on the virtual table, counted clock; return the number of steps done."""
    before = monotonic_ns(scratch)
    for k in range(drive.shape[0]):
        kernel.read(plant, table, noise[k], s.samples)
        if k < log.true_displacement_m.size:
            log.true_displacement_m[k] = table.state[0]
        command = think(s, limits, g, drive[k], log, k)
        kernel.hold(plant, table, command)
        for c in range(table.middle_velocity.size):
            log.true_velocity_m_s[c, k] = table.middle_velocity[c]
        if (k + 1) % STAMPED == 0 and k < log.compute_ns.size:
            before = stamp(log, k, before, monotonic_ns(scratch))
        if table.fault[0] != 0 or g.flags[0] == STOPPED:
            return k + 1
    return drive.shape[0]


def empty_log(steps: int, channels: int, estimates: int, lean: bool = False) -> Log:
    """Return a log full of NaN; `lean` as in Log."""
    kept, three = (0, 1) if lean else (steps, 3)
    shapes = (
        (kept,),
        (three, steps),
        (channels, steps),
        (0 if lean else estimates, steps),
        (kept,),
        (channels, steps),
        (kept,),
        (kept,),
    )
    return Log(*(np.full(shape, np.nan) for shape in shapes))


def _reason(info: RigInfo, state: GuardState) -> str:
    """Return the guard's reason as a sentence, empty when it let everything pass."""
    if state.flags[1] == 0:
        return ""
    text, channel = REASONS[state.flags[1]], state.flags[2]
    return text if channel == NO_CHANNEL else f"{text} (channel {info.channels[channel].name})"
