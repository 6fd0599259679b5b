"""The numerical substructure as a discrete block: equations of motion, integrated by `exact`, `cr` or `newmark`.

Whatever the integration scheme, outputs at step k belong to the same instant as the inputs at step k.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from rths_cli.control.state_space import discretise
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, StateSpace
from rths_cli.structure import Numerical, mode_shapes

INPUTS = ("ground_accel_m_s2", "base_shear_n")
INTERFACE = ("interface_accel_m_s2", "interface_rel_vel_m_s", "interface_rel_disp_m")
Scheme = Literal["exact", "cr", "newmark"]
ROUNDING = 1e-9  # of a spectral radius that is one


def state_space(numerical: Numerical) -> StateSpace:
    """Return Eq. 2.3 with inputs ground acceleration and base shear f; the outputs are, for all p storeys,
    displacement and velocity relative to the ground, then absolute acceleration, shape (3 p, .)."""
    p = len(numerical.masses_kg)
    force = numerical.per_force[:, None]
    lower = np.hstack([-numerical.per_mass(numerical.K), -numerical.per_mass(numerical.C)])
    a = np.vstack([np.hstack([np.zeros((p, p)), np.eye(p)]), lower])
    b = np.block([[np.zeros((p, 2))], [-numerical.ground[:, None], force]])
    c = np.vstack([np.eye(2 * p), lower])
    d = np.vstack([np.zeros((2 * p, 2)), np.hstack([np.zeros((p, 1)), force])])
    return StateSpace(a, b, c, d)


def all_storeys(numerical: Numerical, dt_s: float, scheme: Scheme = "exact") -> Block:
    """Return the block with every storey's motion as output (for the record after a run)."""
    p = len(numerical.masses_kg)
    names = tuple(f"{q}_{i + 1}" for q in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2") for i in range(p))
    if scheme == "exact":
        return discretise(state_space(numerical), dt_s, "foh", "numerical", INPUTS, names)
    make = _chen_ricles if scheme == "cr" else _newmark
    system = make(numerical, dt_s)
    return Block("numerical", system.A, system.B, system.C, system.D, dt_s, INPUTS, names)


def interface(numerical: Numerical, dt_s: float, scheme: Scheme = "exact") -> Block:
    """Return the block of the step: ground acceleration and base shear to the interface floor's motion.

    `exact` is so for inputs that are straight lines between samples; `cr` and `newmark` are the explicit schemes of
    `_chen_ricles` and `_newmark`. Outputs as in INTERFACE, acceleration absolute.
    """
    p = len(numerical.masses_kg)
    block = all_storeys(numerical, dt_s, scheme)
    rows = [3 * p - 1, 2 * p - 1, p - 1]
    return Block(block.name, block.A, block.B, block.C[rows], block.D[rows], dt_s, INPUTS, INTERFACE)


def check_scheme(numerical: Numerical, dt_s: float, scheme: Scheme) -> None:
    """Raise InputError where the scheme by itself is unstable at this step: explicit Newmark with a spectral radius
    above one (the others are stable at any step)."""
    if scheme != "newmark":
        return
    radius = float(np.abs(np.linalg.eigvals(all_storeys(numerical, dt_s, scheme).A)).max())
    if radius <= 1.0 + ROUNDING:
        return
    limit_s = 2.0 / _highest_rad_s(numerical)
    raise InputError(
        f"integration: {scheme} is unstable at dt = {1e3 * dt_s:.4g} ms (spectral radius {radius:.4g}), its limit is "
        f"2 / w_max = {1e3 * limit_s:.4g} ms of the numerical storeys; raise sample_rate_hz above {1.0 / limit_s:.5g}, "
        "or use integration: cr or exact"
    )


def _highest_rad_s(numerical: Numerical) -> float:
    """Return the highest undamped natural frequency in rad/s."""
    if numerical.M is not None:
        return float(2.0 * np.pi * mode_shapes(numerical.M, numerical.K)[0][-1])
    scale = 1.0 / np.sqrt(numerical.masses_kg)
    return float(np.sqrt(np.linalg.eigvalsh(scale[:, None] * numerical.K * scale).max()))


def _chen_ricles(numerical: Numerical, dt_s: float) -> StateSpace:
    """Return A, B, C, D of the explicit, unconditionally stable CR scheme, state = displacement, velocity.

    x[k+1] = x[k] + dt v[k] + dt^2 alpha a[k], v[k+1] = v[k] + dt alpha a[k], a[k] from equilibrium at k,
    alpha = 4 (4 M + 2 dt C + dt^2 K)^-1 M (Chen and Ricles, J. Eng. Mech. 134(8), 2008).
    """
    p, mass = len(numerical.masses_kg), numerical.mass_matrix
    continuous = state_space(numerical)
    alpha = 4.0 * np.linalg.solve(4.0 * mass + 2.0 * dt_s * numerical.C + dt_s**2 * numerical.K, mass)
    advance = np.vstack([dt_s**2 * alpha, dt_s * alpha])
    free = np.block([[np.eye(p), dt_s * np.eye(p)], [np.zeros((p, p)), np.eye(p)]])
    a, b = free + advance @ continuous.A[p:], advance @ continuous.B[p:]
    return StateSpace(a, b, continuous.C, continuous.D)


def _newmark(numerical: Numerical, dt_s: float) -> StateSpace:
    """Return A, B, C, D of explicit Newmark (beta 0, gamma 1/2), state = displacement, velocity half a step before.

    With w = v[k] - dt/2 a[k]: a[k] = (M + dt/2 C)^-1 (F[k] - C w - K x[k]), then w grows by dt a[k] and x by dt
    times the new w (Newmark, J. Eng. Mech. Div. 85(EM3), 1959). Stable up to dt = 2 / w_max, whatever the damping.
    """
    p, mass = len(numerical.masses_kg), numerical.mass_matrix
    inverse = np.linalg.inv(mass + 0.5 * dt_s * numerical.C)
    from_state = inverse @ np.hstack([-numerical.K, -numerical.C])
    from_input = inverse @ np.column_stack([-numerical.inertia_kg, np.eye(p)[-1]])
    pick, none = np.eye(2 * p), np.zeros((p, 2))
    wider = pick[p:] + dt_s * from_state
    a, b = np.vstack([pick[:p] + dt_s * wider, wider]), np.vstack([dt_s**2 * from_input, dt_s * from_input])
    c = np.vstack([pick[:p], pick[p:] + 0.5 * dt_s * from_state, from_state])
    d = np.vstack([none, 0.5 * dt_s * from_input, np.column_stack([numerical.ground, np.zeros(p)]) + from_input])
    return StateSpace(a, b, c, d)


def amplitude_and_lag(numerical: Numerical, block: Block, frequency_hz: Array) -> tuple[Array, Array]:
    """Return amplitude error (-) and lag in s, (n_frequencies,), of an `interface` block against its continuous state
    space, from base shear to the interface's absolute acceleration."""
    frequency = np.asarray(frequency_hz, dtype=float)
    row = 3 * len(numerical.masses_kg) - 1
    ratio = block.response(frequency)[0, 1] / state_space(numerical).response(frequency)[row, 1]
    return np.abs(ratio) - 1.0, -np.angle(ratio) / (2.0 * np.pi * frequency)
