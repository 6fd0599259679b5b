"""Estimate the transport delay beside the table's roots, with its uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.results import DelayEstimate, LevelBand
from rths_cli.identification.root_uncertainty import shifts
from rths_cli.identification.table_fit import Fit, Timing, fit, problem_of, timing_of
from rths_cli.identification.verdict import SHORTFALL
from rths_cli.numerics.lti import Array, ComplexArray, Frf
from rths_cli.rigs.description import RigInfo

REACH_S = 0.01  # the free delay may be shorter than the model's by this time
ROUNDS = 2  # fits: the second one uses the latency of the first for the staircase's alias
WORTH = 0.9  # a larger structure must reduce the misfit to this fraction
SIGMA, SEEN_S = 3.0, 1e-4  # reported difference of declared and identified delay: standard uncertainties, and s


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


def doubts(found: DelayEstimate | None, skew_s: float = 0.0) -> tuple[str, ...]:
    """Return a sentence if identified and declared delay differ by more than SIGMA uncertainties and SEEN_S.

    `skew_s`: declared standard uncertainty of the instants of command and samples, each.
    """
    if found is None:
        return ()
    late_s = found.identified_s - found.declared_s
    if abs(late_s) <= max(SIGMA * float(np.hypot(found.error_s, np.sqrt(2.0) * skew_s)), SEEN_S):
        return ()
    return (
        f"delay: the data show {1e3 * found.identified_s:.3f} +- {2e3 * found.error_s:.3f} ms from command to table, "
        f"{1e3 * found.declared_s:.3f} ms are declared (latency, half a sample of hold, transport); check "
        "converters.latency_samples and the channels' timing; a flexible deck beyond the band looks the same",
    )
