"""The numerical substructure with laws: an exact linear block whose further inputs are the forces of the laws.

Operator splitting on the exact linear part: between samples the force of a law is a straight line, as ground
acceleration and base shear are. It is evaluated at drifts and rates that the present base shear does not enter (it is
extrapolated from the last two), so that the step stays affine in the base shear.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.interface import LAW_FORCE as LAW_FORCE
from rths_cli.control.interface import Logged
from rths_cli.control.numerical_substructure import (
    INPUTS,
    INTERFACE,
    ROUNDING,
    Scheme,
    check_scheme,
    interface,
    state_space,
)
from rths_cli.control.state_space import discretise
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, StateSpace
from rths_cli.structure import Building, Numerical
from rths_cli.structure.storey_laws import Laws

if TYPE_CHECKING:
    from rths_cli.control.program_storeys import ProgramStoreys


@dataclass(frozen=True)
class StoreysWithLaws:
    """The design of computed storeys of which q have laws. `numerical` holds their tangents at rest."""

    numerical: Numerical
    laws: Laws
    dt_s: float
    name: str = "numerical"
    affine: bool = True
    linear: bool = False

    @cached_property
    def storeys(self) -> tuple[int, ...]:
        """Return the storeys (q,) with laws, counted from 0 at the ground."""
        return tuple(int(storey) for storey in np.unique(self.laws.storey))

    @property
    def logs(self) -> tuple[Logged, ...]:
        """Return the force of the laws of each of the q storeys, in addition to its spring."""
        return tuple(Logged(f"{LAW_FORCE}{storey + 1}_n", "N") for storey in self.storeys)

    @property
    def multiplications(self) -> int:
        """Return those of the linear block."""
        states, (outputs, inputs) = 2 * len(self.numerical.masses_kg), self.block.D.shape
        return 2 * states + states * inputs + outputs * (states + inputs)

    def linearised(self, at: Array | None = None) -> Block:
        """Return the storeys with their tangents at rest, whatever the state."""
        return interface(self.numerical, self.dt_s)

    @cached_property
    def block(self) -> Block:
        """Return the block from ground acceleration, base shear and laws' forces (q,) to the interface's motion (3,),
        then drifts (q,) and their rates (q,)."""
        p = len(self.numerical.masses_kg)
        everything = self.all_storeys
        drift = np.eye(p)[list(self.storeys)] - np.eye(p, k=-1)[list(self.storeys)]
        picked = np.zeros((3, 3 * p))
        picked[[0, 1, 2], [3 * p - 1, 2 * p - 1, p - 1]] = 1.0
        none = np.zeros_like(drift)
        rows = np.vstack([picked, np.hstack([drift, none, none]), np.hstack([none, drift, none])])
        names = [f"{what}_{storey + 1}" for what in ("drift_m", "drift_rate_m_s") for storey in self.storeys]
        c, d = rows @ everything.C, rows @ everything.D
        return Block(self.name, everything.A, everything.B, c, d, self.dt_s, everything.inputs, (*INTERFACE, *names))

    @cached_property
    def all_storeys(self) -> Block:
        """Return the block from the same inputs to every storey's displacement, velocity and acceleration (3 p,)."""
        p = len(self.numerical.masses_kg)
        linear = state_space(self.numerical)
        pulls = np.eye(p)[:, list(self.storeys)] - np.eye(p, k=1)[:, list(self.storeys)]
        accel = -pulls / self.numerical.masses_kg[:, None]
        none = np.zeros_like(accel)
        b = np.hstack([linear.B, np.vstack([none, accel])])
        d = np.hstack([linear.D, np.vstack([none, none, accel])])
        inputs = (*INPUTS, *(one.name for one in self.logs))
        names = tuple(f"{q}_{i + 1}" for q in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2") for i in range(p))
        return discretise(StateSpace(linear.A, b, linear.C, d), self.dt_s, "foh", self.name, inputs, names)

    def radius(self, stiffness: Array, dashpots: Array) -> float:
        """Return the spectral radius of the scheme with laws of fixed tangents (q,) in N/m and N s/m, beside those at
        rest, and no base shear."""
        b, q, n = self.block, len(self.storeys), len(self.block.A)
        drift, rate, pushed = b.C[3 : 3 + q], b.C[3 + q :], b.B[:, 2:]
        # g+ = k (drift x + D g) + c (rate x + D (g, its own part new))
        by_drift, by_rate = b.D[3 : 3 + q, 2:], b.D[3 + q :, 2:]
        own = np.diag(np.diag(by_rate))
        solved = np.linalg.inv(np.eye(q) - dashpots[:, None] * own)
        of_state = solved @ (stiffness[:, None] * drift + dashpots[:, None] * rate)
        of_force = solved @ (stiffness[:, None] * by_drift + dashpots[:, None] * (by_rate - own))
        whole = np.block([[b.A + pushed @ of_state, pushed @ of_force], [of_state, of_force]])
        assert whole.shape == (n + q, n + q)
        return float(np.abs(np.linalg.eigvals(whole)).max())


def computed_storeys(building: Building, dt_s: float, scheme: Scheme) -> Block | StoreysWithLaws | ProgramStoreys:
    """Return the design of a building's numerical substructure.

    Raises InputError where the scheme is unstable by itself, for laws with another one than `exact`, and as
    `program_storeys`.
    """
    if building.linear:
        check_scheme(building.numerical, dt_s, scheme)
        return interface(building.numerical, dt_s, scheme)
    if scheme != "exact":
        raise InputError(f"integration: storeys with laws are integrated by exact only, not by {scheme}; remove it")
    if building.has_program:
        from rths_cli.control.program_storeys import program_storeys  # numba, which no other building needs here

        return program_storeys(building, dt_s)
    design = StoreysWithLaws(building.numerical, building.laws, dt_s)
    check_laws(design)
    return design


def check_laws(design: StoreysWithLaws) -> None:
    """Raise InputError where the scheme is unstable by itself at the stiffest or the softest tangents of the laws.

    Tangents that make the storeys themselves unstable (softening below zero) are no fault of the scheme.
    """
    softest, stiffest = (design.laws.of_storeys(design.storeys, column) for column in design.laws.stiffness.T)
    none = np.zeros(len(design.storeys))
    limit = max(1.0, design.radius(none, none)) + ROUNDING
    for what, tangents in (("stiffest", stiffest), ("softest", softest)):
        if what == "softest" and np.linalg.eigvalsh(_with(design.numerical.K, design.storeys, tangents))[0] < 0.0:
            continue
        if design.radius(tangents, none) <= limit:
            continue
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if design.radius(middle * tangents, none) <= limit else (low, middle)
        worst = int(np.argmax(np.abs(tangents)))
        raise InputError(
            f"structure.numerical.law[{design.storeys[worst] + 1}]: its {what} tangent, {tangents[worst]:.4g} N/m "
            f"beside the spring, makes the integration unstable at dt = {1e3 * design.dt_s:.4g} ms; the limit is "
            f"{low * tangents[worst]:.4g} N/m; raise sample_rate_hz, or take a softer law"
        )


def _with(K: Array, storeys: tuple[int, ...], stiffness: Array) -> Array:
    """Return a stiffness matrix (p, p) with further springs in some storeys."""
    changed = K.copy()
    for storey, value in zip(storeys, stiffness, strict=True):
        changed[storey, storey] += value
        if storey:
            changed[storey - 1, storey - 1] += value
            changed[storey, storey - 1] -= value
            changed[storey - 1, storey] -= value
    return changed
