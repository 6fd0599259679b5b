"""A run in real time from Python: its arrays made beforehand, played on an open rig, or rehearsed without one."""

from __future__ import annotations

import socket
from dataclasses import dataclass

import numpy as np

from rths_cli.clocks import IntArray
from rths_cli.control.blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.loop.blocks import Step, assemble
from rths_cli.loop.foresight import foresight_of, no_foresight
from rths_cli.loop.guard import (
    BRAKING,
    END,
    NO_CHANNEL,
    OVERRUN,
    RETURN_RATE,
    RUNNING,
    STOPPED,
    GuardLimits,
    GuardState,
    fresh_guard,
    without_zeros,
)
from rths_cli.loop.log import Log, empty_log
from rths_cli.loop.realtime import (
    AT_REST_STEPS,
    HOLD,
    OVERRUN_IN_A_ROW,
    OVERRUNS,
    STOP,
    Course,
    conduct_once,
    course,
    run_udp,
)
from rths_cli.lti import Array
from rths_cli.rig_info import BRAKE_SHARE
from rths_cli.rigs.interface import Rig, RigInfo
from rths_cli.rigs.ni.rig import NiRig
from rths_cli.rigs.udp import link as udp
from rths_cli.rigs.udp.rig import UdpRig

RAMP_UP_S = 1.0
RETURN_DECAYS = 16.0  # of the return to zero, until a micrometre is left


@dataclass(frozen=True)
class Performance:
    """All arrays of one run in real time, made before the rig is opened."""

    info: RigInfo
    blocks: Blocks
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
    still_s: tuple[float, float] = (0.0, 0.0),
) -> Performance:
    """Return a run over `drive` (n, 3) at rest: a ramp-up before it, room for the way back to rest after it.

    `zeros_v` (c,): what the channels show at rest. `orders` (1 or more,): see Course. `still_s`: how long the table is
    watched at rest before the ramp-up and after a whole record.
    """
    state, channels = assemble(blocks, source), len(info.channels)
    orders = np.zeros(1, dtype=np.int64) if orders is None else orders
    zeros_v = np.zeros(channels) if zeros_v is None else zeros_v
    told = info.can.takes_trajectories and info.overrun == "skip"
    foresight = foresight_of(blocks, source, info.dt_s) if told else no_foresight(channels)
    planned = course(info, ramp_s, len(drive), zeros_v, orders, foresight, still_s)
    limits = without_zeros(limits, zeros_v)
    end = round(way_to_rest_s(limits) / info.dt_s) + planned.rest
    whole = np.vstack([np.zeros((planned.ramp, 3)), drive, np.zeros((end, 3))])
    log = empty_log(len(whole), channels, state.estimated.size)
    return Performance(info, blocks, planned, state, limits, fresh_guard(channels), np.ascontiguousarray(whole), log)


def way_to_rest_s(limits: GuardLimits) -> float:
    """Return how long the guard may take to rest a table from the worst state in s."""
    stroke = min(limits.stroke_m, limits.gain_m_per_v * limits.command_v)
    fastest = min(limits.velocity_m_s, limits.gain_m_per_v * limits.command_rate_v_s)
    braking = BRAKE_SHARE * limits.acceleration_m_s2
    rate = min(RETURN_RATE, np.e * fastest / stroke, np.sqrt(braking / stroke))
    return float(fastest / braking + RETURN_DECAYS / rate)


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
    play = run_udp.bind(rig.link, run.course, run.step, run.limits, run.guard, run.drive, run.log, True)
    rig.arm()  # the target's watchdog runs from here on
    play()
    return rig.fault()


def _perform_exchanging(rig: Rig, run: Performance) -> str:
    """Play through `exchange`, one call per step: the rig's own clock sets the pace."""
    samples = rig.arm()
    given, missed = np.array(samples, dtype=float), 0
    once = conduct_once.bind(run.course, run.step, run.limits, run.guard, run.drive, run.log, given)
    while run.log.done[0] < run.log.columns.shape[1] and not _is_over(run):
        given[:] = samples
        samples = rig.exchange(once())
        if isinstance(rig, NiRig):
            note_missed(run, rig.missed - missed)
            missed = rig.missed
    return ""


def _is_over(run: Performance) -> bool:
    """Tell whether a run has ended, as `realtime.is_over` does."""
    marks, flags = run.course.marks, run.guard.flags
    if flags[0] != STOPPED:
        return False
    marks[AT_REST_STEPS] += 1
    return bool(flags[1] != END or marks[AT_REST_STEPS] > run.course.rest or run.course.orders[0] != 0)


def note_missed(run: Performance, edges: int) -> None:
    """Note how many edges of a rig's own clock passed before the exchange that just ended, as overrun intervals.

    The record waits for them, whatever the policy: the card has held its command. The test stops at the first where
    that is the policy, and where more than `lost_samples` have passed in a row.
    """
    marks, k = run.course.marks, int(run.log.done[0])
    marks[OVERRUNS] += edges
    marks[OVERRUN_IN_A_ROW] = marks[OVERRUN_IN_A_ROW] + edges if edges else 0
    if k < run.log.columns.shape[1]:
        run.log.columns[-5, k] = edges * run.course.dt_ns
    too_many = marks[OVERRUN_IN_A_ROW] > run.course.lost_samples
    if edges and (run.course.policy == STOP or too_many) and run.guard.flags[0] == RUNNING:
        run.guard.flags[:3] = BRAKING, OVERRUN, NO_CHANNEL
        run.guard.seen[0] = marks[OVERRUN_IN_A_ROW]


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
