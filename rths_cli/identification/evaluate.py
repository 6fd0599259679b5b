"""From excited records to what is known of table and specimen: responses, models, modal properties, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification import channels, delay, doubts, friction, verdict
from rths_cli.identification.channels import ChannelReport, UnfitRecord
from rths_cli.identification.delay import DelayEstimate
from rths_cli.identification.fit_table import Fit, FitError, Timing, fit_error, fit_paper, refit, within
from rths_cli.identification.frf import Estimator, estimate, noise_floor, over_model, without_leakage
from rths_cli.identification.friction import Friction
from rths_cli.identification.given import with_ripple
from rths_cli.identification.orders import Candidate, choose, doubtful
from rths_cli.identification.record import Record
from rths_cli.identification.skew import skew
from rths_cli.identification.specimen import (
    Motion,
    SpecimenFit,
    Start,
    fit_specimen,
    fit_stretches,
    modal,
    storey_start,
)
from rths_cli.identification.starts import first_fit
from rths_cli.identification.systematic import shifts
from rths_cli.identification.verdict import LIMITS, Band, LevelBand, Root, Verdict
from rths_cli.lti import Array, Frf, Model
from rths_cli.rig_info import RigInfo

START_HZ = 30.0
NO_CHAIN = 0.005  # share of the floors' motion left by the specimen's fit, from which its modes are not the zeros
SHORTEST_S = 4.0  # segment of a sweep, or its lines are too few for a model
SEGMENTS = 5  # a short record is cut into so many segments that do not overlap
MOST_ROUNDS, CONVERGED = 8, 5e-4  # of taking out leakage; change of the model in 0.7-11 Hz that ends them
MOST_SKEW, SEEN_SKEW = 0.25, 0.05  # samples between floors and table: refused, said
ENOUGH = 120_000  # samples for a first look
LEAST_LEVELS = 1.5  # between full and low level, for a judgement of friction
NOT_COMPARABLE = "friction: not judged; that takes noise or a multisine, and a low-level record at 2/3 of it or less"
COHERENT, OCTAVE_SHARE = 0.5, 2.0 ** (1.0 / 6.0)


@dataclass(frozen=True)
class IdentificationSettings:
    """Bands in Hz of both models, length of the Hann segments (less in short records), the estimator, whether the
    best model's roots carry the latency or an explicit delay does, whether the sensors' corners are out of the records,
    whether the excitation acts on friction like noise, and the errors that its fit must keep."""

    band_hz: tuple[float, float] = (0.5, 60.0)
    paper_band_hz: tuple[float, float] = (0.5, 12.0)
    segment_s: float = 20.0
    estimator: Estimator = "h1"
    latency_in_roots: bool = False
    sensors_removed: bool = True
    like_noise: bool = True
    most: FitError = LIMITS


@dataclass(frozen=True)
class Identification:
    """All that records tell. `frfs`: responses from command to table (without leakage) and to each floor;
    `noise_floors`: what noise at rest alone would show in them (None: not known).

    `specimen` is from the excitation, `free_vibration` the same from the stretch of held command (None: there is
    none). `levels`: low against full level. `roots` are those of `best`, with uncertainties. `friction` is the table's
    (None: the records do not tell), `latency` the transport delay as the data see it.
    """

    frfs: tuple[Frf, ...]
    noise_floors: tuple[Array | None, ...]
    best: Model
    paper: Model
    best_error: FitError
    paper_error: FitError
    specimen: SpecimenFit | None
    free_vibration: SpecimenFit | None
    channels: tuple[ChannelReport, ...]
    candidates: tuple[Candidate, ...]
    roots: tuple[Root, ...]
    residuals: tuple[Band, ...]
    levels: tuple[LevelBand, ...]
    verdict: Verdict
    friction: Friction | None = None
    latency: DelayEstimate | None = None

    @property
    def accepted(self) -> bool:
        """Tell whether the model may drive the table."""
        return self.verdict.accepted

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return why it may not."""
        return self.verdict.reasons

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what else to know."""
        return self.verdict.warnings


def identify(
    records: Sequence[Record], info: RigInfo, floor_masses_kg: Array, settings: IdentificationSettings | None = None,
    quiet: Record | None = None, given: Model | None = None,
) -> Identification:  # fmt: skip
    """Identify table and specimen from records whose commands and channels fit the rig.

    `floor_masses_kg` (c - 1,) are weighed; `quiet` is a record at low level, `given` a model of the table to judge in
    place of one fitted here. Raises InputError for records that do not fit together, UnfitRecord when channels are
    dead, clipped, incoherent, swapped or of wrong sign.
    """
    settings = settings or IdentificationSettings()
    masses = np.asarray(floor_masses_kg, dtype=float)
    check(records, info, masses)
    shortest = min(r.parts.noise.stop - r.parts.noise.start for r in records) * info.dt_s
    suited = [max(r.parts.segment_samples * info.dt_s, SHORTEST_S) for r in records if r.parts.segment_samples]
    longest = min(settings.segment_s, shortest / SEGMENTS)
    settings = replace(settings, segment_s=min([longest, *suited]))
    frfs = estimate(records, info.dt_s, settings.band_hz, settings.segment_s, settings.estimator)
    # short segments cut the floors' vibrations off, which is no fault of the channels
    judged = estimate(records, info.dt_s, settings.band_hz, longest, settings.estimator) if suited else frfs
    seen = channels.reports(records, judged, info)
    faults = channels.response_faults(judged, info, masses)
    if faults:
        raise UnfitRecord(faults, seen)
    settings = replace(settings, band_hz=(settings.band_hz[0], coherent_up_to(frfs[0], settings.band_hz[1])))
    start = _start(frfs, masses)
    start, _ = _specimen_start(records, info, masses, settings, start, None)
    first, table = _table(frfs[0], start, masses, info, settings, records)
    chosen, candidates = choose(first, table, records, settings.estimator, settings.latency_in_roots)
    if (chosen.layout, chosen.held_zeros) != (first.layout, first.held_zeros):
        chosen, table = _refined(frfs[0], chosen, settings, records)
    fitted_paper = fit_paper(table, first, _inside(settings.paper_band_hz, settings.band_hz)).model
    best = with_ripple(given, chosen.model) if given else chosen.model
    paper = best if given and len(best.zeros) == len(best.poles) else fitted_paper
    faults = channels.gain_faults(_smooth(table, chosen.model), frfs[1:], info)
    if faults:
        raise UnfitRecord(faults, seen)
    specimen = _specimen(records, chosen.model, info, masses, settings, start, free=False)
    free, weak = doubts.usable(_specimen(records, chosen.model, info, masses, settings, specimen, free=True))
    apart, said = _skew(records, chosen.model, info, masses, settings, specimen)
    error = fit_error(best, table)
    levels, ratio = _levels(chosen.model, table, quiet, settings), _level_ratio(records, quiet)
    latency = delay.estimate((first, chosen), table, info, levels, ratio, settings.sensors_removed)
    late = delay.doubts(latency) or (() if given else doubts.late(chosen.model, info))
    comparable = settings.like_noise and ratio >= LEAST_LEVELS
    warnings = [
        *channels.hum_warnings(seen),
        *channels.gain_warnings(best.low_frequency_gain_m_per_v, info),
        *weak,
        *doubts.misfit(specimen, seen),
        *(() if comparable or quiet is None else (NOT_COMPARABLE,)),
        *doubts.differences(specimen, free),
        *said,
        *([] if given else [*doubtful(chosen), *doubts.not_held(candidates)]),
        *late,
    ]
    return Identification(
        frfs=(table, *frfs[1:]),
        noise_floors=tuple(noise_floor(records, frf, c, info.dt_s) for c, frf in enumerate(frfs)),
        best=best,
        paper=paper,
        best_error=error,
        paper_error=fit_error(paper, table),
        specimen=specimen,
        free_vibration=free,
        channels=seen,
        candidates=() if given else candidates,
        roots=verdict.roots_given(best)
        if given
        else verdict.roots_of(chosen, specimen, shifts(chosen, table, levels, ratio)),
        residuals=verdict.residuals(best, table),
        levels=levels,
        verdict=verdict.judge(
            best,
            error,
            table,
            settings.most,
            warnings,
            levels if comparable else (),
            ratio,
            (*apart, *channels.far_gain(best.low_frequency_gain_m_per_v, info)),
            given is not None,
        ),
        friction=friction.estimate(records, chosen.model, info),
        latency=latency,
    )


def check(records: Sequence[Record], info: RigInfo, masses: Array) -> None:
    """Raise InputError where records do not fit the rig, UnfitRecord where channels cannot be used."""
    wanted = len(info.channels)
    faults = [
        f"record: {record.accel_m_s2.shape} samples do not fit {wanted} channels and {len(record.command_v)} commands; "
        "give one row per channel of the rig"
        for record in records
        if record.accel_m_s2.shape != (wanted, len(record.command_v))
    ]
    if len(masses) != wanted - 1 or not np.all(masses > 0.0):
        faults.append(f"masses_kg: {masses.tolist()} must be one positive mass for each of {wanted - 1} floors")
    if faults:
        raise InputError(*faults)
    for number, record in enumerate(records, 1):
        where = f"record {number}: " if len(records) > 1 else ""
        faults += [where + fault for fault in channels.signal_faults(record, info)]
    if faults:
        raise UnfitRecord(faults, channels.reports(records, None, info))


def coherent_up_to(frf: Frf, highest_hz: float) -> float:
    """Return the frequency below which every sixth of an octave above 11 Hz has a median coherence of 0.5 or more."""
    low = channels.COMPARED_HZ[1]
    while low < highest_hz:
        high = min(low * OCTAVE_SHARE, highest_hz)
        inside = within(frf.frequency_hz, (low, high))
        if inside.any() and np.median(frf.coherence[inside]) < COHERENT:
            return low
        low = high
    return highest_hz


def without_staircase(table_accel: Array, command_v: Array, model: Model) -> Array:
    """Return the table's samples (n,) in m/s^2 less the alias of the command's staircase, (n,) in V.

    Before the record the command is taken as held.
    """
    late, count = max(model.latency_samples, 1), len(command_v)
    moved = np.concatenate([np.zeros(late + 1), command_v - command_v[0]])
    now, before = moved[1 : count + 1], moved[:count]
    return table_accel - model.ripple_m_s2_per_v * (now - before) - model.ripple_sum_m_s2_per_v * (now + before)


def _smooth(table: Frf, model: Model) -> Frf:
    """Return the table's response less the staircase alias."""
    return replace(table, response=table.response - model.alias(table.frequency_hz))


def _skew(
    records: Sequence[Record], model: Model, info: RigInfo, masses: Array, settings: IdentificationSettings,
    specimen: SpecimenFit | None,
) -> tuple[tuple[str, ...], tuple[str, ...]]:  # fmt: skip
    """Return reasons and warnings when the floors are out of step with the table."""
    if specimen is None:
        return (), ()
    motions = [motion for record in records if (motion := _motion(record, model, free=False)) is not None]
    motions = [motion.cut(slice(0, ENOUGH)) for motion in motions]
    start = Start(specimen.stiffness_n_per_m, specimen.damping_ratio)
    late, error = skew(motions, info.dt_s, masses, settings.band_hz[0], start)
    sentence = (
        f"channels: the floors are {abs(late):.2f} samples ({1e3 * abs(late) * info.dt_s:.3g} ms) "
        f"{'late' if late > 0.0 else 'early'} against the table; all must be sampled at one instant, and their sensors "
        "have the stated corners"
    )
    if abs(late) > MOST_SKEW + doubts.AGREE_SIGMA * error:
        return (sentence,), ()
    return (), ((sentence,) if abs(late) > SEEN_SKEW + doubts.AGREE_SIGMA * error else ())


def _inside(band_hz: tuple[float, float], outer_hz: tuple[float, float]) -> tuple[float, float]:
    return max(band_hz[0], outer_hz[0]), min(band_hz[1], outer_hz[1])


def _start(frfs: Sequence[Frf], masses: Array) -> Start:
    """Return first values of the specimen from the responses up to 30 Hz."""
    if len(masses) == 0:
        return Start(np.zeros(0), np.zeros(0))
    low = frfs[0].frequency_hz <= START_HZ
    floors = np.array([frf.response[low] for frf in frfs[1:]])
    return storey_start(frfs[0].frequency_hz[low], frfs[0].response[low], floors, masses)


def _specimen_start(
    records: Sequence[Record], info: RigInfo, masses: Array, settings: IdentificationSettings, start: Start,
    model: Model | None,
) -> tuple[Start, float]:  # fmt: skip
    """Return the specimen fitted to the motions themselves, where no leakage does harm however light the damping, and
    what that leaves of the floors' motion, relative."""
    if len(masses) == 0:
        return start, 0.0
    motions = [motion for record in records if (motion := _motion(record, model, free=False)) is not None]
    if model is None:
        motions = [motion.cut(slice(0, ENOUGH)) for motion in motions]
    found = fit_specimen(motions, info.dt_s, masses, settings.band_hz[0], start)
    return Start(found.stiffness_n_per_m, found.damping_ratio), found.residual


def _table(
    frf: Frf, start: Start, masses: Array, info: RigInfo, settings: IdentificationSettings, records: Sequence[Record]
) -> tuple[Fit, Frf]:
    """Return the first fit, and the FRF it was made to."""
    omega = modal(masses, start.stiffness_n_per_m)[0] if len(masses) else np.zeros(0)
    modes = (omega / (2.0 * np.pi), start.damping_ratio)
    coupling_hz = info.channels[0].high_pass_hz if settings.sensors_removed else 0.0
    timing = Timing(info.latency_samples, info.dt_s, info.transport_s, coupling_hz)
    found = first_fit(frf, modes, timing, settings.band_hz)
    exact, unexplained = _specimen_start(records, info, masses, settings, start, found.model)
    held = found.held_zeros if unexplained < NO_CHAIN else 0
    found = replace(found, parameters=_with_zeros(found, exact, masses), held_zeros=held)
    return _refined(frf, found, settings, records)


def _refined(frf: Frf, found: Fit, settings: IdentificationSettings, records: Sequence[Record]) -> tuple[Fit, Frf]:
    """Return the fit of the same structure to the response without leakage, and that response.

    Each round takes out the leakage the last model shows (an excitation in whole periods has none, but its lines
    get their errors from the model).
    """
    clean = frf
    for _ in range(MOST_ROUNDS):
        clean = without_leakage(frf, found.model, records, settings.segment_s, settings.estimator)
        before, found = found.model, refit(clean, found)
        change = fit_error(found.model, replace(clean, response=before.sampled_response(clean.frequency_hz)))
        if change.largest < CONVERGED:
            break
    return found, clean


def _specimen(
    records: Sequence[Record], model: Model, info: RigInfo, masses: Array, settings: IdentificationSettings,
    start: Start | SpecimenFit | None, free: bool,
) -> SpecimenFit | None:  # fmt: skip
    """Return the specimen from the excitation or from the free vibration, None without either or without floors."""
    if start is None or len(masses) == 0:
        return None
    motions = [motion for record in records if (motion := _motion(record, model, free)) is not None]
    if not motions:
        return None
    first = Start(start.stiffness_n_per_m, start.damping_ratio)
    return fit_stretches(motions, info.dt_s, masses, settings.band_hz[0], first, free)


def _motion(record: Record, model: Model | None, free: bool) -> Motion | None:
    """Return table and floors during the excitation or the free vibration, less the staircase alias a model knows."""
    part = record.parts.free_vibration if free else record.parts.noise
    if part is None:
        return None
    table = record.accel_m_s2[0]
    if model is not None:
        table = without_staircase(table, record.command_v, model)
    return Motion(table, record.accel_m_s2[1:]).cut(part)


def _with_zeros(found: Fit, specimen: Start, masses: Array) -> Array:
    """Return the parameters of a fit with its held zeros at the specimen's modes."""
    parameters = found.parameters.copy()
    if len(masses):
        omega = modal(masses, specimen.stiffness_n_per_m)[0]
        parameters[found.layout.zeros(len(masses))] = np.log(np.column_stack([omega, specimen.damping_ratio])).ravel()
    return parameters


def _level_ratio(records: Sequence[Record], quiet: Record | None) -> float:
    """Return how much louder the records are than the quiet one, by the table's rms."""
    if quiet is None:
        return float("inf")
    loud = float(np.mean([record.accel_m_s2[0, record.parts.noise].std() for record in records]))
    return loud / float(quiet.accel_m_s2[0, quiet.parts.noise].std())


def _levels(model: Model, table: Frf, quiet: Record | None, settings: IdentificationSettings) -> tuple[LevelBand, ...]:
    """Compare the record at low level with the full one, both over the model; () without one."""
    if quiet is None:
        return ()
    length_s = (quiet.parts.noise.stop - quiet.parts.noise.start) * model.dt_s
    try:
        low = over_model(model, [quiet], settings.band_hz, min(settings.segment_s, length_s / SEGMENTS))
    except InputError:
        return ()
    over = replace(table, response=table.response / model.sampled_response(table.frequency_hz))
    return verdict.level_bands(low, over)
