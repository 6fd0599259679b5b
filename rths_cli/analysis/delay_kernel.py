"""Compiled recursion of SIM-DELAY: two linear parts, the force between them delayed. Import it lazily.

A part is four matrices (E, G, W, V): over a substep y+ = E y + G inputs, and its output and the output's
derivative are W y + V inputs at one instant. Every derivative here is per substep (h d/dt).
"""

import math

import numpy as np
from numba import njit

from rths_cli.lti import Array

_MOST_PASSES = 100
_SETTLED = 1e-14


@njit(cache=True)
def _combine(left: Array, x: Array, right: Array, u: Array, result: Array) -> None:
    """Write left @ x + right @ u to `result`."""
    for i in range(left.shape[0]):
        total = 0.0
        for j in range(left.shape[1]):
            total += left[i, j] * x[j]
        for j in range(right.shape[1]):
            total += right[i, j] * u[j]
        result[i] = total


@njit(cache=True)
def _past(history: Array, position: float) -> tuple[float, float]:
    """Return force and derivative at `position` (in substeps) by cubic Hermite, zero before the start."""
    if position <= 0.0:
        return 0.0, 0.0
    base = int(position)
    s = position - base
    f0, d0 = history[base % history.shape[0]]
    f1, d1 = history[(base + 1) % history.shape[0]]
    c2 = 3.0 * (f1 - f0) - 2.0 * d0 - d1
    c3 = 2.0 * (f0 - f1) + d0 + d1
    return f0 + s * (d0 + s * (c2 + s * c3)), d0 + s * (2.0 * c2 + 3.0 * s * c3)


@njit(
    "int64(float64[::1], int64, float64, float64, UniTuple(float64[:, ::1], 4), UniTuple(float64[:, ::1], 4),"
    " float64[:, ::1], float64[:, ::1])",
    cache=True,
)
def integrate(
    ground: Array,
    substeps: int,
    lag: float,
    force_limit: float,
    numerical: tuple[Array, Array, Array, Array],
    specimen: tuple[Array, Array, Array, Array],
    history: Array,
    result: Array,
) -> int:
    """Advance both parts from rest; return the number of samples reached within the force limit.

    `ground` (n,) in m/s^2, `lag` the delay in substeps. `numerical` takes [ground, ground+, f, f', f+,
    f'+], f in N being the delayed force, and gives the table's [a1, a1'] from [ground, f, f']; `specimen`
    takes [a1, a1', a1+, a1'+] and gives [f, f'] from [a1, a1']. `history` (lag + 3 or more, 2) is a zeroed
    ring; `result` (n, n_states + 1) takes the states of both and the delayed force at every sample. When
    lag < 1 the force is iterated until it agrees with its own history.
    """
    EN, GN, WN, VN = numerical
    ES, GS, WS, VS = specimen
    p, s = EN.shape[0], ES.shape[0]
    y, y_next, z, z_next = np.zeros(p), np.zeros(p), np.zeros(s), np.zeros(s)
    ends, table_ends = np.zeros(6), np.zeros(4)
    now, table, force = np.zeros(3), np.zeros(2), np.zeros(2)
    largest = 0.0
    now[0] = ground[0]
    _combine(WN, y, VN, now, table)
    _combine(WS, z, VS, table, force)
    history[0] = force
    result[0] = 0.0
    for k in range((ground.shape[0] - 1) * substeps):
        sample, part = k // substeps, k % substeps
        rise = (ground[sample + 1] - ground[sample]) / substeps
        ends[0], ends[1] = ground[sample] + rise * part, ground[sample] + rise * (part + 1)
        ends[2], ends[3] = _past(history, k - lag)
        now[0] = ends[1]
        table_ends[:2] = table
        new = (k + 1) % history.shape[0]
        history[new, 0], history[new, 1] = force[0] + force[1], force[1]
        for _ in range(_MOST_PASSES):
            now[1], now[2] = _past(history, k + 1 - lag)
            ends[4:] = now[1:]
            _combine(EN, y, GN, ends, y_next)
            _combine(WN, y_next, VN, now, table)
            table_ends[2:] = table
            _combine(ES, z, GS, table_ends, z_next)
            _combine(WS, z_next, VS, table, force)
            change = abs(force[0] - history[new, 0]) + abs(force[1] - history[new, 1])
            largest = max(largest, abs(force[0]))
            history[new] = force
            if lag >= 1.0 or change <= _SETTLED * largest or not math.isfinite(change):
                break
        if not abs(force[0]) <= force_limit:
            return sample + 1
        y, y_next, z, z_next = y_next, y, z_next, z
        if part + 1 == substeps:
            result[sample + 1, :p] = y
            result[sample + 1, p : p + s] = z
            result[sample + 1, p + s] = now[1]
    return ground.shape[0]
