"""A recording: its channels, the starts they state, their common interval, samples that are missing."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.foreign_texts import rounded_times
from rths_cli.files.measured_data.units import time_factor
from rths_cli.numerics.lti import Array

_NAMES_LISTED = 12

WHOLE = 1e-3  # of a sample: a start that is so near to another's samples is one of them
ROUNDING_S = 1e-6  # of stated times
MOST = 10_000  # channels of one file
TAPS = 32  # samples on either side of which a value between two is made
BETA = 9.0  # of the Kaiser window over them: 1e-4 below 0.85 of half the sample rate
_STARTS = {"t0", "tstart", "starttime", "starttimes", "startoffset", "startoffsets", "timeoffset", "timeoffsets"}
LONGEST_BRIDGED = 3
LARGEST_SHARE = 0.001
"""Share of a record's samples that may be bridged."""
BAND = 0.1
"""A bridged channel's content lies below this part of half the sample rate ..."""
POWER_ABOVE = 0.01
"""... all but this share of its power."""
_BESIDE = 2
"""Samples on either side of a gap through which the cubic passes."""
MAX_INTERVAL_S = 1.0
AGREEMENT = 1e-6
"""Relative difference up to which two statements of one interval agree."""
JITTER = 0.2
"""Largest distance of a time from its even place, as a part of the interval; a step may be wrong by twice that."""
_ADVICE = "resample the recording evenly, or, if it is even, remove the column and give --rate"
_JITTER_NOTED = 0.01
_RATES = {"fs", "fshz", "rate", "ratehz", "samplerate", "sampleratehz", "samplingrate", "samplingratehz"}
_INTERVALS = {"dt", "dts", "ts", "tsample", "sampletime", "sampletimes", "sampleinterval", "sampleintervals"}


@dataclass(frozen=True)
class Recording:
    """One measured recording: channels sampled together, as the file holds them.

    `sha256` is that of the file's bytes. `names` (c,) are as in the file, `units` (c,) canonical or "" where not
    known. `samples` (c, n) are in those units, NaN where missing, every `dt_s`. `notes` are sentences for the user.
    `format` is that of the file; `starts_s`, `steps_s` (c,): start and interval in s as the file states them for each
    channel alone, None where it does not.
    """

    path: Path
    sha256: str
    dt_s: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    samples: Array
    notes: tuple[str, ...] = ()
    format: str = field(default="", compare=False)
    starts_s: tuple[float | None, ...] = field(default=(), compare=False)
    steps_s: tuple[float | None, ...] = field(default=(), compare=False)


@dataclass(frozen=True)
class Column:
    """One series of a file: its name, its figures (n,), and the unit stated beside the name, "" if none.

    `start_s`: when its first sample was taken, in s on a clock that all channels share; None where nothing states it.
    `dt_s`: its own interval in s; `time`: its own time column. Both None where those of the file apply.
    """

    name: str
    values: Array
    unit: str = ""
    start_s: float | None = None
    dt_s: float | None = None
    time: Column | None = None


@dataclass(frozen=True)
class Contents:
    """What a file holds, before any check: columns (time among them) and stated sampling intervals.

    `intervals_s` pairs what states an interval with its value in s. `line_of` returns the line of a row counted from
    0 where the file has lines. `exact`: the project's own form, whose names and units stand as they are. `format`: of
    the file, in words.
    """

    columns: tuple[Column, ...]
    intervals_s: tuple[tuple[str, float], ...] = ()
    notes: tuple[str, ...] = ()
    line_of: Callable[[int], int] | None = None
    exact: bool = False
    format: str = ""


def place(path: Path, contents: Contents, row: int) -> str:
    """Return where a row, counted from 0, stands: `file:line` for text, else `file: row N`."""
    return f"{path}: row {row + 1}" if contents.line_of is None else f"{path}:{contents.line_of(row)}"


def listed(names: Iterable[str]) -> str:
    """Return at most a dozen names as text."""
    every = list(names)
    more = f" and {len(every) - _NAMES_LISTED} more" if len(every) > _NAMES_LISTED else ""
    return ", ".join(every[:_NAMES_LISTED]) + more


_STARTS |= {"wfstartoffset", "wfstarttime", "xstart", "x0", "start", "starts"}


def states_start(name: str) -> bool:
    """Say whether a property such as `wf_start_offset`, `start_time` or `t0` states when a channel starts."""
    return re.sub(r"[^a-z0-9]", "", name.lower()) in _STARTS


def start_of(value: object) -> float | None:
    """Return a stated start in s, of a number or of a date and time (ISO 8601); None where it is neither."""
    if isinstance(value, str):
        try:
            return datetime.fromisoformat(value.strip().replace("Z", "+00:00")).timestamp()
        except ValueError:
            pass
    try:
        found = float(np.asarray(value).reshape(-1)[0]) if np.size(value) == 1 else np.nan  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
    return found if np.isfinite(found) else None


def half_digit(word: str, mark: str = ".") -> float:
    """Return half the last digit of a number as it is written, such as `1.23456E+02`: what its rounding leaves open."""
    figures, _, power = word.strip().lower().partition("e")
    return float(0.5 * 10.0 ** (int(power or 0) - len(figures.partition(mark)[2])))


def differ(columns: Sequence[Column]) -> bool:
    """Say whether the channels state starts that are not all one; a channel that states none agrees with 0 only."""
    stated = {column.start_s for column in columns}
    if None in stated:
        return len(stated) > 1 and stated != {0.0, None}
    return max(stated, default=0.0) - min(stated, default=0.0) > ROUNDING_S  # type: ignore[operator, type-var]


def numbers_of(value: object) -> tuple[float, ...]:
    """Return stated starts in s, one or one per channel; () where they are none."""
    if isinstance(value, str | bytes) or np.ndim(value) == 0:  # type: ignore[arg-type]
        found = start_of(value.decode(errors="replace") if isinstance(value, bytes) else value)
        return () if found is None else (found,)
    every = [start_of(each) for each in np.asarray(value).reshape(-1)[:MOST].tolist()]
    return () if None in every else tuple(each for each in every if each is not None)


def shifts(columns: Sequence[Column]) -> str:
    """Return the starts of the channels after the first one, in ms, as text."""
    first = min(column.start_s or 0.0 for column in columns)
    told = [f"{column.name} {1e3 * ((column.start_s or 0.0) - first):.6g} ms" for column in columns]
    return ", ".join(told[:12]) + (f" and {len(told) - 12} more" if len(told) > 12 else "")


def aligned(path: Path, columns: tuple[Column, ...], dt_s: float) -> tuple[tuple[Column, ...], tuple[str, ...]]:
    """Return the channels on the samples at which most of them are taken, cut to the time that all share, and a note.

    A channel that starts whole samples later is moved by them. Any other is interpolated (windowed sinc of 64 samples,
    1e-4 below 0.85 of half the sample rate). Raises InputError, with the starts, where a channel states none, they
    share too little time, or samples are missing in a channel that has to be interpolated.
    """
    if not differ(columns):
        return columns, ()
    silent = [column.name for column in columns if column.start_s is None]
    if silent:
        raise InputError(
            f"{path}: the channels {', '.join(silent[:12])} state no start, the others do and differ "
            f"({shifts([c for c in columns if c.start_s is not None])}); export all channels with one start"
        )
    starts = np.array([column.start_s for column in columns], dtype=float)
    places = (starts - starts.min()) / dt_s  # in samples
    wanted = Counter(np.round(places % 1.0, 3) % 1.0).most_common(1)[0][0]
    whole = np.rint(places - wanted).astype(int)
    fraction = places - wanted - whole  # of a sample, by which a channel is late on the common samples
    fraction[np.abs(fraction) <= max(WHOLE, ROUNDING_S / dt_s)] = 0.0
    margins = np.where(fraction != 0.0, TAPS, 0)
    lengths = np.array([len(column.values) for column in columns])
    if not whole.any() and not fraction.any() and lengths.min() == lengths.max():
        return columns, ()
    first, end = int((whole + margins).max()), int((whole + lengths - margins).min())
    if end - first < 3:
        raise InputError(
            f"{path}: the channels start at different times ({shifts(columns)}) and share {max(end - first, 0)} "
            "samples; give channels that were measured together"
        )
    moved = []
    for column, at, late in zip(columns, whole, fraction, strict=True):
        if late and not np.isfinite(column.values).all():
            raise InputError(
                f"{path}: {column.name} starts between the samples of the others ({shifts(columns)}) and has missing "
                "samples, between which nothing can be interpolated; export all channels with one start"
            )
        values = (
            column.values[first - at : end - at] if not late else _between(column.values, late, first - at, end - at)
        )
        moved.append(replace(column, values=values, start_s=None))
    how = "interpolated between samples" if fraction.any() else "moved by whole samples"
    lost = int(lengths.max()) - (end - first)
    return tuple(moved), (
        f"the channels start at different times ({shifts(columns)}): {how}, {lost} samples at the ends are not shared",
    )


def _between(values: Array, late: float, first: int, end: int) -> Array:
    """Return a channel (n,) whose samples are `late` samples after the common ones, at those from `first` to `end`."""
    taps = np.arange(-TAPS, TAPS + 1)
    window = np.i0(BETA * np.sqrt(np.clip(1.0 - ((taps + late) / (TAPS + 1)) ** 2, 0.0, 1.0))) / np.i0(BETA)
    weights = np.sinc(taps + late) * window
    # the value at sample i is the sum over k of values[i + k] sinc(k + late)
    return np.convolve(values, (weights / weights.sum())[::-1], "full")[TAPS + first : TAPS + end]


def missing(samples: Array, names: Sequence[str], dt_s: float) -> tuple[str, ...]:
    """Return one sentence per channel with missing samples: number, share, longest run, time of the first.

    `samples` (c, n), NaN where missing; `names` (c,); `dt_s` in s.
    """
    sentences = []
    for name, values in zip(names, samples, strict=True):
        starts, lengths = _gaps(values)
        if len(starts):
            count, longest = int(lengths.sum()), int(lengths.max())
            which = "1 sample is missing" if count == 1 else f"{count} samples are missing"
            sentences.append(
                f"{name}: {which} ({100 * count / len(values):.3g} % of the record), the longest run {longest} "
                f"({longest * dt_s:.4g} s), the first at {starts[0] * dt_s:.6g} s"
            )
    return tuple(sentences)


def mend(samples: Array, names: Sequence[str]) -> tuple[Array, tuple[str, ...]]:
    """Bridge isolated gaps of at most 3 samples by the cubic through two samples on either side; leave all others NaN.

    `samples` (c, n), NaN where missing; `names` (c,). A channel is bridged where that concerns at most 0.1 % of its
    samples and 99 % of its power lies below 1/10 of half the sample rate, where the cubic errs by 1.6 % at most.
    Return the mended samples (c, n) and one sentence per channel that was bridged or could not be.
    """
    mended, notes = np.array(samples, dtype=float), []
    for name, values in zip(names, mended, strict=True):
        starts, lengths = _short_gaps(values)
        count = int(lengths.sum())
        if count == 0:
            continue
        reason = _objection(values, count)
        if reason:
            notes.append(f"{name}: {count} missing samples in short gaps are not bridged, because {reason}")
            continue
        for length in range(1, LONGEST_BRIDGED + 1):
            _bridge(values, starts[lengths == length], length)
        notes.append(f"{name}: {count} missing {'sample' if count == 1 else 'samples'} bridged by cubic interpolation")
    return mended, tuple(notes)


def _gaps(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return start and length of every run of missing samples."""
    edges = np.diff(np.concatenate([[False], np.isnan(values), [False]]).astype(np.int8))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


def _short_gaps(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return start and length of the gaps that are short and have the samples beside them that a cubic needs."""
    starts, lengths = _gaps(values)
    ends = starts + lengths
    before = starts - np.concatenate([[0], ends[:-1]]) if len(starts) else starts
    after = np.concatenate([starts[1:], [len(values)]]) - ends if len(starts) else starts
    wanted = (lengths <= LONGEST_BRIDGED) & (before >= _BESIDE) & (after >= _BESIDE)
    return starts[wanted], lengths[wanted]


def _objection(values: Array, count: int) -> str:
    """Return why a channel's short gaps cannot be bridged, "" if they can."""
    if count > LARGEST_SHARE * len(values):
        return f"they are more than {100.0 * LARGEST_SHARE:.1f} % of the record"
    above = _power_above(values)
    if above > POWER_ABOVE:
        return f"{100.0 * above:.0f} % of the channel's power lies above {BAND:g} of half the sample rate"
    return ""


def _power_above(values: Array) -> float:
    """Return the share of a channel's power above BAND of half the sample rate, gaps filled by straight lines."""
    import scipy.fft

    known = np.flatnonzero(~np.isnan(values))
    filled = np.interp(np.arange(len(values)), known, values[known])
    window = np.hanning(len(filled))
    power = np.abs(scipy.fft.rfft((filled - filled.mean()) * window)) ** 2
    total = float(power.sum())
    return float(power[int(BAND * len(power)) :].sum()) / total if total > 0.0 else 0.0


def _bridge(values: Array, starts: NDArray[np.intp], length: int) -> None:
    """Fill gaps of one length in place with the cubic (Lagrange) through the two samples on either side."""
    nodes = np.array([-2, -1, length, length + 1])
    inside = np.arange(length)
    others = [np.delete(nodes, k) for k in range(4)]
    weights = np.array([[np.prod((x - o) / (n - o)) for n, o in zip(nodes, others, strict=True)] for x in inside])
    values[starts[:, None] + inside] = values[starts[:, None] + nodes] @ weights.T


_RATES |= {"samplefrequency", "samplingfrequency", "samplingfrequencyhz"}
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
    dt_s = simplest(step * factor, max(uncertainty, 1e-11))
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


def simplest(dt_s: float, tolerance: float) -> float:
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
