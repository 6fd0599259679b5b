"""The target's side of UDP in compiled code, for `rths serve`: receive, verify, advance the virtual table, answer,
watchdog.

**Time.** The physics is advanced in ticks of a quarter of the runner's sample interval, counted on this process's
monotonic clock from the first command on. The phase of the ticks follows that of the commands slowly. A late first
command, or a slightly faster clock, therefore does not make an interval three or five ticks long. Other late or missing
commands have the same effect as on a real table. The time of a packet is its arrival by the kernel's stamp, not the
time at which this process reads it: after a stall of the process, samples and commands still belong to their instants,
and only the answers are late.

**Sessions.** A session is replaced only by the first authentic ARM of another one, with the table at rest. Any other
packet of a stranger causes at most one answer, no longer than the packet.
"""

from __future__ import annotations

import math
import socket
from typing import NamedTuple

import numpy as np

from rths_cli.loop.guard import BRAKING, RUNNING, STOPPED, GuardLimits, GuardState, ramp_down
from rths_cli.numerics.clock import SPIN_NS, IntArray, monotonic_ns, sleep_until
from rths_cli.numerics.compiled import borrowed, entry, external, kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import SimulatedPlant, SimulatedState
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.handshake import Greeter, answer_hello, opens_session
from rths_cli.rigs.udp.late_command_trajectory import POINTS, Way, place_after, take_way
from rths_cli.rigs.udp.packets import Bytes, Words

BROKEN_NS = 1_000_000  # wait after an error of the socket

_recvmsg = external("recvmsg", "intp", "intc", "uintp", "intc")
_ppoll = external("ppoll", "intc", "uintp", "uintp", "uintp", "uintp")
_clock_gettime = external("clock_gettime", "intc", "intc", "uintp")
_DONT_WAIT, _WHOLE_SIZE, _READABLE, _WALL_CLOCK = 0x40, 0x20, 1, 0  # MSG_DONTWAIT, MSG_TRUNC, POLLIN, CLOCK_REALTIME
_STAMPS = 35  # SO_TIMESTAMPNS, and SCM_TIMESTAMPNS
_IS_STAMP = socket.SOL_SOCKET | _STAMPS << 32  # level and type of a control message

# words of a message: struct msghdr, of which the kernel writes the sizes of address and control and the flags; struct
# iovec; control: struct cmsghdr (its size, level and type), struct timespec, and room for what nobody asked for
ADDRESS, ADDRESS_SIZE, PARTS, PART_COUNT, CONTROL, CONTROL_SIZE, FLAGS, PART, PART_SIZE = range(9)
STAMP_SIZE, STAMP_KIND, STAMP_S, STAMP_NS = range(9, 13)
WORDS = 17


def open_message(link: socket.socket, incoming: Bytes, address: Bytes) -> IntArray:
    """Enable the kernel's time stamps, and return a message (WORDS,) that receives into two arrays.

    The arrays must live as long as the message.
    """
    link.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
    message = np.zeros(WORDS, np.int64)
    place = message.ctypes.data
    message[ADDRESS], message[PARTS], message[PART_COUNT] = address.ctypes.data, place + 8 * PART, 1
    message[PART], message[PART_SIZE], message[CONTROL] = incoming.ctypes.data, incoming.size, place + 8 * STAMP_SIZE
    return message


@part
def receive(fd: int, message: IntArray, address: Bytes) -> int:
    """Receive a waiting packet; return its full size, also if it was truncated, or -1 if there is none."""
    message[ADDRESS_SIZE], message[CONTROL_SIZE], message[FLAGS] = address.size, 8 * (WORDS - STAMP_SIZE), 0
    return _recvmsg(fd, message.ctypes.data, _DONT_WAIT | _WHOLE_SIZE)  # type: ignore[operator, no-any-return]


@part
def wall_clock_ns(scratch: IntArray) -> int:
    """Return the time of day in ns, the clock of the stamps; `scratch` (2,) receives seconds and nanoseconds."""
    _clock_gettime(_WALL_CLOCK, scratch.ctypes.data)
    return scratch[0] * 1_000_000_000 + scratch[1]


@part
def arrival(message: IntArray, now: int, wall: int, earliest: int) -> int:
    """Return the arrival time of the received packet, on the clock of `now`, when the wall clock shows `wall`.

    Without a stamp it is `now`. It is limited to the range from `earliest` to `now`, in case the wall clock was set.
    """
    if message[CONTROL_SIZE] < 32 or message[STAMP_KIND] != _IS_STAMP:
        return now
    ago = wall - (message[STAMP_S] * 1_000_000_000 + message[STAMP_NS])
    return min(max(now - ago, earliest), now)


@part
def wait(fd: int, time_ns: int, scratch: IntArray) -> None:
    """Sleep until a packet comes, at most `time_ns`; wait a little if the socket has an error. `scratch` (3,)."""
    scratch[0], scratch[1] = time_ns // 1_000_000_000, time_ns % 1_000_000_000
    scratch[2] = fd | _READABLE << 32
    times, polled = scratch.ctypes.data, scratch.ctypes.data + 16
    _ppoll(polled, 1, times, 0)
    seen = scratch[2] >> 48
    if seen != 0 and seen != _READABLE:
        sleep_until(monotonic_ns(scratch) + BROKEN_NS, 0, scratch)


TICKS_PER_INTERVAL = 4
CLOSING_S = 1.0 / (4.0 * math.pi * 14.0)  # closing velocity after a stall over the acceleration limit
PHASE_STEPS = 64  # number of commands over which the phase of the ticks adapts to that of the commands
LOOK_NS = 20_000_000  # longest wait for a packet, and thus the interval at which orders are read

BEGUN, ENDED, ORDERED = 1, 2, 3  # what `serve_packets` returns for

# indices in Door.counts: malformed packets or those of another version, packets with another key, repeated or reordered
# ones; commands obeyed, missing sequence numbers of the session, authentic HELLO
MALFORMED, FORGED, REPLAYED, OBEYED, LOST, GREETED = range(6)
COUNTS = 6

# indices in Door.session. SEQUENCE: highest one received. STARTED_NS: start of the clock, 0 while it does not run.
# TICK: time of the physics. LAST_TICK: that of the last command. ARRIVED_NS: arrival of the last command.
# LONGEST_TICKS: longest time between two commands. REACHED_NS: time to which the physics was advanced; all packets up
# to it are known. MOVED_TICK: last change of the output. ARMING 1: the ARM that began this session is in `incoming` and
# not yet obeyed. CATCHES_UP 1: a command was late, and the output has not yet reached the command.
STATE, FAULTS, SEQUENCE, STARTED_NS, TICK, LAST_TICK, LONGEST_TICKS, ROW, CLOSING, ARMING = range(10)
ARRIVED_NS, REACHED_NS, MOVED_TICK, CATCHES_UP = range(10, 14)
PLACES = 14

_sendto = external("sendto", "intp", "intc", "uintp", "uintp", "intc", "uintp", "uintc")
_AT_ONCE = 0x40  # MSG_DONTWAIT
ADDRESS_BYTES = 28  # of the longest socket address


class Door(NamedTuple):
    """The server socket, its peer and the session."""

    fd: int
    interval_ns: int
    watchdog_ticks: int
    greeter: Greeter  # answers HELLO, and recognises the ARM that follows
    key: Words  # (2,) of the session; a random one without a session
    incoming: Bytes  # (MOST_BYTES,) last packet
    outgoing: Bytes  # (MOST_BYTES,) answer
    address: Bytes  # (ADDRESS_BYTES,) sender of the last packet
    message: IntArray  # (WORDS,) argument of recvmsg, which receives into `incoming` and `address`
    counts: IntArray  # (COUNTS,)
    session: IntArray  # (PLACES,)
    orders: IntArray  # (1,) not 0: bring the table to rest and return
    scratch: IntArray  # (3,) times, and the argument of ppoll


class Table(NamedTuple):
    """The physics of one session."""

    plant: SimulatedPlant  # with a step of one tick
    state: SimulatedState
    limits: GuardLimits  # of the way to rest
    guard: GuardState
    noise: Array  # (rows, c)
    samples: Array  # (c,) in V
    latched_v: Array  # (2,) the output, and the last command
    way: Way  # the last command with its preview


def open_door(
    link: socket.socket,
    greeter: Greeter,
    key: Words,
    interval_ns: int,
    watchdog_ns: int,
    orders: IntArray,
) -> Door:
    """Return the server state for a bound, non-blocking socket, which must stay open as long as it is used."""
    incoming, address = np.zeros(packets.MOST_BYTES, np.uint8), np.zeros(ADDRESS_BYTES, np.uint8)
    return Door(
        link.fileno(), interval_ns, _watchdog_ticks(watchdog_ns, interval_ns), greeter, key,
        incoming, np.zeros(packets.MOST_BYTES, np.uint8), address, open_message(link, incoming, address),
        np.zeros(COUNTS, np.int64), _no_packets(), orders, np.zeros(3, np.int64),
    )  # fmt: skip


def begin_session(door: Door, interval_ns: int, watchdog_ns: int) -> Door:
    """Return the server state for the session that the ARM in `incoming` opened; it obeys that ARM first."""
    session = _no_packets()
    session[ARMING] = 1
    return door._replace(
        interval_ns=interval_ns,
        watchdog_ticks=_watchdog_ticks(watchdog_ns, interval_ns),
        key=door.greeter.key.copy(),
        counts=np.zeros(COUNTS, np.int64),
        session=session,
    )


def _watchdog_ticks(watchdog_ns: int, interval_ns: int) -> int:
    return math.ceil(TICKS_PER_INTERVAL * watchdog_ns / interval_ns)


def _no_packets() -> IntArray:
    session = np.zeros(PLACES, np.int64)
    session[SEQUENCE] = -1
    return session


@part
def lead_to_rest(d: Door, t: Table, fault: int) -> None:
    """Start the way to rest, unless it has been started; `fault` is added to the fault bits."""
    d.session[FAULTS] |= fault
    if d.session[STATE] == packets.ARMED:
        d.session[STATE] = packets.RESTING
        t.guard.flags[0] = BRAKING
    elif d.session[STATE] == packets.IDLE:
        d.session[STATE] = packets.RESTED


@part
def go_on(d: Door, t: Table) -> None:
    """Move the output along the preview, within its own limits, at each instant at which a command was due."""
    since = d.session[TICK] - d.session[LAST_TICK]
    if since == 0 or since % TICKS_PER_INTERVAL != 0:
        return
    gain, interval_s, held = t.limits.gain_m_per_v, TICKS_PER_INTERVAL * t.limits.dt_s, t.latched_v[0]
    outermost, passed = min(t.limits.command_v, t.limits.stroke_m / gain), since // TICKS_PER_INTERVAL
    place = place_after(t.way, passed)
    step = within(place - held, t.limits.velocity_m_s / gain * interval_s)
    if d.session[CATCHES_UP] == 1:
        step = within(step, closing_step(t, place - place_after(t.way, passed - 1), TICKS_PER_INTERVAL))
    t.latched_v[0] = within(held + step, outermost)
    t.guard.motion[0], t.guard.motion[1] = gain * t.latched_v[0], gain * (t.latched_v[0] - held) / interval_s
    if t.latched_v[0] != held:
        d.session[MOVED_TICK] = d.session[TICK]


@part
def closing_step(t: Table, moves_v: float, ticks: int) -> float:
    """Return the largest movement in V of the output towards the command, in `ticks` since it moved last.

    The command itself moves by `moves_v` per interval. A table whose loop has the angular frequency w answers a sudden
    change v of velocity with an acceleration of at most w v; half of the limit is reserved for the command's motion.
    """
    limits, interval_s = t.limits, TICKS_PER_INTERVAL * t.limits.dt_s
    closing_m_s = min(CLOSING_S * limits.acceleration_m_s2, limits.velocity_m_s)
    in_volts = interval_s / limits.gain_m_per_v
    most = min(abs(moves_v) + closing_m_s * in_volts, limits.velocity_m_s * in_volts)
    return most * min(ticks, TICKS_PER_INTERVAL) / TICKS_PER_INTERVAL


@part
def approached(d: Door, t: Table, command_v: float) -> float:
    """Return the output for a command: the command itself if it came in time, else a value that approaches it.

    An output that followed the preview may continue with its present velocity.
    """
    s, held = d.session, t.latched_v[0]
    passed = (s[TICK] - s[LAST_TICK]) // TICKS_PER_INTERVAL
    moves_v = abs(command_v - t.latched_v[1]) / max(passed, 1)
    if passed > 1 and d.counts[OBEYED] > 0:
        s[CATCHES_UP] = 1
        own_v = abs(t.guard.motion[1]) / t.limits.gain_m_per_v * TICKS_PER_INTERVAL * t.limits.dt_s
        moves_v = max(moves_v, own_v)
    if s[CATCHES_UP] == 0:
        return command_v
    latched = held + within(command_v - held, closing_step(t, moves_v, s[TICK] - s[MOVED_TICK]))
    if latched == command_v and TICKS_PER_INTERVAL // 2 <= s[TICK] - s[LAST_TICK] < 2 * TICKS_PER_INTERVAL:
        s[CATCHES_UP] = 0  # only when commands come one by one again: delayed ones may arrive together
    return latched


@kept_part
def tick(d: Door, t: Table) -> None:
    """Advance the physics by one tick, with the watchdog and the way to rest."""
    s = d.session
    if s[STATE] == packets.ARMED and s[TICK] - s[LAST_TICK] >= d.watchdog_ticks:
        lead_to_rest(d, t, packets.WATCHDOG)
    if s[STATE] == packets.ARMED:
        go_on(d, t)
    if s[STATE] == packets.RESTING:
        ramp_down(t.limits, t.guard)
        t.latched_v[0] = t.guard.motion[0] / t.limits.gain_m_per_v
        if t.guard.flags[0] == STOPPED:
            s[STATE] = packets.RESTED
    t.plant.hold_command(t.state, t.latched_v[0])
    s[TICK] += 1
    if t.state.fault[0] != 0:
        lead_to_rest(d, t, packets.END_STOP)


@part
def advance(d: Door, t: Table, now: int) -> None:
    """Advance the physics to the tick nearest to a time in ns; after its session a table at rest is not advanced."""
    s = d.session
    s[REACHED_NS] = now
    due = (2 * TICKS_PER_INTERVAL * (now - s[STARTED_NS]) + d.interval_ns) // (2 * d.interval_ns)
    while s[TICK] < due and (s[STATE] == packets.ARMED or s[STATE] == packets.RESTING):
        tick(d, t)


@part
def arm(d: Door, t: Table, now: int) -> None:
    """Enable motion at the start of a session; a repeated ARM only restarts the noise, for step 0."""
    s = d.session
    if d.counts[OBEYED] == 0:
        s[ROW] = 0
    if s[STATE] == packets.IDLE:
        s[STATE] = packets.ARMED
        s[STARTED_NS], s[TICK], s[LAST_TICK], s[MOVED_TICK], s[LONGEST_TICKS] = now, 0, 0, 0, 0
        t.guard.flags[0] = RUNNING
        t.way.volts[0], t.way.marks[POINTS], t.latched_v[1] = t.latched_v[0], 0, t.latched_v[0]
        s[CATCHES_UP] = 0


@kept_part
def obey(d: Door, t: Table, now: int) -> None:
    """Latch the command of the preview, or start the way to rest if it is not a number or out of range."""
    s, command_v = d.session, t.way.volts[0]
    if s[STATE] != packets.ARMED:
        return
    if not (math.isfinite(command_v) and abs(command_v) <= t.limits.command_v):
        lead_to_rest(d, t, packets.BAD_COMMAND)
        return
    if d.counts[OBEYED] == 0:  # the clock restarts: steps count from the first command, not from ARM
        s[STARTED_NS], s[TICK], s[LAST_TICK], s[MOVED_TICK] = now, 0, 0, 0
    else:
        s[STARTED_NS] += (now - s[STARTED_NS] - s[TICK] * d.interval_ns // TICKS_PER_INTERVAL) // PHASE_STEPS
    latched_v = approached(d, t, command_v)
    place = t.limits.gain_m_per_v * latched_v
    velocity = (place - t.guard.motion[0]) / (max(s[TICK] - s[MOVED_TICK], 1) * t.limits.dt_s)
    t.guard.motion[0], t.guard.motion[1] = place, within(velocity, t.limits.velocity_m_s)
    t.latched_v[0], t.latched_v[1] = latched_v, command_v
    s[LONGEST_TICKS] = max(s[LONGEST_TICKS], s[TICK] - s[LAST_TICK])
    s[LAST_TICK], s[MOVED_TICK], s[ARRIVED_NS] = s[TICK], s[TICK], now
    d.counts[OBEYED] += 1


@part
def within(value: float, limit: float) -> float:
    """Return a value limited to +-`limit`."""
    return min(max(value, -limit), limit)


@part
def post(d: Door, size: int) -> None:
    """Send `outgoing` to the sender of the last packet."""
    address_size = d.message[ADDRESS_SIZE]
    _sendto(d.fd, d.outgoing.ctypes.data, size, _AT_ONCE, d.address.ctypes.data, address_size)


@part
def answer(d: Door, t: Table, now: int) -> None:
    """Send the samples with the state in which they were taken."""
    s, packet = d.session, d.outgoing
    packets.begin(packet, packets.SAMPLES, t.samples.size, s[SEQUENCE])
    packet[packets.STATE] = s[STATE]
    packets.put_bytes(packet, packets.FAULTS, s[FAULTS], 4)
    packets.put_bytes(packet, packets.LOST, min(d.counts[LOST], 0xFFFFFFFF), 4)
    packets.put_int(packet, packets.INSTANT_NS, now)
    for c in range(t.samples.size):
        packets.put_real(packet, packets.WORDS + 8 * c, t.samples[c])
    packets.put_int(packet, packets.SENT_NS, monotonic_ns(d.scratch))
    post(d, packets.seal(packet, d.key))


@part
def sample(t: Table, s: IntArray) -> None:
    """Read the sensors with the next row of noise."""
    t.plant.read_channels(t.state, t.noise[s[ROW]], t.samples)
    s[ROW] = (s[ROW] + 1) % t.noise.shape[0]


@part
def take(d: Door, t: Table, now: int) -> None:
    """Execute and answer an authentic packet of the session; a repeated one is not answered."""
    s, packet = d.session, d.incoming
    sequence, kind = packets.get_int(packet, packets.SEQUENCE), int(packet[packets.KIND])
    if not packets.is_whole(packet):
        d.counts[MALFORMED] += 1
        return
    if sequence <= s[SEQUENCE]:
        d.counts[REPLAYED] += 1
        return
    d.counts[LOST] += sequence - s[SEQUENCE] - 1
    s[SEQUENCE] = sequence
    if kind == packets.ARM:
        arm(d, t, now)
    elif kind == packets.REST or kind == packets.CLOSE:
        lead_to_rest(d, t, 0)
        s[CLOSING] |= 1 if kind == packets.CLOSE else 0
    sample(t, s)
    if kind == packets.COMMAND:
        take_way(packet, t.way)
        obey(d, t, now)
    answer(d, t, now)


@part
def moves(d: Door) -> bool:
    """Return whether the table is armed or not yet at rest."""
    return d.session[STATE] == packets.ARMED or d.session[STATE] == packets.RESTING


@part
def greet(d: Door, size: int) -> None:
    """Answer an authentic HELLO without storing anything; refuse it while the table moves."""
    answer_size = answer_hello(d.greeter, d.incoming, size, monotonic_ns(d.scratch), 0, moves(d), d.outgoing)
    d.counts[GREETED if answer_size > 0 else FORGED] += 1
    if answer_size > 0:
        post(d, answer_size)


@part
def attend(d: Door, t: Table, size: int, now: int) -> int:
    """Execute a received packet; return BEGUN if it begins a session, else 0."""
    verdict = packets.verdict(d.incoming, size, d.key)
    if verdict == packets.GENUINE:
        take(d, t, now)
    elif verdict == packets.MALFORMED:
        d.counts[MALFORMED] += 1
    elif d.incoming[packets.KIND] == packets.HELLO:
        greet(d, size)
    elif not moves(d) and opens_session(d.greeter, d.incoming, size, monotonic_ns(d.scratch), d.outgoing):
        return BEGUN
    else:
        d.counts[FORGED if verdict == packets.FORGED else MALFORMED] += 1
    return 0


@part
def pause(d: Door, now: int) -> int:
    """Return the time in ns to sleep for a packet; 0 if the next command is about to come."""
    if d.session[STATE] != packets.ARMED:
        return LOOK_NS
    spin_ns = min(SPIN_NS, d.interval_ns // 4)
    ahead_ns = d.session[ARRIVED_NS] + d.interval_ns - now
    return min(max(ahead_ns - spin_ns, 0), LOOK_NS) if ahead_ns > -spin_ns else LOOK_NS


@part
def ended(d: Door, t: Table, before: int) -> int:
    """Obey an order to end; return ORDERED or ENDED for a table that came to rest since the state `before`, else 0."""
    s = d.session
    if d.orders[0] != 0:
        lead_to_rest(d, t, 0)
        if s[STATE] == packets.RESTED:
            return ORDERED
    if s[STATE] == packets.RESTED and (before != packets.RESTED or s[CLOSING] == 1):
        s[CLOSING] *= 2  # reported once
        return ENDED
    return 0


@part
def look(d: Door, t: Table) -> int:
    """Serve a waiting packet, or wait for one; return an event of `serve_packets`, or 0 to continue."""
    s = d.session
    before, now = s[STATE], monotonic_ns(d.scratch)  # read before receiving: without a packet, none came until now
    size = receive(d.fd, d.message, d.address)
    if size >= 0:
        now = monotonic_ns(d.scratch)
        now = arrival(d.message, now, wall_clock_ns(d.scratch), s[REACHED_NS])
    advance(d, t, now)  # the only call: the plant is a large piece of code
    if size >= 0 and attend(d, t, size, now) == BEGUN:
        return BEGUN
    event = ended(d, t, before)
    if event != 0:
        return event
    sleep_ns = pause(d, now) if size < 0 else 0
    if sleep_ns > 0:
        wait(d.fd, sleep_ns, d.scratch)
    return 0


@entry
def serve_packets(d: Door, t: Table) -> int:
    """Serve a session until Python has to act; return the event.

    BEGUN: the ARM in `incoming` opens another session, whose key the greeter has. ENDED: the table has come to rest, or
    the session was closed. ORDERED: stopped by `orders`, with the table at rest.
    """
    d, t = borrowed((d, t))
    s, event = d.session, 0
    if s[ARMING] == 1:  # the ARM is dated now, after the session was prepared
        s[ARMING], s[REACHED_NS] = 0, monotonic_ns(d.scratch)
        take(d, t, s[REACHED_NS])
    while event == 0:
        event = look(d, t)
    return event
