"""Errors of a run: zero-phase high pass, test band, RMS, peak and fitted delay.

Time is the last axis of every array.

A series that is not finite, for example because it was cut (NaN from some sample on), has no errors: all its values
are NaN, and `diverged` is true.

The high pass is a 2nd-order Butterworth, forward and backward: gain 1 / (1 + (f_h / f)^4), no phase. It removes the
motion that the low pass of the same order and corner passes. This slow motion is computed at a low rate, from means
over blocks, and subtracted. A parabola is removed first, so that the filter does not ring at the ends of a record, and
the rest is continued by even reflection beyond them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rths_cli.errors import InputError
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.numerics.compiled import borrowed, entry, part
from rths_cli.numerics.filters import LANES, empty_tiles, filter_tiles_both_ways, low_pass
from rths_cli.numerics.lti import Array, ComplexArray

SLOW_ORDER = 2  # of the Butterworth filter, once
BLOCKS_PER_PERIOD = 256  # blocks per period of the corner frequency, the slowest motion that is kept
CONTINUED_PERIODS = 3.0  # periods of the corner frequency by which each end of a record is continued
PARABOLA = 3  # coefficients of the parabola

BAND_ORDER = 4  # of the test band's low pass, once
_SECTIONS = BAND_ORDER // 2  # of second order, of which it is made
_TAPERED = 0.1  # fraction of the record that the delay fit tapers, half of it at each end
_MOST_NEWTON_STEPS = 20
SUMMED_AT_ONCE = 256  # samples of a partial sum of squares


def high_passed(series: ArrayLike, corner_hz: float, dt_s: float) -> Array:
    """Return `series` (..., n) without motion slower than `corner_hz`, in its unit; unchanged for a corner of 0.

    The best parabola is subtracted, then a 2nd-order Butterworth high pass is applied forward and backward. A NaN makes
    its whole series NaN.
    """
    values = np.asarray(series, dtype=float)
    if corner_hz <= 0.0:
        return values
    rows = np.ascontiguousarray(values.reshape(-1, values.shape[-1]))
    tiles = np.zeros((-(-len(rows) // LANES), rows.shape[1], LANES))
    places = [divmod(row, LANES) for row in range(len(rows))]
    for row, (tile, place) in zip(rows, places, strict=True):
        tiles[tile, :, place] = row
    take_off_slow_motion(tiles, 0, corner_hz, dt_s)
    return np.array([tiles[tile, :, place] for tile, place in places]).reshape(values.shape)


def take_off_slow_motion(tiles: Array, padding: int, corner_hz: float, dt_s: float) -> None:
    """Apply `high_passed` in place to series in tiles (n_tiles, n + 2 padding, 4), four series per tile."""
    samples = tiles.shape[1] - 2 * padding
    count = max(round(samples * dt_s * corner_hz * BLOCKS_PER_PERIOD), 1)
    if count >= samples:
        count = samples
    means = np.zeros((len(tiles), count, LANES))
    _means(tiles, padding, means)
    _take_off(tiles, padding, _slow(means, corner_hz, samples * dt_s / count))


def _slow(means: Array, corner_hz: float, dt_s: float) -> Array:
    """Return the slow motion of series of block means, `dt_s` apart, both in tiles (n_tiles, n, 4): parabola and
    low-passed rest."""
    count = means.shape[1]
    basis = _parabolas(count)
    trend = basis.T @ (basis @ means)
    more = min(round(CONTINUED_PERIODS / (corner_hz * dt_s)), count)
    continued = np.pad(means - trend, ((0, 0), (more, more), (0, 0)), "symmetric")
    filter_tiles_both_ways(low_pass(SLOW_ORDER, corner_hz, dt_s), continued, 0)
    return np.ascontiguousarray(trend + continued[:, more : more + count])


@lru_cache(maxsize=4)
def _parabolas(count: int) -> Array:
    """Return orthonormal polynomials (3 or `count`, count) that span constant, line and parabola."""
    powers = np.vander(np.linspace(-1.0, 1.0, count), min(PARABOLA, count), increasing=True)
    basis = np.ascontiguousarray(np.linalg.qr(powers)[0].T)
    basis.flags.writeable = False
    return basis


@entry
def _means(tiles: Array, padding: int, means: Array) -> None:
    """Write the means over m equal parts of the series in tiles into `means` (n_tiles, m, 4)."""
    tiles, means = borrowed((tiles, means))
    samples, count = tiles.shape[1] - 2 * padding, means.shape[1]
    for r in range(tiles.shape[0]):
        for i in range(count):
            start, stop = i * samples // count, (i + 1) * samples // count
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            for k in range(padding + start, padding + stop):
                s0 += tiles[r, k, 0]
                s1 += tiles[r, k, 1]
                s2 += tiles[r, k, 2]
                s3 += tiles[r, k, 3]
            share = 1.0 / (stop - start)
            means[r, i, 0] = share * s0
            means[r, i, 1] = share * s1
            means[r, i, 2] = share * s2
            means[r, i, 3] = share * s3


@entry
def _take_off(tiles: Array, padding: int, slow: Array) -> None:
    """Subtract a slow motion from the series in tiles, in place.

    `slow` (n_tiles, m, 4): its values at the centres of m equal parts, interpolated and at the ends extrapolated by
    straight lines.
    """
    tiles, slow = borrowed((tiles, slow))
    samples, count = tiles.shape[1] - 2 * padding, slow.shape[1]
    length = samples / count
    for r in range(tiles.shape[0]):
        stop, last = 0, max(count - 1, 1)
        for i in range(1, last + 1):  # from the centre of part i - 1 to that of part i; ends extrapolated
            start, stop = stop, int((i + 0.5) * length) if i < last else samples
            first, second = slow[r, i - 1], slow[r, min(i, count - 1)]
            _take_line(tiles[r], first, second, padding, start, stop, (i - 0.5) * length, length)


@part
def _take_line(
    tile: Array, first: Array, last: Array, padding: int, start: int, stop: int, zero: float, length: float
) -> None:
    """Subtract a straight line from the samples `start` to `stop` of a tile (n + 2 padding, 4), in place.

    It goes from `first` (4,) at the time `zero` to `last` (4,) a time `length` later, both in samples.
    """
    a0, a1, a2, a3 = first[0], first[1], first[2], first[3]
    d0, d1, d2, d3 = last[0] - a0, last[1] - a1, last[2] - a2, last[3] - a3
    for k in range(start, stop):
        share = (k + 0.5 - zero) / length
        tile[padding + k, 0] -= a0 + share * d0
        tile[padding + k, 1] -= a1 + share * d1
        tile[padding + k, 2] -= a2 + share * d2
        tile[padding + k, 3] -= a3 + share * d3


@dataclass(frozen=True)
class ErrorFigures:
    """Errors of series (..., n) against their references, each of shape (...), in the unit of the series."""

    rms: Array  # in the test band
    maximum: Array  # largest absolute value in the test band
    rms_full: Array  # in full band
    maximum_full: Array  # largest absolute value in full band
    diverged: NDArray[np.bool_]  # whether series or reference is not finite

    def of(self, row: int) -> ErrorFigures:
        """Return the errors of one of several series."""
        return ErrorFigures(*(getattr(self, field.name)[row] for field in fields(self)))


def test_band(series: ArrayLike, dt_s: float, band_hz: float = TEST_BAND_HZ) -> Array:
    """Filter `series` (..., n) with a 4th-order Butterworth low pass of corner `band_hz`, forward and backward.

    Returns (..., n) in the same unit. The ends are extended by odd reflection over 15 samples, the default of scipy's
    sosfiltfilt, with which a metric can be repeated in one line; over n - 1 if the record is shorter. A NaN makes its
    whole series NaN. Raises InputError if half the sample rate is not above the corner.
    """
    from scipy.signal import sosfiltfilt

    values = np.asarray(series, dtype=float)
    sections = _band(dt_s, band_hz)
    return np.asarray(sosfiltfilt(sections, values, padlen=_padding(values.shape[-1])))


def _band(dt_s: float, band_hz: float) -> Array:
    """Return the sections (n_sections, 6) of the test band."""
    if not 0 < dt_s < 0.5 / band_hz:
        raise InputError(
            f"dt_s is {dt_s:g} s, but the {band_hz:g} Hz test band needs one above 0"
            f" and below {0.5 / band_hz:.4f} s: sample faster"
        )
    return low_pass(BAND_ORDER, band_hz, dt_s)


def _padding(samples: int) -> int:
    """Return the number of samples that extend each end of a series."""
    return min(3 * (2 * _SECTIONS + 1), samples - 1)


def rms(series: ArrayLike) -> Array:
    """Return sqrt(mean(e^2)) of `series` (..., n) over all samples, shape (...), in the unit of the series."""
    return np.sqrt(np.mean(np.square(np.asarray(series, dtype=float)), axis=-1))


def peak(series: ArrayLike) -> Array:
    """Return the largest absolute value of `series` (..., n), shape (...), in the unit of the series."""
    return np.max(np.abs(np.asarray(series, dtype=float)), axis=-1)


def error_figures(
    reference: ArrayLike, value: ArrayLike, dt_s: float, high_pass_hz: float = 0.0, band_hz: float = TEST_BAND_HZ
) -> ErrorFigures:
    """Return the errors reference - value, both (..., n), in the test band (`band_hz`) and in full band.

    Nothing is shifted, so delay counts as error. Motion slower than `high_pass_hz` is first removed from the
    difference, as by `high_passed`; with 0 it is kept, so an offset counts as error. Raises InputError if the shapes
    differ or the series are empty.
    """
    if np.shape(reference) != np.shape(value) or np.size(value) == 0:
        raise InputError(
            f"value has shape {np.shape(value)}, but the reference has {np.shape(reference)}:"
            " compare series of the same storeys and samples"
        )
    shape = np.shape(reference)
    rows = [np.asarray(given, dtype=float).reshape(-1, shape[-1]) for given in (reference, value)]
    found = figures_of_pairs(list(zip(rows[0], rows[1], strict=True)), dt_s, high_pass_hz=high_pass_hz, band_hz=band_hz)
    figures = (found.rms, found.maximum, found.rms_full, found.maximum_full)
    deviation, largest, deviation_full, largest_full = (figure.reshape(shape[:-1])[()] for figure in figures)
    return ErrorFigures(deviation, largest, deviation_full, largest_full, found.diverged.reshape(shape[:-1])[()])


def figures_of_pairs(
    pairs: Sequence[tuple[Array, Array]],
    dt_s: float,
    room: Array | None = None,
    high_pass_hz: float = 0.0,
    band_hz: float = TEST_BAND_HZ,
) -> ErrorFigures:
    """Return the errors (m,) of m pairs (reference, value), both (n,), as `error_figures` does.

    `room`: memory from `room_for_pairs`, which is overwritten; None: new memory.
    """
    samples = len(pairs[0][0])
    sections, padding = _band(dt_s, band_hz), _padding(samples)
    tiles = room_for_pairs(len(pairs), samples) if room is None else room
    for r, tile in enumerate(tiles):
        four = [pairs[min(LANES * r + j, len(pairs) - 1)] for j in range(LANES)]  # unused places repeat the last pair
        _subtract(tile, padding, *(np.ascontiguousarray(series) for pair in four for series in pair))
    if high_pass_hz > 0.0:
        take_off_slow_motion(tiles, padding, high_pass_hz, dt_s)
    squares, peaks, nothing = _sizes(tiles, padding, len(pairs))
    diverged = np.isnan(nothing)
    filter_tiles_both_ways(sections, tiles, padding)
    banded_squares, banded_peaks, _ = _sizes(tiles, padding, len(pairs))
    sizes = (np.sqrt(banded_squares / samples), banded_peaks, np.sqrt(squares / samples), peaks)
    in_band, largest_in_band, full, largest = (np.where(diverged, np.nan, size) for size in sizes)
    return ErrorFigures(in_band, largest_in_band, full, largest, diverged)


def room_for_pairs(pairs: int, samples: int) -> Array:
    """Return memory (n_tiles, samples + 2 padding, 4) for `figures_of_pairs` with that number of pairs and samples."""
    return empty_tiles(pairs, samples, _padding(samples))


def _sizes(tiles: Array, padding: int, series: int) -> tuple[Array, Array, Array]:
    """Return sum of squares and largest absolute value (m,) of the m series in tiles, and a third array (m,).

    The third is NaN for a series that is not finite, else 0.
    """
    found = np.zeros((len(tiles), 3, LANES))
    _measure(tiles, padding, found)
    squares, peaks, nothing = found.transpose(1, 0, 2).reshape(3, -1)[:, :series]
    return squares, peaks, nothing


@entry
def _subtract(
    tile: Array, padding: int, a: Array, b: Array, c: Array, d: Array, e: Array, f: Array, g: Array, h: Array
) -> None:
    """Write a - b, c - d, e - f and g - h, each (n,), into the four columns of `tile` (n + 2 padding, 4)."""
    tile, a, b, c, d, e, f, g, h = borrowed((tile, a, b, c, d, e, f, g, h))
    for k in range(a.size):
        tile[padding + k, 0] = a[k] - b[k]
        tile[padding + k, 1] = c[k] - d[k]
        tile[padding + k, 2] = e[k] - f[k]
        tile[padding + k, 3] = g[k] - h[k]


@part
def _grown(value: float, squares: float, peak: float, nothing: float) -> tuple[float, float, float]:
    """Return sum of squares, peak, and sum of 0 x (NaN after a value that is not finite) with one more value x."""
    return squares + value * value, max(peak, abs(value)), nothing + 0.0 * value


@part
def _measure_block(tile: Array, start: int, stop: int, found: Array) -> None:
    """Add samples `start` to `stop` of a tile (n, 4) to `found` (3, 4): sums of squares, peaks, sums of 0 x.

    The four series are written out, so that one instruction processes all of them.
    """
    q0, q1, q2, q3 = 0.0, 0.0, 0.0, 0.0
    p0, p1, p2, p3 = found[1, 0], found[1, 1], found[1, 2], found[1, 3]
    z0, z1, z2, z3 = 0.0, 0.0, 0.0, 0.0
    for k in range(start, stop):
        q0, p0, z0 = _grown(tile[k, 0], q0, p0, z0)
        q1, p1, z1 = _grown(tile[k, 1], q1, p1, z1)
        q2, p2, z2 = _grown(tile[k, 2], q2, p2, z2)
        q3, p3, z3 = _grown(tile[k, 3], q3, p3, z3)
    found[0, 0], found[0, 1], found[0, 2], found[0, 3] = (
        found[0, 0] + q0, found[0, 1] + q1, found[0, 2] + q2, found[0, 3] + q3,
    )  # fmt: skip
    found[1, 0], found[1, 1], found[1, 2], found[1, 3] = p0, p1, p2, p3
    found[2, 0], found[2, 1], found[2, 2], found[2, 3] = (
        found[2, 0] + z0, found[2, 1] + z1, found[2, 2] + z2, found[2, 3] + z3,
    )  # fmt: skip


@entry
def _measure(tiles: Array, padding: int, found: Array) -> None:
    """Write sums of squares, peaks and sums of 0 x into `found` (n_tiles, 3, 4).

    Partial sums over blocks of SUMMED_AT_ONCE samples keep the rounding error small.
    """
    tiles, found = borrowed((tiles, found))
    end = tiles.shape[1] - padding
    for r in range(tiles.shape[0]):
        for start in range(padding, end, SUMMED_AT_ONCE):
            _measure_block(tiles[r], start, min(start + SUMMED_AT_ONCE, end), found[r])


def check_pair(
    reference: ArrayLike, value: ArrayLike, names: tuple[str, str] = ("desired", "measured")
) -> tuple[Array, Array]:
    """Return both series as floats (n,); raises InputError, which states their `names`, if their lengths differ."""
    x, y = np.asarray(reference, dtype=float), np.asarray(value, dtype=float)
    if x.ndim != 1 or x.shape != y.shape:
        raise InputError(
            f"{names[1]} has shape {y.shape}, but {names[0]} has {x.shape}: compare two series of equal length"
        )
    return x, y


def fitted_delay_s(desired: ArrayLike, measured: ArrayLike, dt_s: float) -> float:
    """Return the delay in s of `measured` (n,) against `desired` (n,): positive is late, negative early.

    At this delay the cross-correlation is largest. It is refined below a sample by Newton steps on the cross-spectrum,
    which find the phase slope weighted by power. Means are removed and the ends tapered. The delay is only reported: no
    series is shifted by it. NaN if a series is constant or not finite. Raises InputError if the lengths differ.
    """
    return fitted_delays_s(desired, (measured,), dt_s)[0]


def fitted_delays_s(desired: ArrayLike, measured: Sequence[ArrayLike], dt_s: float) -> list[float]:
    """Return `fitted_delay_s` of several series (n,) against one; that one is transformed only once."""
    from scipy.fft import next_fast_len

    pairs = [check_pair(desired, each) for each in measured]
    x = pairs[0][0]
    if not _moves(x):
        return [float("nan")] * len(pairs)
    taper, padded = _taper(len(x)), next_fast_len(2 * len(x), real=True)
    lines_x = np.fft.rfft((x - x.mean()) * taper, padded).conj()
    delays = []
    for _, y in pairs:
        cross = lines_x * np.fft.rfft((y - y.mean()) * taper, padded) if _moves(y) else None
        delays.append(float("nan") if cross is None else _lag(cross, padded) * dt_s)
    return delays


@lru_cache(maxsize=2)
def _taper(n: int) -> Array:
    """Return the taper (n,) of the delay fit."""
    from scipy.signal.windows import tukey

    return np.asarray(tukey(n, _TAPERED))


def _moves(series: Array) -> bool:
    """Return whether a series (n,) is finite and not constant."""
    return bool(np.isfinite(series).all() and np.ptp(series) > 0)


def _lag(cross: ComplexArray, padded: int) -> float:
    """Return the lag in samples at which the correlation is largest, from its cross-spectrum (m,).

    `padded`: length of the transformed series.
    """
    lag = int(np.argmax(np.fft.irfft(cross, padded)))
    return _refined_lag(cross, 2 * np.pi / padded, float(lag if lag <= padded / 2 else lag - padded))


def _refined_lag(cross: ComplexArray, angle_rad: float, lag: float) -> float:
    """Return the lag in samples, within one sample of `lag`, that maximises Re sum_k cross_k exp(j k angle lag).

    With k = wide i + l the exponential is a product of two, so that few exponentials are needed.
    """
    wide = math.isqrt(len(cross)) + 1
    angle = angle_rad * np.arange(wide * wide)
    lines = np.zeros((2, wide, wide), dtype=complex)
    lines.reshape(2, -1)[:, : len(cross)] = angle[: len(cross)] * cross
    lines[1] *= angle.reshape(wide, wide)
    refined = lag
    for _ in range(_MOST_NEWTON_STEPS):
        slope, bend = lines @ np.exp(1j * angle[:wide] * refined) @ np.exp(1j * angle[::wide] * refined)
        step = -float(slope.imag) / float(bend.real)
        refined = float(np.clip(refined + step, lag - 1, lag + 1))
        if abs(step) < 1e-9:
            break
    return refined
