"""Play a run on a virtual rig in counted steps, as fast as it computes; `Outcome`, the result that real-time runs
return too."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Logged
from rths_cli.errors import InputError, RigError
from rths_cli.findings import Finding
from rths_cli.loop.diagnosis import NOTHING_FORESEEN, Foreseen, cause_of
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
from rths_cli.loop.run_log import Log, Signals, empty_log, note_step, signals, sizes_of
from rths_cli.loop.step import note_sent, step
from rths_cli.loop.step_arrays import ACCELERATION, Step, assemble
from rths_cli.loop.stop_reasons import stop_of
from rths_cli.numerics.clock import IntArray, monotonic_ns
from rths_cli.numerics.compiled import borrowed, entry, kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import (
    Rig,
    RigInfo,
    SimulatedPlant,
    SimulatedRig,
    SimulatedState,
    as_commands,
    simulated,
)
from rths_cli.rigs.virtual import plant_kernel

Flags = NDArray[np.bool_]
STAMPED = 16  # steps of a virtual rig per reading of the clock, which costs a quarter of a step


@dataclass(frozen=True)
class Whole:
    """A complete run, with the samples at rest before and after its record."""

    corrected: Array  # (c, n) accelerations as the step used them
    command_v: Array  # (n,)
    first: int  # index of the record's first step
    before_v: Array  # (c, .) samples as the rig delivered them, with the table at rest before the record
    after_v: Array  # (c, .) the same after the record
    before_s: float  # time of the first sample of `before_v` on the record's clock
    after_s: float  # the same of `after_v`
    missing: Flags | None = None  # (n,) steps without samples; None: all samples came


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run."""

    log: Signals  # of the record, on the loop's own clock
    steps: int  # of the record that were computed
    stop: Finding | None  # why the guard stopped it early, None if it did not
    rig_fault: str  # fault that the rig reported, "" without one
    stopped_at_s: float  # time at which the guard took over, on the loop's clock; negative before the record
    reason: int = NONE  # the guard's reason
    whole: Whole | None = None  # the run with the rest before and, if reached, after its record
    played: bool = False  # whether all steps of the record passed the guard, so that it ended after the record
    ramp_s: float = 0.0  # duration of the ramp-up before the record
    logs: tuple[Logged, ...] = ()  # what the rows of the log's `logged` are

    @property
    def stopped_by_limit(self) -> str:
        """Return why the guard stopped it early in words, "" if it did not."""
        return "" if self.stop is None else str(self.stop)


ZEROED_S = 1.0  # at rest, over which zeros are taken, as on a real rig


@dataclass(frozen=True)
class Stillness:
    """Number of samples around a record."""

    before: int = 0  # at rest, before the record
    down: int = 0  # on the way to rest
    after: int = 0  # at rest, after the record


def check_commands(info: RigInfo, blocks: Blocks) -> None:
    """Raise InputError where blocks make other commands than a rig takes."""
    made = blocks.interface.actuators
    if made != info.actuators:
        raise InputError(f"interface: {made} commands, but rig {info.name} has {info.actuators} actuators")


@dataclass(frozen=True)
class _Course:
    """A run on the counted clock."""

    drive: Array  # (n, 3) with zeros after the record
    record: int  # steps of the record
    before_v: Array  # (b, c) receives the samples at rest before the record
    after_v: Array  # (a, c) receives the samples after the record


def play(
    rig: Rig,
    info: RigInfo,
    blocks: Blocks,
    source: int,
    drive: Array,
    limits: GuardLimits,
    log: Log | None = None,
    still: Stillness | None = None,
    foreseen: Foreseen = NOTHING_FORESEEN,
) -> Outcome:
    """Play `drive` (n, 3) on the rig: open, arm, exchange in every step, rest, close.

    `log`: log of an earlier run of the same sizes, which is overwritten; after a stopped run its later steps keep their
    old values. `still`: samples at rest around the record (None: none). `foreseen`: as in `cause_of`.
    """
    state, compiled = assemble(blocks, source), simulated(rig)
    sizes = sizes_of(state)
    channels, guard_state = state.samples.size, fresh_guard(sizes.channels, sizes.actuators, sizes.axes, sizes.further)
    check_commands(info, blocks)
    still = still or Stillness()
    end = np.zeros((still.down + still.after, 3))
    whole = np.vstack([drive, end]) if len(end) else drive
    whole = np.ascontiguousarray(whole, dtype=float)  # any other layout would be compiled anew
    course = _Course(whole, len(drive), np.zeros((still.before, channels)), np.zeros((len(end), channels)))
    log = log or empty_log(len(whole), sizes, truths=sizes.channels if compiled else 0)
    log.done[0] = 0
    rig.open()
    try:
        if compiled is not None:
            steps, fault, limits = _play_simulated(compiled, info.dt_s, state, limits, guard_state, course, log)
        else:
            steps, fault, limits = _play_exchanging(rig, state, limits, guard_state, course, log)
    finally:
        rig.rest()
        rig.close()
        blocks.finish()
    blocks.raise_interruption()
    named = signals(log, sizes)
    reason = int(guard_state.flags[1])
    stopped_at_s = float(guard_state.flags[3] * info.dt_s)
    cause = cause_of(info, blocks, limits, guard_state, named, foreseen)
    stop = stop_of(info, limits, guard_state, source, cause, blocks.fault())
    record, record_steps = slice(0, len(drive)), min(steps, len(drive))
    seen = _whole(part_of(named, slice(0, steps)), course, still, info.dt_s) if still.before else None
    played = bool(guard_state.flags[3] >= len(drive))
    return Outcome(
        part_of(named, record), record_steps, stop, fault, stopped_at_s, reason, seen, played, logs=blocks.logs
    )


def part_of(everything: Signals, steps: slice) -> Signals:
    """Return the signals of some steps."""
    names = Signals.__dataclass_fields__
    return replace(everything, **{name: getattr(everything, name)[..., steps] for name in names})


def _whole(played: Signals, course: _Course, still: Stillness, dt_s: float) -> Whole:
    own = len(played.corrected)
    after = slice(still.down, max(played.command_v.shape[-1] - course.record, still.down))
    return Whole(
        played.corrected, played.command_v, 0, course.before_v.T[:own], course.after_v[after].T[:own],
        -still.before * dt_s, (course.record + still.down) * dt_s,
    )  # fmt: skip


def _play_simulated(
    rig: SimulatedRig, dt_s: float, state: Step, limits: GuardLimits, guard_state: GuardState, course: _Course,
    log: Log,
) -> tuple[int, str, GuardLimits]:  # fmt: skip
    """Play in compiled code.

    The noise for the rest before the record is drawn last, so that the noise of the record does not depend on it. The
    channels' zeros are taken before, at a rest of their own. Returns steps, fault and limits of samples without zeros.
    """
    zeros_v = _zeros(rig, round(ZEROED_S / dt_s), state.samples.size)
    limits = without_zeros(limits, zeros_v)
    rig.restart()
    steps, before = len(course.drive), len(course.before_v)
    noise = rig.noise(steps + 1 + before)
    watch_virtual(rig.plant, rig.state, np.ascontiguousarray(noise[steps + 1 :]), course.before_v)
    scratch = np.zeros(2, dtype=np.int64)
    steps = run_virtual(
        rig.plant, rig.state, state, limits, guard_state, course.drive, course.record, noise, log, course.after_v,
        zeros_v, scratch,
    )  # fmt: skip
    fault = "the table ran into its end stop" if rig.state.fault[0] == plant_kernel.END_STOP else ""
    return steps, fault, limits


def _zeros(rig: SimulatedRig, samples: int, channels: int) -> Array:
    """Return the mean (c,) in V of the channels at rest; zero where the rig says that there is none to be taken."""
    noise = rig.noise_at_rest(samples)
    if noise is None:
        return np.zeros(channels)
    rig.restart()
    shown = np.zeros((samples, channels))
    watch_virtual(rig.plant, rig.state, noise, shown)
    return np.asarray(shown.mean(axis=0))


def _play_exchanging(
    rig: Rig, state: Step, limits: GuardLimits, guard_state: GuardState, course: _Course, log: Log
) -> tuple[int, str, GuardLimits]:
    """Play through `exchange`, one call per step, without true signals.

    The mean of the channels at rest is their zero; the limits for samples without that zero are returned.
    """
    samples = rig.arm()
    try:
        for shown in course.before_v:
            shown[:] = samples
            samples = rig.exchange(as_commands(np.zeros(state.command.size)))
        zeros_v = course.before_v.mean(axis=0) if len(course.before_v) else np.zeros(state.samples.size)
        limits, scratch = without_zeros(limits, zeros_v), np.zeros(2, dtype=np.int64)
        think = think_once.bind(state, limits, guard_state, course.drive, course.record, log, scratch)
        while log.done[0] < len(course.drive) and (guard_state.flags[0] != STOPPED or guard_state.flags[1] == END):
            if log.done[0] >= course.record:
                course.after_v[log.done[0] - course.record] = samples
            state.samples[:] = samples - zeros_v
            think()
            samples = rig.exchange(as_commands(state.command))
    except RigError as fault:
        return int(log.done[0]), str(fault), limits
    return int(log.done[0]), "", limits


@kept_part
def think(
    s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, k: int, share: float, came: bool,
    samples: Array, accel: Array,
) -> int:  # fmt: skip
    """Compute the step from `s.samples`, let the guard judge the measured samples, and log both as step k.

    `share`: factor on the command. `came`: whether there are measured samples; `samples` (c,) in V and `accel` (c,) in
    m/s^2 are these. They are the step's own arrays, except after a gap, when the step uses other samples. The commands
    that may be sent are in `s.command`. Returns the first column of the log that is not yet written.
    """
    step(s, drive)
    for a in range(s.command.size):
        s.command[a] *= share
    for i in range(len(s.measured_by)):  # the feedback has read the errors; the next step writes them anew
        s.error[i] += s.corrected[s.measured_by[i]] - accel[s.measured_by[i]]
    of_accel = s.commanded == ACCELERATION
    guard(limits, g, s.command, came, samples, accel, s.expected, s.error, of_accel, s.motion, s.force)
    note_sent(s)
    return note_step(log, s, k)


@part
def end_record(g: GuardState, k: int, record: int) -> None:
    """Start the way to rest after the last step of a record."""
    if k >= record:
        take_over(g, END, math.nan)


@entry
def think_once(
    s: Step, limits: GuardLimits, g: GuardState, drive: Array, record: int, log: Log, scratch: IntArray
) -> None:
    """Call `think` with the next row of the drive (n, 3) and log the time it took; scratch (2,)."""
    s, limits, g, drive, log, scratch = borrowed((s, limits, g, drive, log, scratch))
    k, start = log.done[0], monotonic_ns(scratch)
    end_record(g, k, record)
    think(s, limits, g, drive[k], log, k, 1.0, True, s.samples, s.corrected)
    log.columns[log.columns.shape[0] - 1, k] = monotonic_ns(scratch) - start
    log.done[0] = k + 1


@part
def stamp(log: Log, steps: int, count: int, before: int, now: int) -> int:
    """Log the mean duration of the last `count` steps before `steps`; return the time of their end."""
    place = log.columns.shape[0] - 1
    for i in range(count):
        log.columns[place, steps - 1 - i] = (now - before) / count
    return now


@entry
def watch_virtual(plant: SimulatedPlant, table: SimulatedState, noise: Array, shown_v: Array) -> None:
    """Write the samples (n, c) in V of a virtual table that is commanded to rest."""
    plant, table, noise, shown_v = borrowed((plant, table, noise, shown_v))
    for k in range(shown_v.shape[0]):
        plant.read_channels(table, noise[k], shown_v[k])
        plant.hold_command(table, 0.0)


@entry
def run_virtual(
    plant: SimulatedPlant,
    table: SimulatedState,
    s: Step,
    limits: GuardLimits,
    g: GuardState,
    drive: Array,
    record: int,
    noise: Array,
    log: Log,
    after_v: Array,
    zeros_v: Array,
    scratch: IntArray,
) -> int:
    """Play a complete run on the virtual table with the counted clock; return the number of steps.

    `after_v` (a, c) receives the samples after the record. `zeros_v` (c,): mean of the channels at rest, in V.
    """
    plant, table, s, limits, g = borrowed((plant, table, s, limits, g))
    drive, noise, log, after_v, zeros_v, scratch = borrowed((drive, noise, log, after_v, zeros_v, scratch))
    steps, before = 0, monotonic_ns(scratch)
    while steps < drive.shape[0] and table.fault[0] == 0 and (g.flags[0] != STOPPED or g.flags[1] == END):
        plant.read_channels(table, noise[steps], s.samples)
        end_record(g, steps, record)
        if steps >= record:
            for c in range(s.samples.size):
                after_v[steps - record, c] = s.samples[c] + 0.0
        for c in range(s.samples.size):
            s.samples[c] -= zeros_v[c]
        displacement = table.state[0]
        place = think(s, limits, g, drive[steps], log, steps, 1.0, True, s.samples, s.corrected)
        plant.hold_command(table, s.command[0])
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
