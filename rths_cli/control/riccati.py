"""The discrete algebraic Riccati equation where eigenvalues lie close to the unit circle: slow modes, fast sampling."""

from __future__ import annotations

import numpy as np

from rths_cli.errors import InputError
from rths_cli.lti import Array
from rths_cli.matrices import doubled


def riccati_gain(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array:
    """Return the gain (m, n) of the discrete linear-quadratic regulator with cross weight s (n, m).

    Raises InputError when the equation has no stabilising solution.
    """
    cost = riccati_cost(a, b, q, r, s)
    return np.asarray(np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a + s.T), dtype=float)


def riccati_cost(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array:
    """Return X (n, n) of X = A' X A - (A' X B + S) (R + B' X B)^-1 (B' X A + S') + Q by doubling.

    Modes that last ten thousand samples take some fifteen rounds; a method that orders eigenvalues of the extended
    pencil loses its digits there, or finds no solution. Raises InputError as `riccati_gain` does.
    """
    inverse = np.linalg.inv(r)
    cost = doubled(a - b @ inverse @ s.T, b @ inverse @ b.T, q - s @ inverse @ s.T)
    if cost is None:
        raise InputError(
            "controller: the feedback's Riccati equation cannot be solved with this command_weight and disturbance_hz; "
            "use a larger command_weight or the default band, 1 to 12 Hz"
        )
    return cost
