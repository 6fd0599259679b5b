"""Play a prepared run on an open rig: the loop in a thread of real-time class, those who watch it beside it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

import numpy as np

from rths_cli.errors import crash_note
from rths_cli.loop.diagnosis import cause_of
from rths_cli.loop.drive import Outcome, Whole, part_of
from rths_cli.loop.guard import END, INTERRUPT, OPERATOR, REASONS, TERMINATION, WATCHER_FAILED
from rths_cli.loop.log import Signals, signals
from rths_cli.loop.performance import Performance, perform, rehearse
from rths_cli.loop.realtime import AT_REST, OVERRUNS
from rths_cli.loop.reasons import reason_of
from rths_cli.loop.scheduling import Granted, real_time
from rths_cli.lti import Array
from rths_cli.rigs.interface import Rig

GLANCE_S = 0.05  # between two looks of those who watch
STOP_KEY, CTRL_C, SIGTERM, NO_WATCH = (
    reason - OPERATOR + 1 for reason in (OPERATOR, INTERRUPT, TERMINATION, WATCHER_FAILED)
)  # orders[0]
ORDERS = {"SIGINT": CTRL_C, "SIGTERM": SIGTERM, "SIGHUP": SIGTERM, "SIGTSTP": STOP_KEY}  # Ctrl-Z would freeze the loop
Watch = Callable[[Performance], None]


@dataclass(frozen=True)
class Performed:
    """How a run in real time went, what the system granted its loop, and how many intervals it overran.

    `watch_fault`: what ended those who watched, empty where nothing did.
    """

    outcome: Outcome
    granted: Granted
    overruns: int
    watch_fault: str = ""


class _Loop(threading.Thread):
    """The thread of the loop; `work` is called in it with what the system granted.

    Who waits for it waits for `ended`: an exception that interrupts Thread.join makes Python take a thread that runs
    for ended.
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
    """Play a prepared run on an open rig; `watch` looks at it every 50 ms.

    Ctrl-C, SIGTERM, SIGHUP and a failing watcher lead the table to rest, however often they come; the outcome's reason
    tells of them.
    """
    loop = _Loop(lambda: perform(rig, run))
    watch_fault = _watched(loop, run, watch)
    if loop.error:
        raise loop.error
    assert loop.granted is not None
    return Performed(_outcome(run, str(loop.result)), loop.granted, int(run.course.marks[OVERRUNS]), watch_fault)


def rehearse_watched(run: Performance, seconds: float) -> tuple[Array, Array]:
    """Do what `performance.rehearse` does, in a thread of real-time class; it ends with whatever interrupts this."""
    loop = _Loop(lambda: rehearse(run, seconds))
    try:
        loop.start()
        loop.ended.wait()
    except BaseException:
        order(run, SIGTERM)  # or the process would wait for it
        raise
    if loop.error:
        raise loop.error
    return loop.result  # type: ignore[return-value]


def order(run: Performance, what: int) -> None:
    """Have the loop lead its table to rest; the first order stays."""
    if run.course.orders[0] == 0:
        run.course.orders[0] = what


def _watched(loop: _Loop, run: Performance, watch: Watch) -> str:
    """Run the loop to its end whatever arrives meanwhile; return what ended the watching."""
    fault = ""
    with _signals_as_orders(run):
        loop.start()
        while not loop.ended.wait(GLANCE_S):
            try:
                if not fault:
                    watch(run)
            except KeyboardInterrupt:  # a signal of before that was swallowed on its way
                order(run, CTRL_C)
            except Exception as error:
                fault = f"{type(error).__name__}, {crash_note()}"
                order(run, NO_WATCH)
            except BaseException:  # SIGTERM, as the command line raises it
                order(run, SIGTERM)
    return fault


@contextmanager
def _signals_as_orders(run: Performance) -> Iterator[None]:
    """Let signals order the loop to stop and raise nothing here; whoever took them before is told, too.

    Python gives signals to its main thread alone: in any other there is nothing to do.
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
    """Return a signal handler that gives an order and tells the one before."""

    def take(number: int, frame: FrameType | None) -> None:
        order(run, what)
        if callable(before):
            with suppress(BaseException):
                before(number, frame)

    return take


def _outcome(run: Performance, fault: str) -> Outcome:
    """Return how the run went, and its signals on the record; an order that came after the record is its reason."""
    ramp, still, record_steps, dt_s = run.course.ramp, run.course.still, run.course.record, run.info.dt_s
    everything = signals(run.log, len(run.info.channels), run.step.estimated.size)
    steps = int(np.clip(run.log.done[0] - ramp, 0, record_steps))
    stopped_at_s = float((run.guard.flags[3] - ramp) * dt_s)
    reason, order_given = int(run.guard.flags[1]), int(run.course.orders[0])
    record = slice(ramp, ramp + record_steps)
    cause = cause_of(run.info, run.blocks, run.limits, run.guard, everything)
    told = reason_of(run.info, run.limits, run.guard, run.step.source, cause)
    if reason == END and order_given:
        reason = OPERATOR + order_given - 1
        told = REASONS[reason]
    whole = whole_of(part_of(everything, slice(0, int(run.log.done[0]))), still, ramp, dt_s)
    played = bool(run.guard.flags[3] >= ramp + record_steps)
    signals_of_record, ramp_s = part_of(everything, record), (ramp - still) * dt_s
    return Outcome(signals_of_record, steps, told, fault, stopped_at_s, reason, whole, played, ramp_s)


def whole_of(everything: Signals, still: int, ramp: int, dt_s: float) -> Whole | None:
    """Return a run with the rest before it and, where it got so far, after it; its signals begin with `still` steps at
    rest, its record after `ramp` steps. None without such steps. Samples at rest are NaN where none came, and end with
    the last that came."""
    if not still or not everything.samples_v.size:
        return None
    at_rest = np.flatnonzero(everything.state == AT_REST)
    came = everything.lost == 0.0 if everything.lost.size else np.ones(everything.command_v.size, dtype=bool)
    shown = np.where(came, everything.samples_v, np.nan)
    end = int(at_rest[0]) if at_rest.size else shown.shape[1]
    last = 1 + int(np.max(np.flatnonzero(came), initial=-1))
    return Whole(
        everything.corrected, everything.command_v, ramp, shown[:, :still], shown[:, end:last], -ramp * dt_s,
        (end - ramp) * dt_s, ~came,
    )  # fmt: skip
