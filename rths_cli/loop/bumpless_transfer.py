"""When samples return after a gap: blend samples and commands back without a step in either.

**Samples.** While samples are missing, the step uses substituted samples of the identified rig (dropouts.py). The rig
may have moved differently: a target that froze holds its command and then closes the distance to the newest one. The
step must not see only the second half of such a motion, because the table's samples would integrate to a velocity that
the table never had. Therefore the weight of the measured samples grows from zero to one over SLOWLY times the length of
the gap, at most 100 ms. This is longer than most of the transient. The guard does not wait: it always judges the
measured samples. The log holds the samples that the step used, with a mark, and the samples in V as they came.

**Command.** The distance between the rig and the computed command decays as a critically damped motion with an
acceleration below the guard's braking acceleration. As long as the command preview lasts, there is hardly any distance;
a longer stall leaves some millimetres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.loop.dropouts import bridge, bridges
from rths_cli.loop.guard import AT_REST_M, BRAKE_SHARE, GuardLimits, farthest
from rths_cli.loop.linear_parts import Channels
from rths_cli.loop.step import staircase_of
from rths_cli.loop.step_arrays import Step
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

LONGEST_S = 100e-3  # longest time over which samples return
SLOWLY = 8  # time over which samples return, over the length of the gap
REMEMBERED = 2  # earlier samples that the correction of a sensor's low pass needs (control.sensor_correction)
MISSED, RETURNED, NOW = range(3)  # places in Returning.gap


class Returning(NamedTuple):
    """State of the return of samples after a gap; c channels, the further ones included."""

    gap: IntArray  # (3,) length of the last gap, samples that have come since, consecutive lost samples now
    longest: int  # largest number of samples over which they return
    came: Array  # (c,) measured samples in V
    accel: Array  # (c,) the same, corrected, in their units
    memory: Array  # (c, 4) state of that correction; the step's own correction runs on the samples that the step uses


def returning(info: RigInfo) -> Returning:
    """Return the state without any gap."""
    channels = len(info.all_channels)
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
    """Note that samples come again after a gap.

    A single sample lost during the return only interrupts it; a longer gap starts a new return.
    """
    if r.gap[RETURNED] == 0:
        r.gap[MISSED] = r.gap[NOW]
    elif r.gap[NOW] > 1:
        r.gap[MISSED] = max(r.gap[NOW], r.gap[MISSED] - r.gap[RETURNED] // SLOWLY)
        r.gap[RETURNED] = 0
    r.gap[NOW] = 0


@part
def share_of_measured(r: Returning) -> float:
    """Count a sample that came and return its weight, 0 to 1; after a single lost sample the weight is 1 at once."""
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


@kept_part
def give_back(r: Returning, s: Step) -> bool:
    """Replace the samples in `s.samples` by the weighted ones that the step uses; return whether they are a mix."""
    after_gap = r.gap[NOW] > 0
    share = share_of_measured(r)
    if share == 1.0 or not bridges(s):
        return False
    hear(r, s, after_gap)
    blend(r, s, share)
    return True


@part
def hear(r: Returning, s: Step, after_gap: bool) -> None:
    """Store the measured samples of `s.samples`, and their corrected accelerations.

    After a gap, the correction is started as if the earlier samples had equalled the first ones that came. A change
    during the gap must not count as a jump within its last interval.
    """
    correction = Channels(s.correction.matrix, r.memory)
    for c in range(s.samples.size):
        r.came[c] = s.samples[c]
    if after_gap:
        for c in range(s.samples.size):
            for j in range(4):
                r.memory[c, j] = s.correction.given[c, j]
        for _ in range(REMEMBERED):
            correction.correct(r.came, r.accel)
    correction.correct(r.came, r.accel)
    for i in range(len(s.measured_by)):
        r.accel[s.measured_by[i]] -= staircase_of(s, i)
    if s.cell >= 0:
        r.accel[s.cell] -= s.cell_reads[0] * staircase_of(s, 0)


@part
def blend(r: Returning, s: Step, share: float) -> None:
    """Write the weighted sum of measured and substituted samples to `s.samples`; `share` is the measured weight."""
    bridge(s)
    for c in range(s.samples.size):
        s.samples[c] += share * (r.came[c] - s.samples[c])


STANDS_V, STEP_V, WANTED_V, STOOD_OFF_V, OFF_V, GROWS_V, RATE = range(7)  # places in a drift
FASTEST_RATE = 250.0  # rad/s; largest rate of the return


def fresh_drift() -> Array:
    """Return the state (7,) of the command's return for a rig at 0 V.

    In this order, in V except the last: position of the rig, its last step, last computed command before rounding,
    distance of the rig to that command, remaining distance, change of the remaining distance per interval, and the rate
    of the return in rad per interval.
    """
    return np.zeros(7)


@part
def hardest(limits: GuardLimits) -> float:
    """Return the guard's braking acceleration in V per interval squared."""
    return BRAKE_SHARE * limits.acceleration_m_s2 * limits.dt_s**2 / limits.gain_m_per_v


@part
def steepest(limits: GuardLimits) -> float:
    """Return the largest change of a command per interval that velocity and rate limits permit, in V."""
    return limits.dt_s * min(limits.velocity_m_s / limits.gain_m_per_v, limits.command_rate_v_s)


@part
def outermost(limits: GuardLimits) -> float:
    """Return the largest command that range and stroke permit, in V."""
    return farthest(limits) / limits.gain_m_per_v


@part
def drift_to(drift: Array, limits: GuardLimits, place: float) -> None:
    """Note the position of the rig in V, within its limits, after an interval in which no command was sent.

    The rate r of the return is chosen so that its acceleration, at most 2 r v + r^2 x for a distance x that grows by v,
    stays below the braking acceleration.
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
    """Return the remaining distance of the rig to the computed command after some intervals, in V."""
    if drift[OFF_V] == 0.0 and drift[GROWS_V] == 0.0:
        return 0.0
    rate = drift[RATE]
    return (drift[OFF_V] + (drift[GROWS_V] + rate * drift[OFF_V]) * intervals) * math.exp(-rate * intervals)


@part
def come_back(drift: Array, limits: GuardLimits) -> None:
    """Advance the return by one interval; it ends below a micrometre."""
    rate = drift[RATE]
    slope = drift[GROWS_V] + rate * drift[OFF_V]
    decay = math.exp(-rate)
    drift[OFF_V], drift[GROWS_V] = (drift[OFF_V] + slope) * decay, (drift[GROWS_V] - rate * slope) * decay
    least = AT_REST_M / limits.gain_m_per_v
    if abs(drift[OFF_V]) < least and abs(drift[GROWS_V]) < least:
        drift[OFF_V], drift[GROWS_V] = 0.0, 0.0


@part
def rejoin(drift: Array, limits: GuardLimits, bit_v: float, command: float) -> float:
    """Return the command to send for a computed one, in V: with the remaining distance added, within all limits.

    The distance is rounded to whole bits, so that the sum stays on the converter's grid.
    """
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
