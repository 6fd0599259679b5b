"""What adaptive compensators share: a low pass, least squares of three parameters with a memory that fades, limits.

A law says which parameters move: `ADAPTS`, their names and units, the last states of the law (as what they differ from
their start), and `bounds`. The step holds every such law to it (loop.adapted_states), whatever the law does itself.

Everything is at rest at zero, as the contract of a compensator wants it: parameters are kept as what they differ from
their start, and the mean squares of the regressors begin at none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.numerics.user_functions import callable_in_commands

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

LINES = 200  # of the compared band


def low_pass(corner_hz: float, dt_s: float) -> list[float]:
    """Return the coefficients (10,) of a Butterworth low pass of fourth order, two sections of b0, b1, b2, a1, a2."""
    from scipy.signal import butter

    sections = butter(4, corner_hz, fs=1.0 / dt_s, output="sos")
    return [float(one) for section in sections for one in (*section[:3], *section[4:])]


@callable_in_commands
def filtered(p: Array, at: int, state: Array, next_state: Array, first: int, value: float) -> float:
    """Return the next output of the low pass whose numbers begin at `p[at]`, whose states (4,) at `state[first]`."""
    for i in range(2):
        c, s = at + 5 * i, first + 2 * i
        made = p[c] * value + state[s]
        next_state[s] = p[c + 1] * value - p[c + 3] * made + state[s + 1]
        next_state[s + 1] = p[c + 2] * value - p[c + 4] * made
        value = made
    return value


@callable_in_commands
def remember(
    state: Array, next_state: Array, first: int, x: float, y: float, z: float, error: float, fades: float
) -> None:
    """Add a sample to the means (9,) at `state[first]`, of which a share `fades` is kept: xx, xy, xz, yy, yz, zz and
    x, y, z times the error."""
    new = 1.0 - fades
    next_state[first] = fades * state[first] + new * x * x
    next_state[first + 1] = fades * state[first + 1] + new * x * y
    next_state[first + 2] = fades * state[first + 2] + new * x * z
    next_state[first + 3] = fades * state[first + 3] + new * y * y
    next_state[first + 4] = fades * state[first + 4] + new * y * z
    next_state[first + 5] = fades * state[first + 5] + new * z * z
    next_state[first + 6] = fades * state[first + 6] + new * x * error
    next_state[first + 7] = fades * state[first + 7] + new * y * error
    next_state[first + 8] = fades * state[first + 8] + new * z * error


@callable_in_commands
def fitted(means: Array, first: int, least: float, which: int) -> float:
    """Return parameter `which` (0 to 2) of the least squares fit of the error by the regressors.

    `least` is added to the mean squares: the parameters stay near zero while the regressors are smaller than its root.
    """
    a, b, c = means[first] + least, means[first + 1], means[first + 2]
    d, e, f = means[first + 3] + least, means[first + 4], means[first + 5] + least
    p, q, r = means[first + 6], means[first + 7], means[first + 8]
    minor_a, minor_b, minor_c = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * minor_a + b * minor_b + c * minor_c
    if which == 0:
        return (minor_a * p + minor_b * q + minor_c * r) / determinant
    if which == 1:
        return (minor_b * p + (a * f - c * c) * q + (b * c - a * e) * r) / determinant
    return (minor_c * p + (b * c - a * e) * q + (a * d - b * b) * r) / determinant


@callable_in_commands
def moved(value: float, wanted: float, rate: float, least: float, most: float) -> float:
    """Return a parameter a sample later: towards `wanted`, by `rate` at most, from `least` to `most`."""
    step = min(max(wanted - value, -rate), rate)
    return min(max(value + step, least), most)


def inverse_series(plant: Plant, order: int = 2) -> Array:
    """Return the real a (order + 1,) with which a_0 + a_1 s + a_2 s^2 + ... times the response of the identified
    displacement to the command is nearest to 1 in the compared band."""
    frequency_hz = np.linspace(*plant.band_hz, LINES)
    s = 2j * np.pi * frequency_hz
    displacement = plant.model.response(frequency_hz) / s**2
    columns = np.stack([s**i * displacement for i in range(order + 1)], axis=1)
    both = np.vstack([columns.real, columns.imag])
    wanted = np.concatenate([np.ones(len(s)), np.zeros(len(s))])
    scale = np.linalg.norm(both, axis=0)
    return np.asarray(np.linalg.lstsq(both / scale, wanted, rcond=None)[0] / scale)
