"""The identification's evaluation as a whole: records in, responses, table model, specimen and verdict out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.control.reaction import force_lag_s
from rths_cli.control.sensor_correction import recorrected
from rths_cli.findings import Finding
from rths_cli.identification import (
    channel_responses,
    channel_signals,
    delay,
    friction,
    identify_specimen,
    level_dependence,
    verdict,
)
from rths_cli.identification.absolute_scale import observations, with_scale
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.delay import of_specimen, of_structure, shifts, together
from rths_cli.identification.excitation import accel_rms
from rths_cli.identification.frequency_response import estimate, noise_floor
from rths_cli.identification.identify_table import TableFit, coherent_up_to, fit_table, levels, with_ripple
from rths_cli.identification.inputs import Evidence, IdentificationSettings, evidence
from rths_cli.identification.low_level_probe import louder
from rths_cli.identification.model_order import unsupported
from rths_cli.identification.pitch import pitch
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import (
    Calibration,
    ChannelReport,
    DelayEstimate,
    Friction,
    Identification,
    LevelBand,
    LevelCauses,
    LowLevelLines,
    Root,
    SpecimenFit,
    Verdict,
)
from rths_cli.identification.sensor_calibration import Fitted, calibrated, fitted, priors_of
from rths_cli.identification.session_record import low_level_lines
from rths_cli.identification.specimen_fit import Start
from rths_cli.identification.table_fit import beyond_scatter, fit_error, rms, within
from rths_cli.numerics.lti import Array, Frf, Model
from rths_cli.rigs.description import Channel, RigInfo

NOISE_SHARE = 0.5  # noise at rest explains the scatter of the data if it is at least this fraction of it
LEAST_LEVELS = 1.5  # smallest ratio of full to low level at which friction is judged
UNLIKELY = 1e-3  # chance of sensors and masses that are as declared, from which the declaration is doubted


@dataclass(frozen=True)
class _Specimen:
    """The identified specimen, with the findings for the verdict."""

    excited: SpecimenFit | None  # from the excitation; None without floors
    free: SpecimenFit | None  # from the free vibration; None if it cannot be used
    reasons: tuple[Finding, ...]  # why the channels are rejected
    free_vibration_warnings: tuple[Finding, ...]  # warnings on a free vibration that is too short or too weak
    channel_warnings: tuple[Finding, ...]  # for instance that they are slightly out of step


@dataclass(frozen=True)
class _Table:
    """The identified or supplied model of the table, with the results that its verdict needs."""

    fit: TableFit
    best: Model  # the model to be judged
    paper: Model  # the paper's model
    given: bool  # whether `best` was supplied and not fitted here
    levels: tuple[LevelBand, ...]  # response at low level over that at full level
    causes: LevelCauses  # why the two levels differ
    comparable: bool  # whether the levels are far enough apart to judge friction
    warnings: tuple[Finding, ...]


def identify(
    records: Sequence[Record], info: RigInfo, floor_masses_kg: Array, settings: IdentificationSettings | None = None,
    quiet: Record | None = None, given: Model | None = None,
) -> Identification:  # fmt: skip
    """Identify table and specimen from records whose commands and channels fit the rig.

    `floor_masses_kg` (c - 1,) are the weighed masses, `quiet` is a record at low level. If a model `given` is supplied,
    that model is judged instead of one fitted here. Raises InputError if the records do not fit together, UnfitRecord
    if channels are dead, clipped, incoherent, swapped or have the wrong sign.
    """
    settings = settings or IdentificationSettings()
    data = evidence(records, quiet, info, floor_masses_kg, settings)
    declared, table = _identified(data, given)
    if not info.calibrates or not len(data.masses_kg):
        return _at_every_level(data, declared, table)
    chain, calibration = _calibration(data, declared, table)
    channels = calibrated(info.channels, calibration)
    corrected = [_recorrected(record, info.channels, channels, info.dt_s) for record in records]
    low = _recorrected(quiet, info.channels, channels, info.dt_s) if quiet else None
    there = replace(info, channels=channels)
    data = evidence(corrected, low, there, data.masses_kg * calibration.mass, settings)
    found, table = _identified(data, given)
    found = replace(_at_every_level(data, found, table), calibration=calibration)
    doubts = _doubts(chain, info)
    found = replace(found, verdict=replace(found.verdict, notes=(*found.verdict.notes, *doubts)))
    if quiet is None or found.nonlinear is not None:
        return found  # storeys that bend or rub couple modes as pitch does
    heights = data.settings.heights_m
    return replace(found, pitch=pitch(chain, None if heights is None else np.array(heights)))


def _doubts(chain: Fitted, info: RigInfo) -> Iterator[Finding]:
    """Yield why a calibration, or what is declared of sensors and masses, is to be doubted."""
    found = chain.calibration
    if not chain.settled:
        yield Finding("calibration.unsettled")
    if len(chain.doubted):
        yield Finding("calibration.corners", {"channels": tuple(info.channels[each].name for each in chain.doubted)})
    if chain.gain_spread.chance < UNLIKELY:
        declared = np.array([channel.uncertainty for channel in info.channels])
        worst = _farthest(found.gain, declared)
        values = {"change": found.gain[worst] - 1.0, "declared": declared[worst]}
        yield Finding("calibration.sensors", {**values, "channel": info.channels[worst].name})
    if chain.mass_spread.chance < UNLIKELY:
        declared = np.array(info.uncertainty.of_masses(len(chain.masses_kg)))
        worst = _farthest(found.mass, declared)
        values = {"change": found.mass[worst] - 1.0, "declared": declared[worst]}
        yield Finding("calibration.masses", {**values, "floor": worst + 1})


def _farthest(found: Array, declared: Array) -> int:
    """Return which value, 1 as declared, is most standard uncertainties (k,) off; not one that is exact."""
    return int(np.argmax(np.where(declared > 0.0, np.abs(found - 1.0), 0.0) / np.where(declared > 0.0, declared, 1.0)))


def _at_every_level(data: Evidence, found: Identification, table: _Table) -> Identification:
    """Return an identification with its specimen at every level, where that is not linear."""
    nonlinear = identify_specimen.nonlinear(data, table.fit.chosen.model, found.specimen)
    return replace(found, nonlinear=nonlinear)


def _recorrected(record: Record, before: tuple[Channel, ...], after: tuple[Channel, ...], dt_s: float) -> Record:
    """Return a record corrected for other sensors than it was."""
    accel = recorrected(record.accel_m_s2, before, after, dt_s)
    return Record(record.command_v, accel, record.parts, record.further)


def _calibration(data: Evidence, declared: Identification, table: _Table) -> tuple[Fitted, Calibration]:
    """Return the chain with sensors and masses that the records show, from an identification with those that are
    declared, and what is known of them then, with what further channels show."""
    assert declared.specimen is not None
    start = Start(declared.specimen.stiffness_n_per_m, declared.specimen.damping_ratio)
    error = float("inf") if table.given else _ripple_error(data, table, declared.friction)
    priors = priors_of(data.info, data.settings.sensors_removed, declared.best, error)
    seen, low_hz = identify_specimen.motions(data, declared.best, free=False), identify_specimen.lowest_hz(data, start)
    high_hz = data.settings.band_hz[1]
    chain = fitted(seen, data.info.dt_s, data.masses_kg, data.info.channels, low_hz, start, priors, high_hz)
    first_hz = float(declared.specimen.natural_frequency_hz[0])
    moved = [_without_staircase(record, declared.best) for record in data.records]  # no displacement sensor shows it
    seen_beside = observations(moved, data.info, data.masses_kg, low_hz, first_hz)
    return chain, with_scale(chain.calibration, seen_beside, len(data.info.further))


def _without_staircase(record: Record, model: Model) -> Record:
    """Return a record whose table shows its motion alone, without the alias of the held command."""
    table = identify_specimen.without_staircase(record.accel_m_s2[0], record.command_v, model)
    return Record(record.command_v, np.vstack([table, record.accel_m_s2[1:]]), record.parts, record.further)


def _ripple_error(data: Evidence, table: _Table, dry: Friction | None) -> float:
    """Return the standard uncertainty of the fitted ripple in m/s^2 per V."""
    chosen, other = table.fit.chosen, table.fit.other
    moved = shifts(chosen, table.fit.frf, table.levels, data.level_ratio, dry, law=verdict.SHORTFALL)[-1]
    by_structure = 0.0 if other is None else float(other.parameters[-1] - chosen.parameters[-1])
    return float(np.sqrt(chosen.covariance[-1, -1] + moved**2 + by_structure**2))


def _identified(data: Evidence, given: Model | None) -> tuple[Identification, _Table]:
    """Return the identification of table and specimen with sensors and masses as they are given, and its table."""
    info, settings = data.info, data.settings
    frfs, reports, warnings = _responses(data)
    data = data.up_to(coherent_up_to(frfs[0], data.settings.band_hz[1], data.settings.compared))
    start = identify_specimen.first_look(data)
    wider = data.down_to(identify_specimen.lowest_hz(data, start))
    if wider.settings.band_hz != data.settings.band_hz:
        data = wider
        settings = data.settings
        frfs = estimate(data.records, info.dt_s, settings.band_hz, settings.segment_s, settings.estimator)
    fit = fit_table(data, frfs[0], start)
    specimen = _specimen(data, fit.chosen.model, start)
    specimen = replace(specimen, channel_warnings=(*warnings, *specimen.channel_warnings))
    table = _table(data, fit, given)
    return _identification(data, frfs, reports, table, specimen), table


def _responses(data: Evidence) -> tuple[tuple[Frf, ...], tuple[ChannelReport, ...], tuple[Finding, ...]]:
    """Return the responses from the command to all channels, a report on each channel, and warnings.

    Raises UnfitRecord if the channels cannot be used.
    """
    settings, dt_s = data.settings, data.info.dt_s
    frfs = judged = estimate(data.records, dt_s, settings.band_hz, settings.segment_s, settings.estimator)
    if any(record.parts.segment_samples for record in data.records):
        # short segments truncate the floors' vibrations, which lowers the coherence but is no fault of the channels
        judged = estimate(data.records, dt_s, settings.band_hz, data.longest_s, settings.estimator)
    reports = channel_signals.reports(data.records, judged, data.info, settings.compared)
    judgement = channel_responses.judge(data, judged)
    if judgement.faults:
        raise UnfitRecord(judgement.faults, reports)
    return frfs, reports, judgement.warnings


def _specimen(data: Evidence, model: Model, start: Start) -> _Specimen:
    """Return the specimen identified from excitation and free vibration."""
    excited = identify_specimen.excited(data, model, start)
    free, too_short = identify_specimen.freely_vibrating(data, model, excited)
    free, too_weak = verdict.usable(free)
    reasons, warnings = identify_specimen.out_of_step(data, model, excited)
    return _Specimen(excited, free, reasons, (*too_short, *too_weak), warnings)


def _table(data: Evidence, fit: TableFit, given: Model | None) -> _Table:
    """Return the table's models, the comparison of the levels and the warnings."""
    info, model = data.info, fit.chosen.model
    best = with_ripple(given, model) if given else model
    paper = best if given and len(best.zeros) == len(best.poles) else fit.paper
    compared, in_table = levels(data, fit)
    comparable = data.settings.like_noise and data.level_ratio >= LEAST_LEVELS
    structure = () if given else (*unsupported(fit.chosen), *verdict.not_held(fit.candidates))
    in_storeys = level_dependence.of_specimen(data.records, data.quiet, info, data.masses_kg, data.settings.band_hz)
    causes = LevelCauses(in_table, in_storeys)
    return _Table(fit, best, paper, given is not None, compared, causes, comparable, structure)


def _identification(
    data: Evidence, frfs: tuple[Frf, ...], reports: tuple[ChannelReport, ...], table: _Table, specimen: _Specimen
) -> Identification:
    """Return the complete result of the identification, with its verdict."""
    clean, best, compared = table.fit.frf, table.best, data.settings.compared
    dry = friction.estimate(data.records, table.fit.chosen.model, data.info, compared)
    if dry is not None and data.quiet is not None and table.comparable:
        lag_s = force_lag_s(best, specimen.excited.specimen) if specimen.excited else 0.0
        dry = friction.tried_on(dry, data.quiet, table.fit.chosen.model, lag_s, data.info, compared)
    latency = _delay(data, table)
    late = delay.doubts(latency, data.info.uncertainty.skew_s)
    late = late or (() if table.given else verdict.late(table.fit.chosen.model, data.info))
    low = identify_specimen.at_low_level(data, table.fit.chosen.model, specimen.excited)
    of_level = identify_specimen.of_level(data.level_ratio, specimen.excited, low)
    excited, free = (identify_specimen.with_level(each, *of_level) for each in (specimen.excited, specimen.free))
    roots = _roots(data, table, excited, of_level, dry)
    warnings = [*_warnings(data, reports, table, specimen), *late]
    return Identification(
        frfs=(clean, *frfs[1:]),
        noise_floors=tuple(noise_floor(data.records, frf, c, data.info.dt_s) for c, frf in enumerate(frfs)),
        best=best,
        paper=table.paper,
        best_error=fit_error(best, clean, compared),
        paper_error=fit_error(table.paper, clean, compared),
        specimen=excited,
        free_vibration=free,
        low_level=low,
        channels=reports,
        candidates=() if table.given else table.fit.candidates,
        roots=roots,
        residuals=verdict.residuals(best, clean, compared),
        levels=table.levels if table.comparable else (),
        verdict=_verdict(data, table, specimen, dry, warnings, roots),
        friction=dry,
        latency=latency,
        causes=table.causes,
        compared=compared,
        low_level_m_s2=_low_level(data),
        low_level_lines=_lines_of_low_level(data, specimen.excited),
    )


def _delay(data: Evidence, table: _Table) -> DelayEstimate | None:
    """Return the delay as the data show it, None where they do not."""
    fit = table.fit
    fits = (fit.first, fit.chosen, *([fit.other] if fit.other else []))
    removed = data.settings.sensors_removed
    return delay.estimate(fits, fit.frf, data.info, table.levels, data.level_ratio, removed)


def _low_level(data: Evidence) -> float | None:
    """Return the nominal rms acceleration in m/s^2 of the record at low level, None without one."""
    if data.quiet is None:
        return None
    return accel_rms(data.quiet.command_v, data.info, data.quiet.parts.noise, data.settings.compared)


def _lines_of_low_level(data: Evidence, specimen: SpecimenFit | None) -> LowLevelLines | None:
    """Return the lines of the record at low level, None without one."""
    if data.quiet is None or specimen is None:
        return None
    return low_level_lines(data.quiet, data.info, data.settings.excited_hz, specimen.natural_frequency_hz[-1])


def _roots(
    data: Evidence, table: _Table, specimen: SpecimenFit | None, of_level: tuple[Array, Array], dry: Friction | None
) -> tuple[Root, ...]:
    """Return the model's roots; a model that was fitted here has uncertainties, a supplied one has none.

    `of_level`: relative uncertainties (n,) of the specimen's frequencies and damping ratios by their level.
    """
    if table.given:
        return verdict.roots_given(table.best)
    chosen = table.fit.chosen
    systematic = together(
        chosen,
        shifts(chosen, table.fit.frf, table.levels, data.level_ratio, dry, data.info.uncertainty.skew_s),
        of_structure(chosen, table.fit.other),
        of_specimen(chosen, *of_level),
    )
    return verdict.roots_of(chosen, specimen, systematic)


def _warnings(data: Evidence, reports: tuple[ChannelReport, ...], table: _Table, specimen: _Specimen) -> list[Finding]:
    """Return the warnings of the verdict."""
    return [
        *channel_signals.hum_warnings(reports),
        *_gain(table, data),
        *specimen.free_vibration_warnings,
        *verdict.misfit(specimen.excited, reports),
        *(() if table.comparable or data.quiet is None else (Finding("friction.not_judged"),)),
        *verdict.differences(specimen.excited, specimen.free),
        *specimen.channel_warnings,
        *table.warnings,
    ]


def _gain(table: _Table, data: Evidence) -> tuple[Finding, ...]:
    """Return a warning if the table's gain is far from the data sheet's; a supplied model has no uncertainty."""
    error = 0.0 if table.given else float(np.sqrt(table.fit.chosen.covariance[0, 0]))
    return channel_responses.gain_warnings(table.best.low_frequency_gain_m_per_v, error, data.info)


def _verdict(
    data: Evidence, table: _Table, specimen: _Specimen, dry: Friction | None, warnings: list[Finding],
    roots: tuple[Root, ...],
) -> Verdict:  # fmt: skip
    """Return whether the model may drive the table."""
    compared = data.settings.compared
    error, most = beyond_scatter(table.best, table.fit.frf, compared), data.settings.most
    known_hz, cost, unknown = verdict.without_information(
        table.fit.chosen, () if table.given else roots, most, compared
    )
    return verdict.judge(
        table.best,
        error,
        table.fit.frf,
        most,
        [*warnings, *cost],
        table.levels if table.comparable else (),
        data.level_ratio,
        (
            *unknown,
            *specimen.reasons,
            *channel_responses.far_gain(table.best.low_frequency_gain_m_per_v, data.info, table.fit.frf, compared),
        ),
        table.given,
        table.causes,
        louder(data),
        _noisy(data, table.fit.frf),
        dry,
        compared,
        known_hz,
    )


def _noisy(data: Evidence, frf: Frf) -> bool:
    """Return whether noise at rest explains the scatter of the table's response; True if that noise is not known."""
    floor = noise_floor(data.records, frf, 0, data.info.dt_s)
    inside = within(frf.frequency_hz, data.settings.compared.hz)
    if floor is None:
        return True
    return rms(floor[inside] / np.abs(frf.response[inside])) > NOISE_SHARE * rms(frf.relative_error[inside])
