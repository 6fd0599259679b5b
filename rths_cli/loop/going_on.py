"""How a command goes on in intervals in which none can leave, told to the rig with each one, and what leaves after.

A processor or a link that stalls for some milliseconds must not shake the building: a straight line from the last
command is 3 mV off after 7 ms at 1 m/s^2 (half of a t^2, over 8 mm/V), a parabola through the last ones 0.6.
"""

from __future__ import annotations

import numpy as np

from rths_cli.compiled import part
from rths_cli.loop.guard import RUNNING, GuardLimits, GuardState
from rths_cli.loop.log import Log
from rths_cli.lti import Array
from rths_cli.rigs.udp.wire import BRIDGED

PARABOLA_S, FEWEST_COMMANDS, MOST_COMMANDS = 0.016, 8, 32  # that a parabola is laid through


@part
def look_ahead(
    ahead: Array, slopes: Array, limits: GuardLimits, g: GuardState, log: Log, k: int, command: float
) -> None:
    """Tell how the command of step k - 1 goes on where the next one cannot leave: by a parabola through what left last,
    least squares; while the test ends, and before there are enough, by the rate of the guard alone.

    No step that the rig makes of it is beyond velocity and rate limits.
    """
    count = slopes.shape[1]
    ahead[0], ahead[1], ahead[2] = command, limits.dt_s * g.motion[1] / limits.gain_m_per_v, 0.0
    if count == 0 or k < count or g.flags[0] != RUNNING:
        return
    row = log.truths + g.codes.size + 3  # of the commands
    step = change = 0.0
    for j in range(count):
        left = log.columns[row, k - 1 - j]
        step += slopes[0, j] * left
        change += slopes[1, j] * left
    most = farthest(limits)
    ahead[1] = min(max(step, -most), most)
    ahead[2] = min(max(change, (-most - ahead[1]) / BRIDGED), (most - ahead[1]) / BRIDGED)


@part
def go_on(ahead: Array, limits: GuardLimits) -> None:
    """Move a command on by an interval in which none left, as the rig does: no farther than range and stroke."""
    most = min(limits.command_v, limits.stroke_m / limits.gain_m_per_v)
    fastest = limits.dt_s * limits.velocity_m_s / limits.gain_m_per_v
    ahead[0] = min(max(ahead[0] + ahead[1], -most), most)
    ahead[1] = min(max(ahead[1] + ahead[2], -fastest), fastest)


def slopes_of(dt_s: float) -> Array:
    """Return what makes of the last commands (n,), the newest first, the step of a parabola through them to the next
    and how the steps grow: (2, n); of none where an interval is so long that a parabola says nothing."""
    count = min(round(PARABOLA_S / dt_s), MOST_COMMANDS)
    if count < FEWEST_COMMANDS:
        return np.zeros((2, 0))
    _, slope, bend = np.linalg.pinv(np.vander(-np.arange(float(count)), 3, increasing=True))
    return np.array([slope + bend, 2.0 * bend])


@part
def slewed(limits: GuardLimits, last: float, command: float) -> float:
    """Return a command no farther from the last one that left than velocity and rate limits allow in an interval.

    The guard sees to that from step to step; steps that were caught up left nothing, and their sum may be more.
    """
    most = farthest(limits)
    return min(max(command, last - most), last + most)


@part
def farthest(limits: GuardLimits) -> float:
    """Return how far velocity and rate limits let a command go in an interval, in V."""
    return limits.dt_s * min(limits.velocity_m_s / limits.gain_m_per_v, limits.command_rate_v_s)
