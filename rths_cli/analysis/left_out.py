"""What of a record a fit may use: no samples that never came, and nothing from where the series break off on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rths_cli.analysis.lines import Lines
from rths_cli.lti import Array, ComplexArray

Booleans = NDArray[np.bool_]

BLOCKS = 10  # of a record, left out one at a time
MARGIN_S = 0.05  # before the end, where a series of low lines knows of the end already
FADE_S = 0.5  # before that margin, in which the record fades out of a fit
NEAR_S = 0.05  # on both sides of a gap, in which commands may not be what the blocks make
JOINED_S = 0.02  # of samples on both sides of a gap, to whose mean it is joined


def mended(samples: Array, predicted: Array, lost: Booleans, width: int = 1) -> Array:
    """Return samples (c, n) that follow a prediction (c, n) where they were `lost` (n,), shifted so that they join the
    mean of the nearest ones on both sides, up to `width` of them; what is not lost stays."""
    came = np.flatnonzero(~lost)
    if not came.size:
        return predicted.copy()
    every, box = np.arange(lost.size), np.ones(min(width, lost.size))
    off = np.where(lost, 0.0, samples - predicted)
    count = np.convolve(~lost, box, "same")[came]
    means = [np.convolve(row, box, "same")[came] / count for row in off]
    return np.where(lost, predicted + np.array([np.interp(every, came, mean) for mean in means]), samples)


def at_full_rate(lines: Lines, rows: ComplexArray) -> Array:
    """Return the series (..., n) of lines (..., m) at the record's own sample rate."""
    return np.fft.irfft(rows, lines.padded)[..., : lines.samples]


def inside(lines: Lines) -> Array:
    """Return one inside the record and a slope to zero before its end, at the reduced rate."""
    time_s = np.arange(lines.series(np.zeros(lines.count, dtype=complex)).size) * lines.reduced_dt_s
    return np.clip((lines.samples * lines.dt_s - MARGIN_S - time_s) / FADE_S, 0.0, 1.0)


def bursts(lines: Lines, row: ComplexArray, lost: Booleans) -> ComplexArray:
    """Return the lines (m,) of what a series given by lines does within NEAR_S of `lost` steps (n,), beyond a straight
    line from one end of such a stretch to the other."""
    series = lines.series(row)[None]
    at_s = np.arange(series.shape[1]) * lines.reduced_dt_s
    gaps_s = np.flatnonzero(lost) * lines.dt_s
    after = np.searchsorted(gaps_s, at_s)
    distance = np.minimum(
        np.abs(at_s - gaps_s[np.minimum(after, gaps_s.size - 1)]), np.abs(at_s - gaps_s[np.maximum(after - 1, 0)])
    )
    calm = mended(series, np.zeros_like(series), distance < NEAR_S)
    return _lines(lines, (series - calm)[0])


def weighted_in_time(lines: Lines, rows: ComplexArray, weight: Array) -> ComplexArray:
    """Return the lines (..., m) of series given by lines, after a weight of every instant (at the reduced rate)."""
    return _lines(lines, lines.series(rows) * weight)


def scatter(lines: Lines, rows: ComplexArray, wanted: ComplexArray) -> Array:
    """Return the standard uncertainties (k,) of the real factors of rows (k, m) that make most of lines (m,).

    The factors are found again and again without one of BLOCKS parts of the record, so that whatever is left over may
    depend on time and on frequency. Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), Eq. 11.5.
    """
    series = lines.series(np.vstack([rows, wanted[None]]))
    size = np.linalg.norm(series[:-1], axis=1)
    size[size == 0.0] = 1.0
    series[:-1] /= size[:, None]
    parts = np.array_split(series, BLOCKS, axis=1)
    powers = np.array([part @ part.T for part in parts])
    left = powers.sum(axis=0) - powers
    found = [np.linalg.lstsq(power[:-1, :-1], power[:-1, -1], rcond=1e-12)[0] for power in left]
    return np.sqrt((BLOCKS - 1) * np.var(found, axis=0)) / size


def _lines(lines: Lines, series: Array) -> ComplexArray:
    """Return the lines (..., m) of series at the reduced rate."""
    return np.asarray(np.fft.rfft(series, lines.reduced)[..., : lines.count] * (lines.padded / lines.reduced))
