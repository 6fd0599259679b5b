"""Digital filters: recursions along time.

A filter is a cascade of second-order sections (n_sections, 6), each row b0, b1, b2, 1, a1, a2 of
y[k] = b0 x[k] + b1 x[k-1] + b2 x[k-2] - a1 y[k-1] - a2 y[k-2]. Time is the last axis of every series. The recursions
are compiled and take four series at once: one alone waits for its own last sum most of the time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.numerics.compiled import entry, part
from rths_cli.numerics.lti import Array

FORWARD, BACKWARD = 1, -1
LANES = 4  # series that are filtered at once
_Coefficients = tuple[float, float, float, float, float]
_Sample = tuple[float, float, float]


def filtered_both_ways(sections: Array, series: ArrayLike, padding: int) -> Array:
    """Filter `series` (..., n) forward and backward: the squared gain and no phase; returns (..., n) in its unit.

    The ends are extended by odd reflection over `padding` samples, and both passes start in the steady state of their
    first value. A NaN makes its whole series NaN. Raises ValueError unless 0 <= `padding` < n. Source: Gustafsson,
    IEEE Trans. Signal Process. 44 (1996) 988, for the problem; this is the usual answer, as scipy's sosfiltfilt has it.
    """
    values = np.asarray(series, dtype=float)
    n = values.shape[-1]
    if not 0 <= padding < n:
        raise ValueError(f"padding {padding} of a series of {n} samples: it must be at least 0 and below that")
    tiles = _filled(values, padding)
    filter_tiles_both_ways(sections, tiles, padding)
    return _series(tiles, values.shape, padding)


def empty_tiles(series: int, samples: int, padding: int) -> Array:
    """Return room for so many series four beside each other: (n_tiles, samples + 2 padding, 4), zero."""
    return np.zeros((-(-series // LANES), samples + 2 * padding, LANES))


def filter_tiles_both_ways(sections: Array, tiles: Array, padding: int) -> None:
    """Do in place what `filtered_both_ways` does; what stands in the padding at the ends is replaced."""
    if padding:
        end = tiles.shape[1] - padding
        tiles[:, :padding] = 2.0 * tiles[:, padding : padding + 1] - tiles[:, 2 * padding : padding : -1]
        tiles[:, end:] = 2.0 * tiles[:, end - 1 : end] - tiles[:, end - 2 : end - 2 - padding : -1]
    steady = _steady_states(sections)[:, None, :, None]
    _run(sections, np.ascontiguousarray(steady * tiles[:, :1]), tiles, FORWARD)
    _run(sections, np.ascontiguousarray(steady * tiles[:, -1:]), tiles, BACKWARD)


def _filled(values: Array, padding: int) -> Array:
    """Return series (..., n) in tiles, room for `padding` samples more at each end."""
    rows = np.ascontiguousarray(values.reshape(-1, values.shape[-1]))
    tiles = np.empty((-(-len(rows) // LANES), rows.shape[1] + 2 * padding, LANES))
    _spread(rows, padding, tiles)
    return tiles


def _series(tiles: Array, shape: tuple[int, ...], padding: int) -> Array:
    """Return the series of a shape (..., n) that stand in tiles, without the padding."""
    rows = np.empty((math.prod(shape[:-1]), shape[-1]))
    _collect(tiles, padding, rows)
    return rows.reshape(shape)


def _steady_states(sections: Array) -> Array:
    """Return the states (n_sections, 2) in which a cascade stays while its input is 1."""
    states, level = np.empty((len(sections), 2)), 1.0
    for state, (b0, b1, b2, _, a1, a2) in zip(states, sections, strict=True):
        first, second = b1 - a1 * b0, b2 - a2 * b0
        state[0] = (first + second) / (1.0 + a1 + a2)
        state[1] = (1.0 + a1) * state[0] - first
        state *= level
        level *= (b0 + b1 + b2) / (1.0 + a1 + a2)
    return states


def driven_modes(poles: ArrayLike, now: ArrayLike, before: ArrayLike, series: ArrayLike) -> Array:
    """Return z[k] = p z[k-1] + a u[k] + b u[k-1], z[0] = 0, for each complex mode: (2, m, n), real and imaginary part.

    `poles` p, `now` a, `before` b are complex (m,), `series` u is (n,).
    """
    from scipy.signal import lfilter

    numbers = np.array([poles, now, before], dtype=complex).reshape(3, -1)
    drive = np.asarray(series, dtype=float)
    modes = np.empty((2, numbers.shape[1], len(drive)))
    for r, (p, a, b) in enumerate(numbers.T):
        mode, _ = lfilter([a, b], [1.0, -p], drive, zi=[-a * drive[0]])
        modes[0, r], modes[1, r] = mode.real, mode.imag
    return modes


@part
def _sample(c: _Coefficients, x: float, u: float, v: float) -> _Sample:
    """Return output and states of a section (transposed direct form II) after the sample x."""
    y = c[0] * x + u
    return y, c[1] * x - c[3] * y + v, c[2] * x - c[4] * y


@entry
def _spread(rows: Array, padding: int, tiles: Array) -> None:
    """Write series (m, n) beside each other into tiles; idle places repeat the last series."""
    last = rows.shape[0] - 1
    for r in range(tiles.shape[0]):
        a, b = rows[min(LANES * r, last)], rows[min(LANES * r + 1, last)]
        c, d = rows[min(LANES * r + 2, last)], rows[min(LANES * r + 3, last)]
        for k in range(rows.shape[1]):
            tiles[r, padding + k, 0] = a[k]
            tiles[r, padding + k, 1] = b[k]
            tiles[r, padding + k, 2] = c[k]
            tiles[r, padding + k, 3] = d[k]


@entry
def _collect(tiles: Array, padding: int, rows: Array) -> None:
    """Write the series in tiles into rows (m, n)."""
    for m in range(rows.shape[0]):
        tile, place = tiles[m // LANES], m % LANES
        for k in range(rows.shape[1]):
            rows[m, k] = tile[padding + k, place]


@part
def _coefficients(sections: Array, s: int) -> _Coefficients:
    return sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 4], sections[s, 5]


@part
def _one(c: _Coefficients, states: Array, tile: Array, step: int) -> None:
    """Filter a tile (n, 4) in place by one section that starts in `states` (2, 4)."""
    u0, u1, u2, u3 = states[0, 0], states[0, 1], states[0, 2], states[0, 3]
    v0, v1, v2, v3 = states[1, 0], states[1, 1], states[1, 2], states[1, 3]
    k = 0 if step > 0 else tile.shape[0] - 1
    for _ in range(tile.shape[0]):
        y0, u0, v0 = _sample(c, tile[k, 0], u0, v0)
        y1, u1, v1 = _sample(c, tile[k, 1], u1, v1)
        y2, u2, v2 = _sample(c, tile[k, 2], u2, v2)
        y3, u3, v3 = _sample(c, tile[k, 3], u3, v3)
        tile[k, 0] = y0  # beside each other, so that all four are one instruction
        tile[k, 1] = y1
        tile[k, 2] = y2
        tile[k, 3] = y3
        k += step


@part
def _two(c: _Coefficients, d: _Coefficients, first: Array, second: Array, tile: Array, step: int) -> None:
    """Filter a tile (n, 4) in place by two sections: one works while the other waits for its own last sum."""
    u0, u1, u2, u3 = first[0, 0], first[0, 1], first[0, 2], first[0, 3]
    v0, v1, v2, v3 = first[1, 0], first[1, 1], first[1, 2], first[1, 3]
    p0, p1, p2, p3 = second[0, 0], second[0, 1], second[0, 2], second[0, 3]
    q0, q1, q2, q3 = second[1, 0], second[1, 1], second[1, 2], second[1, 3]
    k = 0 if step > 0 else tile.shape[0] - 1
    for _ in range(tile.shape[0]):
        y0, u0, v0 = _sample(c, tile[k, 0], u0, v0)
        y1, u1, v1 = _sample(c, tile[k, 1], u1, v1)
        y2, u2, v2 = _sample(c, tile[k, 2], u2, v2)
        y3, u3, v3 = _sample(c, tile[k, 3], u3, v3)
        y0, p0, q0 = _sample(d, y0, p0, q0)
        y1, p1, q1 = _sample(d, y1, p1, q1)
        y2, p2, q2 = _sample(d, y2, p2, q2)
        y3, p3, q3 = _sample(d, y3, p3, q3)
        tile[k, 0] = y0
        tile[k, 1] = y1
        tile[k, 2] = y2
        tile[k, 3] = y3
        k += step


@entry
def _run(sections: Array, states: Array, tiles: Array, step: int) -> None:
    """Filter tiles (n_tiles, n, 4) in place, forward (`step` 1) or backward (-1) in time.

    `states` (n_sections, n_tiles, 2, 4): where they start.
    """
    for r in range(tiles.shape[0]):
        s = 0
        while s + 1 < sections.shape[0]:
            c, d = _coefficients(sections, s), _coefficients(sections, s + 1)
            _two(c, d, states[s, r], states[s + 1, r], tiles[r], step)
            s += 2
        if s < sections.shape[0]:
            _one(_coefficients(sections, s), states[s, r], tiles[r], step)
