"""Evaluation criteria J1 to J9 of the 2020 benchmark for real-time hybrid simulation, for any quantity and building.

Source: Silva, Gomez, Maghareh, Dyke, Spencer, Mech. Syst. Signal Process. 135 (2020) 106381. Ratios are not in
percent. Standard deviations remove the mean and divide by n - 1. The benchmark compares displacements relative to the
ground; its measured one is with sensor noise, and nothing is filtered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.errors import InputError
from rths_cli.lti import Array
from rths_cli.metrics.error import check_pair, peak

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
    error = y - x
    return TrackingCriteria(best_lag_s(x, y, dt_s, leads), float(_deviation(error, x)), float(_peak(error, x)))


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
    edge means that or more. NaN when no coefficient is defined. Raises InputError when the lengths differ.
    """
    x, y = check_pair(target, measured, ("target", "measured"))
    most = min(int(WINDOW_S / dt_s + 1e-9), len(x) - 2)
    lags = range(-most if leads else 0, most + 1)
    fits = np.array(
        [_correlation(x[max(-k, 0) : len(x) - max(k, 0)], y[max(k, 0) : len(y) - max(-k, 0)]) for k in lags]
    )
    return float("nan") if np.isnan(fits).all() else float(lags[int(np.nanargmax(fits))] * dt_s)


def _correlation(x: Array, y: Array) -> float:
    """Return the correlation coefficient of two series (m,), NaN when one is constant."""
    a, b = x - x.mean(), y - y.mean()
    scale = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / scale) if scale > 0 else float("nan")


def _deviation(error: Array, reference: Array) -> Array:
    return _over(np.std(error, axis=-1, ddof=1), np.std(reference, axis=-1, ddof=1))


def _peak(error: Array, reference: Array) -> Array:
    return _over(peak(error), peak(reference))


def _over(above: Array, below: Array) -> Array:
    return np.divide(above, below, out=np.full(np.shape(below), np.nan), where=np.asarray(below) > 0)
