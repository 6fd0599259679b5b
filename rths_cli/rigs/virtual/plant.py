"""Set up the virtual table before a run: its equations of motion, from physics to the kernel's arrays.

State: x, v of the table, actuator force F, then displacement and velocity of each floor relative to the table.
The linear part is advanced by its matrix exponential. Its two scalar nonlinearities, Coulomb friction
tanh(v / v_s) and the clipping of F_ref, are inputs interpolated by a parabola over each inner step, whose values
at the step's start, middle and end satisfy the equations (collocation, fourth order). So are the forces of laws of the
specimen's storeys (`specimen_laws`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import expm

from rths_cli.numerics.content_key import content_key
from rths_cli.numerics.lti import Array
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.numerics.tiled_products import ROWS, padded, squares, tiled
from rths_cli.structure import Specimen

if TYPE_CHECKING:
    from rths_cli.case.virtual_physics_schema import VirtualPhysics


class Parts(NamedTuple):
    """The table with its sensors: n states, of which the mechanical ones come first."""

    a: Array  # (n, n)
    b: Array  # (n, 3 + q) tanh(v / v_s), clip(F_ref) - F_ref, command, forces of laws in q storeys
    mechanical: int
    rows: Array  # (2, mechanical) v and F_ref from the state
    row_command: Array  # (2,) the same from the command
    velocity_rows: Array  # (c, n) absolute velocities of table and floors
    scale: Array  # (2,) what v and F_ref are multiplied with
    law_rows: Array  # (2 q, mechanical) drifts, then rates, of the storeys with laws


class Level(NamedTuple):
    """Arrays of one inner step, as in Plant."""

    push: Array
    filters: Array
    nodes: Array
    feed: Array
    arguments: Array  # as in SpecimenLaws


def levels(parts: Parts, interval_s: float, count: int) -> tuple[Level, ...]:
    """Return the arrays of `count` levels of inner steps, each half as long as those before, the first an interval.

    They are kept: the runs of a case, and its variants by seed or gain, are on the same table.
    """
    key = content_key(parts, interval_s, count)
    return _SHARED.get("levels", key, lambda: _levels(parts, interval_s, count))


_SHARED = SharedValues(size=64)


def _levels(parts: Parts, interval_s: float, count: int) -> tuple[Level, ...]:
    """Make the levels; the end of one level's step is the middle of that before, and one exponential serves both."""
    times = [interval_s / 2**k for k in range(count + 1)]
    moved = [_moved(parts, time_s) for time_s in times]
    return tuple(_level(parts, times[k], moved[k + 1], moved[k]) for k in range(count))


def _level(parts: Parts, step_s: float, middle: Array, last: Array) -> Level:
    """Return the arrays of inner steps of this length from the augmented exponentials of half a step and a whole."""
    n, first = parts.mechanical, len(parts.a) - (len(parts.a) - parts.mechanical) // 2
    wide = np.zeros((2, len(parts.a)))
    wide[:, :n] = parts.scale[:, None] * parts.rows
    halfway, half_response = parabola_response(parts, middle, step_s)
    end, response = parabola_response(parts, last, step_s)
    offsets = [
        np.column_stack([wide @ moved[:, :n], wide @ moves[:, 2].sum(axis=1) + parts.scale * parts.row_command])
        for moved, moves in ((halfway, half_response), (end, response))
    ]
    middle, whole = _columns(halfway, half_response, n), _columns(end, response, n)
    return Level(
        push=squares(np.vstack([whole, parts.velocity_rows @ middle])),
        filters=np.array([end[n, n], end[first, first], end[first, n]]),
        nodes=tiled(np.array([offsets[0][0], offsets[1][0], offsets[0][1], offsets[1][1]])),
        feed=np.array([np.einsum("wn,nsj->wsj", wide, moves[:, :2]) for moves in (half_response, response)]),
        arguments=np.array([_arguments(parts, wide, columns) for columns in (middle, whole)]),
    )


def _arguments(parts: Parts, wide: Array, columns: Array) -> Array:
    """Return v / v_s, F_ref, drifts and rates of storeys with laws (2 + 2 q, columns) from the columns of a state."""
    n = parts.mechanical
    found = np.vstack([wide @ columns, parts.law_rows @ columns[:n]])
    found[:2, n] += parts.scale * parts.row_command
    return found


def _columns(moved: Array, moves: Array, mechanical: int) -> Array:
    """Return the response (n, columns) to mechanical state, command, and each nonlinearity at three nodes."""
    first, laws = padded(mechanical + 1), moves.shape[1] - 3
    columns = np.zeros((len(moved), first + (2 + laws) * ROWS))
    columns[:, :mechanical], columns[:, mechanical] = moved[:, :mechanical], moves[:, 2].sum(axis=1)
    columns[:, first : first + 3], columns[:, first + ROWS : first + ROWS + 3] = moves[:, 0], moves[:, 1]
    for q in range(laws):
        place = first + (2 + q) * ROWS
        columns[:, place : place + 3] = moves[:, 3 + q]
    return columns


def velocities(states: int, floors: int) -> Array:
    """Return the rows (1 + floors, states) of the absolute velocities of table and floors."""
    rows = np.zeros((1 + floors, states))
    rows[:, 1] = 1.0
    rows[1:, 3 + floors : 3 + 2 * floors] = np.eye(floors)
    return rows


def parabola_response(parts: Parts, moved: Array, step_s: float) -> tuple[Array, Array]:
    """Return exp(A t) (n, n) and the response at t to b times a parabola over [0, step] by its values, (n, m, 3).

    The parabola is given at 0, step / 2 and step; `moved` is the augmented exponential of t.
    """
    n, m = parts.b.shape
    moments = moved[:n, n:].reshape(n, 3, m)
    lagrange = np.array([[1.0, 0.0, 0.0], [-3.0, 4.0, -1.0], [4.0, -8.0, 4.0]])
    lagrange /= step_s ** np.arange(3)[:, None]
    return moved[:n, :n], np.einsum("nim,ij->nmj", moments, lagrange)


def _moved(parts: Parts, time_s: float) -> Array:
    """Return the exponential of the system augmented with the powers 1, s, s^2 / 2 of time, (n + 3 m, n + 3 m)."""
    n, m = parts.b.shape
    chain = np.zeros((n + 3 * m, n + 3 * m))
    chain[:n, :n] = parts.a
    chain[:n, n : n + m] = parts.b
    chain[n : n + m, n + m : n + 2 * m] = np.eye(m)
    chain[n + m : n + 2 * m, n + 2 * m :] = np.eye(m)
    return np.asarray(expm(chain * time_s))


def continuous(
    physics: VirtualPhysics, specimen: Specimen, interface_mass_kg: float = 0.0
) -> tuple[Array, Array, Array, Array, Array]:
    """Return A (n, n), b_u (n,), B_n (n, 2), argument rows (2, n) and their command part (2,).

    The nonlinearities are tanh(v / v_s), whose argument is v, and clip(F_ref) - F_ref, whose argument is F_ref.
    """
    floors = len(specimen.masses_kg)
    n = 3 + 2 * floors
    drift, vel = slice(3, 3 + floors), slice(3 + floors, n)
    mass = physics.moving_mass_kg + interface_mass_kg
    loop_mass = mass + physics.loop_specimen_mass_kg
    omega = 2.0 * np.pi * physics.loop_frequency_hz
    rows = np.zeros((2, n))
    rows[0, 1] = 1.0
    rows[1, 0] = -loop_mass * omega**2
    rows[1, 1] = -loop_mass * 2.0 * physics.loop_damping_ratio * omega
    command = np.array([0.0, loop_mass * omega**2 * physics.gain_m_per_v])
    a = np.zeros((n, n))
    a[0, 1] = 1.0
    a[1, 1] = -physics.viscous_n_s_per_m / mass
    a[1, 2] = 1.0 / mass
    a[1, drift] = specimen.K.sum(axis=0) / mass
    a[1, vel] = specimen.C.sum(axis=0) / mass
    a[2] = rows[1] / physics.actuator_time_constant_s
    a[2, 2] = -1.0 / physics.actuator_time_constant_s
    a[drift, vel] = np.eye(floors)
    inverse_mass = 1.0 / specimen.masses_kg[:, None]
    a[vel, drift] = -inverse_mass * specimen.K
    a[vel, vel] = -inverse_mass * specimen.C
    a[vel] -= a[1]
    b_n = np.zeros((n, 2))
    b_n[1, 0] = -physics.coulomb_n / mass
    b_n[vel, 0] = physics.coulomb_n / mass
    b_n[2, 1] = 1.0 / physics.actuator_time_constant_s
    b_u = np.zeros(n)
    b_u[2] = command[1] / physics.actuator_time_constant_s
    return a, b_u, b_n, rows, command


def with_sensors(
    a: Array, b_u: Array, b_n: Array, accel_rows: Array, accel_inputs: Array, low_pass_hz: float, high_pass_hz: float
) -> tuple[Array, Array, Array]:
    """Return A, b_u, B_n with the sensors' states appended: the c low passes z' = w_l (a - z), zero without a corner,
    then the c AC couplings s' = w_h (z - s), or w_h (a - s) without a low pass.

    `accel_rows` (c, n) and `accel_inputs` (c, m) make the accelerations a of the states and of the inputs of B_n."""
    n, c = a.shape[0], accel_rows.shape[0]
    low, high = 2.0 * np.pi * low_pass_hz, 2.0 * np.pi * high_pass_hz
    first, second = slice(n, n + c), slice(n + c, n + 2 * c)
    full, inputs = np.zeros((n + 2 * c, n + 2 * c)), np.zeros((n + 2 * c, b_n.shape[1]))
    full[:n, :n], inputs[:n] = a, b_n
    full[first, :n], full[first, first], inputs[first] = low * accel_rows, -low * np.eye(c), low * accel_inputs
    full[second, second] = -high * np.eye(c)
    if low > 0.0:
        full[second, first] = high * np.eye(c)
    else:
        full[second, :n], inputs[second] = high * accel_rows, high * accel_inputs
    return full, np.concatenate([b_u, np.zeros(2 * c)]), inputs


def accelerations(a: Array, b_n: Array, floors: int) -> tuple[Array, Array]:
    """Return rows (c, n) and friction part (c,) of the absolute accelerations of table and floors."""
    base = np.zeros((1 + floors, a.shape[0]))
    base[:, 1] = 1.0
    base[1:, 3 + floors :] = np.eye(floors)
    return base @ a, base @ b_n[:, 0]
