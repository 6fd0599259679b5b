"""Errors of a run: test band, RMS, peak and fitted delay. Time is the last axis of every array.

A series that was cut (NaN from some sample on) has no figures: all of that storey's are NaN, and
`diverged` says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rths_cli.errors import InputError
from rths_cli.filters import butterworth, fast_length, filtered_both_ways, tukey
from rths_cli.lti import Array, ComplexArray

BAND_HZ = 12.0
BAND_ORDER = 4
_TAPERED = 0.1  # share of the record under the taper of the delay fit, half of it at each end
_MOST_NEWTON_STEPS = 20


@dataclass(frozen=True)
class ErrorFigures:
    """Errors of a value against its reference, each figure of shape (...), in the unit of the series.

    `rms`, `maximum` in the test band; `rms_full`, `maximum_full` in full band; `diverged` where a series is
    not finite.
    """

    rms: Array
    maximum: Array
    rms_full: Array
    maximum_full: Array
    diverged: NDArray[np.bool_]


@dataclass(frozen=True)
class Banded:
    """Series in full band and in the test band, each (..., n)."""

    full: Array
    band: Array

    def __getitem__(self, rows: int | slice) -> Banded:
        """Return some of the series."""
        return Banded(self.full[rows], self.band[rows])


def banded(series: ArrayLike, dt_s: float) -> Banded:
    """Return `series` (..., n) with its test band; raises InputError as `test_band`."""
    values = np.asarray(series, dtype=float)
    return Banded(values, test_band(values, dt_s))


def test_band(series: ArrayLike, dt_s: float) -> Array:
    """Filter `series` (..., n) with a 4th-order 12 Hz Butterworth low pass, forward and backward.

    The ends are extended by odd reflection over 15 samples (the default of scipy's sosfiltfilt, so that
    anyone can repeat a figure in one line), or over n - 1 if the record is shorter. A NaN anywhere makes
    its whole series NaN. Raises InputError when half the sample rate is not above 12 Hz.
    """
    values = np.asarray(series, dtype=float)
    if not 0 < dt_s < 0.5 / BAND_HZ:
        raise InputError(
            f"dt_s is {dt_s:g} s, but the {BAND_HZ:g} Hz test band needs one above 0"
            f" and below {0.5 / BAND_HZ:.4f} s: sample faster"
        )
    sections = butterworth(BAND_ORDER, BAND_HZ, 1.0 / dt_s)
    padding = min(3 * (2 * len(sections) + 1), values.shape[-1] - 1)
    return filtered_both_ways(sections, values, padding)


def rms(series: ArrayLike) -> Array:
    """Return sqrt(mean(e^2)) of `series` (..., n) over every sample, shape (...), unit of the series."""
    return np.sqrt(np.mean(np.square(np.asarray(series, dtype=float)), axis=-1))


def peak(series: ArrayLike) -> Array:
    """Return the largest absolute value of `series` (..., n), shape (...), in the unit of the series."""
    return np.max(np.abs(np.asarray(series, dtype=float)), axis=-1)


def error_figures(reference: ArrayLike, value: ArrayLike, dt_s: float) -> ErrorFigures:
    """Return the figures of reference - value, both (..., n), in the test band and in full band.

    Nothing is shifted and no mean is removed: delay and offset are errors. Raises InputError when the
    shapes differ.
    """
    if np.shape(reference) != np.shape(value) or np.size(value) == 0:
        raise InputError(
            f"value has shape {np.shape(value)}, but the reference has {np.shape(reference)}:"
            " compare series of the same storeys and samples"
        )
    error = np.asarray(reference, dtype=float) - np.asarray(value, dtype=float)
    diverged = ~np.isfinite(error).all(axis=-1)
    error = np.where(diverged[..., None], np.nan, error)
    return _figures(error, test_band(error, dt_s), diverged)


def banded_error_figures(reference: Banded, value: Banded) -> ErrorFigures:
    """Return `error_figures` of two series of one shape whose test bands are known: the filter is linear."""
    error, band = reference.full - value.full, reference.band - value.band
    diverged = np.asarray(~np.isfinite(error).all(axis=-1))
    if diverged.any():
        error, band = (np.where(diverged[..., None], np.nan, each) for each in (error, band))
    return _figures(error, band, diverged)


def _figures(error: Array, band: Array, diverged: NDArray[np.bool_]) -> ErrorFigures:
    return ErrorFigures(rms(band), peak(band), rms(error), peak(error), diverged)


def check_pair(
    reference: ArrayLike, value: ArrayLike, names: tuple[str, str] = ("desired", "measured")
) -> tuple[Array, Array]:
    """Return both series as floats (n,); raise InputError, with their names, unless they are of equal length."""
    x, y = np.asarray(reference, dtype=float), np.asarray(value, dtype=float)
    if x.ndim != 1 or x.shape != y.shape:
        raise InputError(
            f"{names[1]} has shape {y.shape}, but {names[0]} has {x.shape}: compare two series of equal length"
        )
    return x, y


def fitted_delay_s(desired: ArrayLike, measured: ArrayLike, dt_s: float) -> float:
    """Return the delay in s of `measured` (n,) against `desired` (n,): positive is late, negative early.

    The maximum of the cross-correlation, refined below a sample by Newton steps on the cross-spectrum, that
    is the phase slope weighted by power. Means are removed and the ends tapered. For reporting only: no
    series is ever shifted by it. NaN when a series is constant or not finite. Raises InputError when the
    lengths differ.
    """
    return fitted_delays_s(desired, (measured,), dt_s)[0]


def fitted_delays_s(desired: ArrayLike, measured: Sequence[ArrayLike], dt_s: float) -> list[float]:
    """Return `fitted_delay_s` of several series (n,) against one, which is transformed once."""
    pairs = [check_pair(desired, each) for each in measured]
    x = pairs[0][0]
    if not _moves(x):
        return [float("nan")] * len(pairs)
    taper, padded = tukey(len(x), _TAPERED), fast_length(2 * len(x))
    lines_x = np.fft.rfft((x - x.mean()) * taper, padded).conj()
    delays = []
    for _, y in pairs:
        cross = lines_x * np.fft.rfft((y - y.mean()) * taper, padded) if _moves(y) else None
        delays.append(float("nan") if cross is None else _lag(cross, padded) * dt_s)
    return delays


def _moves(series: Array) -> bool:
    return bool(np.isfinite(series).all() and np.ptp(series) > 0)


def _lag(cross: ComplexArray, padded: int) -> float:
    """Return the lag in samples at which the correlation with a cross-spectrum (m,) is largest."""
    lag = int(np.argmax(np.fft.irfft(cross, padded)))
    return _refined_lag(cross, 2 * np.pi / padded, float(lag if lag <= padded / 2 else lag - padded))


def _refined_lag(cross: ComplexArray, angle_rad: float, lag: float) -> float:
    """Return the lag in samples, within one of `lag`, that maximises Re sum_k cross_k exp(j k angle lag).

    With k = wide i + l the phase is a product, so no line needs its own exponential.
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
