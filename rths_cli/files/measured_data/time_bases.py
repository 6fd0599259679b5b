"""Channels of one recording with clocks of their own: read each, and bring other rates to the slowest one.

A faster channel passes a linear-phase low pass without delay (Kaiser window, flat within 1e-4 up to 0.8 of half the
slowest rate, -80 dB from half of it on) before its samples are left out, by scipy.signal.resample_poly. One that only
repeats its values between the samples of the slowest rate (a held command) gives one of each.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.measured_data.recording import AGREEMENT, Column, Contents, read_clock
from rths_cli.files.measured_data.units import is_time, time_factor
from rths_cli.numerics.lti import Array

_PASS, _STOP_DB = 0.8, 80.0  # of half the slowest rate
_LARGEST = 1000  # of numerator and denominator of a ratio of rates
_LEAST_CHANGES = 8  # of a channel that is called held


def with_own_clocks(path: Path, contents: Contents) -> Contents:
    """Return contents without times of single channels: one time column where all are equal, else start and interval
    of each channel, NaN where its time jumps over samples. Raises InputError as `read_clock` does."""
    contents = _with_times_beside(contents)
    times = [column.time for column in contents.columns if column.time is not None]
    if not times:
        return contents
    plain = tuple(replace(column, time=None) for column in contents.columns)
    if len(times) == len(plain) and all(
        np.array_equal(times[0].values, one.values) and one.unit == times[0].unit for one in times[1:]
    ):
        return replace(contents, columns=(times[0], *plain))
    own: list[Column] = []
    faults: dict[str, None] = {}
    for column, bare in zip(contents.columns, plain, strict=True):
        try:
            own.append(bare if column.time is None else _clocked(path, contents, bare, column.time))
        except InputError as fault:
            faults |= dict.fromkeys(fault.faults)
    if faults:
        raise InputError(*faults)
    slowest = max(column.dt_s for column in own if column.dt_s is not None)
    stated = ("the slowest time of the channels", slowest)
    return replace(contents, columns=tuple(own), intervals_s=(*contents.intervals_s, stated))


def _with_times_beside(contents: Contents) -> Contents:
    """Return a text's contents in which several time columns belong each to the channels on its right; others as they
    are. A table that is shorter than those beside it ends with its last time."""
    columns = () if contents.line_of is None else contents.columns
    is_x = [column.time is None and is_time(column.name) for column in columns]
    beside = [one for one, after in zip(is_x, [*is_x[1:], True], strict=True) if one and after] if columns else [True]
    if sum(is_x) < 2 or not is_x[0] or any(beside):
        return contents
    channels: list[Column] = []
    for column, x in zip(columns, is_x, strict=True):
        if x:
            end = int(np.flatnonzero(np.isfinite(column.values))[-1]) + 1 if np.isfinite(column.values).any() else 0
            time = replace(column, values=column.values[:end])
        else:
            channels.append(replace(column, values=column.values[:end], time=time))
    return replace(contents, columns=tuple(channels))


def _clocked(path: Path, contents: Contents, column: Column, time: Column) -> Column:
    """Return a channel with start and interval from its own time."""
    if time.values.size != column.values.size or time.values.size < 3:
        raise InputError(
            f"{path}: {column.name} has {column.values.size} samples, its time has {time.values.size}, at least 3; "
            "export it again"
        )
    clock = read_clock(path, contents, replace(time, name=f"{column.name}: {time.name}"))
    values = np.full(int(clock.index[-1]) + 1, np.nan)
    values[clock.index] = column.values
    seconds = time.values * (time_factor(time.name, time.unit) or 1.0)
    start = float(seconds.mean() - clock.dt_s * clock.index.mean())
    return replace(column, values=values, start_s=start, dt_s=clock.dt_s)


def at_one_rate(path: Path, columns: tuple[Column, ...], dt_s: float) -> tuple[tuple[Column, ...], tuple[str, ...]]:
    """Return the channels at the interval `dt_s` in s of the slowest one, and a sentence for each kind of change.

    Raises InputError where rates have no ratio of small whole numbers, or a faster channel misses samples.
    """
    if all(column.dt_s is None or abs(column.dt_s / dt_s - 1.0) <= AGREEMENT for column in columns):
        return columns, ()
    changed = [_at_rate(path, column, dt_s) for column in columns]
    most = max(end for _, end, _ in changed)
    cut = tuple(_cut(column, most - end) for column, end, _ in changed)
    return cut, tuple(note for _, _, note in changed if note)


def _at_rate(path: Path, column: Column, dt_s: float) -> tuple[Column, int, str]:
    """Return a channel at the slowest interval, how many samples its low pass takes at either end, and a sentence."""
    ratio = _ratio(path, column, dt_s)
    own = column.dt_s or dt_s
    changed = replace(column, start_s=column.start_s or 0.0, dt_s=dt_s)
    if ratio == 1:
        return changed, 0, ""
    told = f"{column.name}: sampled at {1.0 / own:.9g} Hz, the slowest channel at {1.0 / dt_s:.9g}"
    held = _held(column.values, ratio.numerator) if ratio.denominator == 1 else None
    if held is not None:
        first = (column.start_s or 0.0) + held * own
        picked = replace(changed, values=column.values[held :: ratio.numerator], start_s=first)
        return picked, 0, f"{told}; it is held between, one sample of each {ratio.numerator} is taken"
    slowed, end = _decimated(path, changed, ratio)
    return slowed, end, f"{told}; taken to that by a low pass without delay, true below {_PASS / 2.0 / dt_s:.4g} Hz"


def _cut(column: Column, count: int) -> Column:
    """Return a channel without so many samples at either end; its start stays, as all channels lose as many."""
    return replace(column, values=column.values[count : column.values.size - count]) if count else column


def _ratio(path: Path, column: Column, dt_s: float) -> Fraction:
    """Return the slowest interval over a channel's own, a ratio of whole numbers."""
    exact = dt_s / (column.dt_s or dt_s)
    ratio = Fraction(exact).limit_denominator(_LARGEST)
    if ratio < 1 or ratio.numerator > _LARGEST or abs(float(ratio) / exact - 1.0) > AGREEMENT:
        raise InputError(
            f"{path}: {column.name} is sampled at {1.0 / (column.dt_s or dt_s):.9g} Hz beside {1.0 / dt_s:.9g} Hz, "
            f"which have no ratio of whole numbers up to {_LARGEST}; export all channels at one rate"
        )
    return ratio


def _held(values: Array, every: int) -> int | None:
    """Return the first sample at which a channel (n,) changes if it changes only each `every` samples, else None."""
    changes = np.flatnonzero(np.diff(values)) + 1
    places = np.unique(changes % every)
    return int(places[0]) if changes.size >= _LEAST_CHANGES and places.size == 1 else None


def _decimated(path: Path, column: Column, ratio: Fraction) -> tuple[Column, int]:
    """Return a channel at 1/ratio of its rate, without the ends that its low pass does not reach, and their samples."""
    from scipy.signal import firwin, kaiserord, resample_poly

    if not np.isfinite(column.values).all():
        raise InputError(
            f"{path}: {column.name} is sampled faster than others and has missing samples, over which no low pass "
            "goes; export all channels at one rate"
        )
    widest = float(max(ratio.numerator, ratio.denominator))
    count, beta = kaiserord(_STOP_DB, (1.0 - _PASS) / widest)
    half = (count + 1) // 2
    taps = firwin(2 * half + 1, (1.0 + _PASS) / 2.0 / widest, window=("kaiser", beta))
    values = resample_poly(column.values, ratio.denominator, ratio.numerator, window=taps)
    end = -(-half // ratio.numerator)
    if values.size < 2 * end + 3:
        raise InputError(f"{path}: {column.name} is too short for a low pass of {2 * end} samples; record longer")
    return _cut(replace(column, values=np.asarray(values)), end), end
