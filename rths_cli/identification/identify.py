"""From excited records to what is known of table and specimen: responses, models, modal properties, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.identification import (
    channel_responses,
    channel_signals,
    delay,
    friction,
    identify_specimen,
    level_dependence,
    verdict,
)
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.excitation_headroom import louder
from rths_cli.identification.frequency_response import estimate, noise_floor
from rths_cli.identification.identify_table import TableFit, coherent_up_to, fit_table, levels, with_ripple
from rths_cli.identification.inputs import Evidence, IdentificationSettings, evidence
from rths_cli.identification.model_order import doubtful
from rths_cli.identification.records import Record
from rths_cli.identification.results import (
    ChannelReport,
    DelayEstimate,
    Friction,
    Identification,
    LevelBand,
    LevelCauses,
    Root,
    SpecimenFit,
    Verdict,
)
from rths_cli.identification.root_uncertainty import shifts
from rths_cli.identification.specimen_fit import Start
from rths_cli.identification.table_fit import COMPARED_HZ, beyond_scatter, fit_error, rms, within
from rths_cli.numerics.lti import Array, Frf, Model
from rths_cli.rigs.description import RigInfo

NOISE_SHARE = 0.5  # of the data's scatter, from which noise at rest explains it
LEAST_LEVELS = 1.5  # between full and low level, for a judgement of friction
NOT_COMPARABLE = "friction: not judged; that takes noise or a multisine, and a low-level record at 2/3 of it or less"


@dataclass(frozen=True)
class _Specimen:
    """The specimen from excitation and free vibration, reasons to refuse the channels, and what to know: the free
    vibration is weak, the channels are a little out of step."""

    excited: SpecimenFit | None
    free: SpecimenFit | None
    reasons: tuple[str, ...]
    weak: tuple[str, ...]
    said: tuple[str, ...]


@dataclass(frozen=True)
class _Table:
    """The table: fits, the model to be judged and that of the paper, levels compared, delay, and warnings."""

    fit: TableFit
    best: Model
    paper: Model
    given: bool
    levels: tuple[LevelBand, ...]
    causes: LevelCauses
    comparable: bool
    latency: DelayEstimate | None
    warnings: tuple[str, ...]


def identify(
    records: Sequence[Record], info: RigInfo, floor_masses_kg: Array, settings: IdentificationSettings | None = None,
    quiet: Record | None = None, given: Model | None = None,
) -> Identification:  # fmt: skip
    """Identify table and specimen from records whose commands and channels fit the rig.

    `floor_masses_kg` (c - 1,) are weighed; `quiet` is a record at low level, `given` a model of the table to judge in
    place of one fitted here. Raises InputError for records that do not fit together, UnfitRecord when channels are
    dead, clipped, incoherent, swapped or of wrong sign.
    """
    data = evidence(records, quiet, info, floor_masses_kg, settings or IdentificationSettings())
    frfs, seen, said = _responses(data)
    data = data.up_to(coherent_up_to(frfs[0], data.settings.band_hz[1]))
    start = identify_specimen.first_look(data)
    wider = data.down_to(identify_specimen.lowest_hz(data, start))
    if wider.settings.band_hz != data.settings.band_hz:
        data = wider
        settings = data.settings
        frfs = estimate(data.records, info.dt_s, settings.band_hz, settings.segment_s, settings.estimator)
    fit = fit_table(data, frfs[0], start)
    specimen = _specimen(data, fit.chosen.model, start)
    specimen = replace(specimen, said=(*said, *specimen.said))
    return _identification(data, frfs, seen, _table(data, fit, given), specimen)


def _responses(data: Evidence) -> tuple[tuple[Frf, ...], tuple[ChannelReport, ...], tuple[str, ...]]:
    """Return the responses to all channels, what these showed and what to say of them; raises UnfitRecord when they
    cannot be used."""
    settings, dt_s = data.settings, data.info.dt_s
    frfs = judged = estimate(data.records, dt_s, settings.band_hz, settings.segment_s, settings.estimator)
    if any(record.parts.segment_samples for record in data.records):
        # short segments cut the floors' vibrations off, which is no fault of the channels
        judged = estimate(data.records, dt_s, settings.band_hz, data.longest_s, settings.estimator)
    seen = channel_signals.reports(data.records, judged, data.info)
    found = channel_responses.judge(data, judged)
    if found.faults:
        raise UnfitRecord(found.faults, seen)
    return frfs, seen, found.warnings


def _specimen(data: Evidence, model: Model, start: Start) -> _Specimen:
    """Return what excitation and free vibration tell of the specimen."""
    excited = identify_specimen.excited(data, model, start)
    free, died = identify_specimen.freely_vibrating(data, model, excited)
    free, weak = verdict.usable(free)
    reasons, said = identify_specimen.out_of_step(data, model, excited)
    return _Specimen(excited, free, reasons, (*died, *weak), said)


def _table(data: Evidence, fit: TableFit, given: Model | None) -> _Table:
    """Return what is known of the table."""
    info, model = data.info, fit.chosen.model
    best = with_ripple(given, model) if given else model
    paper = best if given and len(best.zeros) == len(best.poles) else fit.paper
    (compared, in_table), ratio = levels(data, fit), data.level_ratio
    comparable = data.settings.like_noise and ratio >= LEAST_LEVELS
    latency = delay.estimate((fit.first, fit.chosen), fit.frf, info, compared, ratio, data.settings.sensors_removed)
    late = delay.doubts(latency) or (() if given else verdict.late(model, info))
    structure = () if given else (*doubtful(fit.chosen), *verdict.not_held(fit.candidates))
    in_storeys = level_dependence.of_specimen(data.records, data.quiet, info, data.masses_kg, data.settings.band_hz)
    causes = LevelCauses(in_table, in_storeys)
    return _Table(fit, best, paper, given is not None, compared, causes, comparable, latency, (*structure, *late))


def _identification(
    data: Evidence, frfs: tuple[Frf, ...], seen: tuple[ChannelReport, ...], table: _Table, specimen: _Specimen
) -> Identification:
    """Return all that was found, judged."""
    clean, best = table.fit.frf, table.best
    dry = friction.estimate(data.records, table.fit.chosen.model, data.info)
    return Identification(
        frfs=(clean, *frfs[1:]),
        noise_floors=tuple(noise_floor(data.records, frf, c, data.info.dt_s) for c, frf in enumerate(frfs)),
        best=best,
        paper=table.paper,
        best_error=fit_error(best, clean),
        paper_error=fit_error(table.paper, clean),
        specimen=specimen.excited,
        free_vibration=specimen.free,
        channels=seen,
        candidates=() if table.given else table.fit.candidates,
        roots=_roots(data, table, specimen.excited),
        residuals=verdict.residuals(best, clean),
        levels=table.levels if table.comparable else (),
        verdict=_verdict(data, table, specimen, dry, _warnings(data, seen, table, specimen)),
        friction=dry,
        latency=table.latency,
        causes=table.causes,
    )


def _roots(data: Evidence, table: _Table, specimen: SpecimenFit | None) -> tuple[Root, ...]:
    """Return the model's roots, with uncertainties where it was fitted here."""
    if table.given:
        return verdict.roots_given(table.best)
    chosen = table.fit.chosen
    return verdict.roots_of(chosen, specimen, shifts(chosen, table.fit.frf, table.levels, data.level_ratio))


def _warnings(data: Evidence, seen: tuple[ChannelReport, ...], table: _Table, specimen: _Specimen) -> list[str]:
    """Return what else to know."""
    return [
        *channel_signals.hum_warnings(seen),
        *_gain(table, data),
        *specimen.weak,
        *verdict.misfit(specimen.excited, seen),
        *(() if table.comparable or data.quiet is None else (NOT_COMPARABLE,)),
        *verdict.differences(specimen.excited, specimen.free),
        *specimen.said,
        *table.warnings,
    ]


def _gain(table: _Table, data: Evidence) -> tuple[str, ...]:
    """Return a sentence when the table's gain is far from the data sheet's; a given model has no uncertainty."""
    error = 0.0 if table.given else float(np.sqrt(table.fit.chosen.covariance[0, 0]))
    return channel_responses.gain_warnings(table.best.low_frequency_gain_m_per_v, error, data.info)


def _verdict(data: Evidence, table: _Table, specimen: _Specimen, dry: Friction | None, warnings: list[str]) -> Verdict:
    """Return whether the model may drive the table."""
    error, most = beyond_scatter(table.best, table.fit.frf), data.settings.most
    return verdict.judge(
        table.best,
        error,
        table.fit.frf,
        most,
        warnings,
        table.levels if table.comparable else (),
        data.level_ratio,
        (
            *specimen.reasons,
            *channel_responses.far_gain(table.best.low_frequency_gain_m_per_v, data.info, table.fit.frf),
        ),
        table.given,
        table.causes,
        louder(data),
        _noisy(data, table.fit.frf),
        dry,
    )


def _noisy(data: Evidence, frf: Frf) -> bool:
    """Tell whether what the channels show at rest explains how the table's response scatters, or is not known."""
    floor = noise_floor(data.records, frf, 0, data.info.dt_s)
    inside = within(frf.frequency_hz, COMPARED_HZ)
    if floor is None:
        return True
    return rms(floor[inside] / np.abs(frf.response[inside])) > NOISE_SHARE * rms(frf.relative_error[inside])
