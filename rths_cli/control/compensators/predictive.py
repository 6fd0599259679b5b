"""Inverse of the identified table for the desired motion a few samples ahead, which its derivatives predict.

The inverse of `FF` (control.feedforward.lagged_inverse) lags by a time t: the table's delay and a low pass, a whole
number of samples. It is given the desired motion t ahead,

    d + t v + t^2/2 a + t^3/6 j,   v + t a + t^2/2 j,   a + t j,   j = (a[k] - a[k-1]) / dt,

so that nothing is late. The prediction errs by (w t)^4 / 24 in the displacement: t should be less than a tenth of the
shortest period that matters. A low pass that is shorter predicts better and makes the command louder: the numerical
substructure's acceleration, and noise of the measured force in it, pass the inverse. It knows the table as identified
and does not follow one that changes. A table with a zero in the right half plane has no stable inverse and is refused.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.feedforward import lagged_inverse, lead_samples
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Block

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "This project: the inverse is that of R. Zhang, P. V. Lauenstein, B. M. Phillips, Real-time hybrid simulation of a "
    "shear building with a uni-axial shake table (section 3), the prediction a Taylor series"
)
OPTIONS = {"low_pass_s": (0.001, 1e-6, 0.1, "least delay of the low pass that makes the inverse proper")}


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return inverse and prediction as one block."""
    if np.any(plant.model.zeros.real > 0.0):
        raise InputError(
            "controller: predictive has no stable inverse: the identified table has a zero in the right half plane; "
            "use another kind"
        )
    model, dt_s = plant.model, plant.dt_s
    if len(model.poles) <= len(model.zeros):  # its inverse is proper without a low pass, and lags by the delay alone
        return ahead(lagged_inverse(model, dt_s, 0), max(model.delay_s - plant.lead_samples * dt_s, 0.0))
    needed = (model.delay_s + float(options["low_pass_s"] or 0.0)) / dt_s
    samples = max(lead_samples(model, dt_s), int(np.ceil(needed - 1e-9)))
    return ahead(lagged_inverse(model, dt_s, samples), max(samples - plant.lead_samples, 0) * dt_s)


def ahead(inverse: Block, t: float) -> Block:
    """Return a block of desired acceleration, velocity and displacement that is given them `t` s ahead; its last state
    is the acceleration before."""
    n = len(inverse.A)
    by_jerk = np.array([[t], [t**2 / 2.0], [t**3 / 6.0]]) / inverse.dt_s
    now = np.array([[1.0, 0.0, 0.0], [t, 1.0, 0.0], [t**2 / 2.0, t, 1.0]])
    now[:, :1] += by_jerk
    a = np.block([[inverse.A, -inverse.B @ by_jerk], [np.zeros((1, n + 1))]])
    b = np.vstack([inverse.B @ now, [[1.0, 0.0, 0.0]]])
    return replace(inverse, A=a, B=b, C=np.hstack([inverse.C, -inverse.D @ by_jerk]), D=inverse.D @ now)
