"""The zero-phase high pass above which errors are evaluated, as AC-coupled accelerometers see no slow motion.

The high pass is a 2nd-order Butterworth, forward and backward: 1 / (1 + (f_h / f)^4), no phase. What it removes is what
the low pass of the same order and corner leaves, so that is found at a low rate, from means over blocks, and taken off.
A parabola is removed first, so that the ends of a record do not ring, and the rest is continued evenly beyond them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.numerics.compiled import entry, part
from rths_cli.numerics.filters import LANES, butterworth, filtered_both_ways
from rths_cli.numerics.lti import Array

SLOW_ORDER = 2
BLOCKS_PER_PERIOD = 256  # of the corner: blocks are short beside the slowest motion that stays
CONTINUED_PERIODS = 3.0  # of the corner, beyond each end of a record
PARABOLA = 3  # coefficients


def high_passed(series: ArrayLike, corner_hz: float, dt_s: float) -> Array:
    """Return `series` (..., n) without what is slower than `corner_hz`, in its unit; a corner of 0 leaves it as it is.

    2nd-order Butterworth high pass, forward and backward, after the best parabola is removed. A NaN makes its whole
    series NaN.
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
    """Do in place to series four beside each other (n_tiles, n + 2 padding, 4) what `high_passed` does."""
    samples = tiles.shape[1] - 2 * padding
    count = max(round(samples * dt_s * corner_hz * BLOCKS_PER_PERIOD), 1)
    if count >= samples:
        count = samples
    means = np.zeros((len(tiles), count, LANES))
    _means(tiles, padding, means)
    rows = means.transpose(0, 2, 1).reshape(-1, count)
    slow = _slow(rows, corner_hz, samples * dt_s / count).reshape(len(tiles), LANES, count)
    _take_off(tiles, padding, np.ascontiguousarray(slow.transpose(0, 2, 1)))


def _slow(rows: Array, corner_hz: float, dt_s: float) -> Array:
    """Return what is slower than a corner of series (m, n) of block means."""
    basis = _parabolas(rows.shape[1])
    trend = (rows @ basis.T) @ basis
    more = min(round(CONTINUED_PERIODS / (corner_hz * dt_s)), rows.shape[1])
    continued = np.pad(rows - trend, ((0, 0), (more, more)), "symmetric")
    low = filtered_both_ways(butterworth(SLOW_ORDER, corner_hz, 1.0 / dt_s), continued, 0)
    return np.asarray(trend + low[:, more : more + rows.shape[1]])


@lru_cache(maxsize=4)
def _parabolas(count: int) -> Array:
    """Return orthonormal polynomials (3 or fewer, n) that span constant, line and parabola."""
    powers = np.vander(np.linspace(-1.0, 1.0, count), min(PARABOLA, count), increasing=True)
    basis = np.ascontiguousarray(np.linalg.qr(powers)[0].T)
    basis.flags.writeable = False
    return basis


@entry
def _means(tiles: Array, padding: int, means: Array) -> None:
    """Write the means over equal parts of the series in tiles into `means` (n_tiles, m, 4)."""
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
    """Take `slow` (n_tiles, m, 4), the values at the middles of equal parts, off the series in tiles, straight lines
    between them."""
    samples, count = tiles.shape[1] - 2 * padding, slow.shape[1]
    length = samples / count
    for r in range(tiles.shape[0]):
        stop, last = 0, max(count - 1, 1)
        for i in range(1, last + 1):  # from the middle of part i - 1 to that of part i; the first and last go on
            start, stop = stop, int((i + 0.5) * length) if i < last else samples
            first, second = slow[r, i - 1], slow[r, min(i, count - 1)]
            _take_line(tiles[r], first, second, padding, start, stop, (i - 0.5) * length, length)


@part
def _take_line(
    tile: Array, first: Array, last: Array, padding: int, start: int, stop: int, zero: float, length: float
) -> None:
    """Take the line from `first` (4,) at `zero` to `last` (4,) a `length` later off the samples `start` to `stop`."""
    a0, a1, a2, a3 = first[0], first[1], first[2], first[3]
    d0, d1, d2, d3 = last[0] - a0, last[1] - a1, last[2] - a2, last[3] - a3
    for k in range(start, stop):
        share = (k + 0.5 - zero) / length
        tile[padding + k, 0] -= a0 + share * d0
        tile[padding + k, 1] -= a1 + share * d1
        tile[padding + k, 2] -= a2 + share * d2
        tile[padding + k, 3] -= a3 + share * d3
