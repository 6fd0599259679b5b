"""The discrete algebraic Riccati equation where eigenvalues lie close to the unit circle: slow modes, fast sampling."""

from __future__ import annotations

import numpy as np

from rths_cli.errors import InputError
from rths_cli.lti import Array

MOST_DOUBLINGS, CONVERGED = 60, 1e-13


def riccati_gain(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array:
    """Return the gain (m, n) of the discrete linear-quadratic regulator with cross weight s (n, m).

    Raises InputError when the equation has no stabilising solution.
    """
    from scipy.linalg import solve_discrete_are

    try:
        cost = solve_discrete_are(a, b, q, r, s=s)
    except (np.linalg.LinAlgError, ValueError):  # scipy raises either when it cannot order the eigenvalues
        cost = solve_by_doubling(a, b, q, r, s)
    return np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a + s.T)


def solve_by_doubling(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array:
    """Return X (n, n) of X = A' X A - (A' X B + S) (R + B' X B)^-1 (B' X A + S') + Q, from zero by doubling.

    Each round looks twice as many steps ahead, so that modes that last ten thousand samples take some fifteen rounds.
    Source: the structure-preserving doubling algorithm, Chu, Fan, Lin and Wang, Int. J. Control 77 (2004).
    """
    inverse = np.linalg.inv(r)
    step, reach, cost = a - b @ inverse @ s.T, b @ inverse @ b.T, q - s @ inverse @ s.T
    eye = np.eye(len(a))
    for _ in range(MOST_DOUBLINGS):
        through = np.linalg.solve(eye + reach @ cost, np.hstack([step, reach]))
        left, right = through[:, : len(a)], through[:, len(a) :]
        with np.errstate(over="ignore", invalid="ignore"):  # without a solution it overflows, which is looked for
            more = step.T @ cost @ left
            reach = reach + step @ right @ step.T
            step, cost = step @ left, cost + 0.5 * (more + more.T)
        if not np.isfinite(cost).all():
            break
        if np.abs(more).max() <= CONVERGED * np.abs(cost).max():
            return cost
    raise InputError(
        "controller: the feedback's Riccati equation cannot be solved with this command_weight and disturbance_hz; "
        "use a larger command_weight or the default band, 1 to 12 Hz"
    )
