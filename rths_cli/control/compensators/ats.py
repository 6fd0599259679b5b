"""Adaptive time series: a second-order inverse of the actuator, fitted to command and displacement as they come.

    u = a_0 d + a_1 d' + a_2 d'',   a = arg min mean (u - a_0 x - a_1 x' - a_2 x'')^2,

with desired displacement d. Command and displacement pass the same low pass; velocity and acceleration are central
differences. The mean fades with a time constant of half the window, so that its samples are as old as those of Chae's
moving window on average. The parameters are bounded, change no faster than stated, and stay at their start while the
actuator moves less than `least_m`.

It needs a measured displacement. Noise of that displacement makes the parameters too small where the motion is small.
The check judges it over the range of its parameters, in which its command is affine.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control.adaptation import filtered, fitted, inverse_series, low_pass, moved, remember
from rths_cli.numerics.lti import Array
from rths_cli.numerics.user_functions import callable_in_commands

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "Y. Chae, K. Kazemibidokhti, J. M. Ricles: Adaptive time series compensator for delay compensation of "
    "servo-hydraulic actuator systems for real-time hybrid simulation. Earthquake Engineering and Structural Dynamics "
    "42 (2013) 1697-1715"
)
OPTIONS = {
    "start_0": (None, 0.1, 10.0, "a_0 at the start; default: by the identified model"),
    "start_1": (None, 0.0, 1.0, "a_1 at the start in s; default: by the identified model"),
    "start_2": (None, 0.0, 0.1, "a_2 at the start in s^2; default: by the identified model"),
    "range_0": (0.3, 0.0, 1.0, "by how much a_0 may differ from 1"),
    "most_1": (0.06, 0.0, 1.0, "largest a_1 in s, the least is 0"),
    "most_2": (0.0032, 0.0, 0.1, "largest a_2 in s^2, the least is 0"),
    "rate_0": (2.0, 0.0, 1e3, "largest change of a_0 in 1/s"),
    "rate_1": (0.05, 0.0, 1e3, "largest change of a_1 in s/s"),
    "rate_2": (0.001, 0.0, 1e3, "largest change of a_2 in s^2/s"),
    "window_s": (1.0, 0.05, 100.0, "length of the window"),
    "low_pass_hz": (20.0, 1.0, 200.0, "corner of the low pass, Butterworth of fourth order"),
    "least_m": (1e-5, 1e-9, 1.0, "rms motion below which the parameters stay near their start"),
}
ADAPTS = {"a_0": "", "a_1": "s", "a_2": "s^2"}
STATES = 22  # two low passes (8), displacement before (2), means (9), parameters less their start (3)


def design(plant: Plant, options: dict[str, float | None]) -> list[float]:
    """Return start, bounds, rates, scales and filter."""
    plant.needs_displacement("ats")
    by_model = inverse_series(plant)
    given = {name: float(value or 0.0) for name, value in options.items()}
    start = [float(by_model[i]) if options[f"start_{i}"] is None else given[f"start_{i}"] for i in range(3)]
    lows = [1.0 - given["range_0"], 0.0, 0.0]
    highs = [1.0 + given["range_0"], given["most_1"], given["most_2"]]
    rates = [plant.dt_s * given[f"rate_{i}"] for i in range(3)]
    fades = math.exp(-2.0 * plant.dt_s / given["window_s"])
    scales = [1.0, max(start[1] / start[0], 1e-6), max(start[2] / start[0], 1e-9)]
    filter_ = low_pass(given["low_pass_hz"], plant.dt_s)
    return [*start, *lows, *highs, *rates, *scales, fades, given["least_m"] ** 2, plant.dt_s, *filter_]


def command(p: Array, state: Array, next_state: Array, desired: Array, measured: Array, sent: float) -> float:
    """Return the command in m."""
    return followed(p, state, next_state, desired, measured, sent, 0.0)


@callable_in_commands
def followed(
    p: Array, state: Array, next_state: Array, desired: Array, measured: Array, sent: float, counts_m: float
) -> float:
    """Return the command of parameters that follow while the filtered displacement is `counts_m` at least, and stay
    otherwise."""
    u = filtered(p, 18, state, next_state, 0, sent)
    x = filtered(p, 18, state, next_state, 4, measured[0])
    place, velocity = state[8], (x - state[9]) / (2.0 * p[17])  # of the sample before, that of the command sent
    accel = (x - 2.0 * state[8] + state[9]) / (p[17] * p[17])
    next_state[8], next_state[9] = x, state[8]
    for i in range(10, STATES):
        next_state[i] = state[i]
    if abs(place) >= counts_m:
        error = u - p[0] * place - p[1] * velocity - p[2] * accel
        remember(state, next_state, 10, place, p[13] * velocity, p[14] * accel, error, p[15])
        for i in range(3):
            wanted = p[12 + i] * fitted(next_state, 10, p[16], i)
            next_state[19 + i] = moved(state[19 + i], wanted, p[9 + i], p[3 + i] - p[i], p[6 + i] - p[i])
    made = (p[0] + next_state[19]) * desired[2] + (p[1] + next_state[20]) * desired[1]
    return made + (p[2] + next_state[21]) * desired[0]


def bounds(parameters: Array, dt_s: float) -> tuple[Array, Array, Array, Array]:
    """Return start, least, most and largest change in a second of a_0, a_1, a_2."""
    return parameters[:3], parameters[3:6], parameters[6:9], parameters[9:12] / dt_s


def linear(parameters: Array, dt_s: float, adapted: Array) -> tuple[Any, Any, Any, Any]:
    """Return the law, without a state, at the parameters `adapted`."""
    none = np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0))
    return *none, adapted[[2, 1, 0]].reshape(1, 3)
