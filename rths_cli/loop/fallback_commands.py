"""The commands that follow if no samples come: foreseen in every step, laid within all limits.

A processor or a link that stalls for some milliseconds must not shake the building. The step is linear but for its
limits and its rounding, so the commands that it computes on bridged samples (dropouts.py) are a matrix times its state
and the drive to come. The matrix is found before the run, by letting a step go on by itself from each unit state.
Of the drive one row is read per point, and the rows between are taken to lie on the same curve as the way of the rig.
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
from rths_cli.numerics.compiled import entry, part
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import padded, product, tiled
from rths_cli.rigs.udp.late_command_trajectory import POINTS, SPACING, Way, fresh_way, place_after
from rths_cli.rigs.udp.packets import MOST_POINTS

SPACING_S = 8e-3  # between two points, about: 112 ms are foreseen
DRIVEN = 3  # values in a row of the drive


class Foresight(NamedTuple):
    """The matrix, and where what it is multiplied with is gathered; of no points where nothing is told."""

    matrix: Array  # (tiles, n, 4), tiled_products.tiled: state and drive to come -> points
    given: Array  # (n,) the state, then rows of the drive: that of the last step and those of the points
    made: Array  # (points padded to 4,) in V
    points: int
    spacing: int  # sample intervals from one point to the next
    rest: GuardState  # led to rest ahead of the guard


def no_foresight(channels: int) -> Foresight:
    """Return the foresight of a rig that is not told how commands go on."""
    return Foresight(np.zeros((0, 0, 4)), np.zeros(0), np.zeros(0), 0, 1, fresh_guard(channels))


def foresight_of(blocks: Blocks, source: int, dt_s: float) -> Foresight:
    """Return the foresight of a run of a source."""
    spacing = max(round(SPACING_S / dt_s), 1)
    ahead = MOST_POINTS * spacing  # steps
    own = [_goes_on(blocks, source, ahead, place) for place in range(_size(assemble(blocks, source)))]
    driven = [_goes_on(blocks, source, ahead, -1 - column) for column in range(DRIVEN)]
    by_points = [np.convolve(share, one)[:ahead] for share in _between_points(spacing) for one in driven]
    rows = np.vstack([*own, *by_points])[:, spacing - 1 :: spacing]
    return Foresight(
        tiled(rows.T), np.zeros(len(rows)), np.zeros(padded(MOST_POINTS)), MOST_POINTS, spacing,
        fresh_guard(len(blocks.correction.C)),
    )  # fmt: skip


def _between_points(spacing: int) -> Array:
    """Return what each point has of the rows to come, (points + 1, rows): the first point is the row before them."""
    shares = np.zeros((MOST_POINTS + 1, MOST_POINTS * spacing))
    for point, row in enumerate(shares):
        way = fresh_way()
        way.volts[point], way.marks[POINTS], way.marks[SPACING] = 1.0, MOST_POINTS, spacing
        go_the_way(way, row)
    return shares


def _goes_on(blocks: Blocks, source: int, steps: int, place: int) -> Array:
    """Return the commands (steps,) of a step without limits and rounding that nobody gives samples, from a unit at a
    place of its state, or from rest under a unit of the drive at first (-1, -2, -3: its columns)."""
    s = assemble(blocks, source)
    s = s._replace(shaping=np.zeros(3), command_limit_v=np.inf, feedback_limit_v=np.inf)
    drive, commands = np.zeros((steps, DRIVEN)), np.zeros(steps)
    if place >= 0:
        scattered(s, np.eye(1, _size(s), place)[0])
    else:
        drive[0, -1 - place] = 1.0
    go_on_alone(s, drive, commands)
    return commands


def _size(s: Step) -> int:
    return 3 * s.samples.size + sum(values.size for values in _parts(s))


def _parts(s: Step) -> tuple[Array, ...]:
    """Return what a step keeps from one sample to the next, but for the states of its correction."""
    return (
        s.estimator.given, s.numerical.state, s.feedforward.given, s.feedback.given, s.recent, s.samples, s.sent
    )  # fmt: skip


def scattered(s: Step, state: Array) -> None:
    """Put a state (n,) into a step, in the order of `gathered`."""
    s.correction.given[:, :3] = state[: 3 * s.samples.size].reshape(-1, 3)
    at = 3 * s.samples.size
    for values in _parts(s):
        values[:] = state[at : at + values.size]
        at += values.size


@part
def gathered(s: Step, state: Array) -> int:
    """Write a step's state to the front of an array; return its size."""
    at = 0
    for c in range(s.samples.size):
        for j in range(3):
            state[at] = s.correction.given[c, j]
            at += 1
    at = put(s.estimator.given, state, at)
    at = put(s.numerical.state, state, at)
    at = put(s.feedforward.given, state, at)
    at = put(s.feedback.given, state, at)
    at = put(s.recent, state, at)
    at = put(s.samples, state, at)
    return put(s.sent, state, at)


@part
def put(values: Array, state: Array, at: int) -> int:
    """Copy values to a place; return the place after them."""
    for i in range(values.size):
        state[at + i] = values[i] + 0.0  # as `tiles.copied`
    return at + values.size


@entry
def go_on_alone(s: Step, drive: Array, commands: Array) -> None:
    """Let a step go on without samples over a drive (n, 3); write its commands (n,) in V."""
    for k in range(drive.shape[0]):
        bridge(s)
        commands[k] = step(s, drive[k])
        note_sent(s, commands[k])


@entry
def go_the_way(way: Way, places: Array) -> None:
    """Write where a command has gone on to after one, two, ... intervals, (n,)."""
    for i in range(places.size):
        places[i] = place_after(way, i + 1)


@part
def foresee(f: Foresight, s: Step, drive: Array, k: int, last: int, share: float) -> None:
    """Foresee the commands after that of step k - 1, whose state the step is in: the drive (n, 3) goes on with row k,
    and stays as it is from row `last` on. Of them a share is asked for."""
    at = gathered(s, f.given)
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
    """Foresee the commands of the guard on its way to rest."""
    f.rest.flags[0], f.rest.motion[0], f.rest.motion[1] = g.flags[0], g.motion[0], g.motion[1]
    for i in range(f.points):
        for _ in range(f.spacing):
            ramp_down(limits, f.rest)
        f.made[i] = f.rest.motion[0] / limits.gain_m_per_v


# The line between two points is at most LINE of the steepest allowed and differs from the one before by at most CHANGE
# of it: the curve is then nowhere steeper than allowed, at its beginning LINE + CHANGE / 2, later LINE + CHANGE / 4.
LINE, CHANGE = 0.8, 0.4
CORNER = 0.125  # of the largest change of a line: how far the curve may go beyond a point where it turns


@part
def lay_way(way: Way, f: Foresight, limits: GuardLimits, drift: Array) -> None:
    """Tell how the command goes on that the way begins with: as foreseen, as the rig comes back from where it is off,
    and so that it can stop at the last point.

    Whatever was foreseen, the way holds what is allowed: each line between two points, from the command to the first
    one too, is within LINE of the steepest, and differs from the one before by at most CHANGE of it. The line before
    the command is the step that led to it, from which the first may differ only by what the guard brakes with: a rig
    that goes on for an interval because a command is a little late must not be thrown back by that command.
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
    """Return how long a line may be at most where so much room is left, and each line may be shorter than the one
    before by `braked`, the last one by half of that."""
    return max(math.sqrt(2.0 * braked * max(room, 0.0)) - 0.5 * braked, 0.0)


@part
def within(value: float, most: float) -> float:
    """Return a value, or the limit of its sign where it is beyond that."""
    return min(max(value, -most), most)
