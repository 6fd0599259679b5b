"""The virtual table's equations of motion as the arrays its compiled kernel advances (DESIGN.md section 4).

State: x, v of the table, actuator force F, then displacement and velocity of each floor relative to the table.
The linear part is advanced by its matrix exponential. Its two scalar nonlinearities, Coulomb friction
tanh(v / v_s) and the clipping of F_ref, are inputs interpolated by a parabola over each inner step, whose values
at the step's start, middle and end satisfy the equations (collocation, fourth order).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rths_cli.lti import Array
from rths_cli.structure import Specimen

if TYPE_CHECKING:
    from rths_cli.case.virtual_physics import VirtualPhysics


class Plant(NamedTuple):
    """Constant arrays of the kernel for n states and c = 1 + n_floors channels.

    Arrays with a leading axis of levels hold one entry per inner step: level L divides the sample interval
    into 2^(L + 1) inner steps.
    """

    transition: Array  # (levels, n, n) exp(A h)
    hold: Array  # (levels, n) response at h to the command
    drive: Array  # (levels, n, 2, 3) response at h to the two nonlinearities at start, middle, end
    node_rows: Array  # (levels, 2, 2, n) nonlinearity's argument at middle, end from the state
    node_hold: Array  # (levels, 2, 2) the same from the command
    node_drive: Array  # (levels, 2, 2, 2, 3) the same from the nonlinearities
    start_rows: Array  # (2, n) the argument at the start
    start_hold: Array  # (2,)
    accel_rows: Array  # (c, n) absolute accelerations from the state
    accel_friction: Array  # (c,) the same from tanh(v / v_s)
    mechanical: int  # number of mechanical states; one low pass and one AC coupling per channel follow
    has_low_pass: bool
    dt_s: float
    friction_velocity_m_s: float
    force_limit_n: float
    stroke_m: float
    command_range_v: float
    command_step_v: float
    sensor_range_m_s2: float
    sensor_v_per_m_s2: float
    sensor_range_v: float
    sensor_step_v: float
    noise_rms_m_s2: float
    refine: int  # levels added to the one chosen (0; more to check the integration)


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


def parabola_response(a: Array, b: Array, time_s: float, step_s: float) -> tuple[Array, Array]:
    """Return exp(A t) (n, n) and the response at t to b times a parabola over [0, step] by its values, (n, m, 3).

    The parabola is given at 0, step / 2 and step; the integrals come from one exponential of the system
    augmented with the powers 1, s, s^2 / 2 of time.
    """
    from scipy.linalg import expm

    n, m = b.shape
    chain = np.zeros((n + 3 * m, n + 3 * m))
    chain[:n, :n] = a
    chain[:n, n : n + m] = b
    chain[n : n + m, n + m : n + 2 * m] = np.eye(m)
    chain[n + m : n + 2 * m, n + 2 * m :] = np.eye(m)
    exponential = expm(chain * time_s)
    moments = exponential[:n, n:].reshape(n, 3, m)
    lagrange = np.array([[1.0, 0.0, 0.0], [-3.0, 4.0, -1.0], [4.0, -8.0, 4.0]])
    lagrange /= step_s ** np.arange(3)[:, None]
    return exponential[:n, :n], np.einsum("nim,ij->nmj", moments, lagrange)


def with_sensors(
    a: Array, b_u: Array, b_n: Array, accel_rows: Array, accel_friction: Array, low_pass_hz: float, high_pass_hz: float
) -> tuple[Array, Array, Array]:
    """Return A, b_u, B_n with the sensors' states appended: the c low passes z' = w_l (a - z), zero without a corner,
    then the c AC couplings s' = w_h (z - s), or w_h (a - s) without a low pass."""
    n, c = a.shape[0], accel_rows.shape[0]
    low, high = 2.0 * np.pi * low_pass_hz, 2.0 * np.pi * high_pass_hz
    first, second = slice(n, n + c), slice(n + c, n + 2 * c)
    full, friction = np.zeros((n + 2 * c, n + 2 * c)), np.zeros((n + 2 * c, 2))
    full[:n, :n], friction[:n] = a, b_n
    full[first, :n], full[first, first], friction[first, 0] = low * accel_rows, -low * np.eye(c), low * accel_friction
    full[second, second] = -high * np.eye(c)
    if low > 0.0:
        full[second, first] = high * np.eye(c)
    else:
        full[second, :n], friction[second, 0] = high * accel_rows, high * accel_friction
    return full, np.concatenate([b_u, np.zeros(2 * c)]), friction


def accelerations(a: Array, b_n: Array, floors: int) -> tuple[Array, Array]:
    """Return rows (c, n) and friction part (c,) of the absolute accelerations of table and floors."""
    base = np.zeros((1 + floors, a.shape[0]))
    base[:, 1] = 1.0
    base[1:, 3 + floors :] = np.eye(floors)
    return base @ a, base @ b_n[:, 0]
