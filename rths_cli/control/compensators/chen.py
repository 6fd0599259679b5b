"""Inverse compensation: the actuator as a first-order lag, inverted.

A table that makes of each difference between command and displacement the share 1 / alpha per sample is late by
(alpha - 1) samples; the command c of the desired displacement d undoes that,

    c[k] = alpha d[k] - (alpha - 1) d[k-1] = d[k] + (delay / dt) (d[k] - d[k-1]),  alpha = 1 + delay / dt.

Its gain grows with frequency, |C|^2 = 1 + 4 alpha (alpha - 1) sin^2(w dt / 2): at w delay = 1 it is 1.4, while a table
with a pure delay keeps a gain of 1. Use it for delays of a tenth of the shortest period, and at most.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Block

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "C. Chen, J. M. Ricles: Analysis of actuator delay compensation methods for real-time testing. Engineering "
    "Structures 31 (2009) 2643-2655"
)
OPTIONS = {"delay_s": (None, 0.0, 0.5, "delay of the table; default: its lag in the compared band, as identified")}


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the inverse of a first-order lag."""
    delay_s = max(plant.lag_s, 0.0) if options["delay_s"] is None else options["delay_s"]
    more = delay_s / plant.dt_s
    a, b, c = np.zeros((1, 1)), np.ones((1, 1)), np.array([[-more]])
    return plant.block(Block("chen", a, b, c, np.array([[1.0 + more]]), plant.dt_s))
