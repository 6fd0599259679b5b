"""The table's model from an identification's records: first fit, leakage taken out, structure chosen, levels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification import level_dependence, verdict
from rths_cli.identification.channel_signals import COMPARED_HZ
from rths_cli.identification.frequency_response import over_model, without_leakage
from rths_cli.identification.identify_specimen import fit_motions, motions
from rths_cli.identification.inputs import SEGMENTS, Evidence
from rths_cli.identification.model_order import choose
from rths_cli.identification.results import Candidate, LevelBand
from rths_cli.identification.specimen_fit import Start, modal
from rths_cli.identification.table_fit import Fit, Timing, first_fit, fit_error, fit_paper, refit, within
from rths_cli.numerics.lti import Array, Frf, Model

NO_CHAIN = 0.005  # share of the floors' motion left by the specimen's fit, from which its modes are not the zeros
MOST_TURNS = 4  # of model and specimen
SAME_MODE, SAME_DAMPING = (
    0.5,
    0.5,
)  # frequencies agree within this part of half a resonance's width, ratios within e^0.5
MOST_ROUNDS, CONVERGED = 8, 5e-4  # of taking out leakage; change of the model in 0.7-11 Hz that ends them
COHERENT, OCTAVE_SHARE = 0.5, 2.0 ** (1.0 / 6.0)


@dataclass(frozen=True)
class TableFit:
    """Fits of the table: the first structure, the chosen one, all that were tried, the paper's model, and the response
    without leakage that they were made to."""

    first: Fit
    chosen: Fit
    candidates: tuple[Candidate, ...]
    paper: Model
    frf: Frf


def fit_table(data: Evidence, frf: Frf, start: Start) -> TableFit:
    """Fit the table's models to its response; `start`: the specimen on it."""
    first, clean = _first(data, frf, start)
    settings = data.settings
    chosen, candidates = choose(first, clean, data.records, settings.estimator, settings.latency_in_roots)
    if (chosen.layout, chosen.held_zeros) != (first.layout, first.held_zeros):
        chosen, clean = _refined(data, frf, chosen)
    paper = fit_paper(clean, first, _inside(settings.paper_band_hz, settings.band_hz)).model
    return TableFit(first, chosen, candidates, paper, clean)


def _first(data: Evidence, frf: Frf, start: Start) -> tuple[Fit, Frf]:
    """Return the first fit, and the response it was made to.

    The alias of the hold's staircase in the table's samples hides what drives the floors, and only a model of the table
    tells it. A first look at the specimen, which had none, may be far off; then model and specimen improve in turns.
    """
    masses, info = data.masses_kg, data.info
    coupling_hz = info.channels[0].high_pass_hz if data.settings.sensors_removed else 0.0
    timing = Timing(info.latency_samples, info.dt_s, info.transport_s, coupling_hz)
    for _ in range(MOST_TURNS):
        omega = modal(masses, start.stiffness_n_per_m)[0] if len(masses) else np.zeros(0)
        found = first_fit(frf, (omega / (2.0 * np.pi), start.damping_ratio), timing, data.settings.band_hz)
        exact, unexplained = fit_motions(data, start, motions(data, found.model, free=False))
        if _agree(start, exact, masses):
            break
        start = exact
    held = found.held_zeros if unexplained < NO_CHAIN else 0
    parameters = _with_damping(found, _with_zeros(found, exact, masses), frf)
    return _refined(data, frf, replace(found, parameters=parameters, held_zeros=held))


def _agree(one: Start, other: Start, masses: Array) -> bool:
    """Tell whether two specimens have the same modes but for a part of a resonance's width, so that a model of the
    table fitted with one suits the other."""
    if not len(masses):
        return True
    slower, faster = (modal(masses, each.stiffness_n_per_m)[0] for each in (one, other))
    damped = np.abs(np.log(one.damping_ratio / other.damping_ratio))
    apart = np.abs(np.log(slower / faster)) / np.minimum(one.damping_ratio, other.damping_ratio)
    return bool((apart < SAME_MODE).all() and (damped < SAME_DAMPING).all())


def _refined(data: Evidence, frf: Frf, found: Fit) -> tuple[Fit, Frf]:
    """Return the fit of the same structure to the response without leakage, and that response.

    Each round takes out the leakage the last model shows (an excitation in whole periods has none, but its lines
    get their errors from the model).
    """
    clean = frf
    for _ in range(MOST_ROUNDS):
        clean = without_leakage(frf, found.model, data.records, data.settings.segment_s, data.settings.estimator)
        before, found = found.model, refit(clean, found)
        change = fit_error(found.model, replace(clean, response=before.sampled_response(clean.frequency_hz)))
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
    """Return parameters in which no pole starts with a damping that leakage made up.

    A resonance narrower than the spacing of the lines leaks into all lines about it, and the raw response gives it any
    damping, often none. An undamped pole rings through the whole record, and no round of `_refined` finds back. Such a
    pole starts as damped as the zero beside it, the same floors on a table that stands still.
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


def coherent_up_to(frf: Frf, highest_hz: float) -> float:
    """Return the frequency below which every sixth of an octave above 11 Hz has a median coherence of 0.5 or more."""
    low = COMPARED_HZ[1]
    while low < highest_hz:
        high = min(low * OCTAVE_SHARE, highest_hz)
        inside = within(frf.frequency_hz, (low, high))
        if inside.any() and np.median(frf.coherence[inside]) < COHERENT:
            return low
        low = high
    return highest_hz


def levels(data: Evidence, found: TableFit) -> tuple[tuple[LevelBand, ...], tuple[str, ...]]:
    """Compare the record at low level with the full one, both over the model; and the causes in the table that explain
    how they differ. () without one."""
    quiet, model, frf = data.quiet, found.chosen.model, found.frf
    if quiet is None:
        return (), ()
    length_s = (quiet.parts.noise.stop - quiet.parts.noise.start) * model.dt_s
    try:
        low = over_model(model, [quiet], data.settings.band_hz, min(data.settings.segment_s, length_s / SEGMENTS))
    except InputError:
        return (), ()
    over = replace(frf, response=frf.response / model.sampled_response(frf.frequency_hz))
    return verdict.level_bands(low, over), level_dependence.of_table(low, over, model)


def with_ripple(model: Model, fitted: Model) -> Model:
    """Return the model for the band of one fitted here, with that one's share of the hold's staircase where none (NaN)
    is stated: it belongs to the sampling, not to the table."""
    stated = not math.isnan(model.ripple_m_s2_per_v)
    ripple = model.ripple_m_s2_per_v if stated else fitted.ripple_m_s2_per_v
    return replace(model, band_hz=fitted.band_hz, ripple_m_s2_per_v=ripple)
