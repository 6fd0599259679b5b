"""A real-time run from Python: prepare its arrays, rehearse without a rig, or play it on an open one."""

from __future__ import annotations

import math
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from types import FrameType

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.errors import RigError, crash_note
from rths_cli.findings import Finding
from rths_cli.findings.of_stop import TEXTS
from rths_cli.loop.diagnosis import Foreseen, cause_of
from rths_cli.loop.fallback_commands import foresight_of, no_foresight
from rths_cli.loop.guard import (
    BRAKING,
    END,
    INTERRUPT,
    NO_CHANNEL,
    OPERATOR,
    OVERRUN,
    RETURN_RATE,
    RIG_FAULT,
    RUNNING,
    STOPPED,
    TERMINATION,
    WATCHER_FAILED,
    GuardLimits,
    GuardState,
    fresh_guard,
    without_zeros,
)
from rths_cli.loop.realtime_loop import (
    AT_REST,
    AT_REST_STEPS,
    HOLD,
    IN_RAMP_DOWN,
    OVERRUN_IN_A_ROW,
    OVERRUNS,
    STOP,
    Course,
    conduct_once,
    course,
    run_udp,
)
from rths_cli.loop.run_log import Log, Signals, empty_log, signals, sizes_of
from rths_cli.loop.scheduling import Granted, real_time
from rths_cli.loop.simulated_time_run import Outcome, Whole, check_commands, part_of
from rths_cli.loop.step_arrays import Step, assemble
from rths_cli.loop.stop_reasons import stop_of
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import BRAKE_SHARE
from rths_cli.rigs.interface import (
    LinkedRig,
    Rig,
    RigInfo,
    SteppedRig,
    as_commands,
    linked,
    missed_intervals,
    stepped,
    truthful,
)
from rths_cli.rigs.udp import link as udp
from rths_cli.rigs.udp.stepping_frames import WATCHDOG

RAMP_UP_S = 1.0
NOT_AT_REST = {100: "its mean is", 101: "its noise is"}  # reasons of a step that was armed (rths_step.h)
RETURN_DECAYS = 16.0  # time constants of the return to zero until a micrometre is left


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
    truth: dict[str, Array] = field(default_factory=dict)  # true signals (., n), of a rig that tells them
    foreseen: Foreseen = field(default_factory=dict)  # as in `cause_of`


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
    """Return a run over `drive` (n, 3), with steps for the ramp-up before it and for the way to rest after it.

    `zeros_v` (c,): mean of the channels at rest, in V. `orders` (1 or more,): see Course. `still_s`: time at rest that
    is recorded before the ramp-up and after a complete record, in s.
    """
    state, channels = assemble(blocks, source), len(info.all_channels)
    sizes = sizes_of(state)
    check_commands(info, blocks)
    orders = np.zeros(1, dtype=np.int64) if orders is None else orders
    zeros_v = np.zeros(channels) if zeros_v is None else zeros_v
    foresight = foresight_of(blocks, source, info.dt_s) if info.previews and blocks.linear else no_foresight(channels)
    planned = course(info, ramp_s, len(drive), zeros_v, orders, foresight, still_s)
    limits = without_zeros(limits, zeros_v)
    end = round(way_to_rest_s(limits) / info.dt_s) + planned.rest
    whole = np.vstack([np.zeros((planned.ramp, 3)), drive, np.zeros((end, 3))])
    log, guard = empty_log(len(whole), sizes), fresh_guard(sizes.channels, sizes.actuators, sizes.axes, sizes.further)
    return Performance(info, blocks, planned, state, limits, guard, np.ascontiguousarray(whole), log)


def way_to_rest_s(limits: GuardLimits) -> float:
    """Return the longest time in s that the guard needs to bring the table to rest, from the worst state."""
    stroke = min(limits.stroke_m, limits.gain_m_per_v * limits.command_v)
    fastest = min(limits.velocity_m_s, limits.gain_m_per_v * limits.command_rate_v_s)
    braking = BRAKE_SHARE * limits.acceleration_m_s2
    rate = min(RETURN_RATE, math.e * fastest / stroke, np.sqrt(braking / stroke))
    return float(fastest / braking + RETURN_DECAYS / rate)


def perform(rig: Rig, run: Performance) -> str:
    """Play a prepared run on an open rig and bring the table to rest; return the rig's faults, "" without one.

    Call it in the thread that has the real-time class. The guard's flags hold the end of the test.
    """
    fault, unrest = "", ""
    try:
        there, itself = linked(rig), stepped(rig)
        if itself is not None:
            return _followed(itself, run)
        fault = _perform_linked(there, run) if there is not None else _perform_exchanging(rig, run)
    except RigError as error:
        fault = str(error)
    finally:
        unrest = _brought_to_rest(rig)
    return "; ".join(filter(None, (fault, unrest)))


def _brought_to_rest(rig: Rig) -> str:
    """Bring the table to rest; return a sentence if that is not confirmed, else ""."""
    try:
        rig.rest()
    except RigError as error:
        return str(error)
    there = linked(rig)
    if there is not None and not there.at_rest:
        return f"the target {there.peer} did not confirm that its table is at rest; look at it before you go near"
    return ""


def _perform_linked(rig: LinkedRig, run: Performance) -> str:
    play = run_udp.bind(rig.link, run.course, run.step, run.limits, run.guard, run.drive, run.log, True)
    rig.arm()  # the target's watchdog runs from here on
    play()
    return rig.fault()


FOLLOW_S = 5e-3  # between two questions for rows that are not made yet


def _followed(rig: SteppedRig, run: Performance) -> str:
    """Have a rig's own computer play a run, and take its log as it is made; return what is lost of it, "" if nothing.

    The reason of the end is the rig's, or RIG_FAULT where it fell silent. Raises RigError for a silent rig.
    """
    course, columns, flags, done, gaps = run.course, run.log.columns, run.guard.flags, 0, []
    try:
        rig.begin(run.drive[course.ramp : course.ramp + course.record])
        while True:
            told = rig.fetch(done, bool(course.orders[0]))
            rows = told.rows[: columns.shape[1] - told.first]
            if told.first > done and len(rows):
                gaps.append(f"steps {done} to {told.first - 1} of its log are lost: they were not fetched in time")
            if len(rows):
                columns[:, told.first : told.first + len(rows)] = rows.T
                done = run.log.done[0] = told.first + len(rows)
            elif told.state == AT_REST and done >= min(told.made, columns.shape[1]):
                break
            else:
                time.sleep(FOLLOW_S)
    except RigError as error:
        flags[:4] = STOPPED, RIG_FAULT, NO_CHANNEL, done
        raise RigError(f"{error}; the first {done} steps of its log were stored") from None
    still = signals(run.log, sizes_of(run.step))
    rest_v = np.concatenate([still.samples_v[:, : course.still], still.further_v[:, : course.still]])
    if done > course.still:
        course.zeros_v[:] = rest_v.mean(axis=1)
    ending = np.flatnonzero(still.state[:done] >= IN_RAMP_DOWN)
    flags[:4] = STOPPED, told.reason, told.channel, ending[0] if ending.size else done
    run.guard.seen[0] = told.seen
    if told.reason == OPERATOR and course.orders[0]:
        flags[1] = OPERATOR + course.orders[0] - 1
    if told.reason in NOT_AT_REST:
        channel = run.info.all_channels[min(max(told.channel, 0), len(run.info.all_channels) - 1)].name
        flags[1] = RIG_FAULT
        gaps.append(f"channel {channel} does not rest: {NOT_AT_REST[told.reason]} {told.seen:.3g} V; nothing moved")
    elif told.faults:
        flags[1] = RIG_FAULT
        silent = f"it heard nothing of this host for {rig.watchdog_s:g} s and led its table to rest"
        gaps.append(silent if told.faults == WATCHDOG else f"fault {told.faults}")
    elif gaps:
        flags[1] = RIG_FAULT
    return f"rig {run.info.name}: {'; '.join(gaps)}" if gaps else ""


def _perform_exchanging(rig: Rig, run: Performance) -> str:
    """Play through `exchange`, one call per step, at the rate of the rig's own clock."""
    samples = rig.arm()
    teller = truthful(rig)
    if teller is not None:
        _begin_truth(run)
    given, missed = np.array(samples, dtype=float), 0
    once = conduct_once.bind(run.course, run.step, run.limits, run.guard, run.drive, run.log, given)
    while run.log.done[0] < run.log.columns.shape[1] and not is_over(run):
        given[:] = samples
        once()
        samples = rig.exchange(as_commands(run.step.command))
        if teller is not None:
            _note_truth(run, *teller.truth())
        passed = missed_intervals(rig)
        if passed is not None:
            note_missed(run, passed - missed)
            missed = passed
    return ""


def _begin_truth(run: Performance) -> None:
    """Make room for the truth of each step; the table starts at zero."""
    steps = run.log.columns.shape[1]
    run.truth["true_velocity_m_s"] = np.full((len(run.info.channels), steps), np.nan)
    run.truth["true_displacement_m"] = np.full(steps, np.nan)
    run.truth["true_displacement_m"][0] = 0.0


def _note_truth(run: Performance, velocity_m_s: Array, place_m: float) -> None:
    """Note the truth of the interval that the last exchange took."""
    k = int(run.log.done[0])
    run.truth["true_velocity_m_s"][:, k - 1] = velocity_m_s
    run.truth["true_displacement_m"][k : k + 1] = place_m


def is_over(run: Performance) -> bool:
    """Return whether a run has ended, as `realtime_loop.is_over` does."""
    marks, flags = run.course.marks, run.guard.flags
    if flags[0] != STOPPED:
        return False
    marks[AT_REST_STEPS] += 1
    return bool(flags[1] != END or marks[AT_REST_STEPS] > run.course.rest or run.course.orders[0] != 0)


def note_missed(run: Performance, edges: int) -> None:
    """Count the edges of a rig's own clock that were missed before the last exchange, as overrun intervals.

    The record waits for them, whatever the policy, because the card has held its command. The test stops at the first
    one if that is the policy, and if more than `lost_samples` were missed in a row.
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
    """Compute steps of a prepared run at its rate with samples of zero; nothing is sent.

    Returns the delay at which each step began and its computing time, both (n,) in s. The run cannot be used again.
    """
    steps = min(round(seconds / run.info.dt_s), run.log.columns.shape[1])
    log = run.log._replace(columns=np.ascontiguousarray(run.log.columns[:, :steps]))
    course = run.course._replace(policy=HOLD, lost_samples=steps)  # delays are judged afterwards
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        link = udp.fresh_link(door, np.zeros(2, dtype=np.uint64), len(run.info.all_channels))
        run_udp(link, course, run.step, run.limits, run.guard, run.drive, log, False)
    done = slice(1, int(log.done[0]))
    return log.columns[-5, done] * 1e-9, log.columns[-1, done] * 1e-9


GLANCE_S = 0.05  # interval between two calls of the watcher
STOP_KEY, CTRL_C, SIGTERM, NO_WATCH = (
    reason - OPERATOR + 1 for reason in (OPERATOR, INTERRUPT, TERMINATION, WATCHER_FAILED)
)  # orders[0]
ORDERS = {"SIGINT": CTRL_C, "SIGTERM": SIGTERM, "SIGHUP": SIGTERM, "SIGTSTP": STOP_KEY}  # Ctrl-Z would freeze the loop
Watch = Callable[[Performance], None]


@dataclass(frozen=True)
class Performed:
    """Result of a run in real time."""

    outcome: Outcome
    granted: Granted  # what the system granted the loop's thread
    overruns: int  # intervals
    watch_fault: str = ""  # exception of the watcher, "" if there was none


class _Loop(threading.Thread):
    """The thread of the loop, in which `work` is called with real-time scheduling.

    Wait for `ended`, not with Thread.join: if an exception interrupts join, Python takes a running thread for ended.
    """

    def __init__(self, work: Callable[[], object]) -> None:
        super().__init__(name="rths-loop")
        self._work = work
        self.result: object = None
        self.granted: Granted | None = None
        self.error: BaseException | None = None
        self.ended = threading.Event()

    def run(self) -> None:
        try:
            with real_time() as self.granted:
                self.result = self._work()
        except BaseException as error:
            self.error = error
        finally:
            self.ended.set()


def perform_watched(rig: Rig, run: Performance, watch: Watch) -> Performed:
    """Play a prepared run on an open rig; `watch` is called every 50 ms.

    Ctrl-C, SIGTERM, SIGHUP and a failing watcher bring the table to rest, however often they occur; the outcome states
    them as its reason.
    """
    loop = _Loop(lambda: perform(rig, run))
    watch_fault = _watched(loop, run, watch)
    if loop.error:
        raise loop.error
    assert loop.granted is not None
    return Performed(_outcome(run, str(loop.result)), loop.granted, int(run.course.marks[OVERRUNS]), watch_fault)


def rehearse_watched(run: Performance, seconds: float) -> tuple[Array, Array]:
    """Call `rehearse` in a thread of real-time class; an exception in the calling thread ends it."""
    loop = _Loop(lambda: rehearse(run, seconds))
    try:
        loop.start()
        loop.ended.wait()
    except BaseException:
        order(run, SIGTERM)  # otherwise the process would wait for the thread
        raise
    if loop.error:
        raise loop.error
    return loop.result  # type: ignore[return-value]


def order(run: Performance, what: int) -> None:
    """Ask the loop to bring its table to rest; the first order is kept."""
    if run.course.orders[0] == 0:
        run.course.orders[0] = what


def _watched(loop: _Loop, run: Performance, watch: Watch) -> str:
    """Run the loop to its end, whatever signals arrive; return the watcher's exception, "" if there was none."""
    fault = ""
    with _signals_as_orders(run):
        loop.start()
        while not loop.ended.wait(GLANCE_S):
            try:
                if not fault:
                    watch(run)
            except KeyboardInterrupt:  # from a signal that arrived before the handlers were set
                order(run, CTRL_C)
            except Exception as error:
                fault = f"{type(error).__name__}, {crash_note()}"
                order(run, NO_WATCH)
            except BaseException:  # SIGTERM, as the command line raises it
                order(run, SIGTERM)
    return fault


@contextmanager
def _signals_as_orders(run: Performance) -> Iterator[None]:
    """Handle signals as orders to stop the loop, without raising; the former handlers are called, too.

    Python delivers signals only to its main thread; in any other thread nothing is done.
    """
    before = {}
    if threading.current_thread() is threading.main_thread():
        for name, what in ORDERS.items():
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            if number is not None and signal.getsignal(number) not in (None, signal.SIG_IGN):  # nohup stays in force
                before[number] = signal.signal(number, _giver(run, what, signal.getsignal(number)))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _giver(run: Performance, what: int, before: object) -> Callable[[int, FrameType | None], None]:
    """Return a signal handler that gives an order and then calls the former handler."""

    def take(number: int, frame: FrameType | None) -> None:
        order(run, what)
        if callable(before):
            with suppress(BaseException):
                before(number, frame)

    return take


def _outcome(run: Performance, fault: str) -> Outcome:
    """Return the outcome of the run, with its signals during the record; an order after the record is its reason."""
    ramp, still, record_steps, dt_s = run.course.ramp, run.course.still, run.course.record, run.info.dt_s
    everything = replace(signals(run.log, sizes_of(run.step)), **run.truth)
    steps = int(np.clip(run.log.done[0] - ramp, 0, record_steps))
    stopped_at_s = float((run.guard.flags[3] - ramp) * dt_s)
    reason, order_given = int(run.guard.flags[1]), int(run.course.orders[0])
    record = slice(ramp, ramp + record_steps)
    cause = cause_of(run.info, run.blocks, run.limits, run.guard, everything, run.foreseen)
    stop = stop_of(run.info, run.limits, run.guard, run.step.source, cause, run.blocks.fault())
    if reason == END and order_given:
        reason = OPERATOR + order_given - 1
        stop = Finding(f"stop.{tuple(TEXTS)[reason - 1]}")
    whole = whole_of(part_of(everything, slice(0, int(run.log.done[0]))), still, ramp, dt_s)
    played = bool(run.guard.flags[3] >= ramp + record_steps)
    signals_of_record, ramp_s = part_of(everything, record), (ramp - still) * dt_s
    return Outcome(signals_of_record, steps, stop, fault, stopped_at_s, reason, whole, played, ramp_s, run.blocks.logs)


def whole_of(everything: Signals, still: int, ramp: int, dt_s: float) -> Whole | None:
    """Return the complete run with the rest before it and, if reached, the rest after it; None if `still` is 0.

    The signals begin with `still` steps at rest; the record begins after `ramp` steps. Lost samples at rest are NaN;
    the series end with the last sample that came.
    """
    if not still or not everything.samples_v.size:
        return None
    at_rest = np.flatnonzero(everything.state == AT_REST)
    came = everything.lost == 0.0 if everything.lost.size else np.ones(everything.command_v.shape[-1], dtype=bool)
    shown = np.where(came, everything.samples_v, np.nan)
    end = int(at_rest[0]) if at_rest.size else shown.shape[1]
    last = 1 + int(np.max(np.flatnonzero(came), initial=-1))
    return Whole(
        everything.corrected, everything.command_v, ramp, shown[:, :still], shown[:, end:last], -ramp * dt_s,
        (end - ramp) * dt_s, ~came,
    )  # fmt: skip
