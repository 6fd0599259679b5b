"""The lowest Fourier lines of a long series without transforming all of it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rths_cli.numerics.filters import fast_length
from rths_cli.numerics.lti import Array, ComplexArray

ROOM = 4  # rate of the thinned series over the highest line wanted: that line's alias lies three times as high
TAPS = 16  # of the filter before thinning, in thinned samples: what folds back is below 1e-14 of the series
SHAPE = 0.75 * np.pi * TAPS  # of its Kaiser window: its transform is nothing from the alias of the highest line on


def low_lines(series: Array, count: int, period: int) -> ComplexArray:
    """Return sum_t x_t exp(-2 pi j k t / period), k < `count`: lines (..., count) of series (..., n), n <= period.

    To rounding, whatever factors the period has: the series is filtered by a window and thinned, its lines are found by
    its own transform or, where that does not have them, as a convolution with a chirp, and the window's response is
    divided out. Sources: Bluestein, IEEE Trans. Audio Electroacoustics 18 (1970) 451; Fessler and Sutton, IEEE Trans.
    Signal Process. 51 (2003) 560, for the window.
    """
    step = _step(max(period // (ROOM * count), 1), period)
    rows = series.reshape(-1, series.shape[-1])
    lines = np.empty((len(rows), count), dtype=complex)
    for row, found in zip(rows, lines, strict=True):
        found[:] = _chirped(row, count, period, 1) if step == 1 else _thinned(row, count, period, step)
    return lines.reshape(*series.shape[:-1], count)


def _step(most: int, period: int) -> int:
    """Return the step of thinning: the largest that divides the period, unless that is less than half of the most."""
    return max((step for step in range(most // 2 + 1, most + 1) if period % step == 0), default=most)


def _thinned(series: Array, count: int, period: int, step: int) -> ComplexArray:
    """Return the lines of a series (n,) from its windowed sums over every `step` samples."""
    n = -(-len(series) // step)
    blocks = np.zeros((n, step))
    blocks.reshape(-1)[: len(series)] = series
    sums = np.zeros(n + TAPS - 1)
    for tap, part in enumerate(_window(step) @ blocks.T):
        sums[TAPS - 1 - tap : TAPS - 1 - tap + n] += part
    grid, rest = divmod(period, step)
    own = rest == 0 and len(sums) <= grid
    lines = np.fft.rfft(sums, grid)[:count] if own else _chirped(sums, count, period, step)
    return np.asarray(lines * _unwindowed(count, period, step))


@lru_cache(maxsize=8)
def _window(step: int) -> Array:
    """Return the window (TAPS, step), one thinned sample per row."""
    return np.kaiser(TAPS * step, SHAPE).reshape(TAPS, step)


@lru_cache(maxsize=8)
def _unwindowed(count: int, period: int, step: int) -> ComplexArray:
    """Return the factors (count,) from the lines of the windowed sums, which begin TAPS - 1 early, to the series'."""
    ahead = np.exp(2j * np.pi * np.arange(count) * ((TAPS - 1) * step / period))
    return step * ahead / _chirped(_window(step).ravel(), count, period, 1).conj()


def _chirped(series: Array, count: int, period: int, step: int) -> ComplexArray:
    """Return the lines (count,) of a series (n,) whose samples lie `step` apart."""
    n = len(series)
    chirp, kernel = _chirp(n, count, period, step)
    spectrum = np.fft.fft(series * chirp[:n], len(kernel)) * kernel
    return np.asarray(np.fft.ifft(spectrum)[:count] * chirp[:count])


@lru_cache(maxsize=8)
def _chirp(n: int, count: int, period: int, step: int) -> tuple[ComplexArray, ComplexArray]:
    """Return exp(-j pi step k^2 / period), (n,) or longer, and the transform of its inverse, as long as is needed."""
    k = np.arange(max(n, count))
    chirp = np.exp(-1j * np.pi * (k * k * step % (2 * period)) / period)
    back = np.zeros(fast_length(n + count), dtype=complex)
    back[:count] = chirp[:count].conj()
    back[len(back) - n + 1 :] = chirp[n - 1 : 0 : -1].conj()
    return chirp, np.asarray(np.fft.fft(back))
