"""The compiled real-time loop: absolute deadlines, exchange, step, guard, log; stop orders read in every step.

The runner is the master of the clock. Step k thinks on the samples of t_k; at t_(k+1) its command leaves and the
samples of t_(k+1) come back. A rig without a compiled exchange waits for its own sample clock in `exchange`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.loop.bumpless_transfer import (
    STANDS_V,
    WANTED_V,
    Returning,
    drift_to,
    fresh_drift,
    give_back,
    note_lost,
    rejoin,
    returning,
)
from rths_cli.loop.dropouts import bridge
from rths_cli.loop.fallback_commands import Foresight, foresee, foresee_rest, lay_way
from rths_cli.loop.guard import (
    END,
    LOST,
    OPERATOR,
    OVERRUN,
    RIG_FAULT,
    RUNNING,
    STOPPED,
    GuardLimits,
    GuardState,
    take_over,
)
from rths_cli.loop.run_log import CAUGHT_UP, MIXED, NO_ANSWER, Log
from rths_cli.loop.simulated_time_run import think
from rths_cli.loop.step_arrays import Step
from rths_cli.numerics.clock import IntArray, monotonic_ns, sleep_until, spin_of
from rths_cli.numerics.compiled import entry, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp import link as udp
from rths_cli.rigs.udp.late_command_trajectory import Way, place_after

IN_RAMP_UP, IN_RUN, IN_RAMP_DOWN, AT_REST = 2, 3, 4, 5  # states of docs/decisions/safety.md; 0 idle, 1 armed
HOLD, SKIP, STOP = range(3)  # what an overrun does: the record waits, steps are caught up, the test stops
POLICIES = {"hold": HOLD, "skip": SKIP, "stop": STOP}
ANSWER_SHARE = 0.7  # of an interval, how long an answer may take: step and guard need the rest
PUNCTUAL = 0.125  # of an interval, how late a command may leave where steps are caught up; a later one waits for none

# places in Course.marks: start of the clock, intervals overrun, lost in a row, overrun in a row, intervals by which the
# record waited, steps at rest at last, 1 where the rig obeys no more after the record
START_NS, OVERRUNS, LOST_IN_A_ROW, OVERRUN_IN_A_ROW, HELD, AT_REST_STEPS, GAVE_UP = range(7)
MARKS = 7


class Course(NamedTuple):
    """What a run in real time is: constants, and what the loop notes for those who watch it."""

    dt_ns: int
    spin_ns: int
    ramp: int  # steps before the record: the table is watched at rest, then the command fades in
    still: int  # steps at rest, the first of these
    rest: int  # steps in which the table is watched at rest after a whole record
    record: int  # steps of the record
    lost_samples: int  # in a row, that may pass
    policy: int  # HOLD, SKIP or STOP
    signs: Array  # (c,) of the channels
    zeros_v: Array  # (c,) what each channel shows at rest
    foresight: Foresight  # of the commands to come
    returning: Returning  # of samples after some were lost
    drift: Array  # (7,) where the rig is, and how that goes back to where it should be
    orders: IntArray  # orders[0]: 0 go on, else stop; written by other threads
    marks: IntArray  # (MARKS,)
    scratch: IntArray  # (2,)


def course(
    info: RigInfo, ramp_s: float, record: int, zeros_v: Array, orders: IntArray, foresight: Foresight,
    still_s: tuple[float, float] = (0.0, 0.0),
) -> Course:  # fmt: skip
    """Return the course of a run over `record` steps; `still_s`: rest before the ramp, and at the end."""
    still, rest = (round(each / info.dt_s) for each in still_s)
    return Course(
        round(1e9 * info.dt_s), spin_of(round(1e9 * info.dt_s)), still + round(ramp_s / info.dt_s), still, rest, record,
        info.limits.lost_samples, POLICIES[info.overrun], np.array([float(channel.sign) for channel in info.channels]),
        zeros_v, foresight, returning(info), fresh_drift(), orders,
        np.zeros(MARKS, dtype=np.int64), np.zeros(2, dtype=np.int64),
    )  # fmt: skip


@part
def take(course: Course, s: Step, samples_v: Array) -> None:
    """Give the step the samples of a rig, less their zeros, by the signs of their channels."""
    for c in range(s.samples.size):
        s.samples[c] = course.signs[c] * (samples_v[c] - course.zeros_v[c])


@part
def take_or_bridge(course: Course, s: Step, samples_v: Array, lost: int) -> int:
    """Give the step samples: those of the rig, those that stand in for lost ones, or a mix after a gap. Return `lost`,
    or MIXED."""
    if lost != 0:
        note_lost(course.returning)
        bridge(s)
        return lost
    take(course, s, samples_v)
    return MIXED if give_back(course.returning, s) else 0


@part
def obey(course: Course, g: GuardState, k: int) -> None:
    """End the test where somebody asks for it, or where the record ends."""
    order = course.orders[0]
    if order != 0:
        take_over(g, OPERATOR + order - 1, math.nan)
    if k >= course.ramp + course.record:
        take_over(g, END, math.nan)


@part
def state_of(course: Course, g: GuardState, k: int) -> int:
    """Return the state of the test in step k."""
    if g.flags[0] == STOPPED:
        return AT_REST
    if g.flags[0] != RUNNING:
        return IN_RAMP_DOWN
    return IN_RAMP_UP if k < course.ramp else IN_RUN


@part
def share_of(course: Course, k: int) -> float:
    """Return the share of the command that is asked for in step k."""
    if k < course.still:
        return 0.0
    return (k + 1 - course.still) / (course.ramp + 1 - course.still) if k < course.ramp else 1.0


@part
def is_over(course: Course, g: GuardState) -> bool:
    """Tell whether the run has ended: the table rests and, where the record has ended, was watched long enough, or the
    rig obeys no more."""
    if course.marks[GAVE_UP] == 1:
        return True
    if g.flags[0] != STOPPED:
        return False
    course.marks[AT_REST_STEPS] += 1
    return g.flags[1] != END or course.marks[AT_REST_STEPS] > course.rest or course.orders[0] != 0


@part
def conduct(
    course: Course,
    s: Step,
    limits: GuardLimits,
    g: GuardState,
    drive: Array,
    log: Log,
    samples_v: Array,
    lost: int,
    k: int,
) -> float:
    """Do step k on samples of a rig in V, (c,), and note it; return the command in V.

    `lost`: 0, NO_ANSWER or CAUGHT_UP. The log's `done` is left to the caller: others read what stands before it. The
    drive (n, 3) is zero before and after the record; its last row is used for ever.
    """
    begun = monotonic_ns(course.scratch)
    lost = take_or_bridge(course, s, samples_v, lost)
    came, mixed, heard = lost == 0 or lost == MIXED, lost == MIXED, course.returning
    obey(course, g, k)
    row, carried, share = drive[min(k, drive.shape[0] - 1)], s.shaping[0], share_of(course, k)
    samples, accel = (heard.came, heard.accel) if mixed else (s.samples, s.corrected)
    command, place = think(s, limits, g, row, log, k, share, came, samples, accel)
    course.drift[WANTED_V] = command + share * (s.shaping[0] - carried) if g.flags[0] == RUNNING else command
    for c in range(samples_v.size):
        log.columns[place + c, k] = samples_v[c]
    place += samples_v.size
    log.columns[place + 2, k] = lost
    log.columns[place + 3, k] = state_of(course, g, k)
    log.columns[place + 4, k] = monotonic_ns(course.scratch) - begun
    return command


@part
def note_exchange(log: Log, k: int, late_ns: int, took_ns: int) -> None:
    """Note when the exchange began that brings the samples of step k, and how long it took."""
    place = log.columns.shape[0] - 5
    if k < log.columns.shape[1]:
        log.columns[place, k], log.columns[place + 1, k] = late_ns, took_ns


@part
def judge(course: Course, g: GuardState, outcome: int) -> None:
    """Count what an exchange brought, and stop where too much was lost or the rig has a fault."""
    marks = course.marks
    marks[LOST_IN_A_ROW] = marks[LOST_IN_A_ROW] + 1 if outcome == udp.LOST else 0
    if outcome == udp.FAULT:
        marks[GAVE_UP] = 1 if g.flags[1] == END else 0
        take_over(g, RIG_FAULT, math.nan)
    elif marks[LOST_IN_A_ROW] > course.lost_samples:
        take_over(g, LOST, float(marks[LOST_IN_A_ROW]))


@part
def deadline_of(course: Course, number: int) -> int:
    """Return when exchange `number`, counted from 0, is due on the monotonic clock in ns, as things stand."""
    return course.marks[START_NS] + number * course.dt_ns


@part
def too_late_for(course: Course, number: int, tolerance_ns: int) -> int:
    """Return how many exchanges, from `number` on, were due longer ago than a tolerance."""
    late = monotonic_ns(course.scratch) - deadline_of(course, number)
    return max((late - tolerance_ns + course.dt_ns) // course.dt_ns, 0)


@part
def overrun(course: Course, g: GuardState, missed: int) -> int:
    """Count the exchanges that are too late to be made; return how many steps to catch up.

    Where the record waits (HOLD) the clock is moved, so that no interval is counted twice.
    """
    marks = course.marks
    if missed == 0:
        marks[OVERRUN_IN_A_ROW] = 0
        return 0
    marks[OVERRUNS] += missed
    marks[OVERRUN_IN_A_ROW] += missed
    if course.policy == STOP or marks[OVERRUN_IN_A_ROW] > course.lost_samples:
        take_over(g, OVERRUN, float(marks[OVERRUN_IN_A_ROW]))
    if course.policy == SKIP:
        return missed
    marks[START_NS] += missed * course.dt_ns
    marks[HELD] += missed
    return 0


@entry
def run_udp(
    link: udp.Link, course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, sends: bool
) -> int:
    """Play a whole run in real time; return the steps done. `sends` False: a rehearsal, nothing leaves.

    The samples of step 0 stand in the link. Deadlines are those of the course's clock, which begins now.
    """
    marks, behind, waited, k = course.marks, 0, 0, 0
    marks[START_NS] = monotonic_ns(course.scratch) + course.dt_ns
    command = 0.0
    due, punctual = 0, int(PUNCTUAL * course.dt_ns)
    while k < log.columns.shape[1] and not is_over(course, g):
        lost = 0
        if behind > 0:
            lost, waited = CAUGHT_UP, waited + 1
            pass_by(course, s, limits, log, link.way, waited, k)
        elif k > 0:
            due = k - 1
            deadline = deadline_of(course, due)
            late = sleep_until(deadline, course.spin_ns, course.scratch)
            note_exchange(log, k, late, 0)
            missed = too_late_for(course, due, punctual if course.policy == SKIP else course.dt_ns)
            behind = overrun(course, g, missed) if missed > 0 else 0
            if behind > 0:
                continue  # the command is as old as the stall by now: it never leaves
            waited = 0
            command = leave(course, s, limits, log, link.way, command, k)
            if sends:
                lost = swap(link, course, g, log, deadline + late, late, command, k)
        log.done[0] = k  # what left for the steps before is known from here on
        command = conduct(course, s, limits, g, drive, log, link.samples_v, lost, k)
        k += 1
        if lost != CAUGHT_UP:
            missed = too_late_for(course, due + 1, punctual if course.policy == SKIP else 0)
            behind = overrun(course, g, missed) if k > 1 else 0
        else:
            behind -= 1
        if behind <= 0:
            look_ahead(course, s, limits, g, drive, log, k)
    log.done[0] = k
    return k


@part
def pass_by(course: Course, s: Step, limits: GuardLimits, log: Log, way: Way, waited: int, k: int) -> None:
    """Let an interval pass in which the command of step k - 1 never left: the rig goes on from the last that did."""
    drift_to(course.drift, limits, place_after(way, waited))
    note_command(s, log, k - 1, course.drift[STANDS_V])


@part
def leave(course: Course, s: Step, limits: GuardLimits, log: Log, way: Way, command: float, k: int) -> float:
    """Return what leaves for the command of step k - 1, noted where that differs, and tell how it goes on."""
    left = rejoin(course.drift, limits, s.shaping[1], command)
    if left != command:
        note_command(s, log, k - 1, left)
    way.volts[0] = left
    lay_way(way, course.foresight, limits, course.drift)
    return left


@part
def look_ahead(course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, k: int) -> None:
    """Foresee the commands after that of step k - 1, and count the time with that step's."""
    begun, f = monotonic_ns(course.scratch), course.foresight
    if f.points > 0 and g.flags[0] == RUNNING:
        foresee(f, s, drive, k, course.ramp + course.record - 1, share_of(course, k))
    elif f.points > 0:
        foresee_rest(f, limits, g)
    log.columns[log.columns.shape[0] - 1, k - 1] += monotonic_ns(course.scratch) - begun


@part
def swap(link: udp.Link, course: Course, g: GuardState, log: Log, now: int, late: int, command: float, k: int) -> int:
    """Send a command now, take the samples of this instant for step k; return NO_ANSWER where none came, else 0.

    Its number counts the instants of the run, also those at which nothing left because they were caught up or waited.
    """
    number = k + course.marks[HELD]
    outcome = udp.exchange(link, command, number, now + int(ANSWER_SHARE * course.dt_ns))
    note_exchange(log, k, late, monotonic_ns(course.scratch) - now)
    judge(course, g, outcome)
    return NO_ANSWER if outcome == udp.LOST else 0


@part
def note_command(s: Step, log: Log, k: int, command: float) -> None:
    """Note for step k, the last one, what left instead of what it computed: the staircase of its hold is that."""
    s.sent[0] = command
    log.columns[log.truths + s.corrected.size + 3, k] = command


@entry
def conduct_once(
    course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, samples_v: Array
) -> float:
    """Do what `conduct` does for a rig whose exchange is written in Python."""
    k = log.done[0]
    command = conduct(course, s, limits, g, drive, log, samples_v, 0, k)
    log.done[0] = k + 1
    return command
