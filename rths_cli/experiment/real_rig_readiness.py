"""Checks before a real rig moves: rehearse the sample rate without the rig, measure the channels at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.resolve import VARIED
from rths_cli.errors import InputError
from rths_cli.experiment.rig_access import guard_limits, open_rig
from rths_cli.files.machine_rates import LATE_SHARE, P99_SHARE, delay_summary, held_rate
from rths_cli.files.rig_lock import locked_rig
from rths_cli.loop.realtime_run import Performance, prepare, rehearse_watched
from rths_cli.loop.scheduling import wake_share
from rths_cli.rigs.interface import as_commands, counts_time, linked, name_session

if TYPE_CHECKING:
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Setup
    from rths_cli.numerics.lti import Array
    from rths_cli.rigs.description import RigInfo
    from rths_cli.rigs.interface import Rig

REHEARSAL_S = 2.0  # duration of the rehearsal
LOOK_S = 0.2  # time between two live values
LISTENING_S = 1.0  # duration of the measurement at rest
ZERO_SHARE = 0.1  # largest mean of a channel at rest, as a fraction of its range
NOISE_SHARE = 0.02  # largest rms of a channel at rest about its mean, as a fraction of its range


@dataclass(frozen=True)
class AtRest:
    """Statistics of all channels with the table at rest, the further ones behind the accelerometers."""

    zeros_v: Array  # (c + f,) mean
    noise_v: Array  # (c + f,) rms about the mean


def ready_on_rig(setup: Setup, blocks: Blocks, source: int, drive: Array) -> tuple[Rig, Performance]:
    """Check machine and rig, and return the case's real rig, closed, and a prepared run of `drive` (n, 3) on it.

    Raises InputError if the machine does not hold the rate or a channel is not at rest, RigError if the rig is not
    available.
    """
    rig = open_rig(setup, (), 0)
    check_rate(setup, rig, blocks, source)
    zeros = listened(setup, rig).zeros_v
    return rig, prepare(setup.rig, blocks, source, drive, guard_limits(setup), zeros)


def check_rate(setup: Setup, rig: Rig, blocks: Blocks, source: int) -> None:
    """Raise InputError unless the machine holds the rate of a run, and a rig without a link was measured at it.

    A rig whose clock is counted needs neither: each of its exchanges takes one sample interval, however long it lasts.
    """
    if counts_time(rig):
        return
    rehearsed(setup, blocks, source)
    if linked(rig) is None:
        check_measured(setup.rig)


@contextmanager
def opened(rig: Rig) -> Iterator[None]:
    """Lock and open a rig for this process; at the end it is brought to rest and closed, also after an exception.

    Raises RigError if another process holds the rig or it cannot be opened.
    """
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
    """Compute the steps of a run in real time without a rig; raises InputError if the machine does not hold the rate.

    Both the start of the steps and the end of their computation must be punctual, within a fraction of an interval.
    """
    info = setup.rig
    if blocks.in_python and info.watchdog_s <= 0.0:
        raise InputError(
            f"parts: {blocks.in_python[0].name} is a Python object, which may hang, and rig {info.name} has no "
            "watchdog (watchdog_s: 0) that would lead its table to rest then; use a rig with one, or a compiled part"
        )
    run = prepare(info, blocks, source, np.zeros((round(REHEARSAL_S / info.dt_s), 3)), guard_limits(setup))
    late_s, took_s = rehearse_watched(run, REHEARSAL_S)
    if blocks.fault():
        raise InputError(f"parts: in the rehearsal, {blocks.fault()}")
    for what, after_s, share in (("began", late_s, wake_share(info)), ("were ready", late_s + took_s, P99_SHARE)):
        found = delay_summary(1.0 / info.dt_s, np.round(1e9 * after_s).astype(np.int64), share)
        if not found.held:
            raise InputError(
                f"sample_rate_hz: {found.rate_hz:g} Hz was not held in a silent rehearsal of {REHEARSAL_S:g} s: "
                f"99 % of the steps {what} within {found.p99_us:.0f} us (at most {share * 1e6 * info.dt_s:.0f}), "
                f"{found.late} of {found.steps} late by a whole interval (at most {int(LATE_SHARE * found.steps)}); "
                "choose a lower rate, rths doctor recommends one"
            )


def check_measured(info: RigInfo) -> None:
    """Raise InputError unless rths doctor measured the rig at its rate on this machine, and the rate was held.

    This applies to rigs that are exchanged with from Python. The rehearsal does not include their exchange.
    """
    rate_hz, name = 1.0 / info.dt_s, info.name.removesuffix(VARIED)
    measured = held_rate(rate_hz, name)
    advice = f"run rths doctor with --rig {name} --rate {rate_hz:g}"
    if measured is None:
        raise InputError(f"sample_rate_hz: {rate_hz:g} Hz was not measured with rig {name}; {advice}")
    if not measured.held:
        raise InputError(f"sample_rate_hz: rig {name} did not hold {rate_hz:g} Hz; choose a lower one and {advice}")


def listened(setup: Setup, rig: Rig) -> AtRest:
    """Open and arm the rig, command zero for LISTENING_S, and return mean and noise of its channels.

    Raises InputError with a sentence for each channel that is not at rest, RigError if the rig is not available.
    """
    shown = heard(setup, rig, LISTENING_S)
    found = AtRest(shown.mean(axis=0), shown.std(axis=0))
    faults = channel_faults(setup.rig, found)
    if faults:
        raise InputError(*faults)
    return found


def heard(
    setup: Setup, rig: Rig, seconds: float, look: Callable[[Array], object] = lambda _: None, session: str = "listening"
) -> Array:
    """Open and arm the rig, command zero for a time, and return its samples (n, c + f) in V.

    `look` is called with the newest samples every LOOK_S, the rig is told the name of the `session`. Raises RigError if
    it is not available.
    """
    resting = as_commands(np.zeros(rig.info.actuators))
    name_session(rig, session)
    with opened(rig):
        shown = [np.array(rig.arm(), dtype=float)]
        every = max(round(LOOK_S / setup.rig.dt_s), 1)
        for k in range(round(seconds / setup.rig.dt_s)):
            shown.append(np.array(rig.exchange(resting), dtype=float))
            if k % every == 0:
                look(shown[-1])
    return np.array(shown)


def channel_faults(info: RigInfo, found: AtRest) -> list[str]:
    """Return a sentence for each channel whose mean or noise at rest is too large or not finite."""
    faults = []
    for channel, zero, noise in zip(info.all_channels, found.zeros_v, found.noise_v, strict=True):
        range_v = min(channel.range_v, info.converters.range_v)
        where = f"rig {info.name}: channel {channel.name}"
        if not (np.isfinite(zero) and np.isfinite(noise)):
            faults.append(f"{where} gives no numbers at rest; check its cable")
        elif abs(zero) > ZERO_SHARE * range_v:
            share = f"more than {100.0 * ZERO_SHARE:.0f} % of its range"
            faults.append(
                f"{where} shows {zero:.3g} V at rest, {share}; check its cable, its coupling and its mounting"
            )
        elif "guard" in channel.uses and channel.kind == "displacement" and channel.position == "table":
            faults += _off_centre(where, info.limits.stroke_m, zero / channel.sensitivity_v_per_unit)
        elif noise > NOISE_SHARE * range_v:
            share = f"more than {100.0 * NOISE_SHARE:.0f} % of its range"
            faults.append(f"{where} shows {noise:.3g} V rms at rest, {share}; check its cable, and that nothing moves")
    return faults


def _off_centre(where: str, stroke_m: float, place_m: float) -> list[str]:
    """Return a sentence if a table rests too far from the centre, where its stroke sensor reads zero."""
    if abs(place_m) <= ZERO_SHARE * stroke_m:
        return []
    share = f"more than {100.0 * ZERO_SHARE:.0f} % of limits.stroke_m = {stroke_m:g}"
    return [
        f"{where} shows the table at {place_m:.3g} m at rest, {share}; centre the table, or adjust the sensor's zero"
    ]
