"""Play a source through step, guard and rig, and keep every sample: one drive for every kind of run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.clocks import IntArray, monotonic_ns
from rths_cli.compiled import entry, part
from rths_cli.control.blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.loop.blocks import Step, assemble
from rths_cli.loop.guard import NONE, STOPPED, GuardLimits, GuardState, fresh_guard, guard
from rths_cli.loop.log import Log, Signals, empty_log, note_step, signals
from rths_cli.loop.reasons import reason_of
from rths_cli.loop.step import note_sent, step
from rths_cli.lti import Array
from rths_cli.rigs.interface import Rig, RigInfo
from rths_cli.rigs.virtual import kernel
from rths_cli.rigs.virtual.plant import Plant
from rths_cli.rigs.virtual.rig import VirtualRig

STAMPED = 16  # steps on the counted clock of a virtual rig per look at the time: looking costs a quarter of a step


@dataclass(frozen=True)
class Outcome:
    """How a run went: log on the loop's own clock, steps done, and why it stopped early (empty when it did not).

    `stopped_at_s`: when the guard took over, on the loop's clock; `reason`: why, one of the guard's reasons.
    """

    log: Signals
    steps: int
    stopped_by_limit: str
    rig_fault: str
    stopped_at_s: float
    reason: int = NONE


def play(
    rig: Rig, info: RigInfo, blocks: Blocks, source: int, drive: Array, limits: GuardLimits, log: Log | None = None
) -> Outcome:
    """Play `drive` (n, 3) through the rig: open, arm, exchange every step, rest, close.

    `log`: that of an earlier run of the same sizes, which is written over; what a stopped run leaves stays.
    """
    drive = np.ascontiguousarray(drive, dtype=float)  # any other layout would be compiled anew
    state, guard_state = assemble(blocks, source), fresh_guard(len(info.channels))
    channels, virtual = len(info.channels), isinstance(rig, VirtualRig)
    log = log or empty_log(len(drive), channels, state.estimated.size, truths=channels if virtual else 0)
    log.done[0] = 0
    rig.open()
    try:
        if isinstance(rig, VirtualRig):
            steps, fault = _play_virtual(rig, state, limits, guard_state, drive, log)
        else:
            steps, fault = _play_exchanging(rig, state, limits, guard_state, drive, log)
    finally:
        rig.rest()
        rig.close()
    named = signals(log, channels, state.estimated.size)
    reason = int(guard_state.flags[1])
    stopped_at_s = float(guard_state.flags[3] * info.dt_s)
    return Outcome(named, steps, reason_of(info, limits, guard_state, source), fault, stopped_at_s, reason)


def _play_virtual(
    rig: VirtualRig, state: Step, limits: GuardLimits, guard_state: GuardState, drive: Array, log: Log
) -> tuple[int, str]:
    rig.restart()
    noise = rig.noise(len(drive) + 1)
    scratch = np.zeros(2, dtype=np.int64)
    steps = run_virtual(rig.plant, rig.state, state, limits, guard_state, drive, noise, log, scratch)
    fault = "the table ran into its end stop" if rig.state.fault[0] == kernel.END_STOP else ""
    return steps, fault


def _play_exchanging(
    rig: Rig, state: Step, limits: GuardLimits, guard_state: GuardState, drive: Array, log: Log
) -> tuple[int, str]:
    """Play through `exchange`, one call per step; nothing true is known."""
    think = think_once.bind(state, limits, guard_state, drive, log, np.zeros(2, dtype=np.int64))
    samples = rig.arm()
    try:
        while log.done[0] < len(drive) and guard_state.flags[0] != STOPPED:
            state.samples[:] = samples
            samples = rig.exchange(think())
    except RigError as fault:
        return int(log.done[0]), str(fault)
    return int(log.done[0]), ""


@part
def think(
    s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, k: int, share: float
) -> tuple[float, int]:
    """Run step and guard on the samples in `s.samples` and note them as step k; `share` of the command is asked for.

    Return the command in V and the first column of the log that is still to be noted.
    """
    asked = share * step(s, drive)
    command = guard(limits, g, asked, s.samples, s.corrected, s.interface, s.estimated, s.error[0], s.base_shear[0])
    note_sent(s, command)
    return command, note_step(log, s, command, k)


@entry
def think_once(s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, scratch: IntArray) -> float:
    """Run `think` on the next row of the drive (n, 3) and note the time it took; scratch (2,)."""
    k, start = log.done[0], monotonic_ns(scratch)
    command = think(s, limits, g, drive[k], log, k, 1.0)[0]
    log.columns[log.columns.shape[0] - 1, k] = monotonic_ns(scratch) - start
    log.done[0] = k + 1
    return command


@part
def stamp(log: Log, steps: int, count: int, before: int, now: int) -> int:
    """Note the mean time of the last `count` steps before `steps`; return the time they ended."""
    place = log.columns.shape[0] - 1
    for i in range(count):
        log.columns[place, steps - 1 - i] = (now - before) / count
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
    steps, before = 0, monotonic_ns(scratch)
    while steps < drive.shape[0] and table.fault[0] == 0 and g.flags[0] != STOPPED:
        kernel.read(plant, table, noise[steps], s.samples)
        displacement = table.state[0]
        command, place = think(s, limits, g, drive[steps], log, steps, 1.0)
        kernel.hold(plant, table, command)
        for c in range(log.truths):
            log.columns[c, steps] = table.middle_velocity[c]
        if not log.lean:
            log.columns[place, steps] = displacement
        steps += 1
        if steps % STAMPED == 0 and not log.lean:
            before = stamp(log, steps, STAMPED, before, monotonic_ns(scratch))
    if not log.lean:
        stamp(log, steps, steps % STAMPED, before, monotonic_ns(scratch))
    log.done[0] = steps
    return steps
