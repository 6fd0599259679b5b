"""Kalman filter of the specimen, and the base shear predicted for the instant at which the command acts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm, solve_continuous_are

from rths_cli.control.interface import InterfaceForce, force_of_one
from rths_cli.control.state_space import discretise
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, StateSpace
from rths_cli.structure import Specimen

RESIDUAL = ("base_shear_unexplained_n",)
LASTS = 0.3  # rad of the highest mode, over which a difference from the identified specimen is taken as constant


def specimen_state_space(specimen: Specimen) -> StateSpace:
    """Return Eq. 2.5: table acceleration to the floors' absolute accelerations (n, .), state = disp, then vel."""
    n = len(specimen.masses_kg)
    inverse = 1.0 / specimen.masses_kg[:, None]
    lower = np.hstack([-inverse * specimen.K, -inverse * specimen.C])
    a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower])
    b = np.concatenate([np.zeros(n), -np.ones(n)])[:, None]
    return StateSpace(a, b, lower, np.zeros((n, 1)))


def kalman_gain(system: StateSpace, q: float, r: float) -> Array:
    """Return the steady-state gain (2 n, n) of the continuous filter: process noise of intensity q enters like the
    table's acceleration, measurement noise of intensity r on each output (paper, section 5.2).

    Only q / r matters. Its root counts in both terms of the Riccati equation: with all of it in one of them the solver
    loses digits, and ten times as many equations have no solution. Raises InputError where there is none.
    """
    ratio = np.sqrt(q / r)
    noise = ratio * system.B @ system.B.T
    try:
        covariance = solve_continuous_are(system.A.T, np.sqrt(ratio) * system.C.T, noise, np.eye(len(system.C)))
    except ValueError:  # LinAlgError is one
        raise InputError(
            f"kalman: the filter of this specimen cannot be computed with q / r = {q / r:.3g}; use a smaller q / r, "
            "the default is 1000"
        ) from None
    return np.asarray(ratio * covariance @ system.C.T)


def kalman_block(specimen: Specimen, q: float, r: float, dt_s: float, knows_table: bool) -> Block:
    """Return the filter from corrected accelerations (table, floors) to the specimen's state and floor accelerations.

    Discretised for inputs that are straight lines between samples, so that it adds no half step. With
    `knows_table` the measured table acceleration is a known input; without it, as printed in the paper, the floors
    alone drive the filter.
    """
    system = specimen_state_space(specimen)
    n = len(specimen.masses_kg)
    gain = kalman_gain(system, q, r)
    table = system.B if knows_table else np.zeros_like(system.B)
    full = StateSpace(
        system.A - gain @ system.C,
        np.hstack([table, gain]),
        np.vstack([np.eye(2 * n), system.C]),
        np.zeros((3 * n, 1 + n)),
    )
    inputs = ("table_accel_m_s2", *(f"floor_accel_{i + 1}_m_s2" for i in range(n)))
    states = [f"{q}_{i + 1}" for q in ("rel_disp_m", "rel_vel_m_s", "floor_accel_m_s2") for i in range(n)]
    return discretise(full, dt_s, "foh", "kalman", inputs, tuple(states))


def open_loop(specimen: Specimen, dt_s: float) -> Block:
    """Return the specimen alone, Eq. 2.5: table acceleration to the floors' absolute accelerations (n,).

    No measurement of a floor enters, so what it gives does not follow a sensor that is wrong. Discretised for an input
    that is a straight line between samples.
    """
    floors = tuple(f"floor_accel_{i + 1}_m_s2" for i in range(len(specimen.masses_kg)))
    system = specimen_state_space(specimen)
    return discretise(system, dt_s, "foh", "specimen_open_loop", ("table_accel_m_s2",), floors)


def measured_shear(specimen: Specimen, interface_mass_kg: float) -> InterfaceForce:
    """Return Eq. 2.6 from the estimated floor accelerations at the same instant, without prediction."""
    n = len(specimen.masses_kg)
    estimate = np.concatenate([np.zeros(2 * n), -specimen.masses_kg])
    measured = np.concatenate([[-interface_mass_kg], np.zeros(n)])
    return force_of_one(estimate, np.zeros(0), measured, 0.0)


def predicted_shear(specimen: Specimen, interface_mass_kg: float, lead_samples: int, dt_s: float) -> InterfaceForce:
    """Return the base shear n_p >= 1 samples ahead: the estimated state is carried on by the identified specimen under
    the desired accelerations already issued, straight lines between samples.

    The interface mass feels the desired acceleration plus the tracking error measured now.
    """
    n = len(specimen.masses_kg)
    a, start, end = _foh(specimen_state_space(specimen), dt_s)
    shear = np.concatenate([specimen.K.sum(axis=0), specimen.C.sum(axis=0)])
    weights = np.zeros(lead_samples + 1)
    row = shear
    for j in range(lead_samples, 0, -1):
        weights[j] += row @ end
        weights[j - 1] += row @ start
        row = row @ a
    weights[-1] -= interface_mass_kg
    weights[0] += interface_mass_kg
    measured = np.concatenate([[-interface_mass_kg], np.zeros(n)])
    return force_of_one(np.concatenate([row, np.zeros(n)]), weights[:-1], measured, float(weights[-1]))


def leading_low_pass(corner_hz: float, lead_s: float) -> StateSpace:
    """Return the low pass H(s) = (1 + (3 / w + lead) s + (3 / w^2 + 3 lead / w + lead^2 / 2) s^2) / (1 + s / w)^3,
    w = 2 pi corner_hz, which equals exp(s lead) but for terms of s^3."""
    w = 2.0 * np.pi * corner_hz
    x = w * lead_s
    chain = w * np.array([[-1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])  # three low passes of order one
    weights = [3.0 + 3.0 * x + 0.5 * x**2, -3.0 - 5.0 * x - x**2, 1.0 + 2.0 * x + 0.5 * x**2]
    return StateSpace(chain, np.array([[w], [0.0], [0.0]]), np.array([weights]), np.zeros((1, 1)))


def carried_by_correction(specimen: Specimen, q: float, r: float, lead_s: float) -> Array | None:
    """Return what the filter's correction makes of the base shear within `lead_s`, (n,) in N per m/s^2 by which a floor
    is measured beyond its estimate.

    `predicted_shear` moves the estimated state on by the specimen alone. The filter will go on correcting it, by its
    gain L times a difference that lasts where the specimen is not the identified one: without this part the base shear
    is early or late in proportion to the lead. W = [K, C summed over storeys] int_0^lead exp(A s) ds L. None where the
    highest mode turns by more than LASTS within the lead: there no difference lasts so long, and the loop would only
    lose its margin.
    """
    system = specimen_state_space(specimen)
    if lead_s * float(np.abs(np.linalg.eigvals(system.A)).max()) > LASTS:
        return None
    n = len(system.A)
    chain = np.zeros((2 * n, 2 * n))
    chain[:n, :n], chain[:n, n:] = system.A, np.eye(n)
    shear = np.concatenate([specimen.K.sum(axis=0), specimen.C.sum(axis=0)])
    return np.asarray(shear @ expm(chain * lead_s)[:n, n:] @ kalman_gain(system, q, r))


def with_residual(
    kalman: Block, specimen: Specimen, corner_hz: float, lead_s: float, carried_n: Array | None = None
) -> Block:
    """Return the filter with one more output: the base shear in N that the identified specimen does not explain.

    That is r = -sum (m - carried) (measured - estimated floor acceleration), carried `lead_s` ahead by the low pass of
    `leading_low_pass`. `carried_n` (n,) is that of `carried_by_correction` where the base shear is predicted, None:
    zero. A specimen that is not quite the identified one (damage, payload, yielding) then errs in the base shear by
    (f / corner)^3 of the difference, not by the difference.
    """
    n, h = len(specimen.masses_kg), _lead_filter(corner_hz, lead_s, kalman.dt_s)
    weights = specimen.masses_kg if carried_n is None else specimen.masses_kg - carried_n
    order = len(h.A)
    floors = slice(2 * n, 3 * n)
    from_state, direct = weights @ kalman.C[floors], weights @ kalman.D[floors]
    direct[1:] -= weights
    return Block(
        kalman.name,
        np.block([[kalman.A, np.zeros((len(kalman.A), order))], [np.outer(h.B, from_state), h.A]]),
        np.vstack([kalman.B, np.outer(h.B, direct)]),
        np.block([[kalman.C, np.zeros((len(kalman.C), order))], [np.outer(h.D, from_state), h.C]]),
        np.vstack([kalman.D, np.outer(h.D, direct)]),
        kalman.dt_s,
        kalman.inputs,
        (*kalman.outputs, *RESIDUAL),
    )


def _lead_filter(corner_hz: float, lead_s: float, dt_s: float) -> Block:
    """Return the low pass of `with_residual`, discretised."""
    return discretise(leading_low_pass(corner_hz, lead_s), dt_s, "foh", "residual", ("residual_n",), RESIDUAL)


def cell_in_residual(kalman: Block, corner_hz: float, lead_s: float, weight: float) -> tuple[Array, Array]:
    """Return the columns B (n,) and D (e,) of a load cell in N in a filter `with_residual`, where the cell's share of
    the unexplained base shear is `weight` (control.load_cell)."""
    h = _lead_filter(corner_hz, lead_s, kalman.dt_s)
    b, d = np.zeros(len(kalman.A)), np.zeros(len(kalman.C))
    b[-len(h.A) :], d[-1] = -weight * h.B[:, 0], -weight * h.D[0, 0]
    return b, d


def shear_with_cell(
    shear: InterfaceForce, specimen: Specimen, interface_mass_kg: float, weight: float
) -> InterfaceForce:
    """Return a base shear without prediction of which a load cell gives the share `weight`, written for the
    accelerations that a perfect cell stands for (control.load_cell)."""
    shown = -np.concatenate([[interface_mass_kg], specimen.masses_kg])[None, :]
    return replace(
        shear, estimates=(1.0 - weight) * shear.estimates, samples=(1.0 - weight) * shear.samples + weight * shown
    )


def plus_residual(shear: InterfaceForce, weight: float = 1.0) -> InterfaceForce:
    """Return a base shear for a filter `with_residual`, whose last output counts with this weight."""
    return replace(shear, estimates=np.append(shear.estimates, [[weight]], axis=1))


def _foh(system: StateSpace, dt_s: float) -> tuple[Array, Array, Array]:
    """Return A_d, B_start, B_end of x[k+1] = A_d x[k] + B_start u[k] + B_end u[k+1], input a straight line."""
    n = system.A.shape[0]
    chain = np.zeros((n + 2, n + 2))
    chain[:n, :n], chain[:n, n], chain[n, n + 1] = system.A, system.B[:, 0], 1.0
    moved = expm(chain * dt_s)
    end = moved[:n, n + 1] / dt_s
    return moved[:n, :n], moved[:n, n] - end, end
