"""After a gap: how samples come back, and how the rig comes back to the computed command, without a step.

While samples are missing, the step goes on as identified (dropouts.py). The rig may have done something else: a target
that froze holds its command and then closes the distance to the newest. What that shakes, table and floors, must not be
taken in by halves: table samples that begin in the middle of such a motion integrate to a velocity that the table never
had. Therefore the share of the measurement grows from none to all, over SLOWLY times the length of the gap and 100 ms
at most: longer than most of such a transient, as short as the shortest gaps that are borne. The guard does not wait for
it: it judges what the channels gave. The log keeps what the step was given, with a mark, and the samples in V as they
came.

The distance goes to zero as a critically damped motion, its acceleration below the guard's for braking. Within the
time that a command tells how it goes on there is next to no distance; a longer stall leaves some millimetres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.loop.dropouts import bridge, bridges
from rths_cli.loop.guard import AT_REST_M, BRAKE_SHARE, GuardLimits, farthest
from rths_cli.loop.step import correct, staircase_of
from rths_cli.loop.step_arrays import Channels, Step
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

LONGEST_S = 100e-3
SLOWLY = 8
REMEMBERED = 2  # samples before its own that a correction of a sensor's low pass needs (control.sensor_correction)
MISSED, RETURNED, NOW = range(3)  # places in Returning.gap


class Returning(NamedTuple):
    """What is known of a gap in the samples; c channels."""

    gap: IntArray  # (3,) length of the gap that samples return from, how many have returned, and lost in a row now
    longest: int  # samples over which they come back, at most
    came: Array  # (c,) the samples that came, in V,
    accel: Array  # (c,) and corrected in m/s^2,
    memory: Array  # (c, 4) by a correction with a memory of its own: that of the step holds what the step was given


def returning(info: RigInfo) -> Returning:
    """Return that no samples are missing."""
    channels = len(info.channels)
    return Returning(
        np.zeros(3, dtype=np.int64), round(LONGEST_S / info.dt_s), np.zeros(channels), np.zeros(channels),
        np.zeros((channels, 4)),
    )  # fmt: skip


@part
def note_lost(r: Returning) -> None:
    """Count a sample that is missing."""
    r.gap[NOW] += 1


@part
def end_gap(r: Returning) -> None:
    """Take note that samples come again: one that missed while others returned only held up their return."""
    if r.gap[RETURNED] == 0:
        r.gap[MISSED] = r.gap[NOW]
    elif r.gap[NOW] > 1:
        r.gap[MISSED] = max(r.gap[NOW], r.gap[MISSED] - r.gap[RETURNED] // SLOWLY)
        r.gap[RETURNED] = 0
    r.gap[NOW] = 0


@part
def share_of_measured(r: Returning) -> float:
    """Count a sample that came; return its share in what the step is given: all of it where one alone was lost."""
    if r.gap[NOW] > 0:
        end_gap(r)
    if r.gap[MISSED] == 0:
        return 1.0
    r.gap[RETURNED] += 1
    over = 1 + min(SLOWLY * (r.gap[MISSED] - 1), r.longest)
    if r.gap[RETURNED] >= over:
        r.gap[MISSED], r.gap[RETURNED] = 0, 0
        return 1.0
    way = r.gap[RETURNED] / over
    return way * way * (3.0 - 2.0 * way)


@part
def give_back(r: Returning, s: Step) -> bool:
    """Give the step, in `s.samples`, what it is to have of the samples that came; return whether that is a mix."""
    after_gap = r.gap[NOW] > 0
    share = share_of_measured(r)
    if share == 1.0 or not bridges(s):
        return False
    hear(r, s, after_gap)
    blend(r, s, share)
    return True


@part
def hear(r: Returning, s: Step, after_gap: bool) -> None:
    """Keep the samples in `s.samples` as they came, and correct them.

    The first ones after a gap are taken for those before them, too: a jump within the gap is none of its last interval.
    """
    correction = Channels(s.correction.matrix, r.memory)
    for c in range(s.samples.size):
        r.came[c] = s.samples[c]
    if after_gap:
        for c in range(s.samples.size):
            for j in range(4):
                r.memory[c, j] = s.correction.given[c, j]
        for _ in range(REMEMBERED):
            correct(correction, r.came, r.accel)
    correct(correction, r.came, r.accel)
    r.accel[0] -= staircase_of(s)


@part
def blend(r: Returning, s: Step, share: float) -> None:
    """Mix the samples that came with what the channels would show if all had gone on as identified."""
    bridge(s)
    for c in range(s.samples.size):
        s.samples[c] += share * (r.came[c] - s.samples[c])


STANDS_V, STEP_V, WANTED_V, STOOD_OFF_V, OFF_V, GROWS_V, RATE = range(7)  # places in a drift
FASTEST_RATE = 250.0  # rad/s


def fresh_drift() -> Array:
    """Return a drift (7,) of a rig at 0 V.

    All in V: where it stands, its last step, the last computed command before it was rounded, how far from that it
    stood, how far it is still to come back, by how much that grows in an interval; and the rate of its return in rad
    per interval.
    """
    return np.zeros(7)


@part
def hardest(limits: GuardLimits) -> float:
    """Return the acceleration the guard brakes with, in V per interval squared."""
    return BRAKE_SHARE * limits.acceleration_m_s2 * limits.dt_s**2 / limits.gain_m_per_v


@part
def steepest(limits: GuardLimits) -> float:
    """Return how far velocity and rate limits let a command go in an interval, in V."""
    return limits.dt_s * min(limits.velocity_m_s / limits.gain_m_per_v, limits.command_rate_v_s)


@part
def outermost(limits: GuardLimits) -> float:
    """Return the largest command that range and stroke both allow, in V."""
    return farthest(limits) / limits.gain_m_per_v


@part
def drift_to(drift: Array, limits: GuardLimits, place: float) -> None:
    """Note where the rig has gone, in V and no farther than it may, in an interval in which no command left.

    The rate r is one whose return, from a distance x that grows by v, is no harder than 2 r v + r^2 x.
    """
    stands = min(max(place, -outermost(limits)), outermost(limits))
    off = stands - drift[WANTED_V]
    drift[GROWS_V] = off - drift[STOOD_OFF_V]
    drift[STANDS_V], drift[STOOD_OFF_V], drift[OFF_V] = stands, off, off
    half = 0.5 * hardest(limits)
    fastest = min(FASTEST_RATE * limits.dt_s, 1.0)
    drift[RATE] = min(fastest, math.sqrt(half / abs(off)), half / (2.0 * abs(drift[GROWS_V])))


@part
def off_after(drift: Array, intervals: float) -> float:
    """Return how far the rig is off so many intervals from now on, in V."""
    if drift[OFF_V] == 0.0 and drift[GROWS_V] == 0.0:
        return 0.0
    rate = drift[RATE]
    return (drift[OFF_V] + (drift[GROWS_V] + rate * drift[OFF_V]) * intervals) * math.exp(-rate * intervals)


@part
def come_back(drift: Array, limits: GuardLimits) -> None:
    """Let an interval pass; less than a micrometre is nothing."""
    rate = drift[RATE]
    slope = drift[GROWS_V] + rate * drift[OFF_V]
    decay = math.exp(-rate)
    drift[OFF_V], drift[GROWS_V] = (drift[OFF_V] + slope) * decay, (drift[GROWS_V] - rate * slope) * decay
    least = AT_REST_M / limits.gain_m_per_v
    if abs(drift[OFF_V]) < least and abs(drift[GROWS_V]) < least:
        drift[OFF_V], drift[GROWS_V] = 0.0, 0.0


@part
def rejoin(drift: Array, limits: GuardLimits, bit_v: float, command: float) -> float:
    """Return what leaves for a computed command: as far off as the rig still is, in whole bits, within all limits."""
    if drift[OFF_V] != 0.0 or drift[GROWS_V] != 0.0:
        come_back(drift, limits)
    off = drift[OFF_V] if bit_v == 0.0 else math.floor(drift[OFF_V] / bit_v + 0.5) * bit_v
    most, last = steepest(limits), drift[STANDS_V]
    left = min(max(command + off, last - most), last + most)
    left = min(max(left, -outermost(limits)), outermost(limits))
    if left != command + off:
        drift[OFF_V] = left - command
    drift[STANDS_V], drift[STEP_V], drift[STOOD_OFF_V] = left, left - last, left - drift[WANTED_V]
    return left
