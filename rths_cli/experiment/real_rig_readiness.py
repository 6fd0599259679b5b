"""Before a real rig moves: open it, its guard's limits, rehearse the sample rate, measure the channels at rest, ask
a person."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.resolve import VARIED
from rths_cli.case.rig_schema import DEFAULT_ENERGY_RATIO
from rths_cli.control.compensator import CalledLaw
from rths_cli.control.designed_blocks import cell_reads
from rths_cli.control.law_block import STEP_SHARE, seconds_per_call
from rths_cli.errors import InputError
from rths_cli.experiment.session import wants_session_record
from rths_cli.experiment.setup import Setup, placed
from rths_cli.experiment.unit_plausibility import doubts
from rths_cli.files.machine_rates import LATE_SHARE, P99_SHARE, delay_summary, held_rate
from rths_cli.files.rig_lock import locked_rig
from rths_cli.files.watchdog_proofs import content_sha256, kept_proof
from rths_cli.loop.realtime_run import Performance, prepare, rehearse_watched
from rths_cli.loop.scheduling import wake_share
from rths_cli.quantities import Interval
from rths_cli.rigs.description import RigInfo, capabilities_of
from rths_cli.rigs.from_case import check_link, driver, virtual_driver
from rths_cli.rigs.interface import as_commands, counts_time, linked, name_session

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values
    from rths_cli.rigs.interface import Rig
    from rths_cli.rigs.virtual.virtual_rig import VirtualRig

# noise streams: dropping one run changes no other
IDENTIFICATION, SHAKE_TABLE, EXP_RTHS, PROBE, VERIFICATION = 1, 2, 3, 4, 5
BEFORE = (IDENTIFICATION, PROBE)
AT_REST_SHARE = 0.02  # fraction of the velocity limit above the apparent velocity of a specimen at rest due to noise

REHEARSAL_S = 2.0  # duration of the rehearsal
LOOK_S = 0.2  # time between two live values
LISTENING_S = 1.0  # duration of the measurement at rest
ZERO_SHARE = 0.1  # largest mean of a channel at rest, as a fraction of its range
NOISE_SHARE = 0.02  # largest rms of a channel at rest about its mean, as a fraction of its range
PEAKS = {
    "displacement_m": (1e3, "mm"), "velocity_m_s": (1.0, "m/s"), "acceleration_m_s2": (1.0, "m/s^2"),
    "force_n": (1.0, "N"),
}  # fmt: skip
BEFORE_MOVING = (
    "The emergency stop works without this computer, and somebody stands beside it.",
    "Nobody is within reach of table and specimen; the specimen is bolted down and its guards are in place.",
    "The table stands at mid-stroke and its own controller is switched on.",
    "Every sensor is connected, in the order of the rig file.",
)
Predicted = Callable[["Setup"], "Values"]


def open_rig(setup: Setup, stream: tuple[int, ...], seed: int) -> Rig:
    """Return the case's rig without opening it: nothing is connected, nothing moves.

    On a virtual rig `stream` and `seed` select the noise of one run, and whether the run comes before or after the
    change that the rig file states under `after_identification`. Raises InputError or RigError if a plug-in cannot
    create its rig.
    """
    named = (seed, *stream)
    return driver(
        setup.case, setup.declared_rig or setup.rig, setup.building, named, _changed(stream),
        session_of(setup, stream, seed),
    )  # fmt: skip


def open_virtual(setup: Setup, stream: tuple[int, ...], seed: int) -> VirtualRig:
    """Return the case's virtual rig with the noise stream of one run."""
    return virtual_driver(
        setup.case, setup.declared_rig or setup.rig, setup.building, (seed, *stream), _changed(stream),
        session_of(setup, stream, seed),
    )  # fmt: skip


def session_of(setup: Setup, stream: tuple[int, ...], seed: int) -> tuple[int, ...]:
    """Return what names the session of a run, within which a virtual laboratory's sensors do not drift: probe and
    excitation of an identification are one, the record before a case's table runs and these runs are another, all
    repetitions in a sweep included."""
    if not _changed(stream):
        return (seed, IDENTIFICATION)
    return (setup.session if wants_session_record(setup) else seed, EXP_RTHS)


def _changed(stream: tuple[int, ...]) -> bool:
    """Return whether a run comes after the change that a rig file states under `after_identification`."""
    return bool(stream) and stream[0] not in BEFORE


def guard_limits(setup: Setup) -> GuardLimits:
    """Return the guard's constants for the case's rig."""
    from rths_cli.loop.guard import SATURATED_SHARE, STUCK_BITS, GuardLimits, further_limits

    rig = setup.rig
    bits = np.array([rig.converters.step_v / c.sensitivity_v_per_unit for c in rig.channels])
    saturation = [min(c.range_v, rig.converters.range_v) for c in rig.channels]
    mass = setup.building.interface_experimental_mass_kg
    of_force = rig.interface == "displacement"
    weights = np.array([0.0, 1.0]) if of_force else np.concatenate([[rig.moving_mass_kg], setup.floor_masses_kg])
    limited = np.array([rig.limits.stroke_m, math.inf]) if of_force else rig.limits.acceleration_m_s2
    return GuardLimits(
        stroke_m=rig.limits.stroke_m,
        velocity_m_s=rig.limits.velocity_m_s,
        acceleration_m_s2=rig.limits.acceleration_m_s2,
        force_n=rig.limits.force_n,
        command_v=rig.converters.range_v,
        tracking_error=rig.limits.tracking_error_m if of_force else rig.limits.tracking_error_m_s2,
        gain_m_per_v=rig.gain_m_per_v,
        dt_s=rig.dt_s,
        force_weights=weights,
        saturation_v=SATURATED_SHARE * np.array(saturation),
        stuck=np.where(bits > 0.0, STUCK_BITS * bits, math.inf),
        abort=np.minimum([c.abort for c in rig.channels], limited),
        command_rate_v_s=rig.limits.command_rate_v_s,
        energy_ratio=_energy_ratio(rig),
        further=further_limits(rig, cell_reads(setup.floor_masses_kg, mass, 0.0)),
        energy_floor_j=0.5 * rig.specimen_mass_kg * (AT_REST_SHARE * rig.limits.velocity_m_s) ** 2,
    )


def _energy_ratio(rig: RigInfo) -> float:
    """Return the permitted ratio of added to exchanged energy; infinite on a virtual rig that states none."""
    if math.isfinite(rig.limits.energy_ratio) or not rig.can.moves_hardware:
        return rig.limits.energy_ratio
    return DEFAULT_ENERGY_RATIO


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


def _refuse_slow(feedforward: CalledLaw, dt_s: float, channels: int) -> None:
    """Raise InputError where a compensator in Python takes more than its share of the interval."""
    seconds = seconds_per_call(feedforward.make().command, channels)
    if seconds > STEP_SHARE * dt_s:
        why = f" ({feedforward.why})" if feedforward.why else ""
        raise InputError(
            f"controller: {feedforward.name} takes {1e6 * seconds:.3g} us per step in Python{why}, at "
            f"most {1e6 * STEP_SHARE * dt_s:.3g} us at {1.0 / dt_s:g} Hz ({STEP_SHARE:g} of the interval); let numba "
            "compile it, or lower sample_rate_hz"
        )


def rehearsed(setup: Setup, blocks: Blocks, source: int) -> None:
    """Compute the steps of a run in real time without a rig; raises InputError if the machine does not hold the rate.

    Both the start of the steps and the end of their computation must be punctual, within a fraction of an interval.
    """
    info = setup.rig
    key = "controller" if isinstance(blocks.feedforward, CalledLaw) else "parts"
    if blocks.in_python and info.watchdog_s <= 0.0:
        raise InputError(
            f"{key}: {blocks.in_python[0].name} is a Python object, which may hang, and rig {info.name} has no "
            "watchdog (watchdog_s: 0) that would lead its table to rest then; use a rig with one, or a compiled part"
        )
    if isinstance(blocks.feedforward, CalledLaw):
        _refuse_slow(blocks.feedforward, setup.rig.dt_s, len(blocks.correction.C))
    run = prepare(info, blocks, source, np.zeros((round(REHEARSAL_S / info.dt_s), 3)), guard_limits(setup))
    late_s, took_s = rehearse_watched(run, REHEARSAL_S)
    if blocks.fault():
        raise InputError(f"{key}: in the rehearsal, {blocks.fault()}")
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


def _nothing_predicted(setup: Setup) -> Values:
    """Return no metrics."""
    return {}


def ask_to_move(
    setups: Sequence[Setup],
    yes: bool,
    confirm: Callable[[Sequence[str]], bool],
    predicted: Predicted = _nothing_predicted,
    played: tuple[str, ...] = ("",),
    proven: bool = True,
) -> None:
    """Ask a person to confirm that the real rigs of these cases may move; raises InputError if they may not.

    Cases on virtual rigs need no confirmation. `confirm` shows the lines of the checklist and returns the answer.
    `played`: beginnings of the keys that the motion follows from; doubts on others are of no concern.
    `predicted` returns the metrics `check.*` of a case, {} without a check; the checklist states their peaks. `yes`
    confirms without a question, but only for rigs whose own file states `unattended: true`. Nobody is asked where the
    system has no real time, or where a number is doubted that the case does not call plausible: that one is refused.
    So is, with `proven`, a rig whose watchdog only a trial can show, without that trial.
    """
    real = [setup for setup in setups if setup.rig.can.moves_hardware]
    if not real:
        return
    _refuse_doubts(real, played)
    for setup in real if proven else ():
        check_watchdog(setup.case)
    from rths_cli.numerics.clock import require_real_time

    require_real_time()
    attended = [setup.rig.name for setup in real if not setup.rig.unattended]
    if yes:
        if attended:
            raise InputError(
                f"--yes: rig {attended[0]} does not say `unattended: true` in a file of its own; "
                "a person has to confirm here"
            )
        _check_links(real)
        return
    if sys.stdin is None or not sys.stdin.isatty():
        raise InputError("nobody can be asked here; --yes moves rigs whose file says `unattended: true`")
    _check_links(real)
    motions = [f"{setup.case.name}: {_motion(setup)}{_peaks(predicted(setup))}" for setup in real]
    rigs = dict.fromkeys(_about(setup.rig) for setup in real)
    if not confirm(["This moves a table:", *motions, *rigs, *BEFORE_MOVING]):
        raise InputError("not confirmed; nothing was moved")


def check_watchdog(case: Case) -> None:
    """Raise InputError where only a trial can show a rig's watchdog, and none has for this content of its file."""
    if not capabilities_of(case.table.kind).has_unproven_watchdog:
        return
    name = case.table.name.removesuffix(VARIED)
    proof, again = kept_proof(name), f"run rths doctor with --rig {name} --watchdog"
    if proof is None:
        raise InputError(f"rig {name}: nothing shows that its target leads the table to rest by itself; {again}")
    if proof.content_sha256 != content_sha256(rig_content(case)):
        raise InputError(
            f"rig {name}: its watchdog was proven on {proof.proven_utc} for another content of the rig file; {again}"
        )


def rig_content(case: Case) -> str:
    """Return what a case's rig file states, without the model that belongs to it, as text."""
    table = case.table
    if case.rig_limits is not None:
        table = table.model_copy(update={"limits": case.rig_limits})
    return table.model_dump_json(exclude={"name", "model"})


def _check_links(real: Sequence[Setup]) -> None:
    for setup in real:
        check_link(setup.case)


def _refuse_doubts(real: Sequence[Setup], played: tuple[str, ...]) -> None:
    """Raise InputError with every number of cases on real rigs that is doubted, and what consents to it."""
    found = [(setup, one) for setup in real for one in doubts(setup) if one.key.startswith(played)]
    if found:
        keys = ", ".join(dict.fromkeys(one.key for _, one in found))
        raise InputError(
            *dict.fromkeys(placed(setup.case, one.sentence) for setup, one in found),
            f"rig {real[0].rig.name} is real and moves once these are corrected; where they are right, state "
            f"plausible: [{keys}] in the case",
        )


def _motion(setup: Setup) -> str:
    """Return the line on the record of a case: name, scaling, length and peak."""
    time_s, accel = setup.motion.time_s, setup.motion.accel_m_s2
    return (
        f"record {setup.case.record.name} times {setup.case.scaling:g}, {time_s[-1]:.0f} s, "
        f"ground {np.abs(accel).max():.3g} m/s^2"
    )


def _peaks(figures: Values) -> str:
    """Return the peaks of the table's motion that a check predicts, the largest over samples; "" without a check."""
    known = [(path, figures[f"check.peak_{path}"]) for path in PEAKS if f"check.peak_{path}" in figures]
    known = [(path, peak.high if isinstance(peak, Interval) else peak) for path, peak in known]
    told = ", ".join(f"{float(np.max(peak)) * PEAKS[path][0]:.3g} {PEAKS[path][1]}" for path, peak in known)
    return f"; predicted peaks of the table {told}" if told else ""


def _about(rig: RigInfo) -> str:
    """Return the line on a rig: driver, sample rate and limits."""
    limits, fastest = rig.limits, rig.limits.fastest_m_s(rig.gain_m_per_v)
    return (
        f"rig {rig.name} ({', '.join(filter(None, (rig.kind, rig.driver_verified)))}) at {1.0 / rig.dt_s:g} Hz, within "
        f"{1e3 * limits.stroke_m:g} mm, {fastest:.4g} m/s, {limits.acceleration_m_s2:g} m/s^2, "
        f"{limits.force_n:g} N"
    )
