"""Evaluation criteria J1 to J9 of the 2020 benchmark for real-time hybrid simulation.

Source: Silva, Gomez, Maghareh, Dyke, Spencer, Mech. Syst. Signal Process. 135 (2020) 106381. Ratios are not in
percent; standard deviations remove the mean. The benchmark compares displacements relative to the ground; its
measured one is with sensor noise, and nothing is filtered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rths_cli.analysis.metrics.response_errors import check_pair, peak
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

WINDOW_S = 0.012


@dataclass(frozen=True)
class TrackingCriteria:
    """J1: lag in s, positive = late; J2, J3: standard deviation and peak of the tracking error over the target's."""

    j1_s: float
    j2: float
    j3: float


@dataclass(frozen=True)
class ResponseCriteria:
    """Standard deviation and peak of each storey's error over its reference's, each (n_storeys,).

    The benchmark's three storeys, the interface first: J4, J6, J7 = `deviation`; J5, J8, J9 = `peak`.
    """

    deviation: Array
    peak: Array


def tracking_criteria(target: ArrayLike, measured: ArrayLike, dt_s: float, leads: bool = True) -> TrackingCriteria:
    """Return J1 to J3 of `measured` (n,) against `target` (n,), of one unit; raises InputError as `best_lag_s`."""
    x, y = check_pair(target, measured, ("target", "measured"))
    return TrackingCriteria(best_lag_s(x, y, dt_s, leads), *tracking_ratios(x, y))


def tracking_ratios(target: ArrayLike, measured: ArrayLike) -> tuple[float, float]:
    """Return J2 and J3 of `measured` (n,) against `target` (n,); raises InputError when the lengths differ."""
    x, y = check_pair(target, measured, ("target", "measured"))
    error = y - x
    return float(_deviation(error, x)), float(_peak(error, x))


def response_criteria(reference: ArrayLike, value: ArrayLike) -> ResponseCriteria:
    """Return J4 to J9 of `value` (n_storeys, n) against `reference` (n_storeys, n), of one unit.

    NaN for a storey whose reference does not move. Raises InputError when the shapes differ.
    """
    r, x = np.asarray(reference, dtype=float), np.asarray(value, dtype=float)
    if r.shape != x.shape or r.ndim != 2:
        raise InputError(f"value has shape {x.shape}, but reference has {r.shape}: compare the same storeys")
    return ResponseCriteria(_deviation(x - r, r), _peak(x - r, r))


def best_lag_s(target: ArrayLike, measured: ArrayLike, dt_s: float, leads: bool = True) -> float:
    """Return J1: the lag in s, in whole samples within 12 ms, at which `measured` (n,) best fits `target` (n,).

    The correlation coefficient of the overlapping parts is largest there; positive is late. With `leads` False
    only lags are searched, as the benchmark does, so that early looks like on time. A result at the window's
    edge means that or more. NaN when a series is constant or not finite. Raises InputError when the lengths differ.
    """
    x, y = check_pair(target, measured, ("target", "measured"))
    most = min(int(WINDOW_S / dt_s + 1e-9), len(x) - 1)
    if not (np.ptp(x) > 0 and np.ptp(y) > 0):
        return float("nan")
    lags = np.arange(-most if leads else 0, most + 1)
    return float(lags[np.nanargmax(_correlations(x - x.mean(), y - y.mean(), lags))] * dt_s)


def _correlations(x: Array, y: Array, lags: NDArray[np.int_]) -> Array:
    """Return the correlation coefficients (m,) of the overlaps of y (n,), moved forward by `lags` (m,), and x (n,)."""
    late, early, n = np.maximum(lags, 0), np.maximum(-lags, 0), len(x)
    pairs = zip(early, late, strict=True)
    products = np.array([x[start : n - rest] @ y[rest : n - start] for start, rest in pairs])
    sum_x, square_x = (_inner_sums(z, early, late) for z in (x, x * x))
    sum_y, square_y = (_inner_sums(z, late, early) for z in (y, y * y))
    count = n - np.abs(lags)
    scale = (square_x - sum_x**2 / count) * (square_y - sum_y**2 / count)
    scale[scale < 1e-18 * scale.max()] = 0.0  # nothing moves in that overlap but rounding
    return _over(products - sum_x * sum_y / count, np.sqrt(scale))


def _inner_sums(series: Array, first: NDArray[np.int_], last: NDArray[np.int_]) -> Array:
    """Return the sums (m,) of a series (n,) without its `first` (m,) and `last` (m,) samples."""
    start, end = (np.concatenate([[0.0], np.cumsum(z[: max(first.max(), last.max())])]) for z in (series, series[::-1]))
    return np.sum(series) - start[first] - end[last]


def _deviation(error: Array, reference: Array) -> Array:
    return _over(np.std(error, axis=-1), np.std(reference, axis=-1))


def _peak(error: Array, reference: Array) -> Array:
    return _over(peak(error), peak(reference))


def _over(above: Array, below: Array) -> Array:
    return np.divide(above, below, out=np.full(np.shape(below), np.nan), where=np.asarray(below) > 0)
