"""A target of the plain link in plain Python, from docs/reference/plain_link.md alone; only `rig` is of rths."""

from __future__ import annotations

import math
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence

from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp.plain_rig import Cable, PlainRig

ASK, BEGIN, COMMAND, REST = range(4)
RUNNING, RESTING, AT_REST = 1, 2, 3
FRAME = struct.Struct("<4s5I2d")
Table = Callable[[float | None], Sequence[float]]
Spoil = Callable[[int, bytes], list[bytes]]


def faithful(_: int, frame: bytes) -> list[bytes]:
    return [frame]


class OwnTarget:
    """A target in a thread: `table(None)` gives the first samples, `table(u)` those after u was held one interval.

    `clock_s`: the interval of its own clock; None: the runner has the clock. Each frame passes `spoil(number, frame)`.
    """

    def __init__(
        self, table: Table, channels: int, clock_s: float | None = None, watchdog_s: float = 0.3, range_v: float = 10.0
    ) -> None:
        self.table, self.channels, self.clock_s, self.watchdog_s = table, channels, clock_s, watchdog_s
        self.range_v, self.spoil = range_v, faithful
        self.session, self.state, self.last, self.output_v, self.faults = 0, AT_REST, 0, 0.0, 0
        self.acting, self.instant = 0, 0
        self.waiting: tuple[int, float] | None = None
        self.acting_v, self.step_v, self.late = 0.0, 0.0, 0
        self.fed_s, self.resting_from = 0.0, 0.0
        self.samples: Sequence[float] = [0.0] * channels
        self.obeyed: list[tuple[int, int, float]] = []
        self.door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.door.bind(("127.0.0.1", 0))
        self.port: int = self.door.getsockname()[1]
        self.peer: tuple[str, int] | None = None
        self.ends = False
        self.thread = threading.Thread(target=self._serve, daemon=True)

    def start(self) -> int:
        """Begin to serve a free port of this machine, which is returned."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.peer = free.getsockname()
        self.thread.start()
        return self.peer[1]

    def rig(self, info: RigInfo, watchdog_s: float = 5.0, timeout_s: float = 5.0) -> PlainRig:
        """Begin to serve, and return the runner's rig at the other end."""
        cable = Cable("127.0.0.1", self.start(), "127.0.0.1", self.port, self.clock_s is not None)
        return PlainRig(info, cable, watchdog_s, timeout_s)

    def kill(self) -> None:
        self.ends = True
        if self.thread.is_alive():
            self.thread.join()
        self.door.close()

    def _serve(self) -> None:
        due = time.monotonic() + (self.clock_s or 0.0)
        while not self.ends:
            until = due if self.clock_s is not None else time.monotonic() + 0.02
            if select.select([self.door], [], [], max(until - time.monotonic(), 0.0))[0]:
                data, sender = self.door.recvfrom(2048)
                if sender == self.peer:
                    self.take(data)
            self.watch()
            if self.clock_s is not None and time.monotonic() >= due:
                self.at_instant()
                due += self.clock_s

    def take(self, data: bytes) -> None:
        if len(data) != 40 or data[:4] != b"RPC1":
            return
        _, session, number, _, order, _, _, command_v = FRAME.unpack(data)
        if order > REST:
            return
        if self.clock_s is None:
            if order in (COMMAND, REST) and session == self.session and number > self.last and self.state == RUNNING:
                self.samples = self.table(self.output_v)
            before = self.acting, self.output_v
            self.count(session, number, order, command_v)
            self._latch()
            self._send(self.last, *before)
        else:
            self.count(session, number, order, command_v)

    def count(self, session: int, number: int, order: int, command_v: float) -> None:
        if order == BEGIN and self.state == AT_REST and session == self.session + 1 and number == 0:
            self.session, self.last, self.output_v, self.state = session, 0, 0.0, RUNNING
            self.faults &= ~(1 | 8 | 64)
            self.acting, self.instant, self.waiting = 0, 0, None
            self.acting_v, self.step_v, self.late = 0.0, 0.0, 0
            self.fed_s = time.monotonic()
            self.samples = self.table(None)
            return
        if order not in (COMMAND, REST) or session != self.session or number <= self.last:
            return
        self.last = number
        if self.state != RUNNING:
            return
        if order == REST:
            self.rest(0)
        elif not math.isfinite(command_v) or abs(command_v) > self.range_v:
            self.rest(8)
        else:
            self.fed_s = time.monotonic()
            self.waiting = number, command_v
            self.obeyed.append((session, number, command_v))

    def _latch(self) -> None:
        if self.state != RUNNING:
            return
        if self.waiting is not None:
            number, volts = self.waiting
            self.step_v = (volts - self.acting_v) / (number - self.acting)
            self.acting, self.acting_v, self.output_v, self.waiting, self.late = number, volts, volts, None, 0
        elif self.clock_s is not None:
            stands = 0.05 / self.clock_s
            self.late = min(self.late + 1, round(stands))
            went = self.step_v * (self.late - self.late**2 / (2.0 * stands))
            self.output_v = min(max(self.acting_v + went, -self.range_v), self.range_v)

    def rest(self, fault: int) -> None:
        self.state, self.faults, self.resting_from = RESTING, self.faults | fault, time.monotonic()
        self.waiting, self.started_v = None, self.output_v

    def watch(self) -> None:
        if self.state == RUNNING and time.monotonic() - self.fed_s > self.watchdog_s:
            self.rest(1)
        if self.state == RESTING:
            left = max(1.0 - (time.monotonic() - self.resting_from) / 0.3, 0.0)
            self.output_v = left * self.started_v
            if left == 0.0:
                self.state = AT_REST

    def at_instant(self) -> None:
        if self.state == RUNNING and self.instant > 0:
            self.samples = self.table(self.output_v)
        self._send(self.instant, self.acting, self.output_v)
        self.instant += 1
        self._latch()

    def _send(self, number: int, echo: int, output_v: float) -> None:
        head = FRAME.pack(b"RPS1", self.session, number, echo, self.state, self.faults, time.monotonic(), output_v)
        for frame in self.spoil(number, head + struct.pack(f"<{self.channels}d", *self.samples)):
            self.door.sendto(frame, self.peer)
