"""Evaluation criteria J1 to J9 of the 2020 benchmark for real-time hybrid simulation.

Source: Silva, Gomez, Maghareh, Dyke, Spencer, Mech. Syst. Signal Process. 135 (2020) 106381. Ratios are not in
percent; standard deviations remove the mean. The benchmark compares displacements relative to the ground; its
measured displacement contains sensor noise, and no series is filtered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rths_cli.analysis.metrics.response_errors import check_pair, peak
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

WINDOW_S = 0.012  # largest lag of J1


@dataclass(frozen=True)
class TrackingCriteria:
    """Criteria of the tracking of a target."""

    j1_s: float  # lag in s, positive: late
    j2: float  # standard deviation of the tracking error over that of the target
    j3: float  # peak of the tracking error over that of the target


@dataclass(frozen=True)
class ResponseCriteria:
    """Criteria of the response of each storey.

    For the benchmark's three storeys, the interface first, J4, J6, J7 are `deviation`, and J5, J8, J9 are `peak`.
    """

    deviation: Array  # (n_storeys,) standard deviation of the error over that of the reference
    peak: Array  # (n_storeys,) peak of the error over that of the reference


def tracking_criteria(target: ArrayLike, measured: ArrayLike, dt_s: float, leads: bool = True) -> TrackingCriteria:
    """Return J1 to J3 of `measured` (n,) against `target` (n,), both in the same unit.

    `leads`: see `best_lag_s`. Raises InputError if the lengths differ.
    """
    x, y = check_pair(target, measured, ("target", "measured"))
    return TrackingCriteria(best_lag_s(x, y, dt_s, leads), *tracking_ratios(x, y))


def tracking_ratios(target: ArrayLike, measured: ArrayLike) -> tuple[float, float]:
    """Return J2 and J3 of `measured` (n,) against `target` (n,), both in the same unit; NaN if the target is zero.

    Raises InputError if the lengths differ.
    """
    x, y = check_pair(target, measured, ("target", "measured"))
    error = y - x
    return float(_deviation(error, x)), float(_peak(error, x))


def response_criteria(reference: ArrayLike, value: ArrayLike) -> ResponseCriteria:
    """Return J4 to J9 of `value` (n_storeys, n) against `reference` (n_storeys, n), both in the same unit.

    A storey whose reference does not move has NaN. Raises InputError if the shapes differ.
    """
    r, x = np.asarray(reference, dtype=float), np.asarray(value, dtype=float)
    if r.shape != x.shape or r.ndim != 2:
        raise InputError(f"value has shape {x.shape}, but reference has {r.shape}: compare the same storeys")
    return ResponseCriteria(_deviation(x - r, r), _peak(x - r, r))


def best_lag_s(target: ArrayLike, measured: ArrayLike, dt_s: float, leads: bool = True) -> float:
    """Return J1: the lag in s, in whole samples within 12 ms, at which `measured` (n,) best fits `target` (n,).

    At this lag the correlation coefficient of the overlapping parts is largest; a positive lag means late. With `leads`
    False, only lags from 0 on are searched, as in the benchmark, so an early series counts as on time. A lag at the end
    of the window means that lag or a larger one. NaN if a series is constant or not finite. Raises InputError if the
    lengths differ.
    """
    x, y = check_pair(target, measured, ("target", "measured"))
    most = min(int(WINDOW_S / dt_s + 1e-9), len(x) - 1)
    if not (np.ptp(x) > 0 and np.ptp(y) > 0):
        return float("nan")
    lags = np.arange(-most if leads else 0, most + 1)
    return float(lags[np.nanargmax(_correlations(x - x.mean(), y - y.mean(), lags))] * dt_s)


def _correlations(x: Array, y: Array, lags: NDArray[np.int_]) -> Array:
    """Return the correlation coefficients (m,) of x (n,) with y (n,) advanced by `lags` (m,), over their overlaps."""
    late, early, n = np.maximum(lags, 0), np.maximum(-lags, 0), len(x)
    pairs = zip(early, late, strict=True)
    products = np.array([x[start : n - rest] @ y[rest : n - start] for start, rest in pairs])
    sum_x, square_x = (_inner_sums(z, early, late) for z in (x, x * x))
    sum_y, square_y = (_inner_sums(z, late, early) for z in (y, y * y))
    count = n - np.abs(lags)
    scale = (square_x - sum_x**2 / count) * (square_y - sum_y**2 / count)
    scale[scale < 1e-18 * scale.max()] = 0.0  # this overlap contains only rounding errors
    return _over(products - sum_x * sum_y / count, np.sqrt(scale))


def _inner_sums(series: Array, first: NDArray[np.int_], last: NDArray[np.int_]) -> Array:
    """Return the sums (m,) of a series (n,) that leave out its `first` (m,) first and `last` (m,) last samples."""
    start, end = (np.concatenate([[0.0], np.cumsum(z[: max(first.max(), last.max())])]) for z in (series, series[::-1]))
    return np.sum(series) - start[first] - end[last]


def _deviation(error: Array, reference: Array) -> Array:
    """Return the standard deviation of errors (..., n) over that of their references (..., n), shape (...)."""
    return _over(np.std(error, axis=-1), np.std(reference, axis=-1))


def _peak(error: Array, reference: Array) -> Array:
    """Return the peak of errors (..., n) over that of their references (..., n), shape (...)."""
    return _over(peak(error), peak(reference))


def _over(above: Array, below: Array) -> Array:
    """Return the quotients (...) of two arrays (...), NaN where the divisor is not above 0."""
    return np.divide(above, below, out=np.full(np.shape(below), np.nan), where=np.asarray(below) > 0)
