"""`rths serve --as target`: the designed step of a case over a virtual table, as a laboratory's own computer would run
it (docs/reference/stepping_target.md)."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.case.load import load_cases
from rths_cli.control.designed_blocks import Blocks
from rths_cli.errors import InputError, RigError
from rths_cli.experiment.designed_step import DesignedStep, checksum_number, designed_step
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, open_virtual
from rths_cli.laboratory.serve import ServedRig, describe, end_of_cable
from rths_cli.loop.realtime_loop import conduct_once
from rths_cli.loop.realtime_run import STOP_KEY, Performance, is_over, order, prepare
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.clock import require_real_time
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import capabilities_of
from rths_cli.rigs.interface import Rig
from rths_cli.rigs.stepped_test import Answer
from rths_cli.rigs.udp.packets import END_STOP
from rths_cli.rigs.udp.session import bound, shown
from rths_cli.rigs.udp.stepping_frames import (
    ARMED,
    BEGIN,
    IDLE,
    MOST_DATA,
    RECORD,
    REST,
    STOPPED,
    WATCHDOG,
    Order,
    order_of,
    packed_answer,
    rows_in_a_frame,
)

BEFORE_S, AFTER_S = 1.0, 3.0  # at rest before and after a run, as one_table_run has them
LOOK_S = 0.02
Say = Callable[[str], object]


@dataclass(frozen=True)
class StepRequest:
    """What `rths serve --as target` is asked for."""

    case: str  # of a rig of kind target
    rig: str  # the virtual rig behind it
    structure: str
    watchdog_s: float
    seed: int
    settings: tuple[str, ...]  # of the case
    host: str = "127.0.0.1"
    port: int = 0
    peer: str = "127.0.0.1:47811"
    seconds: float | None = None


def serve_step(request: StepRequest, say: Say) -> int:
    """Serve a stepping target until the time is over or Ctrl-C, its table then at rest; return the sessions."""
    require_real_time()
    there = end_of_cable(request.host, request.peer)
    step, rig = rehearsed_step(request, lambda _: None)
    with bound(request.host, request.port) as door:
        door.connect(there)
        rig.open()
        target = SteppingTarget(door, step, rig, request.watchdog_s, say)
        say(f"the step of case {step.name} at {shown(door.getsockname())} for {request.peer} alone; end with Ctrl-C")
        try:
            target.serve(request.seconds)
        except (KeyboardInterrupt, SystemExit):
            target.ends = True
            target.serve()
        rig.close()
        say("ended; the table was led to rest")
    return target.session


def rehearsed_step(request: StepRequest, say: Callable[[str], None]) -> tuple[DesignedStep, Rig]:
    """Return the designed step of a case and the virtual rig that it will move; raises InputError."""
    case = load_cases([request.case], request.settings)[0]
    if not capabilities_of(case.table.kind).steps_itself:
        raise InputError(
            f"--case: the rig of case {case.name} is of kind {case.table.kind}; only one of kind target steps a test "
            "itself (table: target_loopback)"
        )
    step = designed_step(case, say)
    served: ServedRig = describe(
        request.rig, request.structure, (f"sample_rate_hz={case.sample_rate_hz:g}",), request.seed
    )
    if served.channels != len(step.info.all_channels):
        raise InputError(
            f"{request.rig}: has {served.channels} channels, rig {step.info.name} of the case has "
            f"{len(step.info.all_channels)}; serve a rig with the same ones"
        )
    setup = served.setup
    rig = replace(setup.rig, latency_samples=step.info.latency_samples)
    return step, open_virtual(replace(setup, rig=rig, declared_rig=None), (EXP_RTHS,), request.seed)


class SteppingTarget:
    """A target that steps a designed test over an open rig; `serve` it in one thread, over a connected socket.

    `interval_s`: of its clock; None: that of the step.
    """

    def __init__(
        self, door: socket.socket, step: DesignedStep, rig: Rig, watchdog_s: float, say: Say,
        interval_s: float | None = None,
    ) -> None:  # fmt: skip
        self.state, self.session, self.faults, self.ends = IDLE, 0, 0, False
        self.kept = 1 << 40  # rows of the log that can still be fetched
        self._door, self.step, self._rig, self._watchdog_s, self._say = door, step, rig, watchdog_s, say
        self._record, self._held = np.zeros((len(step.drive), 3)), 0
        self._reason, self._channel, self._seen, self._command_v = 0, -1, 0.0, 0.0
        self.interval_s = step.info.dt_s if interval_s is None else interval_s
        self._rest: list[Array] = []
        self._fed_s = 0.0
        self.run, self._samples = self._prepared(np.zeros(len(step.info.all_channels))), np.zeros(0)
        conduct_once.bind(*self._parts(), np.array(rig.arm(), dtype=float))()  # compiled before anyone waits
        rig.exchange(0.0)
        rig.rest()
        self.run = self._prepared(np.zeros(len(step.info.all_channels)))

    def _prepared(self, zeros_v: Array) -> Performance:
        info, blocks = self.step.info, self.step.blocks
        assert isinstance(blocks, Blocks)
        return prepare(
            info, blocks, NUMERICAL, self._record, self.step.limits, zeros_v, still_s=(BEFORE_S, AFTER_S)
        )  # fmt: skip

    def _parts(self) -> tuple[object, ...]:
        run = self.run
        return run.course, run.step, run.limits, run.guard, run.drive, run.log

    @property
    def moves(self) -> bool:
        """Return whether a test is under way."""
        return self.state not in (IDLE, STOPPED)

    def serve(self, seconds: float | None = None) -> None:
        """Serve until `ends`, or for a time; a test under way is led to its end first."""
        end, due = time.monotonic() + (seconds or np.inf), time.monotonic()
        while self.moves or not (self.ends or time.monotonic() > end):
            if self.moves and (self.ends or time.monotonic() > end):
                self._stop()
            wait_s = max(due - time.monotonic(), 0.0) if self.moves else LOOK_S
            if select.select([self._door], [], [], min(wait_s, LOOK_S))[0]:
                self._attend()
            if not self.moves:
                due = time.monotonic()
            elif time.monotonic() >= due:
                self._instant()
                due += self.interval_s

    def _attend(self) -> None:
        try:
            found = order_of(self._door.recv(MOST_DATA + 1))
            if found is not None:
                self.count(found)
                self._door.send(packed_answer(self._answer(found)))
        except OSError:  # the host's port is closed
            return

    def count(self, asked: Order) -> None:
        """Let an order count."""
        if asked.session == self.session:
            self._fed_s = time.monotonic()
            if asked.order == REST and self.moves:
                self._stop()
        elif asked.session == self.session + 1 and not self.moves:
            rows, first = asked.rows, asked.number
            if asked.order == RECORD and first + len(rows) <= len(self._record) and (first <= self._held or not first):
                self._record[first : first + len(rows)] = rows
                self._held = first + len(rows)
            elif asked.order == BEGIN and self._held == len(self._record):
                self._begin()

    def _stop(self) -> None:
        if self.state == ARMED:
            self._end(15, -1, np.nan)
        order(self.run, STOP_KEY)

    def _begin(self) -> None:
        self.session, self.state, self.faults, self._fed_s = self.session + 1, ARMED, 0, time.monotonic()
        self._reason, self._channel, self._seen, self._command_v, self._rest = 0, -1, 0.0, 0.0, []
        self.run.log.done[0] = 0
        self._samples = self._rig.arm()
        self._say(f"session {self.session}: armed")

    def _end(self, reason: int, channel: int, seen: float) -> None:
        self.state, self._reason, self._channel, self._seen = STOPPED, reason, channel, float(seen)
        self._rig.rest()
        self._held = 0
        self._say(f"session {self.session}: ended with reason {reason} after {int(self.run.log.done[0])} steps")

    def _instant(self) -> None:
        """One instant of the target's clock."""
        if time.monotonic() - self._fed_s > self._watchdog_s and not self.faults:
            self.faults |= WATCHDOG
            self._stop()
        try:
            if self.state == ARMED:
                self._listen()
            elif self.moves:
                self._play()
        except RigError as error:
            self.faults |= END_STOP
            self._say(str(error))
            self._end(0, -1, np.nan)

    def _listen(self) -> None:
        """Measure the zeros at rest, then begin the ramp-up."""
        self._rest.append(np.array(self._samples))
        self._samples = self._rig.exchange(0.0)
        if len(self._rest) < self.step.zero_steps:
            return
        rest_v, (zeros, noise) = np.array(self._rest), self.step.rest_limits_v
        mean, deviation = rest_v.mean(axis=0), rest_v.std(axis=0)
        for reason, found, most in ((100, np.abs(mean), zeros), (101, deviation, noise)):
            if (found > most).any():
                channel = int(np.argmax(found > most))
                self._end(reason, channel, found[channel])
                return
        self.run = self._prepared(mean)
        self._given = np.array(self._samples, dtype=float)
        self._once = conduct_once.bind(*self._parts(), self._given)
        self.state = ARMED + 1

    def _play(self) -> None:
        run = self.run
        self._given[:] = self._samples
        self._once()
        done = int(run.log.done[0])
        self._command_v = float(run.step.command[0])
        self.state = min(int(run.log.columns[-2, done - 1]), STOPPED - 1)  # its rest after the record belongs to it
        self._samples = self._rig.exchange(self._command_v)
        if done == run.log.columns.shape[1] or is_over(run):
            flags = run.guard.flags
            self._end(int(flags[1]), int(flags[2]), float(run.guard.seen[0]))

    def _answer(self, asked: Order) -> Answer:
        log, step = self.run.log, self.step
        made, first = int(log.done[0]), max(asked.number, int(log.done[0]) - self.kept)
        many = 0 if asked.order in (BEGIN, RECORD) else rows_in_a_frame(len(log.columns))
        rows = log.columns[:, first : min(first + many, made)].T
        return Answer(
            self.session, first, self._held, self.state, self.faults, time.monotonic(), self._command_v,
            checksum_number(step.case_sha256), checksum_number(step.model_sha256), step.info.dt_s,
            len(log.columns), made, self._reason, self._channel, self._seen, rows,
        )  # fmt: skip
