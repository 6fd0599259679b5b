"""The sampling interval of a measured recording: from its time column, from what it states, from the user."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.foreign_texts import rounded_times
from rths_cli.files.measured_data.recording import Column, Contents, place
from rths_cli.files.measured_data.units import time_factor
from rths_cli.numerics.lti import Array

MAX_INTERVAL_S = 1.0
AGREEMENT = 1e-6
"""Relative difference up to which two statements of one interval agree."""
JITTER = 0.2
"""Largest distance of a time from its even place, as a part of the interval; a step may be wrong by twice that."""
_ADVICE = "resample the recording evenly, or, if it is even, remove the column and give --rate"
_JITTER_NOTED = 0.01
_RATES = {"fs", "fshz", "rate", "ratehz", "samplerate", "sampleratehz", "samplingrate", "samplingratehz"}
_RATES |= {"samplefrequency", "samplingfrequency", "samplingfrequencyhz"}
_INTERVALS = {"dt", "dts", "ts", "tsample", "sampletime", "sampletimes", "sampleinterval", "sampleintervals"}
_INTERVALS |= {"samplinginterval", "samplingintervals", "samplingperiod", "sampleperiod", "wfincrement"}


@dataclass(frozen=True)
class Clock:
    """What a time column says: the interval, its relative uncertainty, and each row's sample number (n,)."""

    dt_s: float
    uncertainty: float
    index: NDArray[np.int64]
    notes: tuple[str, ...] = ()


def stated_interval(name: str, value: float) -> float | None:
    """Return the interval in s that a variable such as `fs` or `dt` states, None for any other name."""
    key = re.sub(r"[^a-z]", "", name.lower())
    if key in _RATES:
        return 1.0 / value if value else math.inf
    return value if key in _INTERVALS else None


def read_clock(path: Path, contents: Contents, column: Column) -> Clock:
    """Return the interval of a time column and where gaps of whole samples are.

    Raises InputError, with the row, where time is missing, stands still, runs backwards or is uneven.
    """
    factor = time_factor(column.name, column.unit)
    if factor is None:
        raise InputError(f"{path}: the unit of {column.name!r} is not s, ms or us; give the time in s")
    time = column.values
    if (digit := rounded_times(time)) is not None:
        steps = np.diff(time)
        row = int(np.argmax(np.abs(steps - np.median(steps)) > 0.25 * digit)) + 1
        raise InputError(
            f"{place(path, contents, row)}: {column.name!r} has too few digits: it is even but rounded to {digit:g}; "
            "write it with more, or remove the column and give --rate"
        )
    _check_order(path, contents, column.name, time)
    steps = np.diff(time) / _usual_step(time)
    _check_steps(path, contents, column.name, steps)
    index = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps), 1.0))])
    step, off = _straight_line(time, index)
    worst = int(np.argmax(off))
    if not off[worst] <= JITTER:
        raise InputError(
            f"{place(path, contents, worst)}: {column.name!r} is {off[worst]:.2f} of an interval from its even place, "
            f"at most {JITTER:g} is allowed; {_ADVICE}"
        )
    uncertainty = 2.0 * float(off[worst]) / float(index[-1])
    dt_s = _simplest(step * factor, max(uncertainty, 1e-11))
    return Clock(dt_s, uncertainty, index.astype(np.int64), _notes(column.name, off[worst], dt_s, index))


def _straight_line(time: Array, index: Array) -> tuple[float, Array]:
    """Return the step of the least-squares line of time (n,) over sample number, and distances from it in steps."""
    centred, elapsed = index - index.mean(), time - time[0]
    elapsed = elapsed - elapsed.mean()
    step = float(centred @ elapsed / (centred @ centred))
    return step, np.abs(elapsed / step - centred)


def _check_order(path: Path, contents: Contents, name: str, time: Array) -> None:
    """Raise InputError at the first row whose time is missing or not after the row before."""
    faulty = np.flatnonzero(~np.isfinite(time))
    if len(faulty):
        raise InputError(f"{place(path, contents, int(faulty[0]))}: {name!r} is missing here; give every row its time")
    faulty = np.flatnonzero(np.diff(time) <= 0.0) + 1
    if len(faulty):
        row = int(faulty[0])
        what = "repeats" if time[row] == time[row - 1] else "runs backwards"
        raise InputError(
            f"{place(path, contents, row)}: {name!r} {what} ({time[row]:.10g} after {time[row - 1]:.10g}); "
            "mend it or write it with more digits, or remove the column and give --rate"
        )


def _usual_step(time: Array) -> float:
    """Return the mean step between neighbours, gaps left out."""
    steps = np.diff(time)
    return float(np.mean(steps[steps < 1.5 * np.median(steps)]))


def _check_steps(path: Path, contents: Contents, name: str, steps: Array) -> None:
    """Raise InputError where steps (n - 1,), in intervals, are not whole, or jump over more than the file holds."""
    off = np.abs(steps - np.maximum(np.rint(steps), 1.0))
    row, longest = int(np.argmax(off)), int(np.argmax(steps))
    if not steps.sum() < 2.0 * len(steps) + 2.0:
        raise InputError(
            f"{place(path, contents, longest + 1)}: {name!r} has gaps longer than the recording itself, the longest "
            "before this row; cut the file there"
        )
    if not off[row] <= 2.0 * JITTER:
        raise InputError(
            f"{place(path, contents, row + 1)}: {name!r} steps by {steps[row]:.2f} intervals here, which is not whole; "
            f"{_ADVICE}"
        )


def _simplest(dt_s: float, tolerance: float) -> float:
    """Return the interval with the fewest digits, in s or as a rate in Hz, within a relative tolerance."""
    for digits in range(1, 17):
        for near in (float(f"{dt_s:.{digits}g}"), 1.0 / float(f"{1.0 / dt_s:.{digits}g}")):
            if abs(near - dt_s) <= tolerance * dt_s:
                return near
    return dt_s


def _notes(name: str, jitter: float, dt_s: float, index: Array) -> tuple[str, ...]:
    """Return sentences on jitter above 1 % of the interval and on gaps."""
    notes = []
    if jitter > _JITTER_NOTED:
        notes.append(
            f"{name!r} has a jitter of up to {100.0 * jitter:.1f} % of the interval of {dt_s:.6g} s; taken as even"
        )
    steps = np.diff(index)
    gaps = np.flatnonzero(steps > 1.0)
    if len(gaps):
        lost, first = int(np.sum(steps[gaps] - 1.0)), (index[gaps[0]] + 1.0) * dt_s
        count = f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''}"
        notes.append(f"{name!r} has {count}, the first at {first:.6g} s: {lost} samples are missing in every channel")
    return tuple(notes)


def choose_interval(path: Path, contents: Contents, clock: Clock | None, dt_s: float | None) -> float:
    """Return the interval in s from the time column, the file's statements or the user, which must agree.

    Raises InputError where nobody states one, one is out of range, or two differ.
    """
    told = [("the time column", clock.dt_s, clock.uncertainty)] if clock else []
    told += [(where, value, 0.0) for where, value in contents.intervals_s]
    told += [("--rate", dt_s, 0.0)] if dt_s is not None else []
    if not told:
        raise InputError(f"{path}: states no sample rate and has no time column; give --rate HZ")
    faults = [_range_fault(path, where, value) for where, value, _ in told if not 0.0 < value <= MAX_INTERVAL_S]
    if faults:
        raise InputError(*faults)
    where, interval, doubt = told[0]
    for other, value, _ in told[1:]:
        if abs(value - interval) > max(AGREEMENT, doubt) * interval:
            raise InputError(
                f"{path}: {where} says {_rate(interval)}, {other} says {_rate(value)}; correct or remove one of them"
            )
    return told[1][1] if clock and len(told) > 1 else interval


def _range_fault(path: Path, where: str, value: float) -> str:
    """Return the sentence for an interval out of range."""
    return f"{path}: {where} says an interval of {value:g} s; it must be above 0 and at most {MAX_INTERVAL_S:g} s"


def _rate(interval_s: float) -> str:
    """Return an interval with its rate as text."""
    return f"{1.0 / interval_s:.9g} Hz ({interval_s:.9g} s)"
