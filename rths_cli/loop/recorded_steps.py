"""Play the step and the guard over recorded samples, as a run in real time conducts them: what another implementation
of the step must make of the same samples."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rths_cli.control.designed_blocks import Blocks
from rths_cli.loop.fallback_commands import no_foresight
from rths_cli.loop.guard import GuardLimits, GuardState, fresh_guard, without_zeros
from rths_cli.loop.lost_samples import NO_ANSWER
from rths_cli.loop.realtime_loop import Course, conduct, course, judge
from rths_cli.loop.run_log import Log, Signals, empty_log, signals, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL, Step, assemble
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.udp import link as udp


@dataclass(frozen=True)
class Recorded:
    """What reaches the step in n instants, from the first one at rest before the ramp-up on.

    `ground` (r, 3): rows of the record; the ground rests before it and after it.
    """

    samples_v: Array  # (n, c + f) as the rig gives them
    came: NDArray[np.bool_]  # (n,) whether there are samples
    stop: NDArray[np.bool_]  # (n,) whether the operator stops the test
    ground: Array
    still: int  # instants at rest before the ramp-up
    ramp: int  # instants of the ramp-up
    zeros_v: Array  # (c + f,)


@dataclass(frozen=True)
class Conducted:
    """What the step and the guard made of it."""

    log: Signals  # of all n instants
    reason: int  # why the guard stopped the test
    channel: int  # that this concerns
    seconds: float  # that all steps took, with guard and log


def conduct_over(info: RigInfo, blocks: Blocks, limits: GuardLimits, given: Recorded) -> Conducted:
    """Return what step and guard make of recorded samples in an EXP-RTHS.

    `limits` are those without zeros taken off. Raises InputError for blocks from which no step can be assembled.
    """
    step, count = assemble(blocks, NUMERICAL), len(given.samples_v)
    sizes = sizes_of(step)
    guard = fresh_guard(sizes.channels, sizes.actuators, sizes.axes, sizes.further)
    log, record, orders = empty_log(count, sizes), len(given.ground), np.zeros(1, dtype=np.int64)
    times_s = (given.ramp * info.dt_s, (given.still * info.dt_s, 0.0))
    planned = course(info, times_s[0], record, given.zeros_v, orders, no_foresight(sizes.channels), times_s[1])
    before, after = np.zeros((given.still + given.ramp, 3)), np.zeros((1, 3))
    drive = np.ascontiguousarray(np.vstack([before, given.ground, after]), dtype=float)
    samples = np.ascontiguousarray(given.samples_v, dtype=float)
    came, stop = given.came.astype(np.int64), given.stop.astype(np.int64)
    limits = without_zeros(limits, given.zeros_v)
    play = conduct_recorded.bind(planned, step, limits, guard, drive, log, samples, came, stop)
    begun = time.perf_counter()
    play()
    seconds = time.perf_counter() - begun
    return Conducted(signals(log, sizes), int(guard.flags[1]), int(guard.flags[2]), seconds)


@entry
def conduct_recorded(
    course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, samples_v: Array,
    came: IntArray, stop: IntArray,
) -> None:  # fmt: skip
    """Conduct a step for each row of recorded samples (n, c + f)."""
    course, s, limits, g, drive, log = borrowed((course, s, limits, g, drive, log))
    samples_v, came, stop = borrowed((samples_v, came, stop))
    for k in range(samples_v.shape[0]):
        course.orders[0] = stop[k]
        lost = 0 if came[k] else NO_ANSWER
        judge(course, g, udp.LOST if lost else udp.OK)
        conduct(course, s, limits, g, drive, log, samples_v[k], lost, k)
        log.done[0] = k + 1
