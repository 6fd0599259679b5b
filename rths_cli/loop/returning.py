"""How measured samples come back after some were lost: gradually, so that a step in them makes none in the command.

While samples are missing, the step goes on as identified (bridging.py). The rig may have done something else: a target
that froze holds its command and then jumps to the newest. What that shakes, table and floors, must not be taken in by
halves: table samples that begin in the middle of a jump integrate to a velocity that the table never had. Therefore the
share of the measurement grows from none to all, over SLOWLY times the length of the gap and 100 ms at most: longer than
most of such a transient, as short as the shortest gaps that are borne. The guard does not wait for it: it judges what
the channels gave. The log keeps what the step was given, with a mark, and the samples in V as they came.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.clocks import IntArray
from rths_cli.compiled import part
from rths_cli.loop.blocks import Channels, Step
from rths_cli.loop.bridging import bridge, bridges
from rths_cli.loop.step import correct, staircase_of
from rths_cli.lti import Array
from rths_cli.rig_info import RigInfo

LONGEST_S = 100e-3
SLOWLY = 8
REMEMBERED = 2  # samples before its own that a correction of a sensor's low pass needs (control.sensing)
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
