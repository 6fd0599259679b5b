"""The runner's exchange with a target, in compiled code: send a command, accept only its answer, until a deadline
(docs/reference/udp.md). On a plain link (docs/reference/plain_link.md) frames take the place of sealed packets.

Everything is preallocated; the socket is connected, does not block, and belongs to one thread. Linux only.
"""

from __future__ import annotations

import math
import socket
from typing import NamedTuple

import numpy as np

from rths_cli.numerics.clock import IntArray, monotonic_ns, sleep_until
from rths_cli.numerics.compiled import borrowed, entry, external, kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp import packets, plain_frames
from rths_cli.rigs.udp.late_command_trajectory import POINTS, Way, fresh_way, put_way, words_of
from rths_cli.rigs.udp.packets import Bytes, Words

OK, LOST, FAULT = range(3)  # what `exchange` returns
NO_TIMEOUT_NS = 1 << 62
MOST_AHEAD = 1_000_000  # numbers by which the frame of a target with its own clock may be ahead of the command
SPIN_NS = 50_000  # time in which the thread polls for an answer before it sleeps; waking up takes about as long

# indices in Link.counts: commands sent; answers received, missing, missing in a row; packets that were late, repeated
# or reordered, not authentic, authentic but not requested; sends that failed; reports of an unreachable peer
SENT, ANSWERED, UNANSWERED, IN_A_ROW, LATE, DOUBLED, BAD, STRAY, UNSENT, UNREACHABLE = range(10)
COUNTS = ("sent", "answered", "lost", "lost_in_a_row", "late", "doubled", "bad", "stray", "unsent", "unreachable")

# indices in Link.status: sequence numbers of step 0, of the last packet sent, of the newest answer; state, faults and
# lost commands in the newest answer; times at which the last packet was sent and its answer came (own clock), and at
# which the target sampled and sent (its clock)
BASE, LAST, SEEN, STATE, FAULTS, TARGET_LOST, SENT_NS, RECEIVED_NS, SAMPLED_NS, ANSWERED_NS = range(10)

# indices in Link.plain: 1 on a plain link (docs/reference/plain_link.md), 0 on a keyed one; 1 where the target has the
# clock; number of the session; how many answers echoed a command, and the least and the sum of intervals
# between it and the answer; that of the newest answer (0: it echoed none); answers in a row waited for
PLAIN, OF_TARGET, SESSION, ECHOES, LEAST_LATENCY, LATENCIES, NEWEST_LATENCY, IN_STEP = range(8)
PLAIN_PLACES = 8
STEPS_IN_STEP = 8  # answers in a row that were waited for, from which their commands left in time

_send = external("send", "intp", "intc", "uintp", "uintp", "intc")
_recv = external("recv", "intp", "intc", "uintp", "uintp", "intc")
_ppoll = external("ppoll", "intc", "uintp", "uintp", "uintp", "uintp")
_errno_location = external("__errno_location", "uintp")
_memcpy = external("memcpy", "uintp", "uintp", "uintp", "uintp")
_AT_ONCE, _WHOLE_SIZE, _READABLE = 0x40, 0x20, 1  # MSG_DONTWAIT, MSG_TRUNC, POLLIN
_TRY_AGAIN, _INTERRUPTED = 11, 4  # EAGAIN, EINTR


class Link(NamedTuple):
    """A socket with all arrays that an exchange reads and writes; c channels."""

    fd: int
    spin_ns: int
    timeout_ns: int  # longest time of an answer, also before its deadline
    key: Words  # (2,) of the session
    outgoing: Bytes  # (MOST_BYTES,)
    incoming: Bytes  # (MOST_BYTES,)
    arming: Bytes  # (8 * ARM_WORDS,) the words of an ARM: the runner's nonce and the terms of the session
    way: Way  # the next command, with its preview
    samples_v: Array  # (c,) the last samples that came
    status: IntArray
    counts: IntArray
    scratch: IntArray  # (4,) times, and the argument of ppoll
    plain: IntArray  # (PLAIN_PLACES,)
    acted_v: Array  # (1,) on a plain link, the command that acted when the newest samples were taken


def begin_session(link: Link, key: Words, arming: bytes) -> None:
    """Prepare a link for a session with its key (2,) and the words of its ARM; all counts and states are reset."""
    link.key[:], link.arming[:] = key, np.frombuffer(arming, np.uint8)
    link.status[:], link.status[LAST], link.status[SEEN] = 0, -1, -1
    link.counts[:] = 0


def fresh_link(
    door: socket.socket, key: Words, channels: int, spin_ns: int = SPIN_NS, timeout_ns: int = NO_TIMEOUT_NS
) -> Link:
    """Return a link over a connected socket, which must stay open as long as the link is used."""
    return Link(
        door.fileno(), spin_ns, timeout_ns, key.copy(),
        np.zeros(packets.MOST_BYTES, np.uint8), np.zeros(packets.MOST_BYTES, np.uint8),
        np.zeros(8 * packets.ARM_WORDS, np.uint8),
        fresh_way(), np.zeros(channels), np.array([0, -1, -1, *[0] * 7]), np.zeros(len(COUNTS), np.int64),
        np.zeros(4, np.int64), np.zeros(PLAIN_PLACES, np.int64), np.zeros(1),
    )  # fmt: skip


def echoed_latency(link: Link) -> float:
    """Return after how many intervals a command acted, the mean of a plain link's echoes; NaN where there are none."""
    echoes = int(link.plain[ECHOES])
    return int(link.plain[LATENCIES]) / echoes if echoes else math.nan


@part
def error_of(link: Link) -> int:
    """Return the errno of the last failed call."""
    link.scratch[3] = 0
    _memcpy(link.scratch.ctypes.data + 24, _errno_location(), 4)
    return link.scratch[3] & 0xFFFFFFFF


@part
def post(link: Link, kind: int, sequence: int, command_v: float) -> int:
    """Send a packet; return the time of sending in ns.

    If the network reports an error of an earlier packet, the first call of send fails; the second one then sends.
    """
    if link.plain[PLAIN] == 1:
        now, size = write_plain(link, kind, sequence, command_v)
    else:
        now, size = write_keyed(link, kind, sequence, command_v)
    link.status[SENT_NS], link.status[LAST] = now, sequence
    link.counts[SENT] += 1
    for _ in range(2):
        if _send(link.fd, link.outgoing.ctypes.data, size, _AT_ONCE) == size:
            return now
    link.counts[UNSENT] += 1
    return now


@part
def write_plain(link: Link, kind: int, sequence: int, command_v: float) -> tuple[int, int]:
    """Write a frame of the plain link; return the time that it states in ns, and its size in bytes."""
    order, seen = plain_frames.COMMAND if kind == packets.COMMAND else plain_frames.REST, max(link.status[SEEN], 0)
    now = monotonic_ns(link.scratch)
    return now, plain_frames.put_command(link.outgoing, link.plain[SESSION], sequence, seen, order, now, command_v)


@part
def write_keyed(link: Link, kind: int, sequence: int, command_v: float) -> tuple[int, int]:
    """Write and seal a packet; return the time that it states in ns, and its size in bytes."""
    words = words_of(link.way) if kind == packets.COMMAND else packets.ARM_WORDS if kind == packets.ARM else 0
    packets.begin(link.outgoing, kind, words, sequence)
    if kind == packets.COMMAND:
        link.way.volts[0] = command_v
        put_way(link.outgoing, link.way)
    elif kind == packets.ARM:
        for i in range(link.arming.size):
            link.outgoing[packets.WORDS + i] = link.arming[i]
    now = monotonic_ns(link.scratch)
    packets.put_int(link.outgoing, packets.SENT_NS, now)
    return now, packets.seal(link.outgoing, link.key)


@part
def receive(link: Link) -> int:
    """Receive a waiting packet; return its full size, also if it was truncated, or -1 if there is none."""
    size = _recv(link.fd, link.incoming.ctypes.data, link.incoming.size, _AT_ONCE | _WHOLE_SIZE)
    if size < 0:
        error = error_of(link)
        if error not in (_TRY_AGAIN, _INTERRUPTED):
            link.counts[UNREACHABLE] += 1
    return size


@part
def wait(link: Link, time_ns: int) -> None:
    """Sleep until a packet comes, at most `time_ns`; a signal or an error may end it earlier."""
    link.scratch[0], link.scratch[1] = time_ns // 1_000_000_000, time_ns % 1_000_000_000
    link.scratch[2] = link.fd | _READABLE << 32
    times, polled = link.scratch.ctypes.data, link.scratch.ctypes.data + 16
    _ppoll(polled, 1, times, 0)


@part
def is_answer(link: Link, size: int, sequence: int, now: int) -> bool:
    """Count and evaluate a received packet; return whether it is the answer to `sequence`.

    The target's state is taken from every answer that is newer than the ones before, the samples only from the answer
    to `sequence`.
    """
    if link.plain[PLAIN] == 1:
        return is_plain_answer(link, size, sequence, now)
    packet, counts = link.incoming, link.counts
    if not packets.is_genuine(packet, size, link.key):
        counts[BAD] += 1
        return False
    answered = packets.get_int(packet, packets.SEQUENCE)
    strange = packet[packets.KIND] != packets.SAMPLES or packet[packets.COUNT] != link.samples_v.size
    if strange or answered < 0 or answered > sequence:
        counts[STRAY] += 1
        return False
    if answered <= link.status[SEEN]:
        counts[DOUBLED] += 1
        return False
    link.status[SEEN] = answered
    take_status(link, now)
    if answered < sequence:
        counts[LATE] += 1
        return False
    for c in range(link.samples_v.size):
        link.samples_v[c] = packets.get_real(packet, packets.WORDS + 8 * c)
    return True


@part
def is_plain_answer(link: Link, size: int, sequence: int, now: int) -> bool:
    """Do what `is_answer` does, for a frame of the plain link.

    A target that has the clock may be ahead: such a frame tells its state, and that of its instant is lost.
    """
    frame, counts, plain = link.incoming, link.counts, link.plain
    if not plain_frames.is_of_target(frame, size, link.samples_v.size):
        counts[BAD] += 1
        return False
    number, echo = plain_frames.get_small(frame, plain_frames.NUMBER), plain_frames.get_small(frame, plain_frames.ECHO)
    ahead = number - sequence
    strange = plain_frames.get_small(frame, plain_frames.SESSION) != plain[SESSION] or echo > number
    if strange or ahead > plain[OF_TARGET] * MOST_AHEAD:
        counts[STRAY] += 1
        return False
    if number <= link.status[SEEN]:
        counts[DOUBLED] += 1
        return False
    link.status[SEEN] = number
    take_plain_status(link, now)
    if ahead != 0:
        counts[LATE if ahead < 0 else STRAY] += 1
        return False
    for c in range(link.samples_v.size):
        link.samples_v[c] = plain_frames.get_real(frame, plain_frames.SAMPLES_V + 8 * c)
    plain[NEWEST_LATENCY] = number - echo if echo > 0 and link.status[STATE] == plain_frames.RUNNING else 0
    return True


@part
def note_latency(plain: IntArray, waited: bool) -> None:
    """Note after how many intervals a command acted, unless the runner itself is late: then frames wait for it."""
    plain[IN_STEP] = plain[IN_STEP] + 1 if waited or plain[OF_TARGET] == 0 else 0
    if plain[IN_STEP] < STEPS_IN_STEP or plain[NEWEST_LATENCY] == 0:
        return
    first, intervals = plain[ECHOES] == 0, plain[NEWEST_LATENCY]
    plain[LEAST_LATENCY] = intervals if first else min(plain[LEAST_LATENCY], intervals)
    plain[LATENCIES] += intervals
    plain[ECHOES] += 1


@part
def take_plain_status(link: Link, now: int) -> None:
    """Store state, faults, times and acting command of a frame."""
    frame, status = link.incoming, link.status
    status[STATE] = plain_frames.get_small(frame, plain_frames.STATE)
    status[FAULTS] = plain_frames.get_small(frame, plain_frames.FAULTS)
    status[RECEIVED_NS] = now
    status[SAMPLED_NS] = status[ANSWERED_NS] = plain_frames.time_ns_of(frame)
    link.acted_v[0] = plain_frames.get_real(frame, plain_frames.COMMAND_V)


@part
def take_status(link: Link, now: int) -> None:
    """Store state, faults and times of an answer."""
    packet, status = link.incoming, link.status
    status[STATE] = packet[packets.STATE]
    status[FAULTS] = packets.get_small(packet, packets.FAULTS)
    status[TARGET_LOST] = packets.get_small(packet, packets.LOST)
    status[RECEIVED_NS] = now
    status[SAMPLED_NS] = packets.get_int(packet, packets.INSTANT_NS)
    status[ANSWERED_NS] = packets.get_int(packet, packets.SENT_NS)


@part
def converse(link: Link, kind: int, k: int, command_v: float, deadline_ns: int) -> int:
    """Send packet k of a kind and receive its answer; return OK, LOST or FAULT as `exchange` does."""
    sequence = link.status[BASE] + k
    now = post(link, kind, sequence, command_v)
    sleep_ns = now + link.spin_ns
    outcome, waited = -1, False
    while outcome < 0:
        size = receive(link)
        waited = waited or size < 0
        now = monotonic_ns(link.scratch)
        if size >= 0 and is_answer(link, size, sequence, now):
            outcome = OK
        elif now >= deadline_ns:
            outcome = LOST
        elif size < 0 and now > sleep_ns:
            wait(link, deadline_ns - now)
    if outcome == OK and link.plain[PLAIN] == 1:
        note_latency(link.plain, waited)
    link.counts[ANSWERED if outcome == OK else UNANSWERED] += 1
    link.counts[IN_A_ROW] = 0 if outcome == OK else link.counts[IN_A_ROW] + 1
    return FAULT if link.status[FAULTS] != 0 or link.status[STATE] != packets.ARMED else outcome


@kept_part
def exchange(link: Link, command_v: float, k: int, deadline_ns: int) -> int:
    """Send command k (the instant of the session's clock, counted from `arm`'s, step 0), take its samples in V.

    k rises from 1, by more than one where no command left at an instant: the target then counts it as lost.

    Returns OK, LOST when no answer came until the monotonic time `deadline_ns` or for the link's `timeout_ns` (the
    samples are then the last ones that came), FAULT when the target reports a fault or obeys no commands.
    """
    patient_ns = monotonic_ns(link.scratch) + link.timeout_ns
    return converse(link, packets.COMMAND, k, command_v, min(deadline_ns, patient_ns))


@entry
def converse_at(link: Link, kind: int, k: int, command_v: float, instant_ns: int, timeout_ns: int) -> int:
    """Do what `converse` does at a monotonic time, or now when that is past, and wait so long for the answer; how a
    command goes on is not told."""
    link = borrowed(link)
    link.way.marks[POINTS] = 0
    sleep_until(instant_ns, link.spin_ns, link.scratch)
    return converse(link, kind, k, command_v, monotonic_ns(link.scratch) + timeout_ns)


def prepare(channels: int) -> None:
    """Load or compile the code of an exchange in advance, so that no target has to wait for it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nowhere:
        converse_at.bind(fresh_link(nowhere, np.zeros(2, np.uint64), channels), packets.ARM, 0, 0.0, 0, 0)
