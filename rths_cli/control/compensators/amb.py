"""Adaptive model-based compensation: a third-order inverse of the actuator that follows the gradient of its error.

    u = a_0 d + a_1 d' + a_2 d'' + a_3 d''',     a' = Gamma phi (u - phi^T a),  phi = (x, x', x'', x''')

with desired displacement d and measured displacement x. u and x in the adaptation pass one low pass; derivatives are
differences about the sample of u, where the source takes those behind it. The start is the series of the identified
model's inverse in the compared band; parameters are not negative. A sample's step is divided by
max(1, dt phi^T Gamma phi), so that it removes the error at most: the gains were published for motions of a few
millimetres and would be unstable for larger ones.

It needs a measured displacement. The rate of adaptation grows with the square of the motion. Judged at its start.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control.adaptation import filtered, inverse_series, low_pass
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
    "low_pass_hz": (20.0, 1.0, 200.0, "corner of the low pass, Butterworth of fourth order"),
}  # fmt: skip
STATES = 16  # two low passes (8), displacement before (3), acceleration before, parameters less their start (4)


def design(plant: Plant, options: dict[str, float | None]) -> list[float]:
    """Return start, gains, interval and filter."""
    plant.needs_displacement("amb")
    start = np.maximum(inverse_series(plant, order=3), 0.0)
    gains = [10.0 ** float(options[f"gain_{i}"] or 0.0) for i in range(4)]
    return [*start, *gains, plant.dt_s, *low_pass(float(options["low_pass_hz"] or 0.0), plant.dt_s)]


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
    next_state[12] = max(state[12] + p[4] * x1 * step, -p[0])
    next_state[13] = max(state[13] + p[5] * velocity * step, -p[1])
    next_state[14] = max(state[14] + p[6] * accel * step, -p[2])
    next_state[15] = max(state[15] + p[7] * jerk * step, -p[3])
    next_state[11] = desired[0]
    made = (p[0] + next_state[12]) * desired[2] + (p[1] + next_state[13]) * desired[1]
    return made + (p[2] + next_state[14]) * desired[0] + (p[3] + next_state[15]) * (desired[0] - state[11]) / dt


def linear(parameters: Array, dt_s: float) -> tuple[Any, Any, Any, Any]:
    """Return the law at its start; its state is the desired acceleration before."""
    a0, a1, a2, a3 = parameters[:4]
    direct = np.array([[a2 + a3 / dt_s, a1, a0]])
    return np.zeros((1, 1)), np.array([[1.0, 0.0, 0.0]]), np.array([[-a3 / dt_s]]), direct
