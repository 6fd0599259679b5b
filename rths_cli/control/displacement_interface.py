"""The interface of a test whose actuator follows a displacement and whose load cell returns the force.

The numerical substructure gives the interface's motion relative to the ground, as the laboratory's floor stands still.
Its specimen's mass m belongs to the interface floor, and the ground's acceleration acts on it in the building but not
in the laboratory: the force on the interface floor is

    f = -F - m a_g,    F = m x'' + c x' + k x    (what the load cell shows).

With the hybrid clock n_p samples ahead of the actuator, F is measured n_p samples before the instant j for which the
numerical part needs it, and the identified specimen says by how much it changes meanwhile:

    f_j = -F_(j - n_p) - S (y_j - y_(j - n_p)) - m a_g,j,    S y = m x'' + c x' + k x  of the desired motion.

What the specimen does more than its model is measured all the same. All of it is one linear block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rths_cli.control.compensator import CompiledLaw
from rths_cli.control.feedforward import lead_samples
from rths_cli.control.interface import Interface, InterfaceForce, Logged, PartDesign
from rths_cli.control.numerical_substructure import INPUTS, INTERFACE, Scheme, all_storeys
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, Model
from rths_cli.structure import Numerical, Specimen

FELT = Logged("interface_force_n", "N", ahead=True)
LOW_PASS_S = 1e-3  # least delay of the low pass behind the inverse of an actuator, which has no zeros: it is loud


@dataclass(frozen=True)
class StoreysOfActuator:
    """The numerical substructure of such a test: `block` gives the interface's motion relative to the ground, `force`
    has the same states and gives f, which is logged; inputs are ground acceleration and -F."""

    block: Block
    force: Block
    name: str = "numerical"
    affine: bool = True
    linear: bool = True
    logs: tuple[Logged, ...] = (FELT,)

    @property
    def multiplications(self) -> int:
        """Return its work in a step."""
        return int(np.count_nonzero(self.block.A)) + self.block.B.size + self.block.C.size

    def linearised(self, at: Array | None = None) -> Block:
        """Return the linear block that it is at all times."""
        return self.block


def storeys_of_actuator(
    numerical: Numerical, specimen: Specimen, dt_s: float, lead: int, scheme: Scheme = "exact"
) -> StoreysOfActuator:
    """Return the numerical substructure whose force is predicted over `lead` samples by an attached specimen."""
    storeys, p = all_storeys(numerical, dt_s, scheme), len(numerical.masses_kg)
    mass, damping, stiffness = float(specimen.masses_kg[0]), specimen.C[0, 0], specimen.K[0, 0]
    n = len(storeys.A)
    # rows over (storeys' state, S y of the last `lead` samples, a_g, -F)
    width = n + lead + 2
    ground, measured = np.eye(width)[-2], np.eye(width)[-1]
    relative = np.zeros((3 * p, width))
    relative[:, :n], relative[:, -2] = storeys.C, storeys.D[:, 0]
    relative[3 * p - 1] -= ground  # the interface's acceleration relative to the ground
    felt = mass * relative[3 * p - 1] + damping * relative[2 * p - 1] + stiffness * relative[p - 1]  # S y without f
    by_force = storeys.D[:, 1]
    direct = mass * by_force[3 * p - 1] + damping * by_force[2 * p - 1] + stiffness * by_force[p - 1]
    force = measured - mass * ground
    if lead:
        force = (force + np.eye(width)[n + lead - 1] - felt) / (1.0 + direct)
    state = np.zeros((n + lead, width))
    state[:n, :n], state[:n, -2] = storeys.A, storeys.B[:, 0]
    state[:n] += np.outer(storeys.B[:, 1], force)
    if lead:
        state[n] = felt + direct * force
        state[n + 1 :, n : n + lead - 1] = np.eye(lead - 1)
    rows = (relative + np.outer(by_force, force))[[3 * p - 1, 2 * p - 1, p - 1]]
    a, b = state[:, :-2], state[:, -2:]
    block = Block("numerical", a, b, rows[:, :-2], rows[:, -2:], dt_s, INPUTS, INTERFACE)
    return StoreysOfActuator(block, replace(block, C=force[None, :-2], D=force[None, -2:], outputs=(FELT.name,)))


def measured_force(lead: int) -> Interface:
    """Return the interface: displacement commanded, channel 0; the force is minus that of the load cell, channel 1."""
    force = InterfaceForce(np.zeros((1, 1)), np.zeros((1, lead, 1)), np.array([[0.0, -1.0]]), np.zeros((1, 1)))
    return Interface(force, (0,), 1, "displacement")


def lead_of_inverse(model: Model, dt_s: float) -> int:
    """Return by how many samples the inverse of an actuator lags: its delay, and that of the low pass behind it."""
    return max(lead_samples(model, dt_s), int(np.ceil((model.delay_s + LOW_PASS_S) / dt_s - 1e-9)))


def in_volts(part: PartDesign, m_per_v: float) -> PartDesign:
    """Return a compensator that commands metres with its command in V, `m_per_v` of the rig file's nominal gain."""
    if isinstance(part, Block):
        return replace(part, C=part.C / m_per_v, D=part.D / m_per_v)
    if isinstance(part, CompiledLaw):
        judged = part.judged and replace(part.judged, C=part.judged.C / m_per_v, D=part.judged.D / m_per_v)
        return replace(part, judged=judged, units_per_v=m_per_v)
    if m_per_v != 1.0:
        raise InputError(
            f"controller: {part.name}: a law that runs in Python commands metres, and this actuator takes "
            f"{1.0 / m_per_v:g} V per metre; use a law that numba compiles, or nominal.gain_m_per_v: 1"
        )
    return part


def in_metres(model: Model, m_per_v: float) -> Model:
    """Return a model of an actuator with its command in metres."""
    return replace(model, gain=model.gain / m_per_v)
