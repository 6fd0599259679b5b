"""The frames between a host and a target that steps a designed test itself (docs/reference/stepping_target.md).

Heads are those of the plain link. The host's order is followed by rows of the record, the target's answer by what it is
about and rows of its log.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.rigs.stepped_test import Answer
from rths_cli.rigs.udp.plain_frames import HEAD

OF_HOST, OF_STEPPING = b"RTC1", b"RTS1"
ASK, BEGIN, RECORD, REST = range(4)  # orders of the host
IDLE, ARMED, RAMP_UP, IN_RECORD, RAMP_DOWN, STOPPED = range(6)  # states of docs/decisions/safety.md
ABOUT = struct.Struct("<8d")
MOST_DATA = 1400  # bytes of a frame: no network of a cable splits it
RECORD_ROWS = (MOST_DATA - HEAD.size) // 24
WATCHDOG = 1  # fault: the host fell silent


@dataclass(frozen=True)
class Order:
    """A frame of the host: `number` is the first wanted row of the log, or the first of these rows of the record."""

    session: int
    number: int
    order: int
    rows: Array  # (n, 3) acceleration, velocity, displacement of the ground

    def packed(self) -> bytes:
        """Return the frame as bytes."""
        return HEAD.pack(OF_HOST, self.session, self.number, 0, self.order, 0, 0.0, 0.0) + self.rows.tobytes()


def packed_answer(told: Answer) -> bytes:
    """Return an answer as bytes."""
    head = told.session, told.first, told.held, told.state, told.faults, told.time_s, told.command_v
    about = (
        told.case_number, told.model_number, told.dt_s, float(told.columns), float(told.made), float(told.reason),
        float(told.channel), told.seen,
    )  # fmt: skip
    return HEAD.pack(OF_STEPPING, *head) + ABOUT.pack(*about) + np.ascontiguousarray(told.rows).tobytes()


def order_of(data: bytes) -> Order | None:
    """Return the order in a datagram, None for what is none."""
    size = len(data) - HEAD.size
    if size < 0 or data[:4] != OF_HOST or size % 24 or len(data) > MOST_DATA:
        return None
    _, session, number, _, order, *_ = HEAD.unpack_from(data)
    rows = np.frombuffer(data, "<f8", offset=HEAD.size).reshape(-1, 3)
    if order > REST or (rows.size > 0) != (order == RECORD) or not np.isfinite(rows).all():
        return None
    return Order(session, number, order, rows)


def answer_of(data: bytes) -> Answer | None:
    """Return the answer in a datagram, None for what is none."""
    begin = HEAD.size + ABOUT.size
    if len(data) < begin or data[:4] != OF_STEPPING or (len(data) - begin) % 8:
        return None
    _, session, first, held, state, faults, time_s, command_v = HEAD.unpack_from(data)
    about = ABOUT.unpack_from(data, HEAD.size)
    values = np.frombuffer(data, "<f8", offset=begin)
    wanted = about[3]
    whole = all(abs(one) < 2.0**31 for one in about[3:7])
    if state > STOPPED or not whole or wanted < 1 or values.size % int(wanted):
        return None
    columns, made, reason, channel = (int(one) for one in about[3:7])
    case_number, model_number, dt_s, seen = *about[:3], about[7]
    rows = values.reshape(-1, columns)
    return Answer(
        session, first, held, state, faults, time_s, command_v, case_number, model_number, dt_s, columns, made,
        reason, channel, seen, rows,
    )  # fmt: skip


def rows_in_a_frame(columns: int) -> int:
    """Return how many rows of a log with so many columns a frame holds."""
    return max((MOST_DATA - HEAD.size - ABOUT.size) // (8 * columns), 1)
