"""What brings a record to the value of a measure, or to a spectrum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.code_spectra import asce7, compared_periods, ec8, least_squares_factor, misfit
from rths_cli.analysis.intensity import husid, integrate, spectrum
from rths_cli.analysis.spectral_matching import matched
from rths_cli.errors import InputError
from rths_cli.files.accelerograms import Accelerogram
from rths_cli.files.target_spectrum import read_spectrum
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from rths_cli.case.record_schema import ScaleToSpec

OF_MEASURE = {"pga": "m/s^2", "sa_t1": "m/s^2", "arias": "m/s"}
DAMPING = 0.05
STATED_PER_DECADE = 190  # periods at which the misfit of a match is stated: between those that were matched, too
LARGEST_MISFIT = 0.1  # of a match


def scaled_to(record: Accelerogram, asked: ScaleToSpec, first_period_s: float | None) -> tuple[Accelerogram, str]:
    """Return a record times what brings it to the value or the spectrum asked for, and a sentence on it.

    `first_period_s` is that of the building at the record's scale; None where nothing asks for it.
    """
    if asked.measure is not None:
        assert asked.value is not None  # the schema's
        ratio = asked.value / _measured(record, asked.measure, first_period_s)
        factor = float(np.sqrt(ratio)) if asked.measure == "arias" else ratio
        at = f" at {first_period_s:.4g} s" if asked.measure == "sa_t1" else ""
        told = f"scaled by {factor:.6g} to {asked.measure} = {asked.value:g} {OF_MEASURE[asked.measure]}{at}"
        return replace(record, accel_m_s2=factor * record.accel_m_s2), told
    return _to_spectrum(record, asked)


def _to_spectrum(record: Accelerogram, asked: ScaleToSpec) -> tuple[Accelerogram, str]:
    """Return a record brought to a spectrum by a factor or by what is added to it, and a sentence on it.

    Raises InputError for a spectrum's file that cannot be used, and a match that is farther than 10 % from its target.
    """
    assert asked.period_s is not None  # the schema's
    low_s, high_s = asked.period_s
    name, target = _target(asked)
    periods = compared_periods(low_s, high_s)
    factor = least_squares_factor(record.accel_m_s2, record.dt_s, periods, target(periods), asked.damping)
    record = replace(record, accel_m_s2=factor * record.accel_m_s2)
    more = ""
    if asked.method == "match":
        found = matched(record.accel_m_s2, record.dt_s, (low_s, high_s), target, asked.damping)
        record = replace(record, accel_m_s2=found.accel_m_s2, dt_s=found.dt_s)
        velocity, displacement = (float(each[-1]) + 0.0 for each in integrate(found.accel_m_s2, found.dt_s))
        more = (
            f" and matched in {found.steps} steps, sampled every {found.dt_s:g} s; final velocity {velocity:.2g} m/s, "
            f"final displacement {displacement:.4g} m"
        )
        periods = compared_periods(low_s, high_s, STATED_PER_DECADE)
    mean, largest = misfit(record.accel_m_s2, record.dt_s, periods, target(periods), asked.damping)
    if asked.method == "match" and largest > LARGEST_MISFIT:
        raise InputError(
            f"record.scale_to: the match leaves a misfit of {100.0 * largest:.3g} % at some period, at most "
            f"{100.0 * LARGEST_MISFIT:g} % is allowed; narrow period_s, or give another record"
        )
    told = (
        f"scaled by {factor:.6g} to the spectrum of {name} from {low_s:g} to {high_s:g} s{more} (misfit "
        f"{100.0 * mean:.3g} % in the mean, {100.0 * largest:.3g} % at most)"
    )
    return record, told


def _target(asked: ScaleToSpec) -> tuple[str, Callable[[Array], Array]]:
    """Return the name of the spectrum asked for, and the pseudo-acceleration in m/s^2 at periods (p,) in s."""
    if asked.spectrum == "ec8":
        assert asked.ground is not None and asked.ag_m_s2 is not None
        return "ec8", partial(
            ec8, ground=asked.ground, ag_m_s2=asked.ag_m_s2, kind=asked.type, damping_ratio=asked.damping
        )
    if asked.spectrum == "asce7":
        assert asked.sds_g is not None and asked.sd1_g is not None
        return "asce7", partial(asce7, sds_g=asked.sds_g, sd1_g=asked.sd1_g, tl_s=asked.tl_s)
    assert isinstance(asked.spectrum, Path) and asked.period_s is not None
    period, accel = read_spectrum(asked.spectrum)
    name, (low_s, high_s) = asked.spectrum.name, asked.period_s
    if not (period[0] <= low_s and high_s <= period[-1]):
        raise InputError(
            f"record.scale_to.period_s: {low_s:g} to {high_s:g} s is beyond the periods of {name}, {period[0]:g} to "
            f"{period[-1]:g} s; narrow it, or give a spectrum of more periods"
        )
    return name, lambda periods: np.interp(periods, period, accel)


def _measured(record: Accelerogram, measure: str, first_period_s: float | None) -> float:
    if measure == "pga":
        return float(np.abs(record.accel_m_s2).max())
    if measure == "arias":
        return float(husid(record.accel_m_s2, record.dt_s)[-1])
    assert first_period_s is not None
    return float(spectrum(record.accel_m_s2, record.dt_s, [first_period_s], DAMPING).sa_m_s2[0])
