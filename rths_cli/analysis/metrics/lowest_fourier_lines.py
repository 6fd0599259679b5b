"""The lowest Fourier lines of a long series, without a transform of the whole series."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rths_cli.numerics.lti import Array, ComplexArray

ROOM = 4  # sample rate of the decimated series over the highest line; the alias of that line is then 3 times as high
TAPS = 16  # length of the filter before decimation, in decimated samples; aliases are below 1e-14 of the series
SHAPE = 0.75 * np.pi * TAPS  # beta of its Kaiser window; the stop band begins at the alias of the highest line


def low_lines(series: Array, count: int, period: int) -> ComplexArray:
    """Return the lines (..., count) sum_t x_t exp(-2 pi j k t / period), k < `count`, of series (..., n), n <= period.

    The result is exact but for rounding, whatever prime factors the period has. The series is filtered by a window and
    decimated. Its lines follow from a fast Fourier transform or, if that has other lines, from a convolution with a
    chirp. They are divided by the response of the window. Sources: Bluestein, IEEE Trans. Audio Electroacoustics 18
    (1970) 451; Fessler and Sutton, IEEE Trans. Signal Process. 51 (2003) 560, for the window.
    """
    step = _step(max(period // (ROOM * count), 1), period)
    rows = series.reshape(-1, series.shape[-1])
    lines = np.empty((len(rows), count), dtype=complex)
    for row, found in zip(rows, lines, strict=True):
        found[:] = _chirped(row, count, period, 1) if step == 1 else _thinned(row, count, period, step)
    return lines.reshape(*series.shape[:-1], count)


def _step(most: int, period: int) -> int:
    """Return the decimation step: the largest divisor of `period` from more than most / 2 to `most`, else `most`."""
    return max((step for step in range(most // 2 + 1, most + 1) if period % step == 0), default=most)


def _thinned(series: Array, count: int, period: int, step: int) -> ComplexArray:
    """Return the lines (count,) of a series (n,) from its windowed sums, one for every `step` samples."""
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
    """Return the Kaiser window (TAPS, step), one decimated sample per row."""
    return np.kaiser(TAPS * step, SHAPE).reshape(TAPS, step)


@lru_cache(maxsize=8)
def _unwindowed(count: int, period: int, step: int) -> ComplexArray:
    """Return the factors (count,) that turn lines of the windowed sums into lines of the series.

    They divide by the window's response and shift the sums, which begin TAPS - 1 decimated samples early.
    """
    ahead = np.exp(2j * np.pi * np.arange(count) * ((TAPS - 1) * step / period))
    return step * ahead / _chirped(_window(step).ravel(), count, period, 1).conj()


def _chirped(series: Array, count: int, period: int, step: int) -> ComplexArray:
    """Return the lines (count,) of a series (n,) with samples at every `step` of the period, by Bluestein's method."""
    n = len(series)
    chirp, kernel = _chirp(n, count, period, step)
    spectrum = np.fft.fft(series * chirp[:n], len(kernel)) * kernel
    return np.asarray(np.fft.ifft(spectrum)[:count] * chirp[:count])


@lru_cache(maxsize=8)
def _chirp(n: int, count: int, period: int, step: int) -> tuple[ComplexArray, ComplexArray]:
    """Return the chirp exp(-j pi step k^2 / period), max(n, count) long, and the transform of the convolution's kernel.

    The kernel is the conjugate chirp for k from 1 - n to count - 1, in cyclic order, padded with zeros to a length for
    a fast transform.
    """
    from scipy.fft import next_fast_len

    k = np.arange(max(n, count))
    chirp = np.exp(-1j * np.pi * (k * k * step % (2 * period)) / period)
    back = np.zeros(next_fast_len(n + count), dtype=complex)
    back[:count] = chirp[:count].conj()
    back[len(back) - n + 1 :] = chirp[n - 1 : 0 : -1].conj()
    return chirp, np.asarray(np.fft.fft(back))
