"""The numerical substructure as a block of the step: one maker of it is a shear building."""

from __future__ import annotations

import numpy as np

from rths_cli.control.realise import discretise
from rths_cli.lti import Block, StateSpace
from rths_cli.structure import Numerical

INPUTS = ("ground_accel_m_s2", "base_shear_n")
INTERFACE = ("interface_accel_m_s2", "interface_rel_vel_m_s", "interface_rel_disp_m")


def state_space(numerical: Numerical) -> StateSpace:
    """Return Eq. 2.3 with inputs ground acceleration and base shear f; the outputs are, for all p storeys,
    displacement and velocity relative to the ground, then absolute acceleration, shape (3 p, .)."""
    p = len(numerical.masses_kg)
    inverse = 1.0 / numerical.masses_kg[:, None]
    force = np.zeros((p, 1))
    force[-1] = inverse[-1]
    lower = np.hstack([-inverse * numerical.K, -inverse * numerical.C])
    a = np.vstack([np.hstack([np.zeros((p, p)), np.eye(p)]), lower])
    b = np.block([[np.zeros((p, 2))], [-np.ones((p, 1)), force]])
    c = np.vstack([np.eye(2 * p), lower])
    d = np.vstack([np.zeros((2 * p, 2)), np.hstack([np.zeros((p, 1)), force])])
    return StateSpace(a, b, c, d)


def all_storeys(numerical: Numerical, dt_s: float) -> Block:
    """Return the block with every storey's motion as output (for the record after a run)."""
    p = len(numerical.masses_kg)
    names = [f"{q}_{i + 1}" for q in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2") for i in range(p)]
    return discretise(state_space(numerical), dt_s, "foh", "numerical", INPUTS, tuple(names))


def interface(numerical: Numerical, dt_s: float) -> Block:
    """Return the block of the step: ground acceleration and base shear to the interface floor's motion.

    Exact for inputs that are straight lines between samples. Outputs as in INTERFACE, acceleration absolute.
    """
    p = len(numerical.masses_kg)
    block = all_storeys(numerical, dt_s)
    rows = [3 * p - 1, 2 * p - 1, p - 1]
    return Block(block.name, block.A, block.B, block.C[rows], block.D[rows], dt_s, INPUTS, INTERFACE)
