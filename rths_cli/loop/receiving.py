"""Receive datagrams with the time at which they came, as the kernel noted it (64-bit Linux, socket(7) and cmsg(3)).

A process that was held up finds several packets in its socket. What each of them asked for belongs to the instant at
which it came, not to that at which the process was let on.
"""

from __future__ import annotations

import socket

import numpy as np

from rths_cli.clocks import IntArray
from rths_cli.compiled import External, part
from rths_cli.rigs.udp.siphash import Bytes

_recvmsg = External("recvmsg", "intp", "intc", "uintp", "intc")
_clock_gettime = External("clock_gettime", "intc", "intc", "uintp")
_AT_ONCE, _WHOLE_SIZE, _WALL_CLOCK = 0x40, 0x20, 0  # MSG_DONTWAIT, MSG_TRUNC, CLOCK_REALTIME
_STAMPS = 35  # SO_TIMESTAMPNS, and SCM_TIMESTAMPNS
_IS_STAMP = socket.SOL_SOCKET | _STAMPS << 32  # level and type of a control message

# words of a message: struct msghdr, of which the kernel writes the sizes of address and control and the flags; struct
# iovec; control: struct cmsghdr (its size, level and type), struct timespec, and room for what nobody asked for
ADDRESS, ADDRESS_SIZE, PARTS, PART_COUNT, CONTROL, CONTROL_SIZE, FLAGS, PART, PART_SIZE = range(9)
STAMP_SIZE, STAMP_KIND, STAMP_S, STAMP_NS = range(9, 13)
WORDS = 17


def open_message(link: socket.socket, incoming: Bytes, address: Bytes) -> IntArray:
    """Ask for stamps, and return a message (WORDS,) that receives into two arrays, which must live as long as it."""
    link.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
    message = np.zeros(WORDS, np.int64)
    place = message.ctypes.data
    message[ADDRESS], message[PARTS], message[PART_COUNT] = address.ctypes.data, place + 8 * PART, 1
    message[PART], message[PART_SIZE], message[CONTROL] = incoming.ctypes.data, incoming.size, place + 8 * STAMP_SIZE
    return message


@part
def receive(fd: int, message: IntArray, address: Bytes) -> int:
    """Return the size of the next packet that is there, -1 for none; more than fits is told and cut off."""
    message[ADDRESS_SIZE], message[CONTROL_SIZE], message[FLAGS] = address.size, 8 * (WORDS - STAMP_SIZE), 0
    return _recvmsg(fd, message.ctypes.data, _AT_ONCE | _WHOLE_SIZE)  # type: ignore[operator, no-any-return]


@part
def wall_clock_ns(scratch: IntArray) -> int:
    """Return the time of day in ns, the clock of the stamps; `scratch` (2,) receives seconds and nanoseconds."""
    _clock_gettime(_WALL_CLOCK, scratch.ctypes.data)  # type: ignore[operator]
    return scratch[0] * 1_000_000_000 + scratch[1]


@part
def arrival(message: IntArray, now: int, wall: int, earliest: int) -> int:
    """Return when the received packet came on the clock of `now`, which is `wall` on the wall clock; `now` without stamp.

    It is kept between `earliest` and `now`, whatever a step of the wall clock makes of it.
    """
    if message[CONTROL_SIZE] < 32 or message[STAMP_KIND] != _IS_STAMP:
        return now
    ago = wall - (message[STAMP_S] * 1_000_000_000 + message[STAMP_NS])
    return min(max(now - ago, earliest), now)
