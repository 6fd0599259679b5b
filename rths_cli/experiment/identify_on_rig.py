"""Identify on a case's rig, virtual or real: probe, excitation, free vibration, reconstruction of lost samples."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control import feedback, feedforward, numerical_substructure, sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import no_force
from rths_cli.control.state_space import static
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment.excitation_plan import excitation_faults, excitation_settings, plan
from rths_cli.experiment.lost_samples import losses_of
from rths_cli.experiment.real_rig_readiness import (
    IDENTIFICATION,
    PROBE,
    VERIFICATION,
    guard_limits,
    open_rig,
    opened,
    ready_on_rig,
)
from rths_cli.experiment.setup import Progress, Setup
from rths_cli.findings import Finding, sentences, without_repeats
from rths_cli.identification import excitation, low_level_probe
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.excitation import Excitation
from rths_cli.identification.identify import LEAST_LEVELS, IdentificationSettings
from rths_cli.identification.identify import identify as evaluate
from rths_cli.identification.inputs import BAND_HZ, PAPER_BAND_HZ, level_ratio
from rths_cli.identification.low_level_probe import Level
from rths_cli.identification.record_parts import Record, filled
from rths_cli.identification.results import Identification
from rths_cli.interrupts import interruptible
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.guard import INTERRUPT, LOST, OPERATOR, OVERRUN, RIG_FAULT, TERMINATION
from rths_cli.loop.lost_samples import NO_ANSWER, without_samples
from rths_cli.loop.realtime_run import perform_watched
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.numerics.bands import ComparedBand
from rths_cli.numerics.lti import Array, Model
from rths_cli.rigs.interface import name_session

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.case.case_schema import IdentificationSpec
    from rths_cli.loop.realtime_loop import Course
    from rths_cli.loop.realtime_run import Performance, Watch
    from rths_cli.loop.run_log import Signals
    from rths_cli.numerics.lti import Block

MOST_PLAYED = 3  # times that an excitation is played if samples are lost; what was measured before it is kept
MOST_ATTEMPTS = 3  # excitations of a table that is overdriven, each at half the level of the one before
SEED_STEP = 7919  # difference of the seeds of several records
SESSIONS = {IDENTIFICATION: "identification", PROBE: "probe", VERIFICATION: "verification"}
RECORDS = {IDENTIFICATION: "full level", PROBE: "probe", VERIFICATION: "verification"}
ADVICE = "lower identification.accel_rms_m_s2"
TOO_NEAR = "the probe was less than 1.5 times quieter"
NOT_BY_MOTION = (LOST, OVERRUN, RIG_FAULT, OPERATOR)  # a quieter excitation would not help

SETTLED_S = 0.03  # time after which a late command no longer affects the table


class SamplesLost(LimitError):
    """Raised if an excitation was stopped because too many samples in a row were lost or late."""


class UnfitRig(RigError):
    """Raised if the channels of a rig must not be used for a model; `unfit` holds the reports on them."""

    def __init__(self, rig: str, unfit: UnfitRecord) -> None:
        super().__init__(f"identification of rig {rig}: {'; '.join(unfit.faults)}")
        self.unfit = unfit


@dataclass(frozen=True)
class Measured:
    """The measurements of an identification: records at full level, and one at low level (None: there is none).

    `source` states their origin, `lines` are further (label, text) pairs for the page, `notes` are for the user.
    """

    records: tuple[Record, ...]
    quiet: Record | None
    source: str
    lines: tuple[tuple[str, str], ...]
    notes: tuple[Finding, ...] = ()

    @property
    def sha256(self) -> str:
        """Return the hash of all commands and accelerations."""
        digest = hashlib.sha256()
        for record in (*self.records, *((self.quiet,) if self.quiet else ())):
            digest.update(record.command_v.tobytes() + np.ascontiguousarray(record.accel_m_s2).tobytes())
        return digest.hexdigest()


def evaluation_settings(setup: Setup) -> IdentificationSettings:
    """Return the settings of the evaluation that a case requests."""
    options, heights = setup.case.identification, setup.building.heights_m
    compared = ComparedBand(*options.compared_hz)
    low = max(compared.with_low(BAND_HZ[0]), options.low_hz)
    return IdentificationSettings(
        band_hz=(low, min(compared.with_high(BAND_HZ[1]), options.high_hz)),
        paper_band_hz=(low, compared.with_high(PAPER_BAND_HZ[1])),
        estimator=options.estimator,
        latency_in_roots=options.latency == "kept",
        sensors_removed=options.sensor_dynamics == "removed",
        like_noise=options.excitation in ("noise", "multisine"),
        excited_hz=options.low_hz,
        compared=compared,
        heights_m=None if heights is None else tuple(heights[-len(setup.floor_masses_kg) :].tolist()),
    )


def identify(
    setup: Setup, progress: Progress, planned: Excitation | None = None, given: Model | None = None
) -> Identification:
    """Excite the rig, first with the probe, and evaluate its channels.

    If a model `given` is supplied, it is judged instead of one fitted here. Raises LimitError or RigError if the
    excitation was stopped, UnfitRig if the channels cannot be used.
    """
    return evaluated(setup, measure(setup, progress, planned), given)


def evaluated(setup: Setup, measured: Measured, given: Model | None = None) -> Identification:
    """Evaluate the measurements on the rig; raises UnfitRig if its channels cannot be used."""
    try:
        settings = evaluation_settings(setup)
        found = interruptible(
            lambda: evaluate(measured.records, setup.rig, setup.floor_masses_kg, settings, measured.quiet, given)
        )
    except UnfitRecord as unfit:
        raise UnfitRig(setup.rig.name, unfit) from unfit
    except InputError as error:
        raise RigError(f"identification of rig {setup.rig.name}: {'; '.join(error.faults)}") from error
    return noted(found, measured.notes)


def noted(found: Identification, notes: Sequence[Finding]) -> Identification:
    """Return an identification with further warnings."""
    return replace(found, verdict=replace(found.verdict, notes=(*notes, *found.verdict.notes)))


def measure(setup: Setup, progress: Progress, planned: Excitation | None = None) -> Measured:
    """Play probe and excitation on the rig and return the records.

    The probe is the record at low level, unless the limits lower the excitation so far that the two levels cannot be
    compared: then the same noise is played again, as a probe of the level that the excitation had.
    Raises LimitError or RigError if one of them was stopped, RigError if the probe shows a dead channel.
    """
    planned = planned or plan(setup)
    low, quiet = probed(setup, progress)
    records: list[Record] = []
    notes: list[Finding] = []
    for number in range(setup.case.identification.records):
        record, loud, level, said = _excited(setup, low, quiet, planned, number, progress)
        notes += said
        records.append(record)
    lines = _lines(setup, loud, level)
    if evaluation_settings(setup).like_noise and level_ratio(records, quiet) < LEAST_LEVELS:
        low, quiet = probed(setup, progress, (PROBE, 1), loud.accel_rms_m_s2)
        lines = (*lines, ("low level", f"{low.accel_rms_m_s2:.2g} m/s^2 rms, after the excitation: {TOO_NEAR}"))
    kind = setup.case.table.kind
    source = f"excited on the {kind} table for this model"
    return Measured(tuple(records), quiet, source, lines, without_repeats(notes))


def _excited(
    setup: Setup, low: Excitation, quiet: Record, planned: Excitation, number: int, progress: Progress
) -> tuple[Record, Excitation, Level, list[Finding]]:
    """Play one excitation at the level that the probe permits, and again at half of it if the table is overdriven.

    Returns record, plan, level and notes.
    """
    options, settings = setup.case.identification, excitation_settings(setup.case.identification)
    seed = options.seed + SEED_STEP * number
    loud = excitation.plan(setup.rig, settings, seed) if number else planned
    level = _allowed(setup, low, quiet, loud)
    notes, which = [*loud.notes, *level.notes], f" {number + 1} of {options.records}" if options.records > 1 else ""
    for attempt in range(1, MOST_ATTEMPTS + 1):
        if level.accel_rms_m_s2 != loud.accel_rms_m_s2:
            loud = excitation.plan(setup.rig, settings, seed, level.accel_rms_m_s2)
        seconds = loud.command_v.size * setup.rig.dt_s
        what = f"identification{which}, {seconds:.0f} s on the {setup.case.table.kind} table"
        stream = (IDENTIFICATION, number) if number else None
        command, corrected, further, lost = repeated(setup, loud.command_v, stream, what, progress)
        record = Record(command, corrected, loud.parts, further)
        notes += [lost] if lost else []
        grown = None
        if options.excitation == "noise":
            grown = low_level_probe.overdriven(quiet, record, setup.rig.dt_s, setup.compared)
        if grown is None or attempt == MOST_ATTEMPTS:
            break
        values = {"level_m_s2": level.accel_rms_m_s2, "unexplained": grown[1], "in_probe": grown[0]}
        notes.append(Finding("excitation.overdriven", values))
        level = level.at(0.5 * level.accel_rms_m_s2)
    return record, loud, level, notes


def _allowed(setup: Setup, low: Excitation, quiet: Record, loud: Excitation) -> Level:
    """Return the level that the probe permits for a planned excitation."""
    wanted = setup.case.identification.accel_rms_m_s2
    try:
        return low_level_probe.choose_level(setup.rig, low, quiet.accel_m_s2, wanted, loud, setup.floor_masses_kg)
    except InputError as error:
        raise RigError(f"identification of rig {setup.rig.name}: {'; '.join(error.faults)}") from error


def probed(
    setup: Setup, progress: Progress, stream: tuple[int, ...] = (PROBE,), wanted_m_s2: float | None = None,
    most_m_s2: float = math.inf,
) -> tuple[Excitation, Record]:  # fmt: skip
    """Play the probe and return its plan and measurements.

    `wanted_m_s2`: full level in m/s^2 rms to which it belongs, by default the one that the case asks for. `most_m_s2`:
    level that it must not exceed.
    """
    options, settings = setup.case.identification, excitation_settings(setup.case.identification)
    settings = settings if wanted_m_s2 is None else replace(settings, accel_rms_m_s2=wanted_m_s2)
    low = low_level_probe.probe_plan(setup.rig, settings, options.seed, most_m_s2)
    seconds = low.command_v.size * setup.rig.dt_s
    what = f"probe of {seconds:.0f} s at {low.accel_rms_m_s2:.2g} m/s^2 rms"
    command, corrected, further, _ = repeated(setup, low.command_v, stream, what, progress)
    return low, Record(command, corrected, low.parts, further)


def _lines(setup: Setup, played: Excitation, level: Level) -> tuple[tuple[str, str], ...]:
    """Return the page's lines on the excitation."""
    options = setup.case.identification
    count = f"{options.records} records of " if options.records > 1 else ""
    corner_hz = setup.compared.with_high(excitation.CORNER_HZ)
    signal = (
        f"{options.excitation}, {count}{options.duration_s:g} s, {options.low_hz:g}-{options.high_hz:g} Hz, "
        f"{played.accel_rms_m_s2:.3g} m/s^2 rms below {corner_hz:g} Hz, seed {options.seed}"
    )
    reach = ", ".join(f"{name} {100.0 * entry.share:.0f} %" for name, entry in level.reach.items())
    allowed = ", ".join(f"{name} {most:.2f}" for name, most in level.allowed_m_s2.items())
    lowered = (("lowered by", f"at most, m/s^2 rms: {allowed}"),) if allowed else ()
    return (("excitation", signal), *lowered, ("predicted reach", f"{reach} of the limits"), *processing(options))


def processing(options: IdentificationSpec) -> tuple[tuple[str, str], ...]:
    """Return the page's lines on the evaluation."""
    sensors = {"removed": "removed", "kept": "kept, the model describes the channels as they are"}
    latency = {"removed": "removed, an explicit declared delay", "kept": "kept, carried by the roots"}
    return (
        ("estimator", options.estimator.capitalize()),
        ("sensor dynamics", sensors[options.sensor_dynamics]),
        ("latency", latency[options.latency]),
    )


def repeated(
    setup: Setup, command_v: Array, stream: tuple[int, ...] | None, what: str, progress: Progress
) -> tuple[Array, Array, Array | None, Finding | None]:
    """Call `excite`, and again if it was stopped because samples were lost; `what` names it.

    Only this excitation is repeated. Raises as `excite` does.
    """
    for attempt in range(1, MOST_PLAYED + 1):
        this = what if attempt == 1 else f"{what}, attempt {attempt} of {MOST_PLAYED}"
        progress(this if setup.rig.can.counts_steps else f"{this}: getting ready, nothing moves yet")
        try:
            return excite(setup, command_v, stream=stream, progress=partial(_said_of, progress, this))
        except SamplesLost as lost:
            if attempt == MOST_PLAYED:
                raise SamplesLost(f"{lost}; {MOST_PLAYED} attempts ended so") from lost
            progress(f"{this}: {lost}")
    raise AssertionError("the last attempt returns or raises")


def _said_of(progress: Progress, what: str, now: str) -> None:
    progress(f"{what}: {now}")


def excite(
    setup: Setup, command_v: Array, stream: tuple[int, ...] | None = None, progress: Progress = lambda _: None
) -> tuple[Array, Array, Array | None, Finding | None]:
    """Play a command (n,) in V through guard and rig; `progress` hears of the seconds of a real rig.

    Returns the command as sent, the corrected channels (c, n) in m/s^2, the further channels (f, n) each in its unit
    (None: there are none), and notes on reconstructed samples. `stream` names the rig's noise. Raises LimitError if the
    check of its command refuses it or a limit stopped the excitation, SamplesLost if it was that on lost samples,
    RigError if the rig did.
    """
    drive = np.column_stack([command_v, np.zeros((command_v.size, 2))])
    where = f"identification of rig {setup.rig.name}, {RECORDS.get((stream or (IDENTIFICATION,))[0], 'record')}"
    if "check" not in setup.overrides and (faults := excitation_faults(setup, command_v)):
        raise LimitError(f"{where} refused: {'; '.join(sentences(faults))}; {ADVICE}")
    outcome = play_excitation(setup, drive, stream or (IDENTIFICATION,), progress)
    advice = "" if outcome.reason in NOT_BY_MOTION else f"; {ADVICE}"
    if outcome.rig_fault:
        raise RigError(f"{where}: {outcome.rig_fault}{advice}")
    if outcome.stopped_by_limit:
        raise (SamplesLost if outcome.reason in (LOST, OVERRUN) else LimitError)(
            f"{where}: {outcome.stopped_by_limit}{advice}"
        )
    log = outcome.log
    lost = losses_of(log.lost, 1e-9 * log.late_ns, setup.rig.dt_s)
    said = lost.finding(RECORDS.get((stream or (IDENTIFICATION,))[0], "record")) if lost.any else None
    return log.command_v, log.corrected, log.further if setup.rig.further else None, said


def play_excitation(setup: Setup, drive: Array, stream: tuple[int, ...], progress: Progress) -> Outcome:
    """Play an excitation (n, 3) on the rig, a real one in real time."""
    if not setup.rig.can.counts_steps:
        return excited(setup, listening_blocks(setup), drive, progress, SESSIONS.get(stream[0], "identification"))
    rig = open_rig(setup, stream, setup.case.identification.seed)
    blocks, limits = listening_blocks(setup), guard_limits(setup)
    return interruptible(lambda: play(rig, setup.rig, blocks, EXCITATION, drive, limits))


def listening_blocks(setup: Setup) -> Blocks:
    """Return blocks that only correct the sensors, for an excitation, which uses no other block."""
    dt, channels = setup.rig.dt_s, len(setup.rig.channels)
    silent = static(np.zeros((1, channels)), dt, "kalman", (), ())
    return Blocks(
        correction=sensor_correction.correction(setup.rig.channels, dt, setup.removes_sensors),
        estimator=silent,
        numerical=numerical_substructure.interface(setup.building.numerical, dt),
        feedforward=feedforward.direct(setup.rig.gain_m_per_v, dt),
        feedback=feedback.none(dt),
        interface=no_force(channels),
        latency_samples=setup.rig.latency_samples,
        further=sensor_correction.further_correction(setup.rig.further, dt, setup.removes_sensors),
    )


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
