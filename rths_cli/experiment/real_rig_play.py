"""Play on a real rig: rehearse the rate, listen to the channels at rest, then let the loop move the table."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.resolve import VARIED
from rths_cli.errors import InputError, RigError
from rths_cli.experiment.doctor_command import summary, wake_share
from rths_cli.experiment.rig_access import guard_limits, open_rig
from rths_cli.files.machine_rates import LATE_SHARE, P99_SHARE, held_rate
from rths_cli.files.rig_lock import locked_rig
from rths_cli.identification.dropout_reconstruction import filled
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.guard import INTERRUPT, TERMINATION
from rths_cli.loop.realtime_run import Performance, perform_watched, prepare, rehearse_watched
from rths_cli.loop.run_log import NO_ANSWER, without_samples
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.rigs.interface import linked

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Setup
    from rths_cli.loop.realtime_loop import Course
    from rths_cli.loop.run_log import Signals
    from rths_cli.loop.simulated_time_run import Outcome
    from rths_cli.numerics.lti import Array, Block
    from rths_cli.rigs.interface import Rig, RigInfo

REHEARSAL_S = 2.0
LISTENING_S = 1.0
ZERO_SHARE = 0.1  # of a channel's range, that it may show at rest
NOISE_SHARE = 0.02  # of a channel's range, rms at rest
SETTLED_S = 0.03  # in which a table forgets a command that came late


@dataclass(frozen=True)
class AtRest:
    """What the channels showed at rest, (c,) in V: mean and rms about it."""

    zeros_v: Array
    noise_v: Array


def ready_on_rig(setup: Setup, blocks: Blocks, source: int, drive: Array) -> tuple[Rig, Performance]:
    """Return the case's real rig, closed, and a run of a drive (n, 3) on it, ready to be performed.

    Raises InputError where the machine does not hold the rate or a channel is not at rest, RigError where the rig
    cannot be had.
    """
    rehearsed(setup, blocks, source)
    rig = open_rig(setup, (), 0)
    if linked(rig) is None:
        check_measured(setup.rig)
    zeros = listened(setup, rig).zeros_v
    return rig, prepare(setup.rig, blocks, source, drive, guard_limits(setup), zeros)


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


@contextmanager
def opened(rig: Rig) -> Iterator[None]:
    """Hold a rig open, for this process alone; it rests and is closed whatever happens."""
    with locked_rig(rig.info.name):
        rig.open()
        try:
            yield
        finally:
            try:
                rig.rest()
            finally:
                rig.close()


def rehearsed(setup: Setup, blocks: Blocks, source: int) -> None:
    """Do the steps of a run in real time without a rig; raise InputError where the machine does not hold its rate."""
    info = setup.rig
    run = prepare(info, blocks, source, np.zeros((round(REHEARSAL_S / info.dt_s), 3)), guard_limits(setup))
    late_s, took_s = rehearse_watched(run, REHEARSAL_S)
    for what, after_s, share in (("began", late_s, wake_share(info)), ("were ready", late_s + took_s, P99_SHARE)):
        found = summary(1.0 / info.dt_s, np.round(1e9 * after_s).astype(np.int64), share)
        if not found.held:
            raise InputError(
                f"sample_rate_hz: {found.rate_hz:g} Hz was not held in a silent rehearsal of {REHEARSAL_S:g} s: "
                f"99 % of the steps {what} within {found.p99_us:.0f} us (at most {share * 1e6 * info.dt_s:.0f}), "
                f"{found.late} of {found.steps} late by a whole interval (at most {int(LATE_SHARE * found.steps)}); "
                "choose a lower rate, rths doctor recommends one"
            )


def check_measured(info: RigInfo) -> None:
    """Raise InputError unless the rate of a rig whose exchange is written in Python was measured and held."""
    rate_hz, name = 1.0 / info.dt_s, info.name.removesuffix(VARIED)
    measured = held_rate(rate_hz, name)
    advice = f"run rths doctor with --rig {name} --rate {rate_hz:g}"
    if measured is None:
        raise InputError(f"sample_rate_hz: {rate_hz:g} Hz was not measured with rig {name}; {advice}")
    if not measured.held:
        raise InputError(f"sample_rate_hz: rig {name} did not hold {rate_hz:g} Hz; choose a lower one and {advice}")


def listened(setup: Setup, rig: Rig) -> AtRest:
    """Return what every channel shows while the armed table rests; raise InputError where that is no rest."""
    with opened(rig):
        shown = [np.array(rig.arm(), dtype=float)]
        shown += [np.array(rig.exchange(0.0), dtype=float) for _ in range(round(LISTENING_S / setup.rig.dt_s))]
    heard = np.array(shown)
    found = AtRest(heard.mean(axis=0), heard.std(axis=0))
    faults = channel_faults(setup.rig, found)
    if faults:
        raise InputError(*faults)
    return found


def channel_faults(info: RigInfo, found: AtRest) -> list[str]:
    """Return a sentence for every channel that is not at rest, or at a rest too far from zero."""
    faults = []
    for channel, zero, noise in zip(info.channels, found.zeros_v, found.noise_v, strict=True):
        range_v = min(channel.range_m_s2 * channel.sensitivity_v_per_m_s2, info.converters.range_v)
        where = f"rig {info.name}: channel {channel.name}"
        if not (np.isfinite(zero) and np.isfinite(noise)):
            faults.append(f"{where} gives no numbers at rest; check its cable")
        elif abs(zero) > ZERO_SHARE * range_v:
            share = f"more than {ZERO_SHARE:.0%} of its range"
            faults.append(
                f"{where} shows {zero:.3g} V at rest, {share}; check its cable, its coupling and its mounting"
            )
        elif noise > NOISE_SHARE * range_v:
            share = f"more than {NOISE_SHARE:.0%} of its range"
            faults.append(f"{where} shows {noise:.3g} V rms at rest, {share}; check its cable, and that nothing moves")
    return faults
