"""A run in real time: absolute deadlines, exchange, step, guard and log in compiled code, orders read in every step.

The runner is the master of the clock. Step k thinks on the samples of t_k; at t_(k+1) its command leaves and the
samples of t_(k+1) come back. A rig without a compiled exchange waits for its own sample clock in `exchange`.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rths_cli.clocks import SPIN_NS, IntArray, monotonic_ns, sleep_until
from rths_cli.compiled import entry, part
from rths_cli.control.blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.loop.blocks import EXCITATION, Step, assemble
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
    fresh_guard,
    take_over,
)
from rths_cli.loop.log import Log, empty_log
from rths_cli.lti import Array
from rths_cli.rigs.interface import Rig, RigInfo
from rths_cli.rigs.udp import link as udp
from rths_cli.rigs.udp.rig import UdpRig
from rths_cli.rigs.udp.wire import BRIDGED

IN_RAMP_UP, IN_RUN, IN_RAMP_DOWN, AT_REST = 2, 3, 4, 5  # states of DESIGN.md section 6; 0 idle, 1 armed
HOLD, SKIP, STOP = range(3)  # what an overrun does: the record waits, steps are caught up, the test stops
POLICIES = {"hold": HOLD, "skip": SKIP, "stop": STOP}
ANSWER_SHARE = 0.7  # of an interval, how long an answer may take: step and guard need the rest
RESERVE = 0.99  # of the velocity limit, in a step that catches up
RAMP_UP_S = 1.0
RAMP_DOWN_S = 3.0  # at most: the guard is back at zero within 2 s

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
        take_over(g, OPERATOR + order - 1)
    if k >= course.ramp + course.record:
        take_over(g, END)


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
    course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, samples_v: Array, lost: int
) -> float:
    """Do the next step on samples of a rig in V, (c,), and note it; return the command in V.

    `lost` as in the log. The drive (n, 3) is zero before and after the record; its last row is used for ever.
    """
    k, begun = log.done[0], monotonic_ns(course.scratch)
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
    log.done[0] = k + 1
    return command


@part
def note_exchange(log: Log, late_ns: int, took_ns: int) -> None:
    """Note when the exchange began that brings the samples of the next step, and how long it took."""
    k, place = log.done[0], log.columns.shape[0] - 5
    if k < log.columns.shape[1]:
        log.columns[place, k], log.columns[place + 1, k] = late_ns, took_ns


@part
def judge(course: Course, g: GuardState, outcome: int) -> None:
    """Count what an exchange brought, and stop where too much was lost or the rig has a fault."""
    marks = course.marks
    marks[LOST_IN_A_ROW] = marks[LOST_IN_A_ROW] + 1 if outcome == udp.LOST else 0
    if outcome == udp.FAULT:
        take_over(g, RIG_FAULT)
    elif marks[LOST_IN_A_ROW] > course.lost_samples:
        take_over(g, LOST)


@part
def overrun(course: Course, g: GuardState, deadline_ns: int) -> int:
    """Count the intervals that have passed whole since a deadline; return how many steps to catch up."""
    marks = course.marks
    missed = (monotonic_ns(course.scratch) - deadline_ns) // course.dt_ns
    if missed <= 0:
        marks[OVERRUN_IN_A_ROW] = 0
        return 0
    marks[OVERRUNS] += missed
    marks[OVERRUN_IN_A_ROW] += missed
    if course.policy == STOP or marks[OVERRUN_IN_A_ROW] > course.lost_samples:
        take_over(g, OVERRUN)
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
    marks, sent, behind, waited = course.marks, 0, 0, 0
    marks[START_NS] = monotonic_ns(course.scratch) + course.dt_ns
    command = last = 0.0
    deadline = marks[START_NS]
    while log.done[0] < log.columns.shape[1] and g.flags[0] != STOPPED:
        lost = 0
        if behind > 0:
            lost, waited = 2, min(waited + 1, BRIDGED)  # the command of the step before never left: the rig goes on
            note_command(s, log, log.done[0] - 1, last + waited * limits.dt_s * link.rate_v_s[0])
        elif log.done[0] > 0:
            sent, last, waited = sent + 1, command, 0
            link.rate_v_s[0] = g.motion[1] / limits.gain_m_per_v  # a target may go on by it where the next is late
            deadline = marks[START_NS] + (log.done[0] - 1) * course.dt_ns
            if sends:
                lost = swap(link, course, g, log, deadline, command, sent)
            else:
                note_exchange(log, sleep_until(deadline, course.spin_ns, course.scratch), 0)
        command = conduct(course, s, limits, g, drive, log, link.samples_v, lost)
        if lost != 2:
            behind = overrun(course, g, deadline) if sent > 0 else 0
        else:
            behind -= 1
            if behind == 0:
                command = held_back(limits, g, last, command)
                note_command(s, log, log.done[0] - 1, command)
    return log.done[0]


@part
def swap(link: udp.Link, course: Course, g: GuardState, log: Log, deadline: int, command: float, number: int) -> int:
    """Send a command at its deadline and take the samples of that instant; return 1 where none came in time."""
    late = sleep_until(deadline, course.spin_ns, course.scratch)
    outcome = udp.exchange(link, command, number, deadline + late + int(ANSWER_SHARE * course.dt_ns))
    note_exchange(log, late, monotonic_ns(course.scratch) - deadline - late)
    judge(course, g, outcome)
    return 1 if outcome == udp.LOST else 0


@part
def note_command(s: Step, log: Log, k: int, command: float) -> None:
    """Note for step k what left instead of what it computed."""
    log.columns[log.truths + s.corrected.size + 3, k] = command


@part
def held_back(limits: GuardLimits, g: GuardState, last: float, command: float) -> float:
    """Return the command after steps that were caught up, no farther from the last that left than one step may go."""
    fastest = min(limits.velocity_m_s / limits.gain_m_per_v, limits.command_rate_v_s)
    farthest = RESERVE * fastest * limits.dt_s
    command = min(max(command, last - farthest), last + farthest)
    g.motion[0] = limits.gain_m_per_v * command
    return command


@entry
def conduct_once(
    course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, samples_v: Array
) -> float:
    """Do what `conduct` does for a rig whose exchange is written in Python."""
    return conduct(course, s, limits, g, drive, log, samples_v, 0)


@dataclass(frozen=True)
class Performance:
    """All arrays of one run in real time, made before the rig is opened."""

    info: RigInfo
    course: Course
    step: Step
    limits: GuardLimits
    guard: GuardState
    drive: Array
    log: Log


def prepare(
    info: RigInfo,
    blocks: Blocks,
    source: int,
    drive: Array,
    limits: GuardLimits,
    zeros_v: Array | None = None,
    orders: IntArray | None = None,
    ramp_s: float = RAMP_UP_S,
) -> Performance:
    """Return a run over `drive` (n, 3) at rest: a ramp-up before it, room for the way back to rest after it.

    `zeros_v` (c,): what the channels show at rest. `orders` (1 or more,): see Course.
    """
    state, channels = assemble(blocks, source), len(info.channels)
    orders = np.zeros(1, dtype=np.int64) if orders is None else orders
    zeros_v = np.zeros(channels) if zeros_v is None else zeros_v
    way = course(info, ramp_s, len(drive), zeros_v, orders)
    limits = limits._replace(saturation_v=limits.saturation_v - np.abs(zeros_v))
    whole = np.vstack([np.zeros((way.ramp, 3)), drive, np.zeros((round(RAMP_DOWN_S / info.dt_s), 3))])
    log = empty_log(len(whole), channels, state.estimated.size)
    return Performance(info, way, state, limits, fresh_guard(channels), np.ascontiguousarray(whole), log)


def perform(rig: Rig, run: Performance) -> str:
    """Play a prepared run on an open rig, bring the table to rest; return the rig's faults, empty without one.

    To be called in the thread that has the real-time class. How the test ended stands in the guard's flags.
    """
    fault, unrest = "", ""
    try:
        fault = _perform_udp(rig, run) if isinstance(rig, UdpRig) else _perform_exchanging(rig, run)
    except RigError as error:
        fault = str(error)
    finally:
        unrest = _brought_to_rest(rig)
    return "; ".join(filter(None, (fault, unrest)))


def _brought_to_rest(rig: Rig) -> str:
    """Bring the table to rest; return why that is in doubt, empty when it is not."""
    try:
        rig.rest()
    except RigError as error:
        return str(error)
    if isinstance(rig, UdpRig) and not rig.at_rest:
        return f"the target {rig.peer} did not confirm that its table is at rest; look at it before you go near"
    return ""


def _perform_udp(rig: UdpRig, run: Performance) -> str:
    rig.arm()
    run_udp(rig.link, run.course, run.step, run.limits, run.guard, run.drive, run.log, True)
    return rig.fault()


def _perform_exchanging(rig: Rig, run: Performance) -> str:
    """Play through `exchange`, one call per step: the rig's own clock sets the pace."""
    samples = rig.arm()
    given = np.array(samples, dtype=float)
    once = conduct_once.bind(run.course, run.step, run.limits, run.guard, run.drive, run.log, given)
    while run.log.done[0] < run.log.columns.shape[1] and run.guard.flags[0] != STOPPED:
        given[:] = samples
        samples = rig.exchange(once())
    return ""


def rehearse(run: Performance, seconds: float) -> tuple[Array, Array]:
    """Do steps of a prepared run at its rate, on samples that are zero; nothing leaves.

    Return how late every step began and how long it took, both (n,) in s. The run is spent: prepare another one.
    """
    steps = min(round(seconds / run.info.dt_s), run.log.columns.shape[1])
    log = run.log._replace(columns=np.ascontiguousarray(run.log.columns[:, :steps]))
    course = run.course._replace(policy=HOLD, lost_samples=steps)  # what is late is judged afterwards
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        link = udp.fresh_link(door, np.zeros(2, dtype=np.uint64), len(run.info.channels))
        run_udp(link, course, run.step, run.limits, run.guard, run.drive, log, False)
    done = slice(1, int(log.done[0]))
    return log.columns[-5, done] * 1e-9, log.columns[-1, done] * 1e-9
