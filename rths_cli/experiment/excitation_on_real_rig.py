"""Play the identification's excitation on a real rig in real time, and reconstruct lost samples."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError, RigError
from rths_cli.experiment.real_rig_readiness import opened, ready_on_rig
from rths_cli.identification.dropout_reconstruction import filled
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.guard import INTERRUPT, TERMINATION
from rths_cli.loop.lost_samples import NO_ANSWER, without_samples
from rths_cli.loop.realtime_run import perform_watched
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.rigs.interface import name_session

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.loop.realtime_loop import Course
    from rths_cli.loop.realtime_run import Performance, Watch
    from rths_cli.loop.run_log import Signals
    from rths_cli.loop.simulated_time_run import Outcome
    from rths_cli.numerics.lti import Array, Block

SETTLED_S = 0.03  # time after which a late command no longer affects the table


def excited(
    setup: Setup, blocks: Blocks, drive: Array, progress: Progress = lambda _: None, session: str = "identification"
) -> Outcome:
    """Play an excitation (n, 3) on the case's real rig and return its outcome, with lost samples reconstructed.

    `progress` hears of every second of it, for instance "25 of 80 s". `session` names it to a rig that wants to know.

    Raises KeyboardInterrupt after an interrupt, when the table is at rest; InputError or RigError as `ready_on_rig`;
    RigError if too many samples were lost.
    """
    rig, run = ready_on_rig(setup, blocks, EXCITATION, drive)
    name_session(rig, session)
    with opened(rig):
        outcome = perform_watched(rig, run, _seconds(progress)).outcome
    if outcome.reason in (INTERRUPT, TERMINATION):
        raise KeyboardInterrupt  # the command line remembers which signal it was
    if outcome.rig_fault or outcome.stopped_by_limit:
        return outcome
    return replace(outcome, log=mended(outcome.log, run.course, blocks.correction))


def _seconds(progress: Progress) -> Watch:
    """Return a watcher that tells the seconds played, each once."""
    told = [-1]

    def watch(run: Performance) -> None:
        done = run.log.done[0] - run.course.ramp
        played = int(min(max(done, 0), run.course.record) * run.info.dt_s)
        if done > 0 and played > told[0]:
            told[0] = played
            progress(f"{played} of {run.course.record * run.info.dt_s:.0f} s")

    return watch


def mended(log: Signals, course: Course, correction: Block) -> Signals:
    """Return signals in which lost samples are reconstructed and the sensor correction is repeated.

    The correction that ran in the loop used substituted samples, which affect its output for a long time. Raises
    RigError if too many samples were lost.
    """
    no_answer, dt_s = log.lost == NO_ANSWER, 1e-9 * course.dt_ns
    late_there = no_answer & np.roll(no_answer, 1)  # a target that stalls does not follow the commands
    missing = without_samples(log.lost) | followed(late_there, round(SETTLED_S / dt_s))
    if not missing.any():
        return log
    signs, zeros_v = course.signs[: len(log.samples_v), None], course.zeros_v[: len(log.samples_v), None]
    shown = signs * (log.samples_v - zeros_v)
    try:
        return replace(log, corrected=run_block(correction, filled(log.command_v, shown, missing, dt_s)))
    except InputError as fault:
        raise RigError(str(fault)) from fault


def followed(places: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Return flags (n,) that are true at `places` (n,) and at the `by` samples after each of them."""
    return np.asarray(np.convolve(places, np.ones(1 + by))[: places.size] > 0.5)
