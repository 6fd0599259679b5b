"""A zero-phase filter of four series at once, compiled, for sweeps.

A filter is a cascade of second-order sections (n_sections, 6) as scipy.signal has them. One series alone waits for its
own last sum most of the time: with scipy.signal.sosfiltfilt instead, a run of a sweep (eight series of 107,483
samples) takes 27 ms instead of 15.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rths_cli.numerics.compiled import borrowed, entry, fused_part, part
from rths_cli.numerics.lti import Array

FORWARD, BACKWARD = 1, -1
NEUTRAL = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0])  # a section that changes nothing
LANES = 4  # series that are filtered at once
_Coefficients = tuple[float, float, float, float, float]
_Sample = tuple[float, float, float]


def low_pass(order: int, corner_hz: float, dt_s: float) -> Array:
    """Return the sections (n_sections, 6) of a Butterworth low pass, designed once for the runs of a sweep."""
    return _low_pass(order, corner_hz, dt_s).copy()  # neither scipy nor compiled code takes arrays that are read-only


@lru_cache(maxsize=8)
def _low_pass(order: int, corner_hz: float, dt_s: float) -> Array:
    from scipy.signal import butter

    return np.asarray(butter(order, corner_hz, fs=1.0 / dt_s, output="sos"))


def empty_tiles(series: int, samples: int, padding: int) -> Array:
    """Return room for so many series four beside each other: (n_tiles, samples + 2 padding, 4), zero."""
    return np.zeros((-(-series // LANES), samples + 2 * padding, LANES))


def filter_tiles_both_ways(sections: Array, tiles: Array, padding: int) -> None:
    """Filter series in tiles (n_tiles, n + 2 padding, 4) in place, forward and backward, as scipy's sosfiltfilt does.

    `sections` (1, 6) or (2, 6) are those of a filter of order 1 to 4. The ends are extended by odd reflection over
    `padding` samples, which replaces what stands there, and both passes start in the steady state of their first value.
    A NaN makes its whole series NaN.
    """
    if padding:
        end = tiles.shape[1] - padding
        tiles[:, :padding] = 2.0 * tiles[:, padding : padding + 1] - tiles[:, 2 * padding : padding : -1]
        tiles[:, end:] = 2.0 * tiles[:, end - 1 : end] - tiles[:, end - 2 : end - 2 - padding : -1]
    sections = np.vstack([sections, *[NEUTRAL] * (2 - len(sections))])
    steady = _steady(tuple(map(tuple, sections.tolist())))[:, None, :, None]
    _run(sections, np.ascontiguousarray(steady * tiles[:, :1]), tiles, FORWARD)
    _run(sections, np.ascontiguousarray(steady * tiles[:, -1:]), tiles, BACKWARD)


@lru_cache(maxsize=4)
def _steady(sections: tuple[tuple[float, ...], ...]) -> Array:
    """Return the states (n_sections, 2) of sections in the steady state of a constant 1."""
    from scipy.signal import sosfilt_zi

    return np.asarray(sosfilt_zi(np.array(sections)))


@fused_part
def _sample(c: _Coefficients, x: float, u: float, v: float) -> _Sample:
    """Return output and states of a section (transposed direct form II) after the sample x; what waits for the output
    comes last."""
    y = c[0] * x + u
    return y, (c[1] * x + v) - c[3] * y, c[2] * x - c[4] * y


@part
def _coefficients(sections: Array, s: int) -> _Coefficients:
    return sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 4], sections[s, 5]


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
    """Filter tiles (n_tiles, n, 4) in place by two sections (2, 6), forward (`step` 1) or backward (-1) in time.

    `states` (2, n_tiles, 2, 4): where the sections start.
    """
    sections, states, tiles = borrowed((sections, states, tiles))
    c, d = _coefficients(sections, 0), _coefficients(sections, 1)
    for r in range(tiles.shape[0]):
        _two(c, d, states[0, r], states[1, r], tiles[r], step)
