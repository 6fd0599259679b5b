"""H-infinity loop shaping (Glover and McFarlane): the shaped loop made robust to errors of its coprime factors.

    G_s = W G,   W = k (s + w_i) / s,   |G_s| = 1 at the crossover,

with the identified actuator G. The controller K stabilises every plant whose normalised coprime factors differ
from those of G_s by less than 1 / gamma, gamma = (1 + `slack`) gamma_min, gamma_min = sqrt(1 + lambda_max(X Z)), X
and Z solutions of the Riccati equations of control and filter. u = W (K x - K(0) r); the reference leads by the
loop's lag (control.tracking).

Limits of use: a design whose gamma_min is above 4 has a shape that the actuator cannot have and is refused
(lower `crossover_hz`); a transport delay is not in the model. Designed in continuous time, sampled by Tustin's rule. It
needs a measured displacement.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_continuous_are

from rths_cli.control.state_space import discretise
from rths_cli.control.tracking import TRACKS, actuator, balanced, led
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Block, StateSpace

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "D. McFarlane, K. Glover: A loop shaping design procedure using H-infinity synthesis. IEEE Transactions on "
    "Automatic Control 37 (1992) 759-769; equations as in S. Skogestad, I. Postlethwaite, Multivariable Feedback "
    "Control, 9.4"
)
OPTIONS = {
    "crossover_hz": (10.0, 0.1, 200.0, "frequency at which the shaped loop has the gain 1"),
    "integral_hz": (2.0, 0.01, 100.0, "w_i over 2 pi, below which the loop integrates"),
    "slack": (0.1, 0.001, 10.0, "by how much gamma is above its least value, as a share of it"),
}
WORST = 4.0  # gamma_min of a shape that is still compatible with robustness (Skogestad and Postlethwaite)


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the controller with its reference, in discrete time."""
    system, _ = balanced(actuator(plant, "hinf"))
    given = {name: float(value or 0.0) for name, value in options.items()}
    at, corner = 2.0 * math.pi * given["crossover_hz"], 2.0 * math.pi * given["integral_hz"]
    n = len(system.A)
    here = (system.C @ np.linalg.solve(1j * at * np.eye(n) - system.A, system.B)).item()
    k = at / abs(here * (1j * at + corner))
    a = np.block([[system.A, system.B * k * corner], [np.zeros((1, n + 1))]])
    shaped = StateSpace(a, np.vstack([system.B * k, [[1.0]]]), np.hstack([system.C, [[0.0]]]), np.zeros((1, 1)))
    robust, least = robustified(shaped, given["slack"])
    if least > WORST:
        raise InputError(
            f"controller: hinf: gamma_min is {least:.3g}, above {WORST:g}: the actuator cannot have this loop "
            "robustly; lower crossover_hz or integral_hz"
        )
    m = len(robust.A)
    static = float((robust.C @ np.linalg.solve(-robust.A, robust.B)).item())
    # u = W e, e = K x - K(0) r: states of K, then the integral of e
    whole = np.block([[robust.A, np.zeros((m, 1))], [robust.C, np.zeros((1, 1))]])
    into = np.block([[np.zeros((m, 1)), robust.B], [np.array([[-static, 0.0]])]])
    out = np.hstack([k * robust.C, [[k * corner]]])
    made = StateSpace(whole, into, out, np.array([[-k * static, 0.0]]))
    return led(discretise(made, plant.dt_s, "bilinear", "hinf", TRACKS, ("command",)), plant, "hinf")


def robustified(shaped: StateSpace, slack: float) -> tuple[StateSpace, float]:
    """Return K (positive feedback) of a strictly proper shaped plant, and gamma_min."""
    A, B, C = shaped.A, shaped.B, shaped.C
    X = solve_continuous_are(A, B, C.T @ C, np.eye(1), balanced=True)
    Z = solve_continuous_are(A.T, C.T, B @ B.T, np.eye(1), balanced=True)
    least = math.sqrt(1.0 + float(np.linalg.eigvals(X @ Z).real.max()))
    gamma = (1.0 + slack) * least
    into = gamma**2 * np.linalg.solve(((1.0 - gamma**2) * np.eye(len(A)) + X @ Z).T, Z @ C.T)
    return StateSpace(A - B @ (B.T @ X) + into @ C, into, B.T @ X, np.zeros((1, 1))), least
