"""The target's side of the plain link in compiled code, for `rths serve --link plain` (docs/reference/plain_link.md).

Physics, ticks, watchdog and way to rest are those of udp_target.py; frames, sessions and the target's own clock are
here. The output moves no faster than the table's limit of velocity and no farther than its stroke, whatever is asked.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np

from rths_cli.loop.udp_target import (
    ARMING,
    BEGUN,
    FORGED,
    GREETED,
    LOOK_NS,
    LOST,
    MALFORMED,
    MOVED_TICK,
    REACHED_NS,
    REPLAYED,
    SEQUENCE,
    STATE,
    TICK,
    TICKS_PER_INTERVAL,
    Door,
    Table,
    advance,
    arm,
    arrival,
    ended,
    lead_to_rest,
    moves,
    obey,
    pause,
    receive,
    sample,
    wait,
    wall_clock_ns,
    within,
)
from rths_cli.loop.udp_target import FAULTS as FAULTS_OF_SESSION
from rths_cli.numerics.clock import SPIN_NS, IntArray, monotonic_ns
from rths_cli.numerics.compiled import borrowed, entry, external, kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.late_command_trajectory import COASTS_S, POINTS, coast
from rths_cli.rigs.udp.packets import get_real, get_small, put_bytes, put_real
from rths_cli.rigs.udp.plain_frames import (
    ASK,
    AT_REST,
    BEGIN,
    COMMAND_V,
    FAULTS,
    NUMBER,
    OF_TARGET_NUMBER,
    ORDER,
    REST,
    SAMPLES_V,
    SESSION,
    TIME_S,
    is_of_runner,
    put_head,
)

_send = external("send", "intp", "intc", "uintp", "uintp", "intc")
_AT_ONCE = 0x40  # MSG_DONTWAIT
MADE_UP = 2  # longest pause, in sample intervals, whose movement one command may make up for

# indices in Side.marks: 1 where this target has the clock; the newest session; numbers of the acting command and of one
# that waits for its instant (0: none); number and time of the next instant of this target's clock
OF_TARGET, NEWEST_SESSION, ACTING, WAITING, INSTANT, NEXT_NS = range(6)


class Side(NamedTuple):
    """What a target of the plain link keeps beside its door."""

    marks: IntArray  # (6,)
    waiting_v: Array  # (1,) the command that waits for its instant


def open_side(of_target: bool) -> Side:
    """Return the state of a target that starts; `of_target`: it has the clock."""
    side = Side(np.zeros(6, np.int64), np.zeros(1))
    side.marks[OF_TARGET], side.marks[NEXT_NS] = int(of_target), time.monotonic_ns()
    return side


@part
def show(d: Door, p: Side, t: Table, number: int, acting: int, output_v: float, now: int) -> None:
    """Send the samples, with the command that acted when they were taken."""
    out, state = d.outgoing, d.session[STATE]
    put_head(
        out, OF_TARGET_NUMBER, p.marks[NEWEST_SESSION], number, acting, AT_REST if state == packets.IDLE else state
    )
    put_bytes(out, FAULTS, d.session[FAULTS_OF_SESSION], 4)
    put_real(out, TIME_S, 1e-9 * now)
    put_real(out, COMMAND_V, output_v)
    for c in range(t.samples.size):
        put_real(out, SAMPLES_V + 8 * c, t.samples[c])
    _send(d.fd, out.ctypes.data, SAMPLES_V + 8 * t.samples.size, _AT_ONCE)


@part
def count(d: Door, p: Side, t: Table) -> int:
    """Let a well-formed frame count, by the rules of the page; return BEGUN if it begins a session, else 0."""
    s, frame = d.session, d.incoming
    order, session, number = get_small(frame, ORDER), get_small(frame, SESSION), get_small(frame, NUMBER)
    if order == ASK:
        d.counts[GREETED] += 1
    elif order == BEGIN:
        if not moves(d) and session == p.marks[NEWEST_SESSION] + 1 and number == 0:
            p.marks[NEWEST_SESSION] = session
            return BEGUN
    elif session != p.marks[NEWEST_SESSION]:
        d.counts[FORGED] += 1
    elif number <= s[SEQUENCE]:
        d.counts[REPLAYED] += 1
    else:
        d.counts[LOST] += number - s[SEQUENCE] - 1
        s[SEQUENCE] = number
        obey_order(d, p, t, order, number)
    return 0


@part
def obey_order(d: Door, p: Side, t: Table, order: int, number: int) -> None:
    """Obey a REST, or keep a COMMAND until its instant; one that is not a number or out of range leads to rest."""
    if d.session[STATE] != packets.ARMED:
        return
    volts = get_real(d.incoming, COMMAND_V)
    outermost = min(t.limits.command_v, t.limits.stroke_m / t.limits.gain_m_per_v)
    if order == REST:
        lead_to_rest(d, t, 0)
    elif not (math.isfinite(volts) and abs(volts) <= outermost):
        lead_to_rest(d, t, packets.BAD_COMMAND)
    else:
        p.marks[WAITING], p.waiting_v[0] = number, volts


@part
def latch(d: Door, p: Side, t: Table, now: int) -> None:
    """Put the waiting command out, no faster than the table's limit of velocity since the output moved last; while the
    next one is late, the output goes on by its step."""
    s, marks = d.session, p.marks
    if marks[WAITING] == 0 or s[STATE] != packets.ARMED:
        return
    held, before = t.latched_v[0], t.latched_v[1]
    ticks = min(s[TICK] - s[MOVED_TICK], MADE_UP * TICKS_PER_INTERVAL)
    most = t.limits.velocity_m_s / t.limits.gain_m_per_v * t.limits.dt_s * ticks
    t.way.volts[0], t.way.marks[POINTS] = held + within(p.waiting_v[0] - held, most), 0
    step_v = (t.way.volts[0] - before) / (marks[WAITING] - marks[ACTING])
    marks[ACTING], marks[WAITING] = marks[WAITING], 0
    obey(d, t, now)
    coast(t.way, step_v, max(round(1e9 * COASTS_S / d.interval_ns), 1))


@part
def begin(d: Door, p: Side, t: Table) -> None:
    """Begin the session whose BEGIN was received; a target without the clock answers it."""
    s, marks = d.session, p.marks
    now = monotonic_ns(d.scratch)
    s[ARMING], s[SEQUENCE], s[REACHED_NS] = 0, 0, now
    marks[ACTING], marks[WAITING], marks[INSTANT], marks[NEXT_NS] = 0, 0, 0, now
    arm(d, t, now)
    if marks[OF_TARGET] == 0:
        sample(t, s)
        show(d, p, t, 0, 0, 0.0, now)


@part
def instant(d: Door, p: Side, t: Table) -> None:
    """Sample at an instant of this target's clock, send the frame, then put the newest command out."""
    marks = p.marks
    sample(t, d.session)
    show(d, p, t, marks[INSTANT], marks[ACTING], t.latched_v[0], marks[NEXT_NS])
    latch(d, p, t, marks[NEXT_NS])
    marks[INSTANT] += 1
    marks[NEXT_NS] += d.interval_ns


@part
def attend(d: Door, p: Side, t: Table, size: int, now: int) -> int:
    """Let a received frame count, and answer it where the runner has the clock; return BEGUN or 0."""
    if not is_of_runner(d.incoming, size):
        d.counts[MALFORMED] += 1
        return 0
    acting, output_v = p.marks[ACTING], t.latched_v[0]
    if p.marks[OF_TARGET] == 0:
        sample(t, d.session)
    if count(d, p, t) == BEGUN:
        return BEGUN
    if p.marks[OF_TARGET] == 0:
        latch(d, p, t, now)
        show(d, p, t, max(d.session[SEQUENCE], 0), acting, output_v, now)
    return 0


@kept_part
def look(d: Door, p: Side, t: Table) -> int:
    """Serve a waiting frame and the instants before it, or wait; return an event of `serve_frames`, or 0."""
    s, marks = d.session, p.marks
    before, now = s[STATE], monotonic_ns(d.scratch)
    size = receive(d.fd, d.message, d.address)
    if size >= 0:
        now = monotonic_ns(d.scratch)
        now = arrival(d.message, now, wall_clock_ns(d.scratch), s[REACHED_NS])
    due = True
    while due:
        due = marks[OF_TARGET] == 1 and marks[NEXT_NS] <= now
        advance(d, t, marks[NEXT_NS] if due else now)
        if due:
            instant(d, p, t)
    if size >= 0 and attend(d, p, t, size, now) == BEGUN:
        return BEGUN
    event = ended(d, t, before)
    if event != 0:
        return event
    sleep_ns = until_next(d, p, now) if size < 0 else 0
    if sleep_ns > 0:
        wait(d.fd, sleep_ns, d.scratch)
    return 0


@part
def until_next(d: Door, p: Side, now: int) -> int:
    """Return the time in ns to sleep for a frame or the next instant; 0 if the instant is about to come."""
    if p.marks[OF_TARGET] == 0:
        return pause(d, now)
    ahead_ns = p.marks[NEXT_NS] - now
    if moves(d):
        ahead_ns -= min(SPIN_NS, d.interval_ns // 4)
    return min(max(ahead_ns, 0), LOOK_NS)


@entry
def serve_frames(d: Door, p: Side, t: Table) -> int:
    """Serve frames until Python has to act; return the event, as `udp_target.serve_packets` does."""
    d, p, t = borrowed((d, p, t))
    event = 0
    if d.session[ARMING] == 1:
        begin(d, p, t)
    while event == 0:
        event = look(d, p, t)
    return event
