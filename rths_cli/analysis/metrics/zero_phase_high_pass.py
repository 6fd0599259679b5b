"""The zero-phase high pass for the evaluation of errors, as AC-coupled accelerometers do not measure slow motion.

The high pass is a 2nd-order Butterworth, forward and backward: gain 1 / (1 + (f_h / f)^4), no phase. It removes the
motion that the low pass of the same order and corner passes. This slow motion is computed at a low rate, from means
over blocks, and subtracted. A parabola is removed first, so that the filter does not ring at the ends of a record, and
the rest is continued by even reflection beyond them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.numerics.compiled import borrowed, entry, part
from rths_cli.numerics.filters import LANES, filter_tiles_both_ways, low_pass
from rths_cli.numerics.lti import Array

SLOW_ORDER = 2  # of the Butterworth filter, once
BLOCKS_PER_PERIOD = 256  # blocks per period of the corner frequency, the slowest motion that is kept
CONTINUED_PERIODS = 3.0  # periods of the corner frequency by which each end of a record is continued
PARABOLA = 3  # coefficients of the parabola


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
