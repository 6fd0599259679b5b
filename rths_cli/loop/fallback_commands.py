"""What a table is sent when the step's command is not there, and how the command returns to the step's without a
jump.

A processor or a link that stalls for some milliseconds must not shake the building. The step is linear except for its
limits and its rounding. The commands that it would compute on substituted samples (dropouts.py) are therefore a matrix
times its state and the coming drive. The matrix is computed before the run, by simulating the step from each unit
state. One row of the drive is read per point of the preview; the rows between them are assumed to lie on the same
interpolating curve as the rig's trajectory.

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

from rths_cli.control.designed_blocks import Blocks
from rths_cli.loop.dropouts import bridge, bridges
from rths_cli.loop.guard import AT_REST_M, BRAKE_SHARE, GuardLimits, GuardState, farthest, fresh_guard, ramp_down
from rths_cli.loop.linear_parts import Channels
from rths_cli.loop.step import note_sent, staircase_of, step
from rths_cli.loop.step_arrays import Step, assemble
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry, kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import copied, padded, product, tiled
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.udp.late_command_trajectory import POINTS, SPACING, Way, fresh_way, place_after
from rths_cli.rigs.udp.packets import MOST_POINTS

LONGEST_S = 100e-3  # longest time over which samples return
SLOWLY = 8  # time over which samples return, over the length of the gap
REMEMBERED = 2  # earlier samples that the correction of a sensor's low pass needs (control.sensor_correction)
MISSED, RETURNED, NOW = range(3)  # places in Returning.gap

STANDS_V, STEP_V, WANTED_V, STOOD_OFF_V, OFF_V, GROWS_V, RATE = range(7)  # places in a drift
FASTEST_RATE = 250.0  # rad/s; largest rate of the return
SPACING_S = 8e-3  # approximate time between two points: the preview lasts 112 ms
DRIVEN = 3  # values in a row of the drive
# Step between two points of the preview: at most LINE of the largest permitted one, and different from the step before
# by at most CHANGE of it. The slope of the curve is then at most LINE + CHANGE / 2 of the permitted one at its
# beginning, and LINE + CHANGE / 4 later.
LINE, CHANGE = 0.8, 0.4
CORNER = 0.125  # overshoot of the curve beyond a point at which it turns, over the largest change of a step


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


class Foresight(NamedTuple):
    """The prediction of the coming commands; without points there is no preview."""

    matrix: Array  # (tiles, n, 4), tiled_products.tiled: state and coming drive -> predicted commands
    given: Array  # (n,) the state, then rows of the drive: that of the last step and those of the points
    made: Array  # (points padded to 4,) predicted commands in V
    points: int
    spacing: int  # sample intervals from one point to the next
    rest: GuardState  # copy of the guard's state, in which its way to rest is predicted


def no_foresight(channels: int) -> Foresight:
    """Return the prediction without points, for a rig that receives no preview."""
    return Foresight(np.zeros((0, 0, 4)), np.zeros(0), np.zeros(0), 0, 1, fresh_guard(channels))


def foresight_of(blocks: Blocks, source: int, dt_s: float) -> Foresight:
    """Return the prediction for a run; `source` is that of the step."""
    spacing = max(round(SPACING_S / dt_s), 1)
    ahead = MOST_POINTS * spacing  # steps
    own = [_goes_on(blocks, source, ahead, place) for place in range(assemble(blocks, source).deciding)]
    driven = [_goes_on(blocks, source, ahead, -1 - column) for column in range(DRIVEN)]
    by_points = [np.convolve(share, one)[:ahead] for share in _between_points(spacing) for one in driven]
    rows = np.vstack([*own, *by_points])[:, spacing - 1 :: spacing]
    return Foresight(
        tiled(rows.T), np.zeros(len(rows)), np.zeros(padded(MOST_POINTS)), MOST_POINTS, spacing,
        fresh_guard(len(blocks.correction.C)),
    )  # fmt: skip


def _between_points(spacing: int) -> Array:
    """Return the weights (points + 1, rows) of the points in each of the coming rows of the drive.

    The first point is the row before them.
    """
    shares = np.zeros((MOST_POINTS + 1, MOST_POINTS * spacing))
    for point, row in enumerate(shares):
        way = fresh_way()
        way.volts[point], way.marks[POINTS], way.marks[SPACING] = 1.0, MOST_POINTS, spacing
        go_the_way(way, row)
    return shares


def _goes_on(blocks: Blocks, source: int, steps: int, place: int) -> Array:
    """Return the commands (steps,) in V of a step without limits, rounding and samples, for one unit input.

    The input is a unit in the state at index `place`, or, for -1, -2, -3, a unit in a column of the drive's first row.
    """
    s = assemble(blocks, source)
    endless = np.full(s.command.size, np.inf)
    s = s._replace(bit_v=0.0, command_limit_v=endless, feedback_limit_v=endless)
    drive, commands = np.zeros((steps, DRIVEN)), np.zeros(steps)
    if place >= 0:
        s.state[place] = 1.0
    else:
        drive[0, -1 - place] = 1.0
    go_on_alone(s, drive, commands)
    return commands


@entry
def go_on_alone(s: Step, drive: Array, commands: Array) -> None:
    """Simulate a step on substituted samples over a drive (n, 3); write its commands (n,) in V."""
    s, drive, commands = borrowed((s, drive, commands))
    for k in range(drive.shape[0]):
        bridge(s)
        step(s, drive[k])
        note_sent(s)
        commands[k] = s.command[0]


@entry
def go_the_way(way: Way, places: Array) -> None:
    """Write the positions (n,) in V along a preview after one, two, ... intervals."""
    way, places = borrowed((way, places))
    for i in range(places.size):
        places[i] = place_after(way, i + 1)


@part
def foresee(f: Foresight, s: Step, drive: Array, k: int, last: int, share: float) -> None:
    """Predict the commands that follow that of step k - 1, whose state the step holds.

    The drive (n, 3) continues with row k and is constant from row `last` on. The commands are multiplied by `share`.
    """
    copied(s.deciding, s.state, f.given)
    at = s.deciding
    final = min(last, drive.shape[0] - 1)
    for i in range(f.points + 1):
        row = min(k - 1 + i * f.spacing, final)
        for column in range(DRIVEN):
            f.given[at] = drive[row, column] + 0.0
            at += 1
    product(f.matrix, f.given.size, f.given, f.made)
    for i in range(f.points):
        f.made[i] *= share


@part
def foresee_rest(f: Foresight, limits: GuardLimits, g: GuardState) -> None:
    """Predict the commands of the guard on its way to rest."""
    f.rest.flags[0], f.rest.motion[0], f.rest.motion[1] = g.flags[0], g.motion[0], g.motion[1]
    for i in range(f.points):
        for _ in range(f.spacing):
            ramp_down(limits, f.rest)
        f.made[i] = f.rest.motion[0] / limits.gain_m_per_v


@part
def lay_way(way: Way, f: Foresight, limits: GuardLimits, drift: Array) -> None:
    """Write the preview that follows the command in `way.volts[0]`.

    It is the prediction plus the decaying distance of the rig, limited so that the rig can stop at the last point. Each
    step between two points is within LINE of the largest permitted one, and differs from the step before by at most
    CHANGE of it. The first step may differ from the step that led to the command only by the guard's braking
    acceleration: if a command is slightly late and the rig follows the preview for one interval, that command must not
    throw it back.
    """
    way.marks[POINTS], way.marks[SPACING] = f.points, f.spacing
    most = f.spacing * steepest(limits)
    braked = min(hardest(limits) * f.spacing**2, CHANGE * most)
    to_stop = max(braked, abs(drift[STEP_V]) * f.spacing / (f.points - 0.5))
    edge, change = outermost(limits) - CORNER * CHANGE * most, braked
    line = within(drift[STEP_V] * f.spacing, LINE * most)
    for i in range(f.points):
        here, before = way.volts[i], line
        wanted = f.made[i] + off_after(drift, (i + 1) * f.spacing) - here
        line = within(wanted if math.isfinite(wanted) else 0.0, min(LINE * most, to_stop * (f.points - i - 0.5)))
        line = before + within(line - before, change)
        line = max(min(line, room_to_brake(edge - here, braked)), -room_to_brake(edge + here, braked))
        way.volts[i + 1], change = here + line, CHANGE * most


@part
def room_to_brake(room: float, braked: float) -> float:
    """Return the longest step between two points that still permits braking within the remaining `room`.

    Each step may be shorter than the one before by `braked`, the last one by half of that.
    """
    return max(math.sqrt(2.0 * braked * max(room, 0.0)) - 0.5 * braked, 0.0)


@part
def within(value: float, most: float) -> float:
    """Return a value limited to +-`most`."""
    return min(max(value, -most), most)
