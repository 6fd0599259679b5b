"""How the base of the specimen turns, from the stiffness that couples the modes of a chain of storeys.

A table on soft bearings, or a specimen on a soft plate, turns by theta = sum of h m a / k, and a floor at height h
moves by h theta more. This adds c h h' to the flexibility of the specimen, with c = 1 / k for heights relative to the
top floor. A chain of storeys has no such term. So in the modes phi of the chain that fits best, of frequencies w, a
stiffness

    K = K_rigid - c (K h) (K h)'

remains that couples them, to first order in c. Its diagonal is that of other storey stiffnesses; what is then left
beside it is proportional to c. Of one floor it is not seen: it looks like a softer storey.

Accelerometers on floors that turn also show g theta, which is not in this: (g / h w^2) of the motion by the turning, at
3 Hz and 0.4 m 7 % of it.
"""

from __future__ import annotations

import numpy as np

from rths_cli.identification.results import Pitch
from rths_cli.identification.sensor_calibration import Fitted
from rths_cli.identification.specimen_fit import modal, stiffness_slopes
from rths_cli.numerics.lti import Array

MODEL = 0.1  # relative standard uncertainty: weight along the turned floors, the base's own resonance, unequal storeys


def pitch(fitted: Fitted, heights_m: Array | None = None) -> Pitch | None:
    """Return how the base under a fitted chain turns; None where the fit has no stiffness that couples modes.

    `heights_m` (n,) are those of the storeys, None: all the same. What couples the modes in another way than a turning
    base does widens the uncertainty.
    """
    coupled, spread = fitted.coupled_stiffness
    if not len(coupled) or not np.diag(spread).all():
        return None
    heights = np.cumsum(np.ones(len(fitted.masses_kg)) if heights_m is None else heights_m)
    by_one, stiffer = _by_turning(fitted.masses_kg, fitted.stiffness_n_per_m, heights / heights[-1])
    weighted = np.linalg.solve(spread, by_one)
    found = float(weighted @ coupled / (weighted @ by_one))
    left = coupled - found * by_one
    misfit = float(left @ np.linalg.solve(spread, left)) / max(len(coupled) - 1, 1)
    error = np.sqrt(max(misfit, 1.0) / (weighted @ by_one))
    return Pitch(found, float(np.hypot(error, MODEL * found)), 1.0 + found * stiffer)


def _by_turning(masses_kg: Array, stiffness_n_per_m: Array, heights: Array) -> tuple[Array, Array]:
    """Return, per m/N of the top floor, what couples the modes (k,), and by how much the storeys of a chain on a rigid
    base are stiffer than those of the chain that fits best, relative (n,)."""
    omega, shapes = modal(masses_kg, stiffness_n_per_m)
    by_storey = stiffness_slopes(shapes, stiffness_n_per_m)  # (modes, modes, storeys)
    turned = omega**2 * (shapes.T @ (masses_kg * heights))  # phi' K h
    stiffer = np.linalg.solve(by_storey.diagonal().T, turned**2)
    left = (by_storey @ stiffer - np.outer(turned, turned)) / np.outer(omega, omega)
    return left[np.triu_indices(len(omega), 1)], np.asarray(stiffer, dtype=float)
