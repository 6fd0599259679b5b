"""The commands of the next tenth of a second, sent ahead with every command in case the loop stalls, within all limits.

A processor or a link that stalls for some milliseconds must not shake the building. The step is linear except for its
limits and its rounding. The commands that it would compute on substituted samples (dropouts.py) are therefore a matrix
times its state and the coming drive. The matrix is computed before the run, by simulating the step from each unit
state. One row of the drive is read per point of the preview; the rows between them are assumed to lie on the same
interpolating curve as the rig's trajectory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.loop.bumpless_transfer import STEP_V, hardest, off_after, outermost, steepest
from rths_cli.loop.dropouts import bridge
from rths_cli.loop.guard import GuardLimits, GuardState, fresh_guard, ramp_down
from rths_cli.loop.step import note_sent, step
from rths_cli.loop.step_arrays import Step, assemble
from rths_cli.numerics.compiled import borrowed, entry, part
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import copied, padded, product, tiled
from rths_cli.rigs.udp.late_command_trajectory import POINTS, SPACING, Way, fresh_way, place_after
from rths_cli.rigs.udp.packets import MOST_POINTS

SPACING_S = 8e-3  # approximate time between two points: the preview lasts 112 ms
DRIVEN = 3  # values in a row of the drive


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


# Step between two points of the preview: at most LINE of the largest permitted one, and different from the step before
# by at most CHANGE of it. The slope of the curve is then at most LINE + CHANGE / 2 of the permitted one at its
# beginning, and LINE + CHANGE / 4 later.
LINE, CHANGE = 0.8, 0.4
CORNER = 0.125  # overshoot of the curve beyond a point at which it turns, over the largest change of a step


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
