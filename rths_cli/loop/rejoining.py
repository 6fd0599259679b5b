"""How the rig comes back to the computed command from where it went on to, or held, while none left.

The distance goes to zero as a critically damped motion, its acceleration below the guard's for braking. Within the
time that a command tells how it goes on there is next to no distance; a longer stall leaves some millimetres.
"""

from __future__ import annotations

import math

import numpy as np

from rths_cli.compiled import part
from rths_cli.loop.guard import AT_REST_M, BRAKE_SHARE, GuardLimits, farthest
from rths_cli.lti import Array

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
