"""Polynomial extrapolation of the desired displacement over the delay.

The polynomial of the given order through the desired displacements d[k], d[k-m], d[k-2m], ... is evaluated `delay_s`
ahead, with the spacing m dt that is nearest to the delay, one sample at least (Lagrange; equal to Horiuchi's
4 d0 - 6 d1 + 4 d2 - d3 for order 3 and m dt = delay).

It is exact for polynomials of that order. At w delay = 1 third order amplifies 1.6 times, and beyond more: the delay
should be less than a sixth of the shortest period that the loop holds, and noise of the desired displacement is
amplified up to 15 times by third order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "T. Horiuchi, M. Inoue, T. Konno, Y. Namita: Real-time hybrid experimental system with actuator delay compensation "
    "and its application to a piping system with energy absorber. Earthquake Engineering and Structural Dynamics 28 "
    "(1999) 1121-1141"
)
OPTIONS = {
    "delay_s": (None, 0.0, 0.05, "delay of the table; default: its lag in the compared band, as identified"),
    "order": (3.0, 1.0, 5.0, "order of the polynomial, a whole number"),
}
MOST_SAMPLES = 400  # that the block remembers


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the extrapolation as a finite impulse response."""
    order = float(options["order"] or 0.0)
    if order != round(order):
        raise InputError(f"controller.order: must be a whole number, got {order:g}")
    delay_s = max(plant.lag_s, 0.0) if options["delay_s"] is None else options["delay_s"]
    spacing = max(round(delay_s / plant.dt_s), 1)
    count = spacing * round(order)
    if count > MOST_SAMPLES:
        raise InputError(
            f"controller.delay_s: {delay_s:g} s are {spacing} samples, {count} with order {order:g}; at most "
            f"{MOST_SAMPLES}; lower one of them"
        )
    taps = np.zeros(count + 1)
    taps[::spacing] = extrapolation(round(order), delay_s / (spacing * plant.dt_s))
    a, b = np.eye(count, k=-1), np.zeros((count, 1))
    b[0] = 1.0
    return plant.block(Block("horiuchi", a, b, taps[None, 1:], taps[None, :1], plant.dt_s))


def extrapolation(order: int, ahead: float) -> Array:
    """Return the weights (order + 1,) of values at 0, -1, -2, ... with which their polynomial is evaluated at
    `ahead`."""
    nodes = -np.arange(order + 1.0)
    return np.array([np.prod([(ahead - other) / (node - other) for other in nodes if other != node]) for node in nodes])
