"""Tracking fidelity from the lowest Fourier lines: frequency evaluation index (amplitude ratio and delay), tracking
indicator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.analysis.metrics.response_errors import check_pair
from rths_cli.numerics.bands import TEST_BAND_HZ
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


@dataclass(frozen=True)
class FrequencyEvaluation:
    """Frequency evaluation index (FEI)."""

    amplitude: float  # amplitude ratio, 1: exact
    delay_s: float  # positive: late; within half a period of `frequency_hz`, because whole turns of phase are unknown
    frequency_hz: float  # equivalent frequency, the mean of the lines weighted by the power of the desired series


def frequency_evaluation(
    desired: ArrayLike, measured: ArrayLike, dt_s: float, high_hz: float = TEST_BAND_HZ
) -> FrequencyEvaluation:
    """Return the frequency evaluation index of `measured` (n,) against `desired` (n,), both in the same unit.

    FEI = sum (Y / X) |X|^2 / sum |X|^2, summed over the lines 0 < f <= `high_hz` of the discrete Fourier transforms X
    of desired and Y of measured. The amplitude is |FEI|, the frequency sum f |X|^2 / sum |X|^2, and the delay
    -arg(FEI) / (2 pi frequency). All are NaN if `desired` has no power on these lines or a series is not finite. Raises
    InputError if the lengths differ. Source: Guo, Chen, Xu, Sanchez, Smart Mater. Struct. 23 (2014) 045042,
    with the power l = 2.
    """
    return frequency_evaluations(desired, (measured,), dt_s, high_hz)[0]


def frequency_evaluations(
    desired: ArrayLike, measured: Sequence[ArrayLike], dt_s: float, high_hz: float = TEST_BAND_HZ
) -> list[FrequencyEvaluation]:
    """Return `frequency_evaluation` of several series (n,) against one; that one is transformed only once."""
    pairs = [check_pair(desired, each) for each in measured]
    n = len(pairs[0][0])
    frequency = np.arange(n // 2 + 1) / (n * dt_s)
    frequency = frequency[(frequency > 0) & (frequency <= high_hz)]
    X, *others = low_lines(np.stack([pairs[0][0], *(y for _, y in pairs)]), len(frequency) + 1, n)[:, 1:]
    return [_evaluation(X, Y, frequency) for Y in others]


def _evaluation(X: ComplexArray, Y: ComplexArray, frequency_hz: Array) -> FrequencyEvaluation:
    """Return the frequency evaluation index of Fourier lines Y (m,) against X (m,)."""
    power = np.abs(X) ** 2
    total = power.sum()
    if not (total > 0 and np.isfinite(Y).all()):
        return FrequencyEvaluation(np.nan, np.nan, np.nan)
    index = np.sum(np.conj(X) * Y) / total
    equivalent = float(np.sum(frequency_hz * power) / total)
    return FrequencyEvaluation(float(np.abs(index)), float(-np.angle(index)) / (2 * np.pi * equivalent), equivalent)


def tracking_indicator(desired: ArrayLike, measured: ArrayLike) -> Array:
    """Return the tracking indicator (n,) of `measured` (n,) against `desired` (n,), in their unit squared.

    TI = (A - TA) / 2 with the areas A = int x dy and TA = int y dx of the plot of measured y over desired x, by the
    trapezoidal rule. It increases while the table is late and decreases while it is early. Raises InputError if the
    lengths differ. Source: Mercan and Ricles, Earthquake Eng. Struct. Dyn. 36 (2007) 1523.
    """
    x, y = check_pair(desired, measured)
    return 0.5 * np.concatenate([[0.0], np.cumsum(x[:-1] * y[1:] - x[1:] * y[:-1])])
