"""What a text of numbers is that no reader here takes: a named format, dates in place of times, times of too few
digits, the sign of a lost sample."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rths_cli.numerics.lti import Array

LOST = -9999.0  # what streaming recorders write in place of a scan that they lost
LARGEST_BESIDE = 0.1  # of it: a channel that reads so much elsewhere may read it, too
_DATE = re.compile(r"\d{4}[-/]\d\d?[-/]\d\d?([T ]\d\d?:\d\d.*)?|\d\d?[./]\d\d?[./]\d{4}.*|\d\d?:\d\d(:\d\d.*)?")
LEAST_TIMES, MOST_STEPS = 16, 5  # times of few digits step by few different values, over a digit or none
LEAST_UNEVEN, LEAST_SHARE = 4, 0.005  # steps that are not the usual one: a few wrong times are no rounding
UNEVEN = 0.25  # of the longest step, by which such a step is another
_WITHIN = 0.75  # of the last digit: times so near to even ones are even and rounded


UNIVERSAL = r"(15|18|55|58b?|82|151|152|164|2400|2411|2412|2414|2420|2429|2467)( |$)"  # datasets of universal files


def format_of(lines: Sequence[str]) -> str:
    """Return which format a text is that has to be exported as CSV, as the end of a sentence; "" for any other."""
    first = [line.strip() for line in lines[:10] if line.strip()][:2]
    if len(first) == 2 and first[0] == "-1" and re.match(UNIVERSAL, first[1]):
        return f"is a universal file (dataset {first[1].split()[0]}); export it as CSV, one row per sample"
    if first and first[0].startswith("TIMESERIES "):
        return "is an IRIS time series (TSPAIR or SLIST); write its samples as CSV (time_s,accel_m_s2), times from 0"
    if first and first[0].startswith("LabVIEW Measurement"):
        return "is a LabVIEW measurement file (.lvm); export it as CSV, names in the first line"
    return ""


def is_date(word: str) -> bool:
    """Say whether a cell is a date, a time of day, or both."""
    return _DATE.fullmatch(word.strip().strip("\"'")) is not None


def rounded_times(time: Array) -> float | None:
    """Return the last digit of times (n,) that are even but for their rounding to it; None for any others."""
    steps = np.round(np.diff(time), 9)
    if time.size < LEAST_TIMES or not np.isfinite(steps).all() or (steps < 0.0).any() or not (steps > 0.0).any():
        return None
    different = np.unique(steps)
    uneven = int(np.sum(np.abs(steps - np.median(steps)) > UNEVEN * different[-1]))
    if not 1 < different.size <= MOST_STEPS or uneven < max(LEAST_UNEVEN, LEAST_SHARE * steps.size):
        return None
    digit = float(different[different > 0.0][0])
    line = np.polynomial.Polynomial.fit(np.arange(time.size), time, 1)(np.arange(time.size))
    return digit if float(np.abs(time - line).max()) <= _WITHIN * digit else None


def lost_scans(values: Array) -> NDArray[np.bool_]:
    """Return which samples (n,) are the sign of a lost scan: -9999 in a channel that is far smaller elsewhere."""
    lost = np.asarray(values == LOST)
    others = values[~lost & np.isfinite(values)]
    if not lost.any() or not others.size or np.abs(others).max() > LARGEST_BESIDE * abs(LOST):
        return np.zeros(values.size, dtype=bool)
    return lost
