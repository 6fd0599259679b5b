"""The predictive inverse, which follows an actuator or a table that is no longer the identified one.

The identified model G runs beside it with the command that was sent. What is measured beyond the model's signal x
(displacement of an actuator, acceleration of a table) is explained by that signal and its derivatives, which have no
noise,

    measured - x = g x + tau x' + rho x'',   in the least-squares sense over a memory that fades,

so the actuator is G (1 + g + tau s + rho s^2). The desired motion is divided by that factor, to second order in s,
before the predictive inverse of G:

    d -> b_0 d + b_1 d' + b_2 d'',   b_0 = 1 / (1 + g),  b_1 = -tau b_0^2,  b_2 = -rho b_0^2 + tau^2 b_0^3.

Both sides of the fit pass one low pass; derivatives are central differences. Because the regressors are the model's
own, noise of the sensor does not bias the parameters; b_0, b_1, b_2 are bounded, change no faster than stated, and stay
at 1, 0, 0 while the motion is smaller than `least_m`, of a table `least_m_s2`. The command is affine in them: the check
judges the law over their range. A narrow change, such as another resonance of the specimen, is no factor of second
order and is not followed. Nor is dry friction of a table, which the fit takes for delay: 30 % of El Centro on
aps400_virtual ends with 8.8 % of SIM, with `predictive` 0.52 %.
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
    "memory_s": (3.0, 0.02, 100.0, "time constant with which the fit forgets"),
    "range_gain": (0.15, 0.0, 0.9, "by how much b_0 may differ from 1"),
    "range_delay_s": (0.003, 0.0, 0.1, "largest size of b_1"),
    "range_second_s2": (1e-5, 0.0, 0.01, "largest size of b_2"),
    "rate_per_s": (5.0, 0.0, 1e3, "largest change of each parameter in a second, as a share of its range"),
    "low_pass_hz": (20.0, 1.0, 200.0, "corner of the low pass, Butterworth of fourth order"),
    "least_m": (1e-5, 1e-9, 1.0, "rms motion of an actuator below which the parameters stay at their start"),
    "least_m_s2": (0.02, 1e-6, 100.0, "rms acceleration of a table below which the parameters stay at their start"),
}
ADAPTS = {"b_0": "", "b_1": "s", "b_2": "s^2"}
MOST = 16  # states of the inverse, and of the model
LATE = 20  # samples of transport delay of the model
INVERSE, MODEL, FILTERS, MEANS = 0, MOST, 2 * MOST, 2 * MOST + 8
BEFORE, SIGNAL, SHOWN, LINE = MEANS + 9, MEANS + 10, MEANS + 12, MEANS + 13
FITTED = LINE + LATE
STATES = FITTED + 3
# inverse, model, two low passes, means, desired acceleration, two signals and one sample before, commands, parameters
BLOCK = 24  # where the numbers of the inverse begin (A, B, C, D of MOST states); those of the model; its delay
OF_MODEL = BLOCK + MOST * MOST + 3 * MOST + MOST + 3
DELAY = OF_MODEL + MOST * MOST + 2 * MOST + 1


def design(plant: Plant, options: dict[str, float | None]) -> list[float]:
    """Return limits, filter, predictive inverse, model and the weights of its late commands."""
    given = {name: float(value or 0.0) for name, value in options.items()}
    inverse = inverse_of(plant, {"low_pass_s": given["low_pass_s"]})
    of_disp, zeros = plant.interface == "displacement", plant.model.zeros
    system = from_roots(zeros[np.abs(zeros) > 1e-9] if of_disp else zeros, plant.model.poles, plant.model.gain)
    model = discretise(system, plant.dt_s, "zoh", "model", ("command",), ("signal",))
    whole, part = divmod(max(plant.model.delay_s / plant.dt_s - 0.5, 0.0), 1.0)
    if len(inverse.A) > MOST or len(model.A) > MOST or whole + 1 >= LATE:
        raise InputError(
            f"controller: predictive_adaptive has room for {MOST} states of inverse and model and {LATE - 1} samples "
            "of delay; use predictive"
        )
    ranges = [given[f"range_{name}"] for name in ("gain", "delay_s", "second_s2")]
    limits = [*ranges, *(plant.dt_s * given["rate_per_s"] * one for one in ranges)]
    corner = 2.0 * math.pi * given["low_pass_hz"]
    least = given["least_m" if of_disp else "least_m_s2"] ** 2
    fades = math.exp(-plant.dt_s / given["memory_s"])
    head = [*limits, 1.0, 1.0 / corner, 1.0 / corner**2, fades, least, plant.dt_s]
    head += low_pass(given["low_pass_hz"], plant.dt_s)
    parts = (inverse.A, inverse.B, inverse.C, inverse.D), (model.A, model.B, model.C, model.D)
    shapes = ((MOST, MOST), (MOST, 3), (1, MOST), (1, 3)), ((MOST, MOST), (MOST, 1), (1, MOST), (1, 1))
    numbers = [_padded(one, shape) for some, of in zip(parts, shapes, strict=True)
               for one, shape in zip(some, of, strict=True)]  # fmt: skip
    late = np.zeros(LATE)
    late[int(whole)], late[int(whole) + 1] = 1.0 - part, part
    return [*head, *np.zeros(BLOCK - len(head)), *np.concatenate(numbers), *late]


def _padded(matrix: Array, shape: tuple[int, int]) -> Array:
    whole = np.zeros(shape)
    whole[: matrix.shape[0], : matrix.shape[1]] = matrix
    return whole.ravel()


def command(p: Array, state: Array, next_state: Array, desired: Array, measured: Array, sent: float) -> float:
    """Return the command."""
    x = filtered(p, 12, state, next_state, FILTERS + 4, measured[0])
    next_state[LINE] = filtered(p, 12, state, next_state, FILTERS, sent)
    u = p[DELAY] * next_state[LINE]
    for i in range(1, LATE):
        next_state[LINE + i] = state[LINE + i - 1]
        u += p[DELAY + i] * next_state[LINE + i]
    into, out = OF_MODEL + MOST * MOST, OF_MODEL + MOST * MOST + MOST
    signal = p[out + MOST] * u
    for i in range(MOST):
        made = p[into + i] * u
        for j in range(MOST):
            made += p[OF_MODEL + i * MOST + j] * state[MODEL + j]
        next_state[MODEL + i] = made
        signal += p[out + i] * made
    middle, first = state[SIGNAL], state[SIGNAL + 1]
    next_state[SIGNAL], next_state[SIGNAL + 1], next_state[SHOWN] = signal, middle, x
    rate, bend = (signal - first) / (2.0 * p[11]), (signal - 2.0 * middle + first) / (p[11] * p[11])
    remember(state, next_state, MEANS, middle, p[7] * rate, p[8] * bend, state[SHOWN] - middle, p[9])
    tau, rho = p[7] * fitted(next_state, MEANS, p[10], 1), p[8] * fitted(next_state, MEANS, p[10], 2)
    b0 = 1.0 / max(1.0 + fitted(next_state, MEANS, p[10], 0), 0.1)
    wanted = b0 - 1.0, -tau * b0 * b0, -rho * b0 * b0 + tau * tau * b0 * b0 * b0
    for i in range(3):
        next_state[FITTED + i] = moved(state[FITTED + i], wanted[i], p[3 + i], -p[i], p[i])
    b0, b1, b2 = 1.0 + next_state[FITTED], next_state[FITTED + 1], next_state[FITTED + 2]
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


def bounds(parameters: Array, dt_s: float) -> tuple[Array, Array, Array, Array]:
    """Return start, least, most and largest change in a second of b_0, b_1, b_2."""
    start = np.array([1.0, 0.0, 0.0])
    return start, start - parameters[:3], start + parameters[:3], parameters[3:6] / dt_s


def linear(parameters: Array, dt_s: float, adapted: Array) -> tuple[Any, Any, Any, Any]:
    """Return the law at the parameters `adapted`; its last state is the desired acceleration before."""
    shapes = (MOST, MOST), (MOST, 3), (1, MOST), (1, 3)
    ends = BLOCK + np.cumsum([rows * columns for rows, columns in shapes])
    A, B, C, D = (parameters[end - rows * columns : end].reshape(rows, columns)
                  for end, (rows, columns) in zip(ends, shapes, strict=True))  # fmt: skip
    used = np.flatnonzero(A.any(axis=0) | A.any(axis=1) | B.any(axis=1) | C[0].astype(bool))
    b0, b1, b2 = adapted
    now = np.array([[b0 + b1 / dt_s, 0.0, 0.0], [b1 + b2 / dt_s, b0, 0.0], [b2, b1, b0]])
    before = np.array([[-b1 / dt_s], [-b2 / dt_s], [0.0]])
    n = len(used)
    a = np.block([[A[np.ix_(used, used)], B[used] @ before], [np.zeros((1, n + 1))]])
    b = np.vstack([B[used] @ now, [[1.0, 0.0, 0.0]]])
    return a, b, np.hstack([C[:, used], D @ before]), D @ now
