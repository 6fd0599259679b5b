"""What the rate transition of a program does to the modes of a building, at tangents of the program's forces.

The transition with a linear program is linear and repeats itself with the program's interval: its matrix over one
interval, closed by the specimen on a perfect table, is found by playing it from each of its states. Its eigenvalues
beside those of the undivided building are damping that the transition adds or takes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rths_cli.control.program_storeys import RateTransition, Transition
from rths_cli.control.state_space import discretise
from rths_cli.numerics.lti import Array, Block, ComplexArray, StateSpace
from rths_cli.structure import Building, Specimen


class LinearProgram:
    """A program with the forces of a stiffness (p, p) in N/m."""

    def __init__(self, stiffness: Array) -> None:
        self._stiffness, self._asked = stiffness, np.zeros(len(stiffness))

    def request(self, displacement_m: Array) -> None:
        """Ask for the forces at displacements (p,) in m."""
        self._asked = displacement_m.copy()

    def forces(self) -> Array:
        """Return the forces (p,) in N that were asked for."""
        return np.asarray(self._stiffness @ self._asked)


@dataclass(frozen=True)
class ModeInTransition:
    """A mode of the building at a tangent: its natural frequency, its damping ratio undivided, and what the transition
    adds to that (negative: takes from it)."""

    hz: float
    ratio: float
    added: float


def modes_in_transition(building: Building, plan: Transition, dt_s: float) -> tuple[ModeInTransition, ...]:
    """Return the oscillating modes of a linear building whose computed floors are a program with their stiffness, in
    the order of their frequency."""
    interval_s = plan.every * dt_s
    found = np.linalg.eigvals(interval_matrix(building, plan, dt_s)).astype(complex)
    n = len(building.M)
    A = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-np.linalg.solve(building.M, building.K), -np.linalg.solve(building.M, building.C)],
        ]
    )
    return tuple(_paired(np.linalg.eigvals(A).astype(complex), found, interval_s))


def _paired(exact: ComplexArray, found: ComplexArray, interval_s: float) -> Iterator[ModeInTransition]:
    """Yield each oscillating eigenvalue of the building with the nearest one of the transition."""
    for value in sorted(exact[exact.imag > 0.0], key=abs):
        there = found[np.argmin(np.abs(found - np.exp(value * interval_s)))]
        decay = -np.log(max(abs(there), 1e-300)) / interval_s
        size = abs(value)
        yield ModeInTransition(
            float(size / (2.0 * np.pi)), float(-value.real / size), float((decay + value.real) / size)
        )


def interval_matrix(building: Building, plan: Transition, dt_s: float) -> Array:
    """Return the matrix over one interval of the program, of the transition's memory and the specimen's states."""
    specimen = specimen_block(building.specimen, building.interface_experimental_mass_kg, dt_s)
    size = RateTransition(plan, LinearProgram(building.numerical.K)).memory.size
    columns = []
    for unit in np.eye(size + len(specimen.A)):
        floors = RateTransition(plan, LinearProgram(building.numerical.K))
        floors.resume(unit[:size])
        state = unit[size:].copy()
        for _ in range(plan.every):
            state, _ = coupled_step(floors, specimen, state, np.zeros(3))
        columns.append(np.concatenate([floors.memory, state]))
    return np.array(columns).T


def coupled_step(floors: RateTransition, specimen: Block, state: Array, ground: Array) -> tuple[Array, Array]:
    """Return the specimen's next state and the interface's motion (3, 1) of a step on a perfect table: acceleration and
    base shear of one instant depend on each other."""
    known = float((specimen.C @ state)[0])
    through, direct = float(specimen.D[0, 0]), float(floors.direct[0, 0])
    free = float(floors.free(ground)[0])
    accel = (free + direct * known) / (1.0 - direct * through)
    motion = floors.advance(ground, np.array([known + through * accel]))
    return specimen.A @ state + specimen.B[:, 0] * accel, motion


def specimen_block(specimen: Specimen, interface_kg: float, dt_s: float) -> Block:
    """Return the block from the table's absolute acceleration to the base shear f of Eq. 2.6."""
    n, inverse = len(specimen.masses_kg), 1.0 / specimen.masses_kg[:, None]
    lower = -inverse * np.hstack([specimen.K, specimen.C])
    A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower])
    B = np.concatenate([np.zeros((n, 1)), -np.ones((n, 1))])
    shear = -(specimen.masses_kg @ lower)[None, :]  # of absolute accelerations, which the table's own is no part of
    return discretise(StateSpace(A, B, shear, np.array([[-interface_kg]])), dt_s, "foh", "specimen", ("table",), ("f",))
