"""The steps of the table model's identification from its records; the fit itself is table_fit.py."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification import level_dependence, verdict
from rths_cli.identification.frequency_response import over_model, without_leakage
from rths_cli.identification.identify_specimen import fit_motions, motions
from rths_cli.identification.inputs import SEGMENTS, Evidence
from rths_cli.identification.model_order import WORTH, choose, mean_square
from rths_cli.identification.results import Candidate, LevelBand
from rths_cli.identification.specimen_fit import Start, modal
from rths_cli.identification.table_fit import (
    Fit,
    Timing,
    beyond_scatter,
    first_fit,
    fit_error,
    fit_paper,
    refit,
    within,
    without_fastest_pair,
)
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Frf, Model

NO_CHAIN = 0.005  # residual of the specimen's fit, as a fraction of the floors' motion, above which zeros are free
MOST_TURNS = 4  # alternations between fitting the model and the specimen
SAME_MODE, SAME_DAMPING = (
    0.5,
    0.5,
)  # frequencies agree within this part of half a resonance's width, ratios within e^0.5
MOST_ROUNDS, CONVERGED = 8, 5e-4  # rounds of leakage removal; change of the model in the compared band that ends them
COHERENT = (0.2, 0.5)  # least median coherence of a band, with many and with few averages
OCTAVE_SHARE = 2.0 ** (1.0 / 6.0)  # width of a band


@dataclass(frozen=True)
class TableFit:
    """The fits of the table."""

    first: Fit  # of the first structure
    chosen: Fit  # of the structure that was chosen
    candidates: tuple[Candidate, ...]  # all structures that were tried
    paper: Model  # the paper's model
    frf: Frf  # the response without leakage, to which they were fitted
    other: Fit | None = None  # a structure that fits clearly better and was not chosen; None: there is none


def fit_table(data: Evidence, frf: Frf, start: Start) -> TableFit:
    """Fit the table's models to its response; `start` is a first estimate of the specimen on the table.

    Leakage is removed with the first fit, and the other structures are judged on the response without it. A first fit
    that exceeds the limits of the verdict therefore is compared with that of a flexible drive, which replaces it if it
    is within the limits and clearly better.
    """
    first, clean = _first(data, frf, start, flexible=False)
    settings, base = data.settings, first
    if not _within_limits(first, clean, data):
        larger, without = _first(data, frf, start, flexible=True)
        better = mean_square(larger, without) < WORTH**2 * mean_square(first, clean)
        if better and _within_limits(larger, without, data):
            first, clean, base = larger, without, without_fastest_pair(larger)
    chosen, candidates, other = choose(
        first, clean, data.records, settings.estimator, settings.latency_in_roots, settings.compared
    )
    if (chosen.layout, chosen.held_zeros) != (first.layout, first.held_zeros):
        chosen, clean = _refined(data, frf, chosen)
    paper = fit_paper(clean, base, _inside(settings.paper_band_hz, settings.band_hz), settings.compared).model
    return TableFit(first, chosen, candidates, paper, clean, other)


def _within_limits(found: Fit, frf: Frf, data: Evidence) -> bool:
    """Return whether a fit's error beyond the scatter of the data is within the limits of the verdict."""
    error, most = beyond_scatter(found.model, frf, data.settings.compared), data.settings.most
    return error.rms <= most.rms and error.largest <= most.largest and error.rms_mid <= most.rms_mid


def _first(data: Evidence, frf: Frf, start: Start, flexible: bool) -> tuple[Fit, Frf]:
    """Return the first fit, of a stiff or a `flexible` drive, and the response to which it was made.

    The table's samples contain the alias of the hold's staircase, which does not drive the floors, and only a model of
    the table can remove it. The first estimate of the specimen, made without a model, may therefore be wrong. If so,
    model and specimen are improved alternately.
    """
    masses, info = data.masses_kg, data.info
    coupling_hz = info.channels[0].high_pass_hz if data.settings.sensors_removed else 0.0
    timing = Timing(info.latency_samples, info.dt_s, info.transport_s, coupling_hz)
    for _ in range(MOST_TURNS):
        omega = modal(masses, start.stiffness_n_per_m)[0] if len(masses) else np.zeros(0)
        modes, settings = (omega / (2.0 * np.pi), start.damping_ratio), data.settings
        found = first_fit(frf, modes, timing, settings.band_hz, settings.compared, flexible)
        exact, unexplained = fit_motions(data, start, motions(data, found.model, free=False))
        if _agree(start, exact, masses):
            break
        start = exact
    held = found.held_zeros if unexplained < NO_CHAIN else 0
    parameters = _with_damping(found, _with_zeros(found, exact, masses), frf)
    return _refined(data, frf, replace(found, parameters=parameters, held_zeros=held))


def _agree(one: Start, other: Start, masses: Array) -> bool:
    """Return whether the modes of two specimens agree within a fraction of a resonance's width.

    A table model that was fitted with one of them is then valid for the other.
    """
    if not len(masses):
        return True
    slower, faster = (modal(masses, each.stiffness_n_per_m)[0] for each in (one, other))
    damped = np.abs(np.log(one.damping_ratio / other.damping_ratio))
    apart = np.abs(np.log(slower / faster)) / np.minimum(one.damping_ratio, other.damping_ratio)
    return bool((apart < SAME_MODE).all() and (damped < SAME_DAMPING).all())


def _refined(data: Evidence, frf: Frf, found: Fit) -> tuple[Fit, Frf]:
    """Return the fit of the same structure to the response without leakage, and that response.

    Each round removes the leakage that the last model predicts. (An excitation in whole periods has no leakage, but the
    standard errors of its lines follow from the model.)
    """
    clean = frf
    for _ in range(MOST_ROUNDS):
        clean = without_leakage(frf, found.model, data.records, data.settings.segment_s, data.settings.estimator)
        before, found = found.model, refit(clean, found)
        change = fit_error(
            found.model, replace(clean, response=before.sampled_response(clean.frequency_hz)), data.settings.compared
        )
        if change.largest < CONVERGED:
            break
    return found, clean


def _with_zeros(found: Fit, specimen: Start, masses: Array) -> Array:
    """Return the parameters of a fit with its held zeros at the specimen's modes."""
    parameters = found.parameters.copy()
    if len(masses):
        omega = modal(masses, specimen.stiffness_n_per_m)[0]
        parameters[found.layout.zeros(len(masses))] = np.log(np.column_stack([omega, specimen.damping_ratio])).ravel()
    return parameters


def _with_damping(found: Fit, parameters: Array, frf: Frf) -> Array:
    """Return parameters in which no pole starts with a damping that is an artefact of leakage.

    A resonance narrower than the spacing of the lines leaks into the lines around it. The raw response then gives an
    arbitrary damping, often none. An undamped pole rings through the whole record, and the rounds of `_refined` cannot
    recover from it. Such a pole starts with the damping of the nearest zero, which is the same mode of the floors on a
    table at rest.
    """
    spacing_hz, first_zero = frf.frequency_hz[1] - frf.frequency_hz[0], found.layout.zeros(0).start
    poles, zeros = (parameters[start : start + 2 * count].reshape(-1, 2) for start, count in (
        (1, found.layout.pole_pairs), (first_zero, found.layout.zero_pairs)))  # fmt: skip
    started = parameters.copy()
    for i, (log_omega, log_ratio) in enumerate(poles):
        width_hz = np.exp(log_omega + log_ratio) / np.pi
        if width_hz < spacing_hz and len(zeros):
            started[2 + 2 * i] = zeros[np.abs(zeros[:, 0] - log_omega).argmin(), 1]
    return started


def _inside(band_hz: tuple[float, float], outer_hz: tuple[float, float]) -> tuple[float, float]:
    return max(band_hz[0], outer_hz[0]), min(band_hz[1], outer_hz[1])


def coherent_up_to(frf: Frf, highest_hz: float, compared: ComparedBand = USUAL) -> float:
    """Return the frequency up to which each sixth of an octave above the compared band tells more than noise.

    Its median coherence must be twice 1 / averages, the mean that noise alone shows, and within the range COHERENT.
    Noise that is as large as the response (a coherence of 0.5) only widens the lines' scatter, by which the fit weighs
    them; a band that ended there would leave out the pole of a mode beyond its end.
    """
    low, least = compared.high_hz, float(np.clip(2.0 / max(frf.averages, 1), *COHERENT))
    while low < highest_hz:
        high = min(low * OCTAVE_SHARE, highest_hz)
        inside = within(frf.frequency_hz, (low, high))
        if inside.any() and np.median(frf.coherence[inside]) < least:
            return low
        low = high
    return highest_hz


def levels(data: Evidence, found: TableFit) -> tuple[tuple[LevelBand, ...], tuple[str, ...]]:
    """Compare the table's response at low level with that at full level, both divided by the model's.

    Returns the comparison by band, and the causes in the table that explain the difference; both () without a record at
    low level, or if that is too short.
    """
    quiet, model, frf = data.quiet, found.chosen.model, found.frf
    if quiet is None:
        return (), ()
    length_s = (quiet.parts.noise.stop - quiet.parts.noise.start) * model.dt_s
    try:
        low = over_model(model, [quiet], data.settings.band_hz, min(data.settings.segment_s, length_s / SEGMENTS))
    except InputError:
        return (), ()
    over = replace(frf, response=frf.response / model.sampled_response(frf.frequency_hz))
    compared = data.settings.compared
    return verdict.level_bands(low, over, compared), level_dependence.of_table(low, over, model, compared)


def with_ripple(model: Model, fitted: Model) -> Model:
    """Return a supplied model with the band of a fitted one, and with its staircase alias if none (NaN) is stated.

    The alias depends on the sampling and not on the table.
    """
    stated = not math.isnan(model.ripple_m_s2_per_v)
    ripple = model.ripple_m_s2_per_v if stated else fitted.ripple_m_s2_per_v
    return replace(model, band_hz=fitted.band_hz, ripple_m_s2_per_v=ripple)
