"""What a case does to a record before it is scaled: baseline removed, tapered, filtered, brought to rest, resampled."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.intensity import integrate
from rths_cli.errors import InputError
from rths_cli.experiment.ground_motion import end_steps, without_baseline
from rths_cli.files.accelerograms import Accelerogram
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from rths_cli.case.record_schema import BaselineSpec, RecordSpec

POLES = 2  # of the band's ends, forth and back
PADDING = 3.0  # periods of the lower end, of zeros on both sides of a record that is filtered
LARGEST_RATIO = 2000  # numerator and denominator of a change of rate
RATE_AGREEMENT = 1e-6


def treated(record: Accelerogram, asked: RecordSpec) -> tuple[Accelerogram, tuple[str, ...]]:
    """Return a record as the case asks for it, and what was done to it, in its order; nothing without a key.

    Raises InputError, with the key, for a taper or a band that the record does not have, a rate that is no ratio of
    small numbers to its own, and a record of which nothing remains.
    """
    told: list[str] = []
    if asked.baseline is not None:
        record = _without(record, asked.baseline, told)
    if asked.band_hz is not None:
        low_hz, high_hz = asked.band_hz
        record = replace(record, accel_m_s2=_in_band(record, low_hz, high_hz))
        told.append(f"filtered to {low_hz:g} to {high_hz:g} Hz")
    if asked.baseline is not None and asked.baseline.zero_velocity:
        accel, velocity = _to_rest(record)
        record = replace(record, accel_m_s2=accel)
        told.append(f"final velocity of {velocity:.4g} m/s removed")
    if asked.resample_hz is not None:
        record = _resampled(record, asked.resample_hz)
        told.append(f"resampled to {asked.resample_hz:g} Hz")
    return record, tuple(told)


def _without(record: Accelerogram, baseline: BaselineSpec, told: list[str]) -> Accelerogram:
    """Return a record without its baseline and tapered; what was done is appended to `told`."""
    remove = baseline.remove
    if remove == "step":
        for level, first, end in end_steps(record.accel_m_s2):
            told.append(f"level of {level:.4g} m/s^2 removed from {first * record.dt_s:g} to {end * record.dt_s:g} s")
    elif remove != "none":
        told.append(f"polynomial of order {baseline.order} removed" if remove == "polynomial" else f"{remove} removed")
    record = without_baseline(record, remove, baseline.order)
    if baseline.taper_s > 0.0:
        record = replace(record, accel_m_s2=_tapered(record, baseline.taper_s))
        told.append(f"tapered over {baseline.taper_s:g} s at both ends")
    return record


def _tapered(record: Accelerogram, taper_s: float) -> Array:
    """Return an acceleration (n,) that a half cosine of `taper_s` leads from and to zero."""
    samples, count = record.accel_m_s2.size, round(taper_s / record.dt_s)
    if not 1 <= count <= samples // 2:
        raise InputError(
            f"record.baseline.taper_s: {taper_s:g} s must be at least a sample ({record.dt_s:g} s) and at most half of "
            f"the record's {(samples - 1) * record.dt_s:g} s; correct it"
        )
    rise = 0.5 * (1.0 - np.cos(np.pi * np.arange(count) / count))
    window = np.ones(samples)
    window[:count], window[samples - count :] = rise, rise[::-1]
    return np.asarray(window * record.accel_m_s2)


def _in_band(record: Accelerogram, low_hz: float, high_hz: float) -> Array:
    """Return an acceleration (n,) less what lies outside a band, without a shift in time."""
    from scipy.signal import butter, sosfiltfilt

    highest_hz = 0.5 / record.dt_s
    if high_hz >= highest_hz:
        raise InputError(
            f"record.band_hz: {high_hz:g} Hz is not below half of the record's rate, {highest_hz:g} Hz; lower it"
        )
    sos = butter(POLES, [low_hz, high_hz], "bandpass", fs=2.0 * highest_hz, output="sos")
    zeros = np.zeros(min(int(PADDING / low_hz / record.dt_s), 10 * record.accel_m_s2.size))
    padded = sosfiltfilt(sos, np.concatenate([zeros, record.accel_m_s2, zeros]), padtype=None)
    return np.asarray(padded[zeros.size : zeros.size + record.accel_m_s2.size])


def _to_rest(record: Accelerogram) -> tuple[Array, float]:
    """Return an acceleration (n,) whose velocity is zero at its end, by a smooth one over its whole length that begins
    and ends at zero, and the velocity in m/s that it removes."""
    accel = record.accel_m_s2
    window = np.sin(np.pi * np.arange(accel.size) / (accel.size - 1)) ** 2
    velocity = float(integrate(accel, record.dt_s)[0][-1])
    return accel - window * velocity / float(integrate(window, record.dt_s)[0][-1]), velocity


def _resampled(record: Accelerogram, rate_hz: float) -> Accelerogram:
    """Return a record at another rate, by the polyphase filter of scipy."""
    from scipy.signal import resample_poly

    wanted = rate_hz * record.dt_s
    ratio = Fraction(wanted).limit_denominator(LARGEST_RATIO)
    if not 0 < ratio.numerator <= LARGEST_RATIO or abs(float(ratio) - wanted) > RATE_AGREEMENT * wanted:
        raise InputError(
            f"record.resample_hz: {rate_hz:g} Hz is no simple ratio to the record's {1.0 / record.dt_s:g} Hz; name "
            "a rate that is"
        )
    accel = np.asarray(resample_poly(record.accel_m_s2, ratio.numerator, ratio.denominator))
    return replace(record, accel_m_s2=accel, dt_s=float(f"{1.0 / rate_hz:.12g}"))
