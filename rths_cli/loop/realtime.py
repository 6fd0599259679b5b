"""A run in real time: absolute deadlines, exchange, step, guard and log in compiled code, orders read in every step.

The runner is the master of the clock. Step k thinks on the samples of t_k; at t_(k+1) its command leaves and the
samples of t_(k+1) come back. A rig without a compiled exchange waits for its own sample clock in `exchange`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.clocks import SPIN_NS, IntArray, monotonic_ns, sleep_until
from rths_cli.compiled import entry, part
from rths_cli.loop.blocks import EXCITATION, Step
from rths_cli.loop.drive import think
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
from rths_cli.loop.log import Log
from rths_cli.lti import Array
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp import link as udp
from rths_cli.rigs.udp.wire import BRIDGED

IN_RAMP_UP, IN_RUN, IN_RAMP_DOWN, AT_REST = 2, 3, 4, 5  # states of DESIGN.md section 6; 0 idle, 1 armed
HOLD, SKIP, STOP = range(3)  # what an overrun does: the record waits, steps are caught up, the test stops
POLICIES = {"hold": HOLD, "skip": SKIP, "stop": STOP}
ANSWER_SHARE = 0.7  # of an interval, how long an answer may take: step and guard need the rest
PUNCTUAL = 0.125  # of an interval, how late a command may leave where steps are caught up; a later one waits for none

# places in Course.marks: start of the clock, intervals overrun, lost in a row, overrun in a row
START_NS, OVERRUNS, LOST_IN_A_ROW, OVERRUN_IN_A_ROW = range(4)


class Course(NamedTuple):
    """What a run in real time is: constants, and what the loop notes for those who watch it."""

    dt_ns: int
    spin_ns: int
    ramp: int  # steps in which the command fades in; the record begins after them
    record: int  # steps of the record
    lost_samples: int  # in a row, that may pass
    policy: int  # HOLD, SKIP or STOP
    signs: Array  # (c,) of the channels
    zeros_v: Array  # (c,) what each channel shows at rest
    volts: Array  # (c,) sensitivities in V per m/s^2
    orders: IntArray  # orders[0]: 0 go on, else stop; written by other threads
    marks: IntArray  # (4,)
    scratch: IntArray  # (2,)


def course(info: RigInfo, ramp_s: float, record: int, zeros_v: Array, orders: IntArray) -> Course:
    """Return the course of a run over `record` steps."""
    return Course(
        round(1e9 * info.dt_s), SPIN_NS, round(ramp_s / info.dt_s), record, info.limits.lost_samples,
        POLICIES[info.overrun], np.array([float(channel.sign) for channel in info.channels]), zeros_v,
        np.array([channel.sensitivity_v_per_m_s2 for channel in info.channels]), orders,
        np.zeros(4, dtype=np.int64), np.zeros(2, dtype=np.int64),
    )  # fmt: skip


@part
def take(course: Course, s: Step, samples_v: Array) -> None:
    """Give the step the samples of a rig, less their zeros, by the signs of their channels."""
    for c in range(s.samples.size):
        s.samples[c] = course.signs[c] * (samples_v[c] - course.zeros_v[c])


@part
def bridge(course: Course, s: Step, log: Log, k: int) -> None:
    """Give the step what the channels would show, where no samples came: the table as desired, the floors as estimated.

    What is desired at t_k is known from before; the estimated accelerations of the floors go on in a straight line.
    An excitation, and a step without lead, keep the last samples.
    """
    floors, lead = s.samples.size - 1, s.recent.size - 1
    if s.source == EXCITATION or lead == 0 or k < 2 or s.estimated.size < 3 * floors:
        return
    first = log.truths + s.samples.size + 5 + 2 * floors  # of the floors' accelerations in the log
    s.samples[0] = course.volts[0] * s.recent[0]
    for i in range(floors):
        last, before = log.columns[first + i, k - 1], log.columns[first + i, k - 2]
        s.samples[1 + i] = course.volts[1 + i] * (2.0 * last - before)


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

    `lost` as in the log, whose `done` is left to the caller: others read what stands before it. The drive (n, 3) is
    zero before and after the record; its last row is used for ever.
    """
    begun = monotonic_ns(course.scratch)
    if lost == 0:
        take(course, s, samples_v)
    else:
        bridge(course, s, log, k)
    obey(course, g, k)
    share = (k + 1) / (course.ramp + 1) if k < course.ramp else 1.0
    command, place = think(s, limits, g, drive[min(k, drive.shape[0] - 1)], log, k, share)
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
    return 0


@entry
def run_udp(
    link: udp.Link, course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, sends: bool
) -> int:
    """Play a whole run in real time; return the steps done. `sends` False: a rehearsal, nothing leaves.

    The samples of step 0 stand in the link. Deadlines are those of the course's clock, which begins now.
    """
    marks, sent, behind, waited, k = course.marks, 0, 0, 0, 0
    marks[START_NS] = monotonic_ns(course.scratch) + course.dt_ns
    command = last = 0.0
    due, punctual = 0, int(PUNCTUAL * course.dt_ns)
    while k < log.columns.shape[1] and g.flags[0] != STOPPED:
        lost = 0
        if behind > 0:
            lost, waited = 2, min(waited + 1, BRIDGED)  # the command of the step before never left: the rig goes on
            note_command(s, log, k - 1, gone_on(limits, last, waited, link.rate_v_s[0]))
        elif k > 0:
            due = k - 1
            deadline = deadline_of(course, due)
            late = sleep_until(deadline, course.spin_ns, course.scratch)
            note_exchange(log, k, late, 0)
            missed = too_late_for(course, due, punctual if course.policy == SKIP else course.dt_ns)
            behind = overrun(course, g, missed) if missed > 0 else 0
            if behind > 0:
                continue  # the command is as old as the stall by now: it never leaves
            gone = gone_on(limits, last, waited, link.rate_v_s[0])
            sent, last, waited = sent + 1, slewed(limits, gone, command), 0
            if last != command:
                command = last
                note_command(s, log, k - 1, command)
            if sends:
                link.rate_v_s[0] = g.motion[1] / limits.gain_m_per_v if course.policy == SKIP else math.nan
                lost = swap(link, course, g, log, deadline + late, late, command, sent, k)
        log.done[0] = k  # what left for the steps before is known from here on
        command = conduct(course, s, limits, g, drive, log, link.samples_v, lost, k)
        k += 1
        if lost != 2:
            missed = too_late_for(course, due + 1, punctual if course.policy == SKIP else 0)
            behind = overrun(course, g, missed) if k > 1 else 0
        else:
            behind -= 1
    log.done[0] = k
    return k


@part
def swap(
    link: udp.Link, course: Course, g: GuardState, log: Log, now: int, late: int, command: float, number: int, k: int
) -> int:
    """Send a command now, take the samples of this instant for step k; return 1 where none came in time."""
    outcome = udp.exchange(link, command, number, now + int(ANSWER_SHARE * course.dt_ns))
    note_exchange(log, k, late, monotonic_ns(course.scratch) - now)
    judge(course, g, outcome)
    return 1 if outcome == udp.LOST else 0


@part
def note_command(s: Step, log: Log, k: int, command: float) -> None:
    """Note for step k, the last one, what left instead of what it computed: the staircase of its hold is that."""
    s.sent[0] = command
    log.columns[log.truths + s.corrected.size + 3, k] = command


@part
def gone_on(limits: GuardLimits, last: float, waited: int, rate_v_s: float) -> float:
    """Return what a target holds `waited` intervals after the last command, which told it a rate, or none (no number).

    It goes no farther than range and stroke, and so nothing that is slewed from there does.
    """
    if waited == 0 or not math.isfinite(rate_v_s):
        return last
    most = min(limits.command_v, limits.stroke_m / limits.gain_m_per_v)
    return min(max(last + waited * limits.dt_s * rate_v_s, -most), most)


@part
def slewed(limits: GuardLimits, last: float, command: float) -> float:
    """Return a command no farther from the last one that left than velocity and rate limits allow in an interval.

    The guard sees to that from step to step; steps that were caught up left nothing, and their sum may be more.
    """
    farthest = limits.dt_s * min(limits.velocity_m_s / limits.gain_m_per_v, limits.command_rate_v_s)
    return min(max(command, last - farthest), last + farthest)


@entry
def conduct_once(
    course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, samples_v: Array
) -> float:
    """Do what `conduct` does for a rig whose exchange is written in Python."""
    k = log.done[0]
    command = conduct(course, s, limits, g, drive, log, samples_v, 0, k)
    log.done[0] = k + 1
    return command
