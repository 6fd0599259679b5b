"""The trajectory between commands sent ahead, which runner and target follow while the next command is late
(docs/reference/udp.md).

Runner and target both use `place_after`, so that after a stall the runner knows the position of the table. Between two
points it is a cubic whose slope at each point is the mean of the slopes on both sides (E. Catmull and R. Rom 1974). It
is at most twice as steep as the steepest straight line between consecutive points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.packets import Bytes

POINTS, SPACING = range(2)  # indices in Way.marks
COASTS_S = 0.05  # time over which a target of the plain link comes to a stand while no command comes
FARTHEST_V = 1e6  # largest accepted point, so that no position between two points overflows


class Way(NamedTuple):
    """A command with its preview."""

    volts: Array  # (MOST_POINTS + 1,) the command, then the points after one, two, ... times the spacing, in V
    marks: IntArray  # (2,) number of points (0: the command is held), spacing of the points in sample intervals


def fresh_way() -> Way:
    """Return a command of 0 V without points."""
    return Way(np.zeros(packets.MOST_POINTS + 1), np.array([0, 1]))


@part
def place_after(way: Way, intervals: int) -> float:
    """Return the position of the preview in V, a number of sample intervals after its command.

    It begins with the curvature of the first three points and comes to rest at the last one.
    """
    points, spacing = way.marks[POINTS], way.marks[SPACING]
    behind = intervals // spacing
    if behind >= points:
        return way.volts[points]
    here, there = way.volts[behind], way.volts[behind + 1]
    after = way.volts[behind + 2] if behind + 2 <= points else here
    before = way.volts[behind - 1] if behind > 0 else 3.0 * (here - there) + after
    t = (intervals - behind * spacing) / spacing
    bend, twist = 2.0 * before - 5.0 * here + 4.0 * there - after, after - before + 3.0 * (here - there)
    return here + 0.5 * t * (there - before + t * (bend + t * twist))


@part
def coast(way: Way, step_v: float, intervals: int) -> None:
    """Let a command without preview go on by its last step, evenly slower until it stands after some intervals: after j
    of them by step_v (j - j^2 / (2 intervals))."""
    way.volts[1] = way.volts[0] + 0.5 * step_v * intervals
    way.marks[POINTS], way.marks[SPACING] = 1, intervals


@part
def put_way(packet: Bytes, way: Way) -> None:
    """Write the words of a COMMAND to a packet: the command alone, or with spacing and points."""
    packets.put_real(packet, packets.COMMAND_V, way.volts[0])
    if way.marks[POINTS] > 0:
        packets.put_int(packet, packets.SPACING, way.marks[SPACING])
        for i in range(way.marks[POINTS]):
            packets.put_real(packet, packets.FIRST_POINT + 8 * i, way.volts[1 + i])


@part
def words_of(way: Way) -> int:
    """Return the number of words that `put_way` writes."""
    return way.marks[POINTS] + 2 if way.marks[POINTS] > 0 else 1


@part
def take_way(packet: Bytes, way: Way) -> None:
    """Read the words of a COMMAND; if the spacing or a point is out of range or NaN, the command is held."""
    points, spacing = max(int(packet[packets.COUNT]) - 2, 0), 1
    way.volts[0] = packets.get_real(packet, packets.COMMAND_V)
    if points > 0:
        spacing = packets.get_int(packet, packets.SPACING)
    for i in range(points):
        way.volts[1 + i] = packets.get_real(packet, packets.FIRST_POINT + 8 * i)
        if not abs(way.volts[1 + i]) <= FARTHEST_V:
            spacing = 0
    good = 1 <= spacing <= packets.LONGEST_SPACING
    way.marks[POINTS], way.marks[SPACING] = points if good else 0, spacing if good else 1
