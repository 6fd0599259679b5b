"""Smith predictor: PI control of the displacement that the actuator would show without its transport delay.

    u = (k_p + k_i / s) (r - x_0 - (x - x_n)),

with the displacement x_0 of the identified actuator's model without delay, driven by u, and x_n the same late by the
delay's n samples. With a perfect model x - x_n is zero: the delay is no part of the characteristic polynomial, and the
gains may be those of the actuator without delay. The response stays late by it; the reference r leads by the loop's lag
(control.tracking).

Limits of use: a delay that is not the identified one, and poles that move, come back into the polynomial; the model's
own poles stay, so that a disturbance decays no faster than the actuator's slowest; the delay is a whole number of
samples. It needs a measured displacement.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.state_space import discretise
from rths_cli.control.tracking import TRACKS, actuator, late_samples, led
from rths_cli.numerics.lti import Array, Block

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = "O. J. M. Smith: Closer control of loops with dead time. Chemical Engineering Progress 53 (1957) 217-219"
OPTIONS = {
    "proportional": (2.0, 0.0, 1000.0, "k_p, command over displacement error"),
    "integral_per_s": (95.0, 0.0, 1e5, "k_i in 1/s"),
}


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the predictor with its reference."""
    return led(predictor(plant, float(options["proportional"] or 0.0), float(options["integral_per_s"] or 0.0)),
               plant, "smith")  # fmt: skip


def predictor(plant: Plant, proportional: float, integral_per_s: float) -> Block:
    """Return the controller: states are the integral, the model's and its displacements of the samples before."""
    model = discretise(actuator(plant, "smith"), plant.dt_s, "zoh", "model", ("command",), ("displacement",))
    late, m = late_samples(plant), len(model.A)
    error = np.zeros((1, 1 + m + late))  # r - x less what it takes from the states: x_0 - x_n
    error[0, 1 : 1 + m] -= model.C[0]
    if late:
        error[0, -1] += 1.0
    else:
        error[0, 1 : 1 + m] += model.C[0]
    given = np.array([[1.0, -1.0]])
    c, d = proportional * error, proportional * given
    c[0, 0] += 1.0
    a, b = np.zeros((1 + m + late, 1 + m + late)), np.zeros((1 + m + late, 2))
    step = plant.dt_s * integral_per_s
    a[0], b[0] = step * error[0], step * given[0]
    a[0, 0] += 1.0
    a[1 : 1 + m, 1 : 1 + m] = model.A
    a[1 : 1 + m] += model.B @ c
    b[1 : 1 + m] = model.B @ d
    if late:
        a[1 + m, 1 : 1 + m] = model.C[0]
        a[2 + m :, 1 + m : -1] = np.eye(late - 1)
    return _block(a, b, c, d, plant.dt_s)


def _block(a: Array, b: Array, c: Array, d: Array, dt_s: float) -> Block:
    return Block("smith", a, b, c, d, dt_s, TRACKS, ("command",))
