"""Where the samples of a recording lie on the clock of a record: offset and rate of the recorder's clock, and what is
lost between two of its samples.

Sample k of the recording lies at sample `offset + step * k` of the record. A coarse search (normalised
cross-correlation of block means over all offsets, and over rates up to 10 % off) finds the neighbourhood, also of a
motion of the wrong sign. Windows of 3 s are then placed one by one: places on a straight line are one even clock, a
jump of the line is a lost block, anything else is no even clock. The line is refined by Gauss-Newton steps on all
samples together; what its parameters are uncertain by is the jackknife over ten parts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline

from rths_cli.numerics.lti import Array

MOST_OFF = 0.1  # of the stated rate, up to which another one is searched for
BLOCK_S = 0.02  # over which the coarse search averages
END_S = 0.015  # by which two rates of the coarse search are apart at the ends of the recording
LEAST_SEEN = 0.3  # of the record's energy, that a recording must hold to be recognised
ENOUGH = 0.98  # correlation at the stated rate, from which no other rate is searched for
WINDOW_S, HOP_S = 3.0, 1.5
SEARCH_S = 5.0  # by which a window may be elsewhere than the coarse search says: the longest lost block that is told
LEAST_ENERGY = 1e-3  # of the loudest window's, of a window that tells the time
LEAST_PLACED = 0.5  # of the windows that tell the time: with fewer, another motion is recorded
ALIKE = 0.9  # correlation of a window that is believed
SURE = 1e-3  # samples: no window tells its place better
JUMP = 0.5  # samples between two windows, from which a block is lost
PARTS = 10  # of the jackknife
STEPS = 30  # of Gauss and Newton, at most
WHOLE = 0.02  # samples: a recording that is so near to whole samples everywhere is not interpolated
TAPS, BETA = 32, 9.0  # of the interpolation: samples on either side, Kaiser window over them


class LostBlock(NamedTuple):
    """Samples of the record that a recording without a time of its own leaves out (negative: repeats)."""

    before: int  # sample of the recording after which they are missing
    samples: int
    at: int  # the same place on the record


@dataclass(frozen=True)
class Alignment:
    """A recording on the clock of a record; errors are standard uncertainties.

    `correlation` is what the record explains of the recorded motion, signed; `gain` and `mean` are those of the
    recorded motion, gain * record + mean; `residual` is the RMS of what that leaves, over the recorded RMS. `worst`
    is the largest distance of a window from the line, in samples of the record, beyond twice its own uncertainty.
    """

    offset: float
    step: float
    offset_error: float
    middle_error: float  # in the middle of the recording
    step_error: float
    gain: float
    mean: float
    correlation: float
    residual: float
    worst: float
    lost: tuple[LostBlock, ...] = ()
    as_stated: bool = False  # whether offset and step are whole and stated ones, which the motion does not contradict

    def error_at_ends(self, samples: int) -> float:
        """Return the largest standard uncertainty of the place of one of `samples`, in samples of the record."""
        if self.as_stated:
            return 0.0
        return max(self.offset_error, float(np.hypot(self.middle_error, self.step_error * 0.5 * samples)))

    def whole(self, samples: int) -> int | None:
        """Return the whole samples by which `samples` of a recording are moved, None where they lie between."""
        shift = round(self.offset)
        ends = np.array([0.0, float(samples - 1)])
        off = np.abs(self.offset + (self.step - 1.0) * ends - shift)
        return shift if off.max() <= WHOLE else None

    def places(self, samples: int) -> Array:
        """Return where the samples (n,) of the record lie in the recording, in its samples."""
        return np.asarray((np.arange(samples) - self.offset) / self.step)


def align(recorded: Array, record: Array, stated: float, dt_s: float) -> Alignment | None:
    """Return where a recorded motion (k,) lies on a record (n,), NaN where samples are missing; None if it is nowhere.

    `stated`: samples of the record from one recorded sample to the next, as the file has it; `dt_s`: interval of the
    record in s.
    """
    known = np.isfinite(recorded)
    if known.sum() < 3 or not np.ptp(recorded[known]) or not np.ptp(record):
        return None
    filled = np.where(known, recorded - recorded[known].mean(), 0.0)
    coarse = _coarse(filled, record, stated, dt_s)
    if coarse is None:
        return None
    offset, step, correlation = coarse
    windows = _windows(recorded, record, offset, step, dt_s)
    if len(windows) < 2:
        return Alignment(offset, step, np.inf, np.inf, np.inf, np.nan, np.nan, correlation, np.inf, np.inf)
    (offset, step), lost = _line(windows, recorded, record)
    if lost:
        return Alignment(offset, step, np.inf, np.inf, np.inf, np.nan, np.nan, correlation, np.inf, np.inf, lost)
    return _if_as_stated(_refined(recorded, record, (offset, step), windows), stated, recorded.size)


def _coarse(filled: Array, record: Array, stated: float, dt_s: float) -> tuple[float, float, float] | None:
    """Return offset, step and signed correlation of the best rate, None where no motion is alike anywhere."""
    block = max(round(BLOCK_S / dt_s), 1)
    wanted = _means(record, float(block))
    length_s = min(filled.size * stated, record.size) * dt_s
    spread = np.arange(1, int(MOST_OFF * length_s / (2.0 * END_S)) + 1) * 2.0 * END_S / length_s
    best: tuple[float, float, float] | None = None
    for off in [0.0, *np.column_stack([spread, -spread]).reshape(-1)]:
        step = stated * (1.0 + off)
        found = _best_lag(_means(filled, block / step), wanted)
        if found is not None and (best is None or abs(found[1]) > abs(best[2])):
            best = found[0] * block, step, found[1]
        if off == 0.0 and best is not None and abs(best[2]) > ENOUGH:
            return best
    return best


def _means(series: Array, block: float) -> Array:
    """Return the means of a series over blocks of `block` samples, which need not be whole."""
    sums = np.concatenate([[0.0], np.cumsum(series)])
    edges = np.arange(int(series.size / block) + 1) * block
    return np.diff(np.interp(edges, np.arange(sums.size), sums)) / block


def _best_lag(recorded: Array, record: Array) -> tuple[int, float] | None:
    """Return the lag (block of the record at which the recording begins) of the largest correlation, and that."""
    size = next_fast_len(recorded.size + record.size, real=True)
    motion, seen = rfft(recorded, size), rfft(np.ones(recorded.size), size)
    cross = irfft(np.conj(motion) * rfft(record, size), size)
    of_record = irfft(np.conj(seen) * rfft(record**2, size), size)
    of_recorded = irfft(np.conj(rfft(recorded**2, size)) * rfft(np.ones(record.size), size), size)
    total = float(np.sum(record**2))
    valid = (of_record > LEAST_SEEN * total) & (of_recorded > 0.0)
    if not valid.any():
        return None
    score = np.where(valid, cross / np.sqrt(np.where(valid, of_record * of_recorded, 1.0)), 0.0)
    lag = int(np.argmax(np.abs(score)))
    return (lag if lag < record.size else lag - size), float(score[lag])


class _Window(NamedTuple):
    """A part of the recording and where it lies."""

    middle: float  # sample of the recording
    place: float  # sample of the record at which its middle lies
    error: float  # standard uncertainty of it, in samples


def _windows(recorded: Array, record: Array, offset: float, step: float, dt_s: float) -> list[_Window]:
    """Return the parts of a recording that tell their place; none if most of them are not in the record."""
    length, hop = (max(round(seconds / (dt_s * step)), 8) for seconds in (WINDOW_S, HOP_S))
    length = min(length, recorded.size // 2)
    reach = round(SEARCH_S / dt_s)
    curve = CubicSpline(np.arange(record.size), record)
    padded = np.concatenate([np.zeros(reach), record, np.zeros(reach)])
    found: list[tuple[_Window | None, float]] = []
    for first in range(0, recorded.size - length + 1, max(min(hop, length), 1)):
        part = recorded[first : first + length]
        start = offset + step * first
        if np.isfinite(part).all() and -reach < start and start + step * length < record.size + reach:
            found.append((_placed(part, first, start, step, padded, reach, curve), float(np.var(part))))
    loudest = max((energy for _, energy in found), default=0.0)
    loud = [window for window, energy in found if energy >= LEAST_ENERGY * loudest]
    placed = [window for window in loud if window is not None]
    return placed if len(placed) >= LEAST_PLACED * len(loud) else []


def _placed(
    part: Array, first: int, start: float, step: float, padded: Array, reach: int, curve: CubicSpline
) -> _Window | None:
    """Return the place of a part of the recording that begins near `start` of the record, None where none is alike."""
    at = np.arange(part.size)
    low = max(int(np.floor(start)), -reach + 1)
    span = padded[max(low, 0) : min(low + int(step * part.size) + 2 * reach, padded.size)]  # from low - reach on
    even = np.interp(np.arange(int(step * part.size)) / step, at, part)  # on the record's clock
    even = even - even.mean()
    if span.size <= even.size or not even.any():
        return None
    size = next_fast_len(span.size + even.size, real=True)
    cross = irfft(np.conj(rfft(even, size)) * rfft(span, size), size)[: span.size - even.size + 1]
    sums, squares = (np.concatenate([[0.0], np.cumsum(row)]) for row in (span, span**2))
    energy = (squares[even.size :] - squares[: -even.size]) - (sums[even.size :] - sums[: -even.size]) ** 2 / even.size
    score = cross / np.sqrt(np.maximum(energy, 1e-12 * np.max(energy)) * np.sum(even**2))
    lag = int(np.argmax(np.abs(score)))
    if abs(score[lag]) < ALIKE:
        return None
    shift = float(max(low, 0) - reach + lag)
    inside = (shift + step * at >= 1.0) & (shift + step * at <= curve.x[-1] - 1.0)
    if inside.sum() < 0.5 * part.size:
        return None
    moved, error = _shifted(part[inside], shift + step * at[inside], curve)
    middle = 0.5 * float(at[inside][0] + at[inside][-1])
    return _Window(first + middle, shift + step * middle + moved, error)


def _shifted(part: Array, places: Array, curve: CubicSpline) -> tuple[float, float]:
    """Return by how much the middle of a part on the record is to be moved, and the uncertainty of that.

    The part may be stretched beside it, because its step is known roughly.
    """
    aside = np.linspace(-1.0, 1.0, part.size)
    moved = stretched = 0.0
    for _ in range(STEPS):
        at = places + moved + stretched * aside
        slope = curve(at, 1)
        rows = np.column_stack([curve(at), np.ones(part.size), slope, slope * aside])
        factors, *_ = np.linalg.lstsq(rows, part, rcond=None)
        gain = factors[0] or 1.0
        moved += float(np.clip(factors[2] / gain, -5.0, 5.0))
        stretched += float(np.clip(factors[3] / gain, -5.0, 5.0))
        if abs(factors[2] / gain) < 1e-7 and abs(factors[3] / gain) < 1e-7:
            break
    left = part - rows @ factors
    spread = float(np.linalg.pinv(rows.T @ rows)[2, 2]) * np.mean(left**2)
    return moved, float(np.sqrt(_related(left) * spread) / abs(gain))


def _related(left: Array) -> float:
    """Return the number of samples that tell as much as one of a residual (n,): by how much its sums exceed chance."""
    whole = float(np.sum(left**2))
    if not whole:
        return 1.0
    size = max(int(np.sqrt(left.size)), 1)
    sums = np.add.reduceat(left, np.arange(0, left.size, size))
    return float(max(np.sum(sums**2) / whole, 1.0))


def _line(windows: list[_Window], recorded: Array, record: Array) -> tuple[tuple[float, float], tuple[LostBlock, ...]]:
    """Return offset and step of the straight line through the places of the windows, and where it jumps."""
    middle, place, error = (np.array(column) for column in zip(*windows, strict=True))
    slopes = np.diff(place) / np.diff(middle)
    step = float(np.median(slopes))
    jump = np.diff(place) - step * np.diff(middle)
    limit = JUMP + 5.0 * np.hypot(error[1:], error[:-1])
    breaks = np.flatnonzero(np.abs(jump) > limit) + 1
    segments = [part for part in np.split(np.arange(len(windows)), breaks) if part.size > 1]
    if len(segments) < 2:
        kept = segments[0] if segments else np.arange(len(windows))
        step, offset = (float(one) for one in np.polyfit(middle[kept], place[kept], 1))
        return (offset, step), ()
    sure = 1.0 / (error**2 + SURE**2)  # a window across a jump lies anywhere, and its error says so
    centre = [float(np.average(middle[part], weights=sure[part])) for part in segments]
    mean = [float(np.average(place[part], weights=sure[part])) for part in segments]
    aside = [middle[part] - one for part, one in zip(segments, centre, strict=True)]
    risen = [place[part] - one for part, one in zip(segments, mean, strict=True)]
    weighted = [sure[part] * one for part, one in zip(segments, aside, strict=True)]
    step = sum(float(w @ y) for w, y in zip(weighted, risen, strict=True)) / sum(
        float(w @ x) for w, x in zip(weighted, aside, strict=True)
    )
    offsets = [y - step * x for y, x in zip(mean, centre, strict=True)]
    lost = []
    for (before, after), (one, other) in zip(pairwise(offsets), pairwise(segments), strict=True):
        k = _break(recorded, record, step, (before, after), (int(middle[one[-1]]), int(middle[other[0]])))
        lost.append(LostBlock(k, round(after - before), round(before + step * k)))
    return (offsets[0], step), tuple(one for one in lost if one.samples)


def _break(recorded: Array, record: Array, step: float, offsets: tuple[float, float], within: tuple[int, int]) -> int:
    """Return the sample of the recording, within two, after which it lies at the second offset."""
    at = np.arange(within[0], within[1] + 1)
    every = np.arange(record.size)
    misfit = [(recorded[at] - np.interp(offset + step * at, every, record)) ** 2 for offset in offsets]
    first, second = (np.concatenate([[0.0], np.nancumsum(one)]) for one in misfit)
    return int(within[0] + np.argmin(first + second[-1] - second)) - 1


def _refined(recorded: Array, record: Array, start: tuple[float, float], windows: list[_Window]) -> Alignment:
    """Return the alignment that explains all samples best."""
    curve, (offset, step) = CubicSpline(np.arange(record.size), record), start
    k = np.flatnonzero(np.isfinite(recorded))
    k = k[(offset + step * k >= 0.0) & (offset + step * k <= record.size - 1)]
    centre, values = float(k.mean()), recorded[k]
    place = offset + step * centre
    for _ in range(STEPS):
        at = place + step * (k - centre)
        slope = curve(at, 1)
        rows = np.column_stack([curve(at), np.ones(k.size), slope, slope * (k - centre)])
        factors, *_ = np.linalg.lstsq(rows, values, rcond=None)
        moved, stretched = (float(one / factors[0]) for one in factors[2:])
        place, step = place + moved, step + stretched
        if abs(moved) < 1e-7 and abs(stretched) * k.size < 1e-7:
            break
    left, errors = values - rows[:, :2] @ factors[:2], _jackknife(rows, values) / abs(factors[0])
    off = [abs(one.place - place - step * (one.middle - centre)) - 2.0 * one.error for one in windows]
    return Alignment(
        offset=place - step * centre,
        step=step,
        offset_error=float(np.hypot(errors[2], errors[3] * centre)),
        middle_error=float(errors[2]),
        step_error=float(errors[3]),
        gain=float(factors[0]),
        mean=float(factors[1]),
        correlation=float(np.corrcoef(rows[:, 0], values)[0, 1]),
        residual=float(np.sqrt(np.mean(left**2)) / np.std(values)),
        worst=float(max(0.0, *off)),
    )


def _if_as_stated(found: Alignment, stated: float, samples: int) -> Alignment:
    """Return an alignment by whole samples of the stated rate where the motion is too noisy to tell it and says nothing
    against it."""
    ends = np.array([0.0, samples - 1.0])
    shift = round(found.offset)
    errors = np.hypot(found.middle_error, found.step_error * np.abs(ends - 0.5 * samples))
    off = np.abs(found.offset - shift + (found.step - 1.0) * ends)
    if stated != 1.0 or found.error_at_ends(samples) <= WHOLE or np.any(off > 2.0 * errors):
        return found
    return replace(found, offset=float(shift), step=1.0, as_stated=True)


def _jackknife(rows: Array, values: Array) -> Array:
    """Return the standard uncertainties of the factors of rows (n, f), each part of the record left out in turn."""
    parts = np.array_split(np.column_stack([rows, values]), PARTS)
    powers = np.array([part.T @ part for part in parts])
    left = powers.sum(axis=0) - powers
    size = np.sqrt(np.diag(powers.sum(axis=0)))
    left = left / size / size[:, None]
    found = [np.linalg.lstsq(one[:-1, :-1], one[:-1, -1], rcond=None)[0] for one in left]
    return np.asarray(np.sqrt((PARTS - 1) * np.var(found, axis=0)) * size[-1] / size[:-1])


def moved_to_record(series: Array, found: Alignment, samples: int) -> Array:
    """Return recorded series (c, k) at the samples (c, n) of the record, NaN where there is nothing.

    Where all samples lie on whole ones they are taken as they are, else interpolated (windowed sinc of 64 samples); up
    to one sample outside, the first or the last one stands.
    """
    count = series.shape[1]
    moved = np.full((len(series), samples), np.nan)
    shift = found.whole(count)
    if shift is not None:
        first, end = max(shift, 0), min(shift + count, samples)
        moved[:, first:end] = series[:, first - shift : end - shift]
        return moved
    places = found.places(samples)
    inside = np.flatnonzero((places > -1.0) & (places < count))
    edges = np.pad(series, ((0, 0), (TAPS + 1, TAPS + 1)), mode="edge")
    taps = np.arange(-TAPS + 1, TAPS + 1)
    for stretch in np.array_split(inside, max(inside.size // 4096, 1)):
        whole = np.floor(places[stretch]).astype(int)
        distance = taps - (places[stretch] - whole)[:, None]
        window = np.i0(BETA * np.sqrt(np.clip(1.0 - (distance / (TAPS + 1)) ** 2, 0.0, 1.0)))
        weights = np.sinc(distance) * window
        weights /= weights.sum(axis=1, keepdims=True)
        taken = edges[:, (whole + TAPS + 1)[:, None] + taps]
        moved[:, stretch] = np.einsum("cnt,nt->cn", taken, weights)
    return moved
