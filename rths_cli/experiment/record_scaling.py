"""What brings a record to the value of a measure, or to a code's spectrum."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.code_spectra import asce7, compared_periods, ec8, least_squares_factor
from rths_cli.analysis.intensity import husid, spectrum
from rths_cli.files.accelerograms import Accelerogram

if TYPE_CHECKING:
    from rths_cli.case.record_schema import ScaleToSpec

OF_MEASURE = {"pga": "m/s^2", "sa_t1": "m/s^2", "arias": "m/s"}
DAMPING = 0.05


def scaled_to(record: Accelerogram, asked: ScaleToSpec, first_period_s: float | None) -> tuple[Accelerogram, str]:
    """Return a record times what brings it to the value or the spectrum asked for, and a sentence on it.

    `first_period_s` is that of the building at the record's scale; None where nothing asks for it.
    """
    accel, dt_s = record.accel_m_s2, record.dt_s
    if asked.measure is not None:
        assert asked.value is not None  # the schema's
        ratio = asked.value / _measured(record, asked.measure, first_period_s)
        factor = float(np.sqrt(ratio)) if asked.measure == "arias" else ratio
        at = f" at {first_period_s:.4g} s" if asked.measure == "sa_t1" else ""
        told = f"scaled by {factor:.6g} to {asked.measure} = {asked.value:g} {OF_MEASURE[asked.measure]}{at}"
        return replace(record, accel_m_s2=factor * accel), told
    assert asked.period_s is not None
    periods = compared_periods(*asked.period_s)
    if asked.spectrum == "ec8":
        assert asked.ground is not None and asked.ag_m_s2 is not None
        target = ec8(periods, asked.ground, asked.ag_m_s2, asked.type, asked.damping)
    else:
        assert asked.sds_g is not None and asked.sd1_g is not None
        target = asce7(periods, asked.sds_g, asked.sd1_g, asked.tl_s)
    factor, mean, largest = least_squares_factor(accel, dt_s, periods, target, asked.damping)
    told = (
        f"scaled by {factor:.6g} to the spectrum of {asked.spectrum} from {asked.period_s[0]:g} to "
        f"{asked.period_s[1]:g} s (misfit {100.0 * mean:.3g} % in the mean, {100.0 * largest:.3g} % at most)"
    )
    return replace(record, accel_m_s2=factor * accel), told


def _measured(record: Accelerogram, measure: str, first_period_s: float | None) -> float:
    if measure == "pga":
        return float(np.abs(record.accel_m_s2).max())
    if measure == "arias":
        return float(husid(record.accel_m_s2, record.dt_s)[-1])
    assert first_period_s is not None
    return float(spectrum(record.accel_m_s2, record.dt_s, [first_period_s], DAMPING).sa_m_s2[0])
