"""The predictive inverse, which follows an actuator that is no longer the identified one.

The model G of the identified actuator runs beside it with the command that was sent. What is measured beyond the
model's displacement x is explained by that displacement and its derivatives, which have no noise,

    measured - x = g x + tau x' + rho x'',   in the least-squares sense over a memory that fades,

so the actuator is G (1 + g + tau s + rho s^2). The desired motion is divided by that factor, to second order in s,
before the predictive inverse of G:

    d -> b_0 d + b_1 d' + b_2 d'',   b_0 = 1 / (1 + g),  b_1 = -tau b_0^2,  b_2 = -rho b_0^2 + tau^2 b_0^3.

Both sides of the fit pass one low pass. Because the regressors are the model's own, noise of the sensor does not bias
the parameters; they are bounded, change no faster than stated, and stay at zero while the actuator moves less than
`least_m`. It needs a measured displacement, and the actuator's transport delay must be that of its hold. It is
judged at its start, as `predictive`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control.adaptation import filtered, fitted, low_pass, moved, remember
from rths_cli.control.compensators.predictive import OPTIONS as OF_INVERSE
from rths_cli.control.compensators.predictive import design as inverse_of
from rths_cli.control.state_space import discretise, from_roots
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "This project; the idea of a series whose parameters are fitted while the test runs: Y. Chae, K. Kazemibidhokhti, "
    "J. M. Ricles, Earthquake Engineering and Structural Dynamics 42 (2013) 1697-1715"
)
OPTIONS = {
    **OF_INVERSE,
    "memory_s": (0.5, 0.02, 100.0, "time constant with which the fit forgets"),
    "range_gain": (0.3, 0.0, 0.9, "largest size of g"),
    "range_delay_s": (0.01, 0.0, 0.1, "largest size of tau"),
    "range_second_s2": (1e-4, 0.0, 0.01, "largest size of rho"),
    "rate_per_s": (5.0, 0.0, 1e3, "largest change of each parameter in a second, as a share of its range"),
    "low_pass_hz": (20.0, 1.0, 200.0, "corner of the low pass, Butterworth of fourth order"),
    "least_m": (1e-5, 1e-9, 1.0, "rms motion below which the parameters stay near zero"),
}
MOST = 10  # states of the inverse, and of the model
STATES = 2 * MOST + 8 + 9 + 3 + 1  # inverse, model, two low passes, means, parameters, acceleration before
INVERSE, MODEL, FILTERS, MEANS, FITTED, BEFORE = 0, MOST, 2 * MOST, 2 * MOST + 8, 2 * MOST + 17, 2 * MOST + 20
# where the numbers of the inverse begin (A, B, C, D of MOST states), and those of the model
BLOCK = 24
OF_MODEL = BLOCK + MOST * MOST + 3 * MOST + MOST + 3


def design(plant: Plant, options: dict[str, float | None]) -> list[float]:
    """Return limits, filter, predictive inverse and model."""
    plant.needs_displacement("predictive_adaptive")
    inverse = inverse_of(plant, {"low_pass_s": options["low_pass_s"]})
    finite = plant.model.zeros[np.abs(plant.model.zeros) > 1e-9]
    system = from_roots(finite, plant.model.poles, plant.model.gain)
    model = discretise(system, plant.dt_s, "zoh", "model", ("command",), ("displacement",))
    if len(inverse.A) > MOST or len(model.A) > MOST:
        raise InputError(f"controller: predictive_adaptive has room for {MOST} states of inverse and model each")
    given = {name: float(value or 0.0) for name, value in options.items()}
    ranges = [given[f"range_{name}"] for name in ("gain", "delay_s", "second_s2")]
    limits = [*ranges, *(plant.dt_s * given["rate_per_s"] * one for one in ranges)]
    scales = [1.0, 1.0 / (2.0 * math.pi * given["low_pass_hz"]), 1.0 / (2.0 * math.pi * given["low_pass_hz"]) ** 2]
    fades = math.exp(-plant.dt_s / given["memory_s"])
    head = [*limits, *scales, fades, given["least_m"] ** 2, plant.dt_s, *low_pass(given["low_pass_hz"], plant.dt_s)]
    outputs = np.vstack([system.C, system.C @ system.A, system.C @ system.A @ system.A])
    direct = np.vstack([np.zeros((1, 1)), outputs[:2] @ system.B])  # of velocity and acceleration by the command
    parts = (inverse.A, inverse.B, inverse.C, inverse.D), (model.A, model.B, outputs, direct)
    shapes = ((MOST, MOST), (MOST, 3), (1, MOST), (1, 3)), ((MOST, MOST), (MOST, 1), (3, MOST), (3, 1))
    numbers = [_padded(one, shape) for some, of in zip(parts, shapes, strict=True)
               for one, shape in zip(some, of, strict=True)]  # fmt: skip
    return [*head, *np.zeros(BLOCK - len(head)), *np.concatenate(numbers)]


def _padded(matrix: Array, shape: tuple[int, int]) -> Array:
    whole = np.zeros(shape)
    whole[: matrix.shape[0], : matrix.shape[1]] = matrix
    return whole.ravel()


def command(p: Array, state: Array, next_state: Array, desired: Array, measured: Array, sent: float) -> float:
    """Return the command in m."""
    u = filtered(p, 12, state, next_state, FILTERS, sent)
    x = filtered(p, 12, state, next_state, FILTERS + 4, measured[0])
    at = OF_MODEL + MOST * MOST + MOST  # of the outputs
    place, velocity, accel = 0.0, p[at + 3 * MOST + 1] * u, p[at + 3 * MOST + 2] * u
    for i in range(MOST):
        made = p[OF_MODEL + MOST * MOST + i] * u
        for j in range(MOST):
            made += p[OF_MODEL + i * MOST + j] * state[MODEL + j]
        next_state[MODEL + i] = made
        place += p[at + i] * made
        velocity += p[at + MOST + i] * made
        accel += p[at + 2 * MOST + i] * made
    remember(state, next_state, MEANS, place, p[7] * velocity, p[8] * accel, x - place, p[9])
    for i in range(3):
        wanted = p[6 + i] * fitted(next_state, MEANS, p[10], i)
        next_state[FITTED + i] = moved(state[FITTED + i], wanted, p[3 + i], -p[i], p[i])
    b0 = 1.0 / (1.0 + next_state[FITTED])
    b1 = -next_state[FITTED + 1] * b0 * b0
    b2 = -next_state[FITTED + 2] * b0 * b0 + next_state[FITTED + 1] ** 2 * b0 * b0 * b0
    jerk = (desired[0] - state[BEFORE]) / p[11]
    next_state[BEFORE] = desired[0]
    a = b0 * desired[0] + b1 * jerk
    v = b0 * desired[1] + b1 * desired[0] + b2 * jerk
    d = b0 * desired[2] + b1 * desired[1] + b2 * desired[0]
    of_b, of_c = BLOCK + MOST * MOST, BLOCK + MOST * MOST + 3 * MOST
    made = p[of_c + MOST] * a + p[of_c + MOST + 1] * v + p[of_c + MOST + 2] * d
    for i in range(MOST):
        made += p[of_c + i] * state[INVERSE + i]
        after = p[of_b + 3 * i] * a + p[of_b + 3 * i + 1] * v + p[of_b + 3 * i + 2] * d
        for j in range(MOST):
            after += p[BLOCK + i * MOST + j] * state[INVERSE + j]
        next_state[INVERSE + i] = after
    return made


def linear(parameters: Array, dt_s: float) -> tuple[Any, Any, Any, Any]:
    """Return the predictive inverse, as it is at the start."""
    shapes = (MOST, MOST), (MOST, 3), (1, MOST), (1, 3)
    ends = BLOCK + np.cumsum([rows * columns for rows, columns in shapes])
    return tuple(
        parameters[end - rows * columns : end].reshape(rows, columns)
        for end, (rows, columns) in zip(ends, shapes, strict=True)
    )  # type: ignore[return-value]
