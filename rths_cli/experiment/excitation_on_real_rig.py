"""Play the identification's excitation on a real rig in real time, and put back the samples that were lost."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError, RigError
from rths_cli.experiment.real_rig_readiness import opened, ready_on_rig
from rths_cli.identification.dropout_reconstruction import filled
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.guard import INTERRUPT, TERMINATION
from rths_cli.loop.realtime_run import perform_watched
from rths_cli.loop.run_log import NO_ANSWER, without_samples
from rths_cli.loop.step_arrays import EXCITATION

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Setup
    from rths_cli.loop.realtime_loop import Course
    from rths_cli.loop.run_log import Signals
    from rths_cli.loop.simulated_time_run import Outcome
    from rths_cli.numerics.lti import Array, Block

SETTLED_S = 0.03  # in which a table forgets a command that came late


def excited(setup: Setup, blocks: Blocks, drive: Array) -> Outcome:
    """Play an excitation (n, 3) on the case's real rig; an interrupt leads the table to rest first."""
    rig, run = ready_on_rig(setup, blocks, EXCITATION, drive)
    with opened(rig):
        outcome = perform_watched(rig, run, lambda _: None).outcome
    if outcome.reason in (INTERRUPT, TERMINATION):
        raise KeyboardInterrupt  # the command line remembers which signal it was
    if outcome.rig_fault or outcome.stopped_by_limit:
        return outcome
    return replace(outcome, log=mended(outcome.log, run.course, blocks.correction))


def mended(log: Signals, course: Course, correction: Block) -> Signals:
    """Return signals with the samples put back that were lost, as the sensors show them, and all corrected anew: what
    stood in their place while the loop ran is still in its corrected samples long after.

    Raises RigError where too many were lost.
    """
    no_answer, dt_s = log.lost == NO_ANSWER, 1e-9 * course.dt_ns
    late_there = no_answer & np.roll(no_answer, 1)  # a target that stalls moves the table other than it was told
    missing = without_samples(log.lost) | followed(late_there, round(SETTLED_S / dt_s))
    if not missing.any():
        return log
    shown = course.signs[:, None] * (log.samples_v - course.zeros_v[:, None])
    try:
        return replace(log, corrected=run_block(correction, filled(log.command_v, shown, missing, dt_s)))
    except InputError as fault:
        raise RigError(str(fault)) from fault


def followed(places: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Return places (n,) and so many after each of them."""
    return np.asarray(np.convolve(places, np.ones(1 + by))[: places.size] > 0.5)
