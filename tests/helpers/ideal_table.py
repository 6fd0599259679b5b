"""A hybrid test on an ideal table: it stands where the numerical part wants it, but holds while it is frozen, and then
catches up at a given velocity. Written from the equations of both substructures; shares no code with the loop.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from rths_cli.numerics.lti import Array
from rths_cli.structure import Building

FINE = 4  # steps of the solution in a sample interval


def storeys_of(building: Building, ground: Array, dt_s: float, frozen: dict[int, float], velocity_m_s: float) -> Array:
    """Return the absolute accelerations (storeys, n) under a ground motion (2, n): displacement and velocity.

    `frozen`: for how many intervals the table holds, by the sample at which that begins. No mass at the interface.
    """
    a, b, rows, direct = _equations(building)
    n, count = len(building.numerical.masses_kg), ground.shape[1]
    size, h = len(a), dt_s / FINE
    moved = expm(h * np.block([[a, b], [np.zeros((4, size + 4))]]))
    a_d, b_d = moved[:size, :size], moved[:size, size:]
    states, places, accel = np.zeros(size), np.zeros(count + 1), np.zeros((len(rows), count))
    place, until, catching = 0.0, -1.0, False
    for k in range(count):
        until = k + frozen[k] if k in frozen else until
        places[k] = place
        accel[:, k] = rows @ states + direct @ [*ground[:, k], place, states[2 * n - 1]]
        for i in range(FINE):
            off = states[n - 1] - place
            if k + i / FINE < until:
                velocity, catching = 0.0, True
            elif catching and abs(off) > velocity_m_s * h:
                velocity = np.sign(off) * velocity_m_s
            else:
                velocity, catching, place = states[2 * n - 1], False, states[n - 1]
            at = ground[0, k] + ground[1, k] * (i + 0.5) * h
            states = a_d @ states + b_d @ [at, ground[1, k], place + 0.5 * velocity * h, velocity]
            place += velocity * h
    accel[n - 1, 1:-1] = np.diff(places[:count], 2) / dt_s**2
    return accel


def _equations(building: Building) -> tuple[Array, Array, Array, Array]:
    """Return A, B of the absolute displacements and velocities of the numerical storeys, then of the floors, driven by
    displacement and velocity of ground and table; and the accelerations' rows of states and inputs."""
    numerical, floors = building.numerical, building.specimen
    assert building.interface_experimental_mass_kg == 0.0
    n, m = len(numerical.masses_kg), len(floors.masses_kg)
    rows, direct = np.zeros((n + m, 2 * (n + m))), np.zeros((n + m, 4))
    for part, first, state, source in ((numerical, 0, 0, 0), (floors, n, 2 * n, 2)):
        count = len(part.masses_kg)
        own, stiff, damped = (
            slice(first, first + count),
            part.K / part.masses_kg[:, None],
            part.C / part.masses_kg[:, None],
        )
        rows[own, state : state + 2 * count] = np.hstack([-stiff, -damped])
        direct[own, source : source + 2] = np.column_stack([stiff.sum(axis=1), damped.sum(axis=1)])
    share = floors.masses_kg / numerical.masses_kg[-1]  # base shear f = -sum m a acts on the interface storey
    rows[n - 1] -= share @ rows[n:]
    direct[n - 1] -= share @ direct[n:]
    a, b = np.zeros((2 * (n + m), 2 * (n + m))), np.zeros((2 * (n + m), 4))
    for first, state, count in ((0, 0, n), (n, 2 * n, m)):
        a[state : state + count, state + count : state + 2 * count] = np.eye(count)
        a[state + count : state + 2 * count] = rows[first : first + count]
        b[state + count : state + 2 * count] = direct[first : first + count]
    return a, b, rows, direct
