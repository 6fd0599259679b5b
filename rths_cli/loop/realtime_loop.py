"""The compiled real-time loop: absolute deadlines, exchange, step, guard, log; stop orders read in every step.

The runner is the clock master. Step k computes with the samples of t_k. At t_(k+1) its command is sent and the samples
of t_(k+1) come back. A rig without a compiled exchange waits for its own sample clock in `exchange`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.loop.dropouts import bridge
from rths_cli.loop.fallback_commands import (
    STANDS_V,
    WANTED_V,
    Foresight,
    Returning,
    drift_to,
    foresee,
    foresee_rest,
    fresh_drift,
    give_back,
    lay_way,
    note_lost,
    rejoin,
    returning,
)
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
from rths_cli.loop.lost_samples import CAUGHT_UP, MIXED, NO_ANSWER
from rths_cli.loop.run_log import Log
from rths_cli.loop.scheduling import PUNCTUAL
from rths_cli.loop.simulated_time_run import think
from rths_cli.loop.step_arrays import Step
from rths_cli.numerics.clock import IntArray, monotonic_ns, sleep_until, spin_of
from rths_cli.numerics.compiled import borrowed, entry, kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp import link as udp
from rths_cli.rigs.udp.late_command_trajectory import COASTS_S, Way, coast, place_after

IN_RAMP_UP, IN_RUN, IN_RAMP_DOWN, AT_REST = 2, 3, 4, 5  # states of docs/decisions/safety.md; 0 idle, 1 armed
HOLD, SKIP, STOP = range(3)  # after an overrun: the record waits, steps are caught up, the test stops
POLICIES = {"hold": HOLD, "skip": SKIP, "stop": STOP}
SLOWLY = 64  # part of an interval by which a late frame moves the deadlines of a target's clock
ANSWER_SHARE = 0.7  # longest time of an answer over the interval; step and guard need the rest

# indices in Course.marks: start of the clock, overrun intervals, consecutive lost samples, consecutive overruns,
# intervals by which the record waited, steps at rest at the end, 1 if the rig no longer obeys after the record
START_NS, OVERRUNS, LOST_IN_A_ROW, OVERRUN_IN_A_ROW, HELD, AT_REST_STEPS, GAVE_UP = range(7)
MARKS = 7


class Course(NamedTuple):
    """A run in real time: its constants, its state, and the counters that other threads read."""

    dt_ns: int
    spin_ns: int  # time before a deadline in which the loop watches the clock instead of sleeping
    ramp: int  # steps before the record: the table at rest, then the ramp-up of the command
    still: int  # number of those steps at rest
    rest: int  # steps at rest that are recorded after a complete record
    record: int  # steps of the record
    lost_samples: int  # tolerated number of consecutive lost samples
    policy: int  # HOLD, SKIP or STOP
    signs: Array  # (c,) of the channels, the further ones included
    zeros_v: Array  # (c,) mean of each channel at rest
    foresight: Foresight  # prediction of the coming commands
    returning: Returning  # return of samples after a gap
    drift: Array  # (7,) return of the command after an outage, see bumpless_transfer.fresh_drift
    coasts: int  # intervals over which a rig on a plain link comes to a stand while no command comes
    orders: IntArray  # orders[0]: 0 continue, else stop; written by other threads
    marks: IntArray  # (MARKS,)
    scratch: IntArray  # (2,)


def course(
    info: RigInfo, ramp_s: float, record: int, zeros_v: Array, orders: IntArray, foresight: Foresight,
    still_s: tuple[float, float] = (0.0, 0.0),
) -> Course:  # fmt: skip
    """Return the course of a run over `record` steps; `still_s`: time at rest before the ramp, and at the end, in s."""
    still, rest = (round(each / info.dt_s) for each in still_s)
    return Course(
        round(1e9 * info.dt_s), spin_of(round(1e9 * info.dt_s)), still + round(ramp_s / info.dt_s), still, rest, record,
        info.limits.lost_samples, POLICIES[info.overrun], np.array([channel.sign for channel in info.all_channels]),
        zeros_v, foresight, returning(info), fresh_drift(), max(round(COASTS_S / info.dt_s), 1), orders,
        np.zeros(MARKS, dtype=np.int64), np.zeros(2, dtype=np.int64),
    )  # fmt: skip


@part
def take(course: Course, s: Step, samples_v: Array) -> None:
    """Write a rig's samples (c,) to the step: minus their zeros, times the signs of their channels."""
    for c in range(s.samples.size):
        s.samples[c] = course.signs[c] * (samples_v[c] - course.zeros_v[c])


@kept_part
def take_or_bridge(course: Course, s: Step, samples_v: Array, lost: int) -> int:
    """Write samples to the step: the rig's, substituted ones if they were lost, or a mix after a gap.

    Returns `lost` (0, NO_ANSWER or CAUGHT_UP), or MIXED.
    """
    if lost != 0:
        note_lost(course.returning)
        bridge(s)
        return lost
    take(course, s, samples_v)
    return MIXED if give_back(course.returning, s) else 0


@part
def obey(course: Course, g: GuardState, k: int) -> None:
    """Start the way to rest if an order was given, or if the record has ended."""
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
    """Return the factor on the command in step k: 0 at rest, rising in the ramp-up, 1 in the record."""
    if k < course.still:
        return 0.0
    return (k + 1 - course.still) / (course.ramp + 1 - course.still) if k < course.ramp else 1.0


@part
def is_over(course: Course, g: GuardState) -> bool:
    """Return whether the run has ended.

    It has ended if the table rests and, after a complete record, its rest was recorded long enough, or if the rig no
    longer obeys.
    """
    if course.marks[GAVE_UP] == 1:
        return True
    if g.flags[0] != STOPPED:
        return False
    course.marks[AT_REST_STEPS] += 1
    return g.flags[1] != END or course.marks[AT_REST_STEPS] > course.rest or course.orders[0] != 0


@kept_part
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
    """Compute step k from a rig's samples (c,) in V and log it; return the (first) command in V.

    `lost`: 0, NO_ANSWER or CAUGHT_UP. The caller advances the log's `done`, because other threads read all steps before
    it. The drive (n, 3) is zero before and after the record; its last row is used for all later steps.
    """
    begun = monotonic_ns(course.scratch)
    lost = take_or_bridge(course, s, samples_v, lost)
    came, mixed, heard = lost == 0 or lost == MIXED, lost == MIXED, course.returning
    obey(course, g, k)
    row, carried, share = drive[min(k, drive.shape[0] - 1)], s.carried[0], share_of(course, k)
    samples, accel = (heard.came, heard.accel) if mixed else (s.samples, s.corrected)
    place = think(s, limits, g, row, log, k, share, came, samples, accel)
    command = s.command[0]
    course.drift[WANTED_V] = command + share * (s.carried[0] - carried) if g.flags[0] == RUNNING else command
    for c in range(samples_v.size):
        log.columns[place + c, k] = samples_v[c]
    place += samples_v.size
    log.columns[place + 2, k] = lost
    log.columns[place + 3, k] = state_of(course, g, k)
    log.columns[place + 4, k] = monotonic_ns(course.scratch) - begun
    return command


@part
def note_exchange(log: Log, k: int, late_ns: int, took_ns: int) -> None:
    """Log how late the exchange for the samples of step k began, and how long it took, in ns."""
    place = log.columns.shape[0] - 5
    if k < log.columns.shape[1]:
        log.columns[place, k], log.columns[place + 1, k] = late_ns, took_ns


@part
def judge(course: Course, g: GuardState, outcome: int) -> None:
    """Count the outcome of an exchange; stop the test if too many samples were lost or if the rig has a fault."""
    marks = course.marks
    marks[LOST_IN_A_ROW] = marks[LOST_IN_A_ROW] + 1 if outcome == udp.LOST else 0
    if outcome == udp.FAULT:
        marks[GAVE_UP] = 1 if g.flags[1] == END else 0
        take_over(g, RIG_FAULT, math.nan)
    elif marks[LOST_IN_A_ROW] > course.lost_samples:
        take_over(g, LOST, float(marks[LOST_IN_A_ROW]))


@part
def deadline_of(course: Course, number: int) -> int:
    """Return the deadline of exchange `number`, from 0, on the monotonic clock in ns, as it is at present."""
    return course.marks[START_NS] + number * course.dt_ns


@part
def too_late_for(course: Course, number: int, tolerance_ns: int) -> int:
    """Return the number of exchanges, from `number` on, whose deadline passed longer ago than a tolerance."""
    late = monotonic_ns(course.scratch) - deadline_of(course, number)
    return max((late - tolerance_ns + course.dt_ns) // course.dt_ns, 0)


@part
def overrun(course: Course, g: GuardState, missed: int) -> int:
    """Count the exchanges that are too late to be made; return the number of steps to catch up.

    If the record waits (HOLD), the clock's start is moved, so that no interval is counted twice.
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


@part
def lag(course: Course, g: GuardState, missed: int, before: int) -> int:
    """Count the intervals by which the runner lags behind the frames of a target, and stop the test if they are too
    many; return them. `before`: those at the exchange before. No sample is lost: the frames wait."""
    marks = course.marks
    marks[OVERRUNS] += max(missed - before, 0)
    if missed > course.lost_samples:
        take_over(g, OVERRUN, float(missed))
    return missed


@entry
def run_udp(
    link: udp.Link, course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, sends: bool
) -> int:
    """Play a complete run in real time; return the number of steps. `sends` False: a rehearsal, nothing is sent.

    The link holds the samples of step 0. The course's clock, which sets the deadlines, starts now; where the target
    has the clock, with its step 0. A command then leaves as soon as it is computed, before the target's next instant.
    """
    link, course, s, limits, g, drive, log = borrowed((link, course, s, limits, g, drive, log))
    marks, behind, waited, lagging, sent_k, k = course.marks, 0, 0, 0, 0, 0
    paced = sends and link.plain[udp.OF_TARGET] == 1  # its frames set the deadlines
    catches_up = paced and course.policy == SKIP  # its frames wait for a runner that is late
    begun = link.status[udp.RECEIVED_NS] if paced else monotonic_ns(course.scratch)
    marks[START_NS] = begun + course.dt_ns
    command = sent_v = 0.0
    due, punctual = 0, course.dt_ns // 2 if link.plain[udp.PLAIN] == 1 else int(PUNCTUAL * course.dt_ns)
    while k < log.columns.shape[1] and not is_over(course, g):
        lost = 0
        if behind > 0:
            lost, waited = CAUGHT_UP, waited + 1
            pass_by(course, s, limits, log, link.way, waited, k)
        elif k > 0:
            due = k - 1
            deadline = deadline_of(course, due)
            late = 0 if paced else sleep_until(deadline, course.spin_ns, course.scratch)
            note_exchange(log, k, late, 0)
            missed = too_late_for(course, due, punctual if course.policy == SKIP else course.dt_ns)
            if catches_up:
                lagging = lag(course, g, missed, lagging)
                deadline = max(deadline, monotonic_ns(course.scratch) - course.dt_ns // 2)
            else:
                behind = overrun(course, g, missed) if missed > 0 else 0
            if behind > 0:
                continue  # the command is as old as the stall: it is not sent
            waited = 0
            command = leave(course, s, limits, log, link.way, command, k)
            if link.plain[udp.PLAIN] == 1:
                coast(link.way, (command - sent_v) / (k - sent_k), course.coasts)
                sent_v, sent_k = command, k
            if sends:
                lost = swap(link, course, g, log, deadline + late, late, command, k)
            if paced and lost == 0:
                note_acted(s, log, k - 2, link.acted_v[0], lagging)
                follow(course, link.status[udp.RECEIVED_NS] - deadline_of(course, due))
        log.done[0] = k  # from here on the commands sent for all earlier steps are known
        command = conduct(course, s, limits, g, drive, log, link.samples_v, lost, k)
        k += 1
        if catches_up:
            behind = 0
        elif lost != CAUGHT_UP:
            missed = too_late_for(course, due + 1, punctual if course.policy == SKIP else 0)
            behind = overrun(course, g, missed) if k > 1 else 0
        else:
            behind -= 1
        if behind <= 0:
            look_ahead(course, s, limits, g, drive, log, k)
    log.done[0] = k
    return k


@part
def follow(course: Course, after_ns: int) -> None:
    """Move the deadlines towards a target's clock, whose frame came so long after its deadline.

    No frame comes too early, so an early one counts at once, and a late one, which the machine may have held, slowly.
    """
    course.marks[START_NS] += min(after_ns, course.dt_ns // SLOWLY)


@part
def note_acted(s: Step, log: Log, k: int, acted_v: float, lagging: int) -> None:
    """Log the command that acted in step k, as the target's frame tells it, where the runner lagged behind."""
    if lagging > 0 and k >= 0:
        log.columns[place_of_command(s, log), k] = acted_v


@part
def pass_by(course: Course, s: Step, limits: GuardLimits, log: Log, way: Way, waited: int, k: int) -> None:
    """Account for an interval in which the command of step k - 1 was not sent: the rig follows the last preview."""
    drift_to(course.drift, limits, place_after(way, waited))
    note_command(s, log, k - 1, course.drift[STANDS_V])


@kept_part
def leave(course: Course, s: Step, limits: GuardLimits, log: Log, way: Way, command: float, k: int) -> float:
    """Return the command to send for step k - 1, log it if it differs from the computed one, and write its preview."""
    left = rejoin(course.drift, limits, s.bit_v, command)
    if left != command:
        note_command(s, log, k - 1, left)
    way.volts[0] = left
    lay_way(way, course.foresight, limits, course.drift)
    return left


@part
def look_ahead(course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, k: int) -> None:
    """Predict the commands after that of step k - 1; the time counts as computing time of that step."""
    begun, f = monotonic_ns(course.scratch), course.foresight
    if f.points > 0 and g.flags[0] == RUNNING:
        foresee(f, s, drive, k, course.ramp + course.record - 1, share_of(course, k))
    elif f.points > 0:
        foresee_rest(f, limits, g)
    log.columns[log.columns.shape[0] - 1, k - 1] += monotonic_ns(course.scratch) - begun


@kept_part
def swap(link: udp.Link, course: Course, g: GuardState, log: Log, now: int, late: int, command: float, k: int) -> int:
    """Send a command and receive the samples of this instant for step k; return NO_ANSWER if none came, else 0.

    The command's number counts all instants of the run, also those without a command.
    """
    number = k + course.marks[HELD]
    outcome = udp.exchange(link, command, number, now + int(ANSWER_SHARE * course.dt_ns))
    note_exchange(log, k, late, monotonic_ns(course.scratch) - now)
    judge(course, g, outcome)
    return NO_ANSWER if outcome == udp.LOST else 0


@part
def place_of_command(s: Step, log: Log) -> int:
    """Return the row of a log that holds the (first) command."""
    return log.truths + s.corrected.size + s.motion.size


@part
def note_command(s: Step, log: Log, k: int, command: float) -> None:
    """Log the command that was sent for the last step k instead of the computed one; its hold causes the alias."""
    s.sent[0, 0] = command
    log.columns[place_of_command(s, log), k] = command


@entry
def conduct_once(
    course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, samples_v: Array
) -> None:
    """Compute one step with `conduct`, for a rig whose exchange is written in Python; its commands are in `s`."""
    course, s, limits, g, drive, log, samples_v = borrowed((course, s, limits, g, drive, log, samples_v))
    k = log.done[0]
    conduct(course, s, limits, g, drive, log, samples_v, 0, k)
    log.done[0] = k + 1
