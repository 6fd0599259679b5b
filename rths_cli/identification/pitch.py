"""Pitch of the specimen's base, from the stiffness that couples the modes of a chain of storeys.

A table on soft guides, or a specimen on a soft plate, pitches by theta = sum of h m a / k, and a floor at height h
moves by h theta more. This adds c h h' to the flexibility of the specimen: for heights relative to the top floor with
c = h_top^2 / k. A chain of storeys has no such term. So in the modes of the chain that fits best a stiffness

    K = K_rigid - c (K h) (K h)'

remains that couples them, to first order in c. Its diagonal is that of other storey stiffnesses; what is then left
beside it is proportional to c. Of one floor pitch is not seen: it looks like a softer storey.

Not in this: the weight along the pitched floors, of which an accelerometer shows g theta, and the inertia of the base.
"""

from __future__ import annotations

import numpy as np

from rths_cli.identification.results import Pitch
from rths_cli.identification.sensor_calibration import Fitted
from rths_cli.identification.specimen_fit import modal, stiffness_slopes
from rths_cli.numerics.lti import Array

MODEL = 0.1  # relative standard uncertainty: weight along the floors, the base's own resonance, unequal storeys


def pitch(fitted: Fitted, heights_m: Array | None = None) -> Pitch | None:
    """Return how the base under a fitted chain pitches; None for one floor, where sensors or masses were taken as exact
    (what they are off by would be taken for pitch), and where the fit has not settled.

    `heights_m` (n,) are those of the storeys, None: all the same. Of three floors and more, what couples the modes in
    another way than pitch does widens the uncertainty.
    """
    coupled, spread = fitted.coupled_stiffness
    if not len(coupled) or not fitted.problem.priors.none_exact or not fitted.settled:
        return None
    heights = np.cumsum(np.ones(len(fitted.masses_kg)) if heights_m is None else heights_m)
    by_c, stiffer = _by_pitch(fitted.masses_kg, fitted.stiffness_n_per_m, heights / heights[-1])
    weighted = np.linalg.solve(spread, by_c)
    found = float(weighted @ coupled / (weighted @ by_c))
    left = coupled - found * by_c
    misfit = float(left @ np.linalg.solve(spread, left)) / max(len(coupled) - 1, 1)
    error = np.sqrt(max(misfit, 1.0) / (weighted @ by_c))
    return Pitch(found, float(np.hypot(error, MODEL * found)), 1.0 + found * stiffer)


def _by_pitch(masses_kg: Array, stiffness_n_per_m: Array, heights: Array) -> tuple[Array, Array]:
    """Return, per m/N of the top floor, what couples the modes (k,), and by how much the storeys of a chain on a rigid
    base are stiffer than those of the chain that fits best, relative (n,)."""
    omega, shapes = modal(masses_kg, stiffness_n_per_m)
    by_storey = stiffness_slopes(shapes, stiffness_n_per_m)  # (modes, modes, storeys)
    carried = omega**2 * (shapes.T @ (masses_kg * heights))  # phi' K h
    stiffer = np.linalg.solve(by_storey.diagonal().T, carried**2)
    left = (by_storey @ stiffer - np.outer(carried, carried)) / np.outer(omega, omega)
    return left[np.triu_indices(len(omega), 1)], np.asarray(stiffer, dtype=float)
