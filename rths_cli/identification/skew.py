"""Are floors and table sampled at one instant? The specimen's fit once more, with a common delay of the floors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rths_cli.identification.chain import evaluated, modal
from rths_cli.identification.least_squares import covariance, least_squares
from rths_cli.identification.specimen import ABOVE_HIGHEST, Motion, Start, reach_of, transform
from rths_cli.lti import Array

EXPLAINS = 0.5
MOST_LEFT = 0.1  # of the floors' motion
LONGEST = 1000.0  # samples


def skew(motions: Sequence[Motion], dt_s: float, masses_kg: Array, low_hz: float, start: Start) -> tuple[float, float]:
    """Return by how many samples the floors come late against the table, and the standard error of that.

    It is zero where a delay leaves half of what the specimen does not explain, or a tenth of the floors' motion: then
    that has another cause.
    """
    masses = np.asarray(masses_kg, dtype=float)
    highest = modal(masses, start.stiffness_n_per_m)[0][-1] / (2.0 * np.pi)
    lines = [transform(motion, dt_s, (low_hz, ABOVE_HIGHEST * highest)) for motion in motions]

    def left(theta: Array) -> tuple[Array, Array]:
        late = [replace(part, table=part.table * np.exp(-part.s * dt_s * theta[-1])) for part in lines]
        residual, slopes = evaluated(late, masses, theta[:-1])
        slopes[-1] *= dt_s
        return residual, slopes

    first = np.append(np.log(np.concatenate([start.stiffness_n_per_m, start.damping_ratio])), 0.0)
    found = least_squares(left, first, reach=np.append(reach_of(len(masses)), LONGEST))
    unexplained = float(np.linalg.norm(left(first)[0]))
    if found.size > min(EXPLAINS * unexplained, MOST_LEFT * np.sqrt(len(motions))):
        return 0.0, 0.0
    variance = found.size**2 / max(len(found.residual) - len(first), 1)
    return float(found.parameters[-1]), float(np.sqrt(covariance(found.slopes, variance)[-1, -1]))
