"""Systematic uncertainty of the model's poles and zeros, from delay and friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.identification.least_squares import linear, parts
from rths_cli.identification.results import LevelBand
from rths_cli.identification.specimen_fit import SKEW
from rths_cli.identification.table_fit import HOLD, Fit, problem_of, timing_of
from rths_cli.identification.verdict import SHORTFALL
from rths_cli.numerics.lti import Array, ComplexArray, Frf


def shifts(found: Fit, frf: Frf, levels: Sequence[LevelBand], level_ratio: float) -> Array:
    """Return the systematic uncertainty (n_parameters,) of the parameters of a fit, beside their random error.

    Two distortions of the response are propagated to first order: an error of 1 % of a sample in the declared delay,
    and the effect of friction at full level, d / (r - 1) for a difference d between levels of ratio r.
    """
    model = found.model
    problem = problem_of(frf, found.layout, timing_of(model), model.band_hz, ripple=True)
    _, slopes = problem.evaluated(found.parameters)
    held = found.layout.zeros(found.held_zeros)
    fixed = np.diag(np.where(np.isin(np.arange(len(found.parameters)), np.arange(held.start, held.stop)), HOLD, 0.0))
    known = np.hstack([slopes, fixed])
    late = problem.s * SKEW * model.dt_s
    frequency = np.abs(problem.s) / (2.0 * np.pi)
    distortions = [late, _friction(frequency, levels, level_ratio)]
    moved = [np.append(parts(problem.weight * each), np.zeros(len(fixed))) for each in distortions]
    return np.hypot(*(linear(known, each) for each in moved))


def _friction(frequency_hz: Array, levels: Sequence[LevelBand], level_ratio: float) -> ComplexArray:
    """Return the relative effect of friction on the response at full level, interpolated between the bands' centres."""
    if not levels or not level_ratio > 1.0:
        return np.zeros(len(frequency_hz), dtype=complex)
    centres = np.sqrt([band.low_hz * band.high_hz for band in levels])
    share = SHORTFALL * (np.array([band.ratio for band in levels]) - 1.0) / (level_ratio - 1.0)
    at = np.log(frequency_hz)
    return np.interp(at, np.log(centres), share.real) + 1j * np.interp(at, np.log(centres), share.imag)
