"""Adaptive model-based compensation: a third-order inverse of the actuator that follows the gradient of its error.

    u = a_0 d + a_1 d' + a_2 d'' + a_3 d''',     a' = Gamma phi (u - phi^T a),  phi = (x, x', x'', x''')

with desired displacement d and measured displacement x. u and x in the adaptation pass one low pass; derivatives are
differences about the sample of u, where the source takes those behind it. The start is the series of the identified
model's inverse in the compared band; each parameter stays within `range` of its start, not below zero, and changes by
no more than `rate_per_s`, where the source bounds them below only. A sample's step is divided by
max(1, dt phi^T Gamma phi), so that it removes the error at most: the gains were published for motions of a few
millimetres and would be unstable for larger ones.

It needs a measured displacement. The rate of adaptation grows with the square of the motion. Its command is affine in
the parameters; the check judges it over their range.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control.adaptation import filtered, inverse_series, low_pass, moved
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "C. Galmez, G. Fermandois: Robust adaptive model-based compensator for the real-time hybrid simulation benchmark. "
    "Frontiers in Built Environment 8 (2022) 962952"
)
OPTIONS = {
    **{f"gain_{i}": (power, -20.0, 20.0, f"power of ten of Gamma for a_{i}")
       for i, power in enumerate((8.4, 6.2, 2.1, 0.8))},
    "range": (1.0, 0.0, 10.0, "by how much each parameter may differ from its start, as a share of it"),
    "rate_per_s": (5.0, 0.0, 1e3, "largest change of each parameter in a second, as a share of its start"),
    "low_pass_hz": (20.0, 1.0, 200.0, "corner of the low pass, Butterworth of fourth order"),
}  # fmt: skip
ADAPTS = {"a_0": "", "a_1": "s", "a_2": "s^2", "a_3": "s^3"}
STATES = 16  # two low passes (8), displacement before (3), acceleration before, parameters less their start (4)


def design(plant: Plant, options: dict[str, float | None]) -> list[float]:
    """Return start, gains, interval and filter."""
    plant.needs_displacement("amb")
    start = np.maximum(inverse_series(plant, order=3), 0.0)
    gains = [10.0 ** float(options[f"gain_{i}"] or 0.0) for i in range(4)]
    share, rate = float(options["range"] or 0.0), plant.dt_s * float(options["rate_per_s"] or 0.0)
    lows, highs, rates = np.maximum(start - share * start, 0.0), start + share * start, rate * start
    filter_ = low_pass(float(options["low_pass_hz"] or 0.0), plant.dt_s)
    return [*start, *gains, plant.dt_s, *filter_, *lows, *highs, *rates]


def command(p: Array, state: Array, next_state: Array, desired: Array, measured: Array, sent: float) -> float:
    """Return the command in m."""
    dt = p[8]
    u = filtered(p, 9, state, next_state, 0, sent)
    x = filtered(p, 9, state, next_state, 4, measured[0])
    x1, x2, x3 = state[8], state[9], state[10]
    next_state[8], next_state[9], next_state[10] = x, x1, x2
    velocity, accel = (x - x2) / (2.0 * dt), (x - 2.0 * x1 + x2) / (dt * dt)
    jerk = (x - 3.0 * x1 + 3.0 * x2 - x3) / (dt * dt * dt)
    error = u - (p[0] + state[12]) * x1 - (p[1] + state[13]) * velocity - (p[2] + state[14]) * accel
    error -= (p[3] + state[15]) * jerk
    size = dt * (p[4] * x1 * x1 + p[5] * velocity * velocity + p[6] * accel * accel + p[7] * jerk * jerk)
    step = dt * error / max(1.0, size)
    next_state[12] = state[12] + p[4] * x1 * step
    next_state[13] = state[13] + p[5] * velocity * step
    next_state[14] = state[14] + p[6] * accel * step
    next_state[15] = state[15] + p[7] * jerk * step
    for i in range(4):
        next_state[12 + i] = moved(state[12 + i], next_state[12 + i], p[27 + i], p[19 + i] - p[i], p[23 + i] - p[i])
    next_state[11] = desired[0]
    made = (p[0] + next_state[12]) * desired[2] + (p[1] + next_state[13]) * desired[1]
    return made + (p[2] + next_state[14]) * desired[0] + (p[3] + next_state[15]) * (desired[0] - state[11]) / dt


def bounds(parameters: Array, dt_s: float) -> tuple[Array, Array, Array, Array]:
    """Return start, least, most and largest change in a second of a_0 to a_3."""
    return parameters[:4], parameters[19:23], parameters[23:27], parameters[27:31] / dt_s


def linear(parameters: Array, dt_s: float, adapted: Array) -> tuple[Any, Any, Any, Any]:
    """Return the law at the parameters `adapted`; its state is the desired acceleration before."""
    a0, a1, a2, a3 = adapted
    direct = np.array([[a2 + a3 / dt_s, a1, a0]])
    return np.zeros((1, 1)), np.array([[1.0, 0.0, 0.0]]), np.array([[-a3 / dt_s]]), direct
