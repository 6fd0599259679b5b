"""Second-order prediction from the desired velocity and acceleration, which the step knows beside the displacement,

    c = d + delay v + delay^2 / 2 a,

with desired displacement d, velocity v and acceleration a of the same instant. C(j w) = 1 + j w delay -
(w delay)^2 / 2: the gain differs from 1 by (w delay)^4 / 8, the phase from w delay by (w delay)^3 / 6. It remembers
nothing, and amplifies the acceleration of the numerical substructure: noise of the measured force that reaches it
directly becomes noise of the command.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.state_space import static
from rths_cli.numerics.lti import Block

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "M. Ahmadizadeh, G. Mosqueda, A. M. Reinhorn: Compensation of actuator delay and dynamics for real-time hybrid "
    "structural simulation. Earthquake Engineering and Structural Dynamics 37 (2008) 21-42"
)
OPTIONS = {"delay_s": (None, 0.0, 0.5, "delay of the table; default: its lag in the compared band, as identified")}
INPUTS = ("desired_disp_m", "desired_vel_m_s", "desired_accel_m_s2")


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the prediction, a block without memory."""
    delay_s = max(plant.lag_s, 0.0) if options["delay_s"] is None else options["delay_s"]
    weights = np.array([[1.0, delay_s, 0.5 * delay_s**2]]) / plant.gain_m_per_v
    return static(weights, plant.dt_s, "taylor", INPUTS, ("command_v",))
