"""Series as figures draw them: thinned so that every peak stays, and the stretches of a record worth a closer look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.lti import Array, Integers

POINTS_PER_FIGURE = 7500  # of all lines together: what keeps a vector file below 300 KB
POINTS_PER_LINE = (40, 2000)
CLOSE_LOOK_S = 3.0


def points_of_lines(weights: Sequence[float]) -> list[int]:
    """Return how many points each line of a figure may have, in proportion to its weight."""
    least, most = POINTS_PER_LINE
    return [int(np.clip(POINTS_PER_FIGURE * weight / sum(weights), least, most)) for weight in weights]


def thinned(time_s: Array, values: Array, points: int) -> tuple[Array, Array]:
    """Return at most `points` samples of a series (n,): smallest and largest of equal stretches, in their order.

    Each keeps its own instant, so peaks stay what and where they were. Stretches share their end samples: where a
    series goes one way one sample of each is enough, and there may be twice as many. A stretch without any number is
    a NaN, which breaks the line. A series that is short enough comes back as it is.
    """
    if values.size <= points:
        return time_s, values
    for stretches in (points - 1, 3 * points // 4, points // 2):
        kept = _extremes(values, stretches)
        if kept.size <= points:
            break
    return time_s[kept], values[kept]


def _extremes(values: Array, stretches: int) -> Integers:
    """Return the places of the smallest and largest value of at most so many stretches, in their order, each once."""
    last = values.size - 1
    length = -(-last // stretches)
    places = np.minimum(np.arange(0, last, length)[:, None] + np.arange(length + 1), last)
    inside = values[places]
    known = np.isfinite(inside)
    rows = np.arange(len(places))
    lowest = places[rows, np.where(known, inside, np.inf).argmin(axis=1)]
    highest = places[rows, np.where(known, inside, -np.inf).argmax(axis=1)]
    return np.unique(np.concatenate([lowest, highest]))


def known_part(values: Array) -> int:
    """Return how many samples of a series (n,) stand before the first that is no number."""
    unknown = np.flatnonzero(~np.isfinite(values))
    return int(unknown[0]) if unknown.size else values.size


def window_at(time_s: Array, instant_s: float, length_s: float = CLOSE_LOOK_S) -> slice:
    """Return the samples of a stretch of `length_s` around an instant, moved where the record ends before."""
    first = min(max(instant_s - 0.5 * length_s, float(time_s[0])), max(float(time_s[-1]) - length_s, float(time_s[0])))
    start = int(np.searchsorted(time_s, first - 1e-9))
    return slice(start, int(np.searchsorted(time_s, first + length_s + 1e-9)))


def busiest(time_s: Array, values: Array, length_s: float = CLOSE_LOOK_S) -> slice:
    """Return the stretch around the largest absolute value of a series (n,)."""
    return window_at(time_s, float(time_s[int(np.nanargmax(np.abs(values)))]), length_s)


def quietest(time_s: Array, values: Array, length_s: float) -> slice:
    """Return the stretch after the largest absolute value in which a series (n,) has the least power."""
    peak = int(np.nanargmax(np.abs(values)))
    count = round(length_s * (len(time_s) - 1) / float(time_s[-1] - time_s[0]))
    count = min(max(count, 1), values.size - 1)
    power = np.concatenate([[0.0], np.cumsum(np.nan_to_num(values) ** 2)])
    start = min(peak, max(values.size - count - 1, 0))
    moving = power[start + count :] - power[start : power.size - count]
    first = start + int(moving.argmin())
    return slice(first, min(first + count + 1, values.size))
