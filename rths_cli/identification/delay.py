"""Estimate the transport delay beside the table's roots; systematic uncertainty of poles, zeros and delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.findings import Finding
from rths_cli.identification.least_squares import linear, parts
from rths_cli.identification.results import DelayEstimate, Friction, LevelBand
from rths_cli.identification.specimen_fit import CLOCK, SKEW
from rths_cli.identification.table_fit import HOLD, Fit, Timing, fit, problem_of, timing_of
from rths_cli.identification.verdict import SHORTFALL
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model
from rths_cli.rigs.description import RigInfo

FLEXIBLE = 2  # pole pairs beyond those of zeros: of the loop, and of a deck on a flexible drive
SPRING_DAMPING = 0.05  # part of a pair's damping ratio beyond the band that the dashpot of its spring may be
UNKNOWN_LAW = 2.0  # factor on the effect at full level that dry friction would have, for friction of another law
SAME_MODE = 0.2  # logarithm of a frequency ratio within which a pole and a mode of the specimen are the same

REACH_S = 0.01  # the free delay may be shorter than the model's by this time
ROUNDS = 2  # fits: the second one uses the latency of the first for the staircase's alias
WORTH = 0.9  # a larger structure must reduce the misfit to this fraction
SIGMA, SEEN_S = 3.0, 1e-4  # reported difference of declared and identified delay: standard uncertainties, and s


def shifts(
    found: Fit, frf: Frf, levels: Sequence[LevelBand], level_ratio: float, friction: Friction | None = None,
    skew_s: float = 0.0, law: float = UNKNOWN_LAW,
) -> Array:  # fmt: skip
    """Return the systematic uncertainty (n_parameters,) of the parameters of a fit, beside their random error.

    Three distortions of the response are propagated to first order: a lag of 1 % of a sample and of the declared
    uncertainty `skew_s` of the instants of command and samples, each; the lead of a spring beyond the band, which no
    model has; and the effect of friction at full level. Friction that the low-level record has shown is an equivalent
    dashpot, kappa c G exp(s T) / s for the table's response G. Other friction is `law` times what dry friction would
    leave, d / (r - 1) for a difference d between levels of ratio r: one that sticks over part of the motion leaves more
    at full level.
    """
    model = found.model
    problem = problem_of(frf, found.layout, timing_of(model), model.band_hz, ripple=True)
    _, slopes = problem.evaluated(found.parameters)
    held = found.layout.zeros(found.held_zeros)
    fixed = np.diag(np.where(np.isin(np.arange(len(found.parameters)), np.arange(held.start, held.stop)), HOLD, 0.0))
    known = np.hstack([slopes, fixed])
    late = problem.s * np.hypot(SKEW * model.dt_s, np.sqrt(2.0) * skew_s)
    frequency = np.abs(problem.s) / (2.0 * np.pi)
    shown = friction is not None and friction.shown
    rubbed = (
        _dashpot(model, problem.s, friction) if friction and shown else _friction(frequency, levels, level_ratio, law)
    )
    distortions = [late, problem.s * _spring_lead_s(found), rubbed]
    moved = [np.append(parts(problem.weight * each), np.zeros(len(fixed))) for each in distortions]
    return np.asarray(np.linalg.norm([linear(known, each) for each in moved], axis=0))


def _spring_lead_s(found: Fit) -> float:
    """Return the lead in s that the dashpot of a deck's spring may add to what the spring transmits, 0 within the band.

    A spring k with a dashpot c transmits k + c s: a lead of c / k. Within the band it cancels the lag that the dashpot
    gives the pole pair beyond the band, whose damping is found too small.
    """
    layout = found.layout
    if layout.pole_pairs - layout.zero_pairs < FLEXIBLE:
        return 0.0
    fastest = float(np.exp(max(found.parameters[columns[0]] for columns in _poles(found)[: layout.pole_pairs])))
    return 2.0 * SPRING_DAMPING / fastest if fastest > 2.0 * np.pi * found.model.band_hz[1] else 0.0


def _friction(frequency_hz: Array, levels: Sequence[LevelBand], level_ratio: float, law: float) -> ComplexArray:
    """Return the relative effect of friction on the response at full level, interpolated between the bands' centres."""
    if not levels or not level_ratio > 1.0:
        return np.zeros(len(frequency_hz), dtype=complex)
    centres = np.sqrt([band.low_hz * band.high_hz for band in levels])
    share = law * (np.array([band.ratio for band in levels]) - 1.0) / (level_ratio - 1.0)
    at = np.log(frequency_hz)
    return np.interp(at, np.log(centres), share.real) + 1j * np.interp(at, np.log(centres), share.imag)


def _dashpot(model: Model, s: ComplexArray, friction: Friction) -> ComplexArray:
    """Return the relative effect (m,) on the response of the equivalent dashpot of dry friction.

    Its size follows the resonances of the table, which a mean over a band would hide.
    """
    accel = model.response(np.abs(s) / (2.0 * np.pi)) * np.exp(s * model.delay_s)
    return np.asarray(friction.command_v * friction.linear_s_per_m * accel / s)


def of_structure(found: Fit, other: Fit | None) -> Array:
    """Return by how much another structure moves the parameters (n_parameters,) of the poles of a fit, beyond scatter.

    `other` is a structure that fits better and was not chosen, because the data do not determine all its roots; None:
    there is none. A mode beyond the band, and any other part of the table that a structure lacks, moves the roots that
    it has. Each pole is compared with the nearest one of its kind. What the other fit scatters more than this one is
    expected and left out (J. A. Hausman, Econometrica 46, 1978, 1251).
    """
    moved = np.zeros(len(found.parameters))
    if other is None:
        return moved
    mine, theirs = _poles(found), _poles(other)
    here, there = (np.diag(each.covariance) for each in (found, other))
    for columns in mine:
        alike = [each for each in theirs if len(each) == len(columns)]
        if not alike:
            moved[columns] = np.nan  # not a pole of that structure
            continue
        nearest = min(alike, key=lambda each: abs(other.parameters[each[0]] - found.parameters[columns[0]]))
        change = other.parameters[nearest] - found.parameters[columns]
        scatter = np.abs(there[nearest] - here[columns])
        moved[columns] = np.sqrt(np.maximum(change**2 - scatter, 0.0))
    return moved


def _poles(found: Fit) -> list[list[int]]:
    """Return the columns of each pole's parameters: frequency and damping of a pair, or the corner of a single pole."""
    single = 1 + 2 * found.layout.pole_pairs
    pairs = [[column, column + 1] for column in range(1, single, 2)]
    return pairs + [[column] for column in range(single, single + found.layout.single_poles)]


def of_specimen(found: Fit, frequency: Array, damping: Array) -> Array:
    """Return what relative uncertainties (n,) of the specimen's modes make of the parameters (n_parameters,) of poles.

    A pole near a mode is the motion of the floors on a table that yields a little, and changes as much as they do.
    """
    moved = np.zeros(len(found.parameters))
    if not len(frequency):
        return moved
    modes = found.parameters[found.layout.zeros(len(frequency))].reshape(-1, 2)[:, 0]
    for columns in _poles(found)[: found.layout.pole_pairs]:
        apart = np.abs(modes - found.parameters[columns[0]])
        nearest = int(np.argmin(apart))
        if apart[nearest] < SAME_MODE:
            moved[columns] = frequency[nearest], damping[nearest]
    return moved


def together(found: Fit, *parts: Array) -> Array:
    """Return the root sum of squares of systematic parts (n_parameters,) and of the clock's 20 ppm of each pole."""
    squares = np.sum([part**2 for part in parts], axis=0)
    for columns in _poles(found):
        squares[columns[0]] += CLOCK**2
    return np.asarray(np.sqrt(squares))


def estimate(
    fits: tuple[Fit, ...], table: Frf, info: RigInfo, levels: tuple[LevelBand, ...] = (), level_ratio: float = np.inf,
    sensors_removed: bool = True,
) -> DelayEstimate | None:  # fmt: skip
    """Estimate the delay together with a fit's roots from the table's response; None if the data do not determine it.

    `fits`: structures with an explicit delay, the smallest first; a larger one is used only if its misfit is clearly
    smaller. The standard uncertainty has three parts: the Gauss-Newton covariance with all roots free, the possible
    effect of friction, and 1 % of a sample of error in the channels' timing.
    """
    channel = channel_response(info, table.frequency_hz, sensors_removed)
    bare = replace(table, response=table.response / channel)
    try:
        found = _smallest([_free(each, bare) for each in _distinct(fits)], bare)
    except InputError:
        return None
    column = found.layout.size - 1
    extra_s = found.model.delay_s - found.layout.delay_s
    moved = shifts(found, bare, levels, level_ratio, law=SHORTFALL)[column]
    error_s = extra_s * float(np.hypot(np.sqrt(found.covariance[column, column]), moved))
    return DelayEstimate(found.model.delay_s, error_s, declared(info)) if error_s < REACH_S else None


def declared(info: RigInfo) -> float:
    """Return the delay from command to table in s that a rig declares."""
    return Timing(info.latency_samples, info.dt_s, info.transport_s).delay_s


def channel_response(info: RigInfo, frequency_hz: Array, sensors_removed: bool) -> ComplexArray:
    """Return the frequency response (n,) of the table channel's sensor together with its correction.

    The correction (a second-order backward difference) does not cancel the sensor's low pass exactly. The remainder
    would count as lag: for a corner of 1549 Hz, at 60 Hz, 1 us at 2 kHz and 5 us at 1 kHz sample rate. The gain of the
    hold is part of the model and not included here.
    """
    channel, s = info.channels[0], 2j * np.pi * frequency_hz
    value = np.ones_like(s)
    if channel.low_pass_hz > 0.0:
        corner_s, late = 1.0 / (2.0 * np.pi * channel.low_pass_hz), np.exp(-s * info.dt_s)
        lead = corner_s / info.dt_s * (1.5 - 2.0 * late + 0.5 * late**2) if sensors_removed else 0.0
        value = (1.0 + lead) / (1.0 + s * corner_s)
    return value if sensors_removed else value * s / (s + 2.0 * np.pi * channel.high_pass_hz)


def _free(known: Fit, table: Frf) -> Fit:
    """Return the fit of the same structure with a free delay, which may be up to REACH_S shorter than the model's."""
    layout = replace(known.layout, delay_s=known.model.delay_s - REACH_S, fits_delay=True)
    roots, ripple = known.parameters[: layout.size - 1], known.parameters[known.layout.size :]
    found = replace(known, layout=layout, parameters=np.concatenate([roots, [np.log(REACH_S)], ripple]))
    for _ in range(ROUNDS):
        dt = known.model.dt_s
        timing = replace(timing_of(known.model), latency_samples=max(round(found.model.delay_s / dt - 0.5), 0))
        found = fit(table, layout, found.parameters, timing, known.model.band_hz, True, known.held_zeros)
    return found


def _distinct(fits: tuple[Fit, ...]) -> list[Fit]:
    """Return one fit per structure, without the structures whose roots represent the delay."""
    kinds = {(each.layout, each.held_zeros): each for each in fits if each.layout.delay_s > 0.0}
    return list(kinds.values())


def _smallest(fits: list[Fit], table: Frf) -> Fit:
    """Return the smallest structure whose misfit no larger one reduces to the fraction WORTH."""
    best = fits[0]
    for other in fits[1:]:
        if _misfit(other, table) < WORTH * _misfit(best, table):
            best = other
    return best


def _misfit(found: Fit, table: Frf) -> float:
    """Return the rms weighted residual of a fit."""
    model = found.model
    problem = problem_of(table, found.layout, timing_of(model), model.band_hz, ripple=True)
    return float(np.linalg.norm(problem.evaluated(found.parameters)[0]))


def doubts(found: DelayEstimate | None, skew_s: float = 0.0) -> tuple[Finding, ...]:
    """Return a warning if identified and declared delay differ by more than SIGMA uncertainties and SEEN_S.

    `skew_s`: declared standard uncertainty of the instants of command and samples, each.
    """
    if found is None:
        return ()
    late_s = found.identified_s - found.declared_s
    if abs(late_s) <= max(SIGMA * float(np.hypot(found.error_s, np.sqrt(2.0) * skew_s)), SEEN_S):
        return ()
    values = {"delay_s": found.identified_s, "within_s": 2.0 * found.error_s, "declared_s": found.declared_s}
    return (Finding("delay.not_as_declared", values),)
