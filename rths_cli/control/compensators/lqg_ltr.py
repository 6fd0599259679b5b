"""LQG control with loop transfer recovery: optimal state feedback and integral, behind a Kalman filter.

    u = -k x_e - k_i xi,   xi' = x - r,   x_e' = A x_e + B u + l (x - r - C x_e),

with the identified actuator A, B, C. k, k_i minimise the integral of (x - r)^2 + w^2 xi^2 + c u^2; l is the Kalman gain
for a unit noise of the displacement and a process noise q B B'. For an actuator without zeros in the right half plane
the loop at the command tends, as q grows, to that of the state feedback, k (s - A)^-1 B, with its margins of 60 degrees
and a factor from 1/2 to infinity. The reference leads by the loop's lag (control.tracking).

Limits of use: what is recovered is paid for with noise of the displacement in the command; a transport delay is not in
the model, and a zero in the right half plane refuses. Designed in continuous time, sampled by Tustin's rule. It needs a
measured displacement.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_continuous_are

from rths_cli.control.state_space import discretise
from rths_cli.control.tracking import TRACKS, actuator, balanced, led
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, StateSpace

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "J. C. Doyle, G. Stein: Multivariable feedback design: concepts for a classical/modern synthesis. IEEE "
    "Transactions on Automatic Control 26 (1981) 4-16"
)
OPTIONS = {
    "integral_hz": (3.0, 0.01, 100.0, "w over 2 pi, corner of the integral"),
    "command_weight": (0.001, 1e-6, 1e6, "c, cost of the command, relative to the square of the actuator's gain"),
    "recovery": (1e4, 1e-6, 1e12, "q of the process noise, relative to the noise of the displacement, in 1/s"),
}


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the regulator with its reference, in discrete time."""
    if np.any(plant.model.zeros.real > 1e-9):
        raise InputError("controller: lqg_ltr recovers nothing with a zero in the right half plane; use another kind")
    system, _ = balanced(actuator(plant, "lqg_ltr"))
    given = {name: float(value or 0.0) for name, value in options.items()}
    feedback, gain = gains(system, 2.0 * math.pi * given["integral_hz"], given["command_weight"], given["recovery"])
    n = len(system.A)
    k, ki = feedback[:, :n], feedback[:, n:]
    a = np.block([[system.A - system.B @ k - gain @ system.C, -system.B @ ki], [np.zeros((1, n + 1))]])
    b = np.block([[-gain, gain], [-np.ones((1, 1)), np.ones((1, 1))]])
    made = StateSpace(a, b, -np.hstack([k, ki]), np.zeros((1, 2)))
    return led(discretise(made, plant.dt_s, "bilinear", "lqg_ltr", TRACKS, ("command",)), plant, "lqg_ltr")


def gains(system: StateSpace, integral_rad_s: float, command_weight: float, recovery: float) -> tuple[Array, Array]:
    """Return state feedback (1, n + 1), the integral's last, and Kalman gain (n, 1) of an actuator."""
    A, B, C = system.A, system.B, system.C
    n = len(A)
    static = float((C @ np.linalg.solve(-A, B)).item())
    whole = np.block([[A, np.zeros((n, 1))], [C, np.zeros((1, 1))]])
    into = np.vstack([B, [[0.0]]])
    cost = np.zeros((n + 1, n + 1))
    cost[:n, :n], cost[n, n] = C.T @ C, integral_rad_s**2
    weight = np.array([[command_weight * static**2]])
    X = solve_continuous_are(whole, into, cost, weight, balanced=True)
    Y = solve_continuous_are(A.T, C.T, recovery * (B @ B.T) / static**2, np.eye(1), balanced=True)
    return into.T @ X / weight, Y @ C.T
