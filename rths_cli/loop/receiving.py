"""Receive datagrams with the time at which they came, as the kernel noted it (64-bit Linux, socket(7) and cmsg(3)).

A process that was held up finds several packets in its socket. What each of them asked for belongs to the instant at
which it came, not to that at which the process was let on.
"""

from __future__ import annotations

import socket

import numpy as np

from rths_cli.clocks import IntArray, monotonic_ns, sleep_until
from rths_cli.compiled import External, part
from rths_cli.rigs.udp.siphash import Bytes

BROKEN_NS = 1_000_000  # wait after a failing socket

_recvmsg = External("recvmsg", "intp", "intc", "uintp", "intc")
_ppoll = External("ppoll", "intc", "uintp", "uintp", "uintp", "uintp")
_clock_gettime = External("clock_gettime", "intc", "intc", "uintp")
_AT_ONCE, _WHOLE_SIZE, _READABLE, _WALL_CLOCK = 0x40, 0x20, 1, 0  # MSG_DONTWAIT, MSG_TRUNC, POLLIN, CLOCK_REALTIME
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
    """Return when the received packet came, on the clock of `now`, at which the wall clock shows `wall`.

    That is `now` where no stamp came; a step of the wall clock makes it no earlier than `earliest` and no later than
    `now`.
    """
    if message[CONTROL_SIZE] < 32 or message[STAMP_KIND] != _IS_STAMP:
        return now
    ago = wall - (message[STAMP_S] * 1_000_000_000 + message[STAMP_NS])
    return min(max(now - ago, earliest), now)


@part
def wait(fd: int, time_ns: int, scratch: IntArray) -> None:
    """Sleep until a packet comes, at most for a time in ns; rest a little where the socket fails. `scratch` (3,)."""
    scratch[0], scratch[1] = time_ns // 1_000_000_000, time_ns % 1_000_000_000
    scratch[2] = fd | _READABLE << 32
    times, polled = scratch.ctypes.data, scratch.ctypes.data + 16
    _ppoll(polled, 1, times, 0)  # type: ignore[operator]
    seen = scratch[2] >> 48
    if seen != 0 and seen != _READABLE:
        sleep_until(monotonic_ns(scratch) + BROKEN_NS, 0, scratch)
