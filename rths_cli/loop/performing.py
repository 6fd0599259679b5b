"""Play a prepared run on an open rig: the loop in a thread of real-time class, those who watch it beside it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields, replace

import numpy as np

from rths_cli.loop.drive import Outcome, reason_of
from rths_cli.loop.guard import INTERRUPT, OPERATOR, TERMINATION
from rths_cli.loop.log import Signals, signals
from rths_cli.loop.realtime import OVERRUNS, Performance, perform, rehearse
from rths_cli.loop.scheduling import Granted, real_time
from rths_cli.lti import Array
from rths_cli.rigs.interface import Rig

GLANCE_S = 0.05  # between two looks of those who watch
STOP_KEY, CTRL_C, SIGTERM = (reason - OPERATOR + 1 for reason in (OPERATOR, INTERRUPT, TERMINATION))  # orders[0]
Watch = Callable[[Performance], None]


@dataclass(frozen=True)
class Performed:
    """How a run in real time went, what the system granted its loop, and how many intervals it overran."""

    outcome: Outcome
    granted: Granted
    overruns: int


class _Loop(threading.Thread):
    """The thread of the loop; `work` is called in it with what the system granted."""

    def __init__(self, work: Callable[[], object]) -> None:
        super().__init__(name="rths-loop")
        self._work = work
        self.result: object = None
        self.granted: Granted | None = None
        self.error: BaseException | None = None
        self.ended = threading.Event()  # a signal that arrives in Thread.join makes Python 3.11 take a thread for dead

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

    Ctrl-C, SIGTERM and a failing watcher lead the table to rest first. An interrupt is then told by the outcome's
    reason; what else the watcher raised is raised again.
    """
    loop = _Loop(lambda: perform(rig, run))
    raised = _watched(loop, run, watch)
    if loop.error or raised:
        raise loop.error or raised  # type: ignore[misc]
    assert loop.granted is not None
    return Performed(_outcome(run, str(loop.result)), loop.granted, int(run.course.marks[OVERRUNS]))


def rehearse_watched(run: Performance, seconds: float) -> tuple[Array, Array]:
    """Do what `realtime.rehearse` does, in a thread of real-time class."""
    loop = _Loop(lambda: rehearse(run, seconds))
    loop.start()
    loop.ended.wait()
    if loop.error:
        raise loop.error
    return loop.result  # type: ignore[return-value]


def order(run: Performance, what: int) -> None:
    """Have the loop lead its table to rest; the first order stays."""
    if run.course.orders[0] == 0:
        run.course.orders[0] = what


def _watched(loop: _Loop, run: Performance, watch: Watch) -> Exception | None:
    """Run the loop to its end whatever arrives meanwhile; return what the watcher raised."""
    raised: Exception | None = None
    loop.start()
    try:
        while not loop.ended.is_set():
            try:
                loop.ended.wait(GLANCE_S)
                if raised is None:
                    watch(run)
            except KeyboardInterrupt:
                order(run, CTRL_C)
            except Exception as error:
                raised = error
                order(run, STOP_KEY)
            except BaseException:  # SIGTERM, as the command line raises it
                order(run, SIGTERM)
    finally:
        order(run, CTRL_C)
        _outlast(loop)
    return raised


def _outlast(loop: _Loop) -> None:
    """Wait for the loop: whatever arrives meanwhile, the table comes to rest first."""
    while not loop.ended.is_set():
        with suppress(BaseException):
            loop.ended.wait(GLANCE_S)


def _outcome(run: Performance, fault: str) -> Outcome:
    """Return how the run went, and its signals on the record."""
    ramp, dt_s = run.course.ramp, run.info.dt_s
    everything = signals(run.log, len(run.info.channels), run.step.estimated.size)
    steps = int(np.clip(run.log.done[0] - ramp, 0, run.course.record))
    stopped_at_s = float(max(run.guard.flags[3] - ramp, 0) * dt_s)
    reason = int(run.guard.flags[1])
    record = slice(ramp, ramp + run.course.record)
    return Outcome(_part(everything, record), steps, reason_of(run.info, run.guard), fault, stopped_at_s, reason)


def _part(everything: Signals, steps: slice) -> Signals:
    """Return the signals of some steps."""
    return replace(everything, **{field.name: getattr(everything, field.name)[..., steps] for field in fields(Signals)})
