"""How measured samples come back after some were lost: gradually, so that a step in them makes none in the command.

While samples are missing, the step goes on as identified (bridging.py). The rig may have done something else: a target
that froze holds its command and then jumps to the newest. What that shakes, table and floors, must not be taken in by
halves: table samples that begin in the middle of a jump integrate to a velocity that the table never had. Therefore the
share of the measurement grows from none to all, over SLOWLY times the length of the gap and 100 ms at most: longer than
most of such a transient, as short as the shortest gaps that are borne. The guard does not wait for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.clocks import IntArray
from rths_cli.compiled import part
from rths_cli.loop.blocks import Step
from rths_cli.loop.bridging import bridge
from rths_cli.loop.guard import GuardLimits
from rths_cli.lti import Array
from rths_cli.rig_info import RigInfo

LONGEST_S = 100e-3
SLOWLY = 8
MISSED, RETURNED, NOW = range(3)  # places in Returning.gap


class Returning(NamedTuple):
    """What is known of a gap in the samples; c channels."""

    gap: IntArray  # (3,) length of the gap that samples return from, how many have returned, and lost in a row now
    longest: int  # samples over which they come back, at most
    alarm_v: Array  # (c,) a larger sample is never mixed
    came: Array  # (c,) the samples that came, in V


def returning(info: RigInfo) -> Returning:
    """Return that no samples are missing."""
    aborts = [min(c.abort_m_s2, info.limits.acceleration_m_s2) * c.sensitivity_v_per_m_s2 for c in info.channels]
    return Returning(
        np.zeros(3, dtype=np.int64), round(LONGEST_S / info.dt_s), np.array(aborts), np.zeros(len(info.channels))
    )


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
def blend(r: Returning, s: Step, limits: GuardLimits, share: float) -> None:
    """Mix the samples in `s.samples` with what the channels would show if all had gone on as identified.

    A sample that is no number, saturated or beyond its alarm is left as it is: the guard must see it.
    """
    for c in range(s.samples.size):
        r.came[c] = s.samples[c]
    bridge(s)
    for c in range(s.samples.size):
        came = abs(r.came[c])
        mixes = came <= r.alarm_v[c] and came < limits.saturation_v[c]  # false where it is not a number
        s.samples[c] = s.samples[c] + share * (r.came[c] - s.samples[c]) if mixes else r.came[c]
