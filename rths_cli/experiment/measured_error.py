"""The error of a hybrid test's loop as its own records show it, whatever the specimen is.

Put the measured motion of table and floors into the equations of the computed storeys: with the shear of the measured
floors they should move as

    x = N(ground, F),    F = -(sum of masses times measured accelerations).

What the test moved otherwise, r = reported - N(ground, F), is all that the loop did wrong: tracking errors, latency,
friction, noise in the command, held commands, dropouts, saturation and the integration scheme. The specimen obeys its
own equations in the test as in the ideal one, S. So the interface is wrong by e = r + N_F S e, the motion of the
undivided building by a kinematic error r of the specimen's base. A specimen that differs from the one in S by some
percent changes e by some percent of itself, while it changes SIM by far more.

Errors of sensors and masses are not in it: the motion and F are those that the sensors show (true_error.py has them).
Of noise in the floors' samples nothing is in r, because F has it, too; it moves the table nevertheless.
"""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.sim import state_equation
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.control.state_space import discretise
from rths_cli.loop.block_replay import run_block
from rths_cli.numerics.lti import Array, ComplexArray, StateSpace
from rths_cli.structure import Building

FINEST_S = 2.5e-4  # between which the shear of the floors may be taken for straight


def residual_of_computed_storeys(building: Building, dt_s: float, ground_m_s2: Array, reported_m_s2: Array) -> Array:
    """Return by how much the computed storeys (p, n) in m/s^2 moved otherwise than the measured floors ask for.

    `reported_m_s2` (n_storeys, n): absolute accelerations of the test, measured from the interface up. Between samples
    the ground's acceleration is straight, as SIM takes it, and the shear is smooth.
    """
    from scipy.interpolate import CubicSpline

    p, masses = len(building.numerical.masses_kg), _masses(building)
    shear_n, finer = -(masses @ reported_m_s2[p - 1 :]), max(int(np.ceil(dt_s / FINEST_S)), 1)
    at, between = np.arange(len(shear_n)), np.arange(finer * (len(shear_n) - 1) + 1) / finer
    ground = np.interp(between, at, ground_m_s2[: len(shear_n)])
    inputs = np.vstack([ground, CubicSpline(at, shear_n)(between)])
    moved = run_block(all_storeys(building.numerical, dt_s / finer), inputs)[2 * p :, ::finer]
    return np.asarray(reported_m_s2[:p] - moved)


def loop_error(building: Building, dt_s: float, residual_m_s2: Array) -> Array:
    """Return the error (n_storeys, n) in m/s^2 of a test against SIM of a linear building, by its residual (p, n)."""
    p, size = len(building.numerical.masses_kg), len(building.M)
    a, b = _by_base(building)
    names = tuple(f"storey_{storey}" for storey in range(1, size + 1))
    block = discretise(StateSpace(a, b, a[size:], b[size:]), dt_s, "foh", "loop_error", ("base",), names)
    error = run_block(block, residual_m_s2[-1:])
    error[:p] += residual_m_s2
    error[p:] += residual_m_s2[-1]
    return error


def loop_error_lines(building: Building, frequency_hz: Array, reported_m_s2: ComplexArray) -> ComplexArray:
    """Return what both make (n_storeys, m) of a reported motion (n_storeys, m) by frequency, without ground motion."""
    p, masses, numerical = len(building.numerical.masses_kg), _masses(building), building.numerical
    own = np.diag(numerical.masses_kg)
    a, _ = state_equation(own, numerical.C, numerical.K)
    pushed = np.zeros((2 * p, 1))
    pushed[-1] = 1.0 / numerical.masses_kg[-1]
    by_force = StateSpace(a, pushed, a[p:], pushed[p:]).response(frequency_hz)[:, 0]
    residual = reported_m_s2[:p] + by_force * (masses @ reported_m_s2[p - 1 :])
    a, b = _by_base(building)
    error = StateSpace(a, b, a[len(building.M) :], b[len(building.M) :]).response(frequency_hz)[:, 0] * residual[-1]
    error[:p] += residual
    error[p:] += residual[-1]
    return np.asarray(error)


def _by_base(building: Building) -> tuple[Array, Array]:
    """Return the state equation of the building whose specimen's base has a kinematic error."""
    p, size = len(building.numerical.masses_kg), len(building.M)
    a, _ = state_equation(building.M, building.C, building.K)
    pushed = np.zeros(size)
    pushed[p - 1 :] = -_masses(building)  # in relative motion the specimen feels its base's error as inertia
    return a, np.concatenate([np.zeros(size), np.linalg.solve(building.M, pushed)])[:, None]


def _masses(building: Building) -> Array:
    return np.concatenate([[building.interface_experimental_mass_kg], building.specimen.masses_kg])
