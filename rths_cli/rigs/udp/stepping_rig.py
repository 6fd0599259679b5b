"""A rig whose own computer steps a designed test: the host sends record and start, and fetches the log
(docs/reference/stepping_target.md)."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from rths_cli.errors import RigError
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import STEPS_ITSELF, Commands, RigInfo, one_actuator
from rths_cli.rigs.stepped_test import Answer, Designed
from rths_cli.rigs.udp.plain_frames import LARGEST_NUMBER
from rths_cli.rigs.udp.plain_rig import Cable, connected
from rths_cli.rigs.udp.session import on_this_machine, shown
from rths_cli.rigs.udp.stepping_frames import (
    ASK,
    BEGIN,
    IDLE,
    MOST_DATA,
    RECORD,
    RECORD_ROWS,
    REST,
    STOPPED,
    Order,
    answer_of,
)

GREETING_S, SILENT_S, AGAIN_S = 5.0, 2.0, 0.02
REST_S = 10.0  # longest way to rest
NO_ROWS = np.zeros((0, 3))


class SteppingRig:
    """A rig that steps itself: `arm` and `exchange` are refused, `begin`, `fetch` and `rest` conduct a whole test."""

    offers = (STEPS_ITSELF,)

    def __init__(self, info: RigInfo, cable: Cable, watchdog_s: float) -> None:
        one_actuator(info)
        self.info, self.cable, self.watchdog_s = info, cable, watchdog_s
        self.peer = f"{cable.host}:{cable.port}"
        self._door: socket.socket | None = None
        self._session = 0
        self.last: Answer | None = None  # newest frame of the target

    def open(self) -> None:
        """Find the target; raises RigError if it is silent or steps another case."""
        self.close()
        self._door = connected(self.info.name, self.cable)
        self._door.setblocking(True)
        self.peer = shown(self._door.getpeername())
        self.info = replace(self.info, driver_verified="loopback" if on_this_machine(self._door) else "hardware")
        self._session = self._asked(Order(0, 0, ASK, NO_ROWS), GREETING_S).session

    @property
    def _named(self) -> str:
        return f"rig {self.info.name}: the target {self.peer}"

    def arm(self) -> Array:
        """Raise RigError: no command is taken."""
        raise RigError(
            f"rig {self.info.name}: its computer steps a designed test itself and takes no command; identify the table "
            "through a rig file of kind udp_plain, or from recordings (rths identify --data)"
        )

    def exchange(self, command_v: Commands) -> Array:
        """Raise RigError: no command is taken."""
        return self.arm()

    def agree(self, designed: Designed) -> None:
        """Raise RigError unless the target holds the step of this case and model, at this rate, and is at rest."""
        found, name = (
            self._asked(Order(0, 0, ASK, NO_ROWS), GREETING_S),
            f"rig {self.info.name}: the target {self.peer}",
        )
        again = "write it anew (rths export step CASE --to c DIR), and build and start the target with it"
        if found.case_number != designed.case_number:
            raise RigError(f"{name} holds the step of another case (checksum); {again}")
        if found.model_number != designed.model_number:
            raise RigError(f"{name} holds the step of another model of the table (checksum); {again}")
        if abs(found.dt_s / self.info.dt_s - 1.0) > 1e-9 or found.columns != designed.columns:
            raise RigError(
                f"{name} steps every {found.dt_s:g} s and logs {found.columns} columns, the case needs "
                f"{self.info.dt_s:g} s and {designed.columns}; {again}"
            )
        if found.state not in (IDLE, STOPPED):
            raise RigError(f"{name} is in a test (state {found.state}): another host has it; wait until it has ended")

    def begin(self, record: Array) -> None:
        """Send the record (n, 3) and start the test; raises RigError where the target does not begin."""
        record = np.ascontiguousarray(record, "<f8")
        end = time.monotonic() + GREETING_S + 1e-4 * len(record)
        held, session = 0, self._session + 1
        if session > LARGEST_NUMBER:
            raise RigError(f"{self._named} has counted {session} sessions; restart it")
        while held < len(record):
            rows = record[held : held + RECORD_ROWS]
            held = self._asked(Order(session, held, RECORD, rows), SILENT_S).held
            if time.monotonic() > end:
                raise RigError(f"{self._named} does not take the record (row {held})")
        end = time.monotonic() + SILENT_S
        while self._asked(Order(session, 0, BEGIN, NO_ROWS), SILENT_S).session != session:
            if time.monotonic() > end:
                raise RigError(f"{self._named} does not begin a session")
        self._session = session

    def fetch(self, first: int, stop: bool) -> Answer:
        """Return the target's newest rows from `first` on, none if they are not made yet; raises RigError after
        SILENT_S without an answer. With `stop` the target leads its table to rest."""
        return self._asked(Order(self._session, first, REST if stop else ASK, NO_ROWS), SILENT_S)

    def rest(self) -> None:
        """Bring the table to rest; raises RigError where the target does not confirm it."""
        if self._door is None or self.last is None:
            return
        end = time.monotonic() + REST_S
        while self._asked(Order(self._session, 0, REST, NO_ROWS), SILENT_S).state not in (IDLE, STOPPED):
            if time.monotonic() > end:
                raise RigError(
                    f"rig {self.info.name}: the target {self.peer} did not confirm that its table is at rest"
                )
            time.sleep(AGAIN_S)

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        if self._door is not None:
            self._door.close()
        self._door, self.last = None, None

    def _asked(self, order: Order, patience_s: float) -> Answer:
        """Send an order until an answer comes; raises RigError after a time."""
        assert self._door is not None
        data, begun = order.packed(), time.monotonic()
        while time.monotonic() < begun + patience_s:
            with _silence_is_no_error():
                self._door.settimeout(AGAIN_S)
                self._door.send(data)
                while True:
                    found = answer_of(self._door.recv(MOST_DATA + 1))
                    if found is not None and self._fits(order, found):
                        self.last = found
                        return found
        raise RigError(
            f"{self._named} was silent for {patience_s:g} s; look at its table before "
            "you go near, then at its program and the cable"
        )

    def _fits(self, order: Order, found: Answer) -> bool:
        """Return whether an answer is one to this order, and not a late one to an order before."""
        if order.order in (ASK, REST) and order.session:
            return found.session == order.session and (found.first >= order.number or found.rows.size == 0)
        return bool(math.isfinite(found.dt_s) and found.dt_s > 0.0)


@contextmanager
def _silence_is_no_error() -> Iterator[None]:
    try:
        yield
    except TimeoutError:
        return
    except OSError:  # the peer's port is closed
        time.sleep(AGAIN_S)
