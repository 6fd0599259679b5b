"""The way that a rig is told to go on, laid within all limits: no place on it, between points too, is beyond one."""

from __future__ import annotations

import math

from rths_cli.compiled import part
from rths_cli.loop.foresight import Foresight
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.rejoining import STEP_V, hardest, off_after, outermost, steepest
from rths_cli.lti import Array
from rths_cli.rigs.udp.way import POINTS, SPACING, Way

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
