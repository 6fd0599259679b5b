"""Play a run on a virtual rig in counted steps, as fast as it computes; `Outcome`, the result that real-time runs
return too."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rths_cli.control.designed_blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.loop.diagnosis import cause_of
from rths_cli.loop.guard import (
    END,
    NONE,
    STOPPED,
    GuardLimits,
    GuardState,
    fresh_guard,
    guard,
    take_over,
    without_zeros,
)
from rths_cli.loop.run_log import Log, Signals, empty_log, note_step, signals
from rths_cli.loop.step import note_sent, step
from rths_cli.loop.step_arrays import Step, assemble
from rths_cli.loop.stop_reasons import reason_of
from rths_cli.numerics.clock import IntArray, monotonic_ns
from rths_cli.numerics.compiled import entry, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import Rig, RigInfo, SimulatedRig, simulated
from rths_cli.rigs.virtual import plant_kernel
from rths_cli.rigs.virtual.plant import Plant

Flags = NDArray[np.bool_]
STAMPED = 16  # steps on the counted clock of a virtual rig per look at the time: looking costs a quarter of a step


@dataclass(frozen=True)
class Whole:
    """A run from its first sample at rest to its last: `corrected` (c, n) accelerations and `command_v` (n,) as the
    step had them, the record's from `first` on. `before_v`, `after_v` (c, .): samples in V as the rig gave them while
    the table was told to stand still; `before_s`, `after_s`: when the first of each was taken, on the record's clock.
    `missing` (n,): steps whose samples the rig did not give (None: it gave all).
    """

    corrected: Array
    command_v: Array
    first: int
    before_v: Array
    after_v: Array
    before_s: float
    after_s: float
    missing: Flags | None = None


@dataclass(frozen=True)
class Outcome:
    """How a run went: log on the loop's own clock, steps done, and why it stopped early (empty when it did not).

    `stopped_at_s`: when the guard took over, on the loop's clock, negative before the record; `reason`: why, one of the
    guard's reasons; `whole`: the run with the rest before it and, where it got so far, after it; `played`: every step
    of the record passed the guard, so that what ended the run came after it; `ramp_s`: how long the command faded in
    before the record.
    """

    log: Signals
    steps: int
    stopped_by_limit: str
    rig_fault: str
    stopped_at_s: float
    reason: int = NONE
    whole: Whole | None = None
    played: bool = False
    ramp_s: float = 0.0


@dataclass(frozen=True)
class Stillness:
    """How many samples a table is watched at rest before a record, led to rest after it, and watched at rest again."""

    before: int = 0
    down: int = 0
    after: int = 0


@dataclass(frozen=True)
class _Course:
    """A run on the counted clock: its drive with zeros after the record, its record's steps, and what the channels show
    at rest before it (b, c) and after the record (a, c), in V."""

    drive: Array
    record: int
    before_v: Array
    after_v: Array


def play(
    rig: Rig,
    info: RigInfo,
    blocks: Blocks,
    source: int,
    drive: Array,
    limits: GuardLimits,
    log: Log | None = None,
    still: Stillness | None = None,
) -> Outcome:
    """Play `drive` (n, 3) through the rig: open, arm, exchange every step, rest, close.

    `log`: that of an earlier run of the same sizes, which is written over; what a stopped run leaves stays. `still`:
    how long the table is watched at rest (None: not at all).
    """
    state, guard_state = assemble(blocks, source), fresh_guard(len(info.channels))
    channels, compiled = len(info.channels), simulated(rig)
    still = still or Stillness()
    end = np.zeros((still.down + still.after, 3))
    whole = np.ascontiguousarray(np.vstack([drive, end]), dtype=float)  # any other layout would be compiled anew
    course = _Course(whole, len(drive), np.zeros((still.before, channels)), np.zeros((len(end), channels)))
    log = log or empty_log(len(whole), channels, state.estimated.size, truths=channels if compiled else 0)
    log.done[0] = 0
    rig.open()
    try:
        if compiled is not None:
            steps, fault = _play_simulated(compiled, state, limits, guard_state, course, log)
        else:
            steps, fault, limits = _play_exchanging(rig, state, limits, guard_state, course, log)
    finally:
        rig.rest()
        rig.close()
    named = signals(log, channels, state.estimated.size)
    reason = int(guard_state.flags[1])
    stopped_at_s = float(guard_state.flags[3] * info.dt_s)
    cause = cause_of(info, blocks, limits, guard_state, named)
    told = reason_of(info, limits, guard_state, source, cause)
    record, record_steps = slice(0, len(drive)), min(steps, len(drive))
    seen = _whole(part_of(named, slice(0, steps)), course, still, info.dt_s) if still.before else None
    played = bool(guard_state.flags[3] >= len(drive))
    return Outcome(part_of(named, record), record_steps, told, fault, stopped_at_s, reason, seen, played)


def part_of(everything: Signals, steps: slice) -> Signals:
    """Return the signals of some steps."""
    names = Signals.__dataclass_fields__
    return replace(everything, **{name: getattr(everything, name)[..., steps] for name in names})


def _whole(played: Signals, course: _Course, still: Stillness, dt_s: float) -> Whole:
    after = slice(still.down, max(played.command_v.size - course.record, still.down))
    return Whole(
        played.corrected, played.command_v, 0, course.before_v.T, course.after_v[after].T, -still.before * dt_s,
        (course.record + still.down) * dt_s,
    )  # fmt: skip


def _play_simulated(
    rig: SimulatedRig, state: Step, limits: GuardLimits, guard_state: GuardState, course: _Course, log: Log
) -> tuple[int, str]:
    """Play in compiled code. The noise at rest before the record is drawn last: that of the record is the same with and
    without it."""
    rig.restart()
    steps, before = len(course.drive), len(course.before_v)
    noise = rig.noise(steps + 1 + before)
    watch_virtual(rig.plant, rig.state, np.ascontiguousarray(noise[steps + 1 :]), course.before_v)
    scratch = np.zeros(2, dtype=np.int64)
    steps = run_virtual(
        rig.plant, rig.state, state, limits, guard_state, course.drive, course.record, noise, log, course.after_v,
        scratch,
    )  # fmt: skip
    fault = "the table ran into its end stop" if rig.state.fault[0] == plant_kernel.END_STOP else ""
    return steps, fault


def _play_exchanging(
    rig: Rig, state: Step, limits: GuardLimits, guard_state: GuardState, course: _Course, log: Log
) -> tuple[int, str, GuardLimits]:
    """Play through `exchange`, one call per step; nothing true is known. What the channels show at rest is their
    zero; the limits are returned as they are without it."""
    samples = rig.arm()
    try:
        for shown in course.before_v:
            shown[:] = samples
            samples = rig.exchange(0.0)
        zeros_v = course.before_v.mean(axis=0) if len(course.before_v) else np.zeros(state.samples.size)
        limits, scratch = without_zeros(limits, zeros_v), np.zeros(2, dtype=np.int64)
        think = think_once.bind(state, limits, guard_state, course.drive, course.record, log, scratch)
        while log.done[0] < len(course.drive) and (guard_state.flags[0] != STOPPED or guard_state.flags[1] == END):
            if log.done[0] >= course.record:
                course.after_v[log.done[0] - course.record] = samples
            state.samples[:] = samples - zeros_v
            samples = rig.exchange(think())
    except RigError as fault:
        return int(log.done[0]), str(fault), limits
    return int(log.done[0]), "", limits


@part
def think(
    s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, k: int, share: float, came: bool,
    samples: Array, accel: Array,
) -> tuple[float, int]:  # fmt: skip
    """Run the step on the samples in `s.samples` and the guard on what the channels gave, and note it as step k.

    `share` of the command is asked for. `came`: whether the channels gave anything, (c,) in V and corrected in m/s^2;
    these are the step's own arrays unless the step is given something else. Return the command in V and the first
    column of the log that is still to be noted.
    """
    asked = share * step(s, drive)
    error = s.error[0] + (s.corrected[0] - accel[0])
    command = guard(limits, g, asked, came, samples, accel, s.expected, error, s.interface[1], s.base_shear[0])
    note_sent(s, command)
    return command, note_step(log, s, command, k)


@part
def end_record(g: GuardState, k: int, record: int) -> None:
    """Lead the table to rest after the last step of a record."""
    if k >= record:
        take_over(g, END, math.nan)


@entry
def think_once(
    s: Step, limits: GuardLimits, g: GuardState, drive: Array, record: int, log: Log, scratch: IntArray
) -> float:
    """Run `think` on the next row of the drive (n, 3) and note the time it took; scratch (2,)."""
    k, start = log.done[0], monotonic_ns(scratch)
    end_record(g, k, record)
    command = think(s, limits, g, drive[k], log, k, 1.0, True, s.samples, s.corrected)[0]
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
def watch_virtual(plant: Plant, table: plant_kernel.PlantState, noise: Array, shown_v: Array) -> None:
    """Write the samples (n, c) of a virtual table that is told to stand still."""
    for k in range(shown_v.shape[0]):
        plant_kernel.read(plant, table, noise[k], shown_v[k])
        plant_kernel.hold(plant, table, 0.0)


@entry
def run_virtual(
    plant: Plant,
    table: plant_kernel.PlantState,
    s: Step,
    limits: GuardLimits,
    g: GuardState,
    drive: Array,
    record: int,
    noise: Array,
    log: Log,
    after_v: Array,
    scratch: IntArray,
) -> int:
    """Play a whole run on the virtual table, counted clock; return the number of steps done. `after_v` (a, c) takes the
    samples after the record."""
    steps, before = 0, monotonic_ns(scratch)
    while steps < drive.shape[0] and table.fault[0] == 0 and (g.flags[0] != STOPPED or g.flags[1] == END):
        plant_kernel.read(plant, table, noise[steps], s.samples)
        end_record(g, steps, record)
        if steps >= record:
            for c in range(s.samples.size):
                after_v[steps - record, c] = s.samples[c] + 0.0
        displacement = table.state[0]
        command, place = think(s, limits, g, drive[steps], log, steps, 1.0, True, s.samples, s.corrected)
        plant_kernel.hold(plant, table, command)
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
