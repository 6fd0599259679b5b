"""The discrete algebraic Riccati equation by doubling."""

from __future__ import annotations

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

_MOST_DOUBLINGS, _CONVERGED = 60, 1e-14


def doubled(step: Array, reach: Array, cost: Array) -> Array | None:
    """Return X (n, n) of X = cost + step' X (1 + reach X)^-1 step, from zero by doubling; None if it does not settle,
    or where 1 + reach X is singular, which a positive cost never makes it.

    Each round looks twice as many steps ahead. Source: Chu, Fan, Lin and Wang, Int. J. Control 77 (2004) 767.
    """
    n = len(step)
    cost = 0.5 * (cost + cost.T)
    for _ in range(_MOST_DOUBLINGS):
        try:
            both = np.linalg.solve(np.eye(n) + reach @ cost, np.hstack([step, reach]))
        except np.linalg.LinAlgError:
            return None
        with np.errstate(over="ignore", invalid="ignore"):  # without a solution it overflows, which is looked for
            more = step.T @ cost @ both[:, :n]
            reach = reach + step @ both[:, n:] @ step.T
            step, cost = step @ both[:, :n], cost + 0.5 * (more + more.T)
        if not np.isfinite(cost).all():
            return None
        if np.abs(more).max() <= _CONVERGED * np.abs(cost).max():
            return cost
    return None


def riccati_gain(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array:
    """Return the gain (m, n) of the discrete linear-quadratic regulator with cross weight s (n, m).

    Raises InputError when the equation has no stabilising solution.
    """
    cost = riccati_cost(a, b, q, r, s)
    return np.asarray(np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a + s.T), dtype=float)


def riccati_cost(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array:
    """Return X (n, n) of X = A' X A - (A' X B + S) (R + B' X B)^-1 (B' X A + S') + Q by doubling.

    Modes that last ten thousand samples take some fifteen rounds. scipy.linalg.solve_discrete_are orders eigenvalues
    of the extended pencil, which then lie beside the circle: it refuses one in ten of the regulators for light
    specimens (tests/numerics/test_riccati.py), or without its balancing loses half the digits. Raises InputError as
    `riccati_gain` does.
    """
    inverse = np.linalg.inv(r)
    cost = doubled(a - b @ inverse @ s.T, b @ inverse @ b.T, q - s @ inverse @ s.T)
    if cost is None:
        raise InputError(
            "controller: the feedback's Riccati equation cannot be solved with this command_weight and disturbance_hz; "
            "use a larger command_weight or leave disturbance_hz out"
        )
    return cost
