"""Are floors and table sampled at one instant? The specimen's fit once more, with a common delay of the floors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rths_cli.identification.specimen import ABOVE_HIGHEST, Motion, Start, modal, residual, transform
from rths_cli.lti import Array

EXPLAINS = 0.5


def skew(motions: Sequence[Motion], dt_s: float, masses_kg: Array, low_hz: float, start: Start) -> tuple[float, float]:
    """Return by how many samples the floors come late against the table, and the standard error of that.

    It is zero where a delay leaves half of what the specimen does not explain, or more: then that has another cause.
    """
    from scipy.optimize import least_squares

    masses = np.asarray(masses_kg, dtype=float)
    highest = modal(masses, start.stiffness_n_per_m)[0][-1] / (2.0 * np.pi)
    lines = [transform(motion, dt_s, (low_hz, ABOVE_HIGHEST * highest)) for motion in motions]

    def left(theta: Array) -> Array:
        late = [replace(part, table=part.table * np.exp(-part.s * dt_s * theta[-1])) for part in lines]
        return np.concatenate([residual(part, masses, theta[:-1]) for part in late])

    first = np.append(np.log(np.concatenate([start.stiffness_n_per_m, start.damping_ratio])), 0.0)
    found = least_squares(left, first, method="lm", xtol=1e-8, ftol=1e-8)
    if float(np.linalg.norm(found.fun)) > EXPLAINS * float(np.linalg.norm(left(first))):
        return 0.0, 0.0
    variance = float(found.fun @ found.fun) / max(len(found.fun) - len(first), 1)
    covariance = variance * np.linalg.pinv(found.jac.T @ found.jac)
    return float(found.x[-1]), float(np.sqrt(covariance[-1, -1]))
