"""SIM-DELAY: the substructured building with the base shear acting on the numerical part a pure delay later.

Numerical part and specimen are advanced with their matrix exponentials. Over a substep the table
acceleration and the delayed base shear are cubic Hermite polynomials of their values and derivatives, which
both parts give exactly; the ground acceleration is linear. The substep is halved until the response no
longer changes. Nothing here is shared with the loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.analysis.delay_kernel import Part, Scratch, integrate
from rths_cli.analysis.sim import (
    Response,
    base_shear_n,
    checked_record,
    hold_matrices,
    simulate,
    state_equation,
)
from rths_cli.errors import InputError
from rths_cli.lti import Array, ComplexArray, Integers
from rths_cli.structure import Building, Numerical, Specimen

DIVERGENCE_FACTOR = 1000.0
_LARGEST_PHASE_PER_SUBSTEP = 0.5  # rad, of the fastest mode of either part, in the coarsest solution
_MOST_SUBSTEPS = 2e7  # of the whole record, where refinement ends
_MOST_SUBSTEPS_PER_SAMPLE = 10_000
_LARGEST_CONDITION = 1e6  # of modal coordinates: beyond it they lose six digits


@dataclass(frozen=True)
class DelayedResponse(Response):
    """Response with a delayed base shear; every series is NaN from `diverged_at_s` on.

    `error_estimate` is the change, relative to the peak of each quantity, when `substep_s` was last halved.
    """

    substep_s: float
    diverged_at_s: float | None


@dataclass(frozen=True)
class _Basis:
    """Coordinates y of a part, states = T y: modal ones, of pairs and single `eigenvalues`, or the states (None)."""

    T: Array
    eigenvalues: ComplexArray | None


def simulate_delayed(
    building: Building,
    dt_s: float,
    ground_accel_m_s2: ArrayLike,
    delay_s: float,
    tolerance: float = 1e-6,
    sim: Response | None = None,
) -> DelayedResponse:
    """Solve Eq. 2.3 with f(t - delay_s), 2.5 and 2.6 from rest for a record (n,) linear between samples.

    The substep is halved until no quantity changes by more than `tolerance` of its peak. An absolute acceleration
    beyond 1000 times SIM's peak cuts the response; `sim` is SIM where that is known already. Raises InputError for a
    negative delay, a bad step, record or tolerance.
    """
    record = checked_record(dt_s, ground_accel_m_s2)
    _check(delay_s, tolerance)
    sim = sim or simulate(building, dt_s, record)
    if delay_s == 0:
        series = {field.name: getattr(sim, field.name) for field in fields(sim)}
        return DelayedResponse(**series, substep_s=dt_s, diverged_at_s=None)
    limit = DIVERGENCE_FACTOR * float(np.abs(sim.abs_accel_m_s2).max())
    substeps = _first_substeps(building, dt_s, delay_s)
    bases = _basis(building.numerical), _basis(building.specimen)
    coarse = _solve(building, bases, dt_s, record, delay_s, substeps, limit)
    while True:
        substeps *= 2
        fine = _solve(building, bases, dt_s, record, delay_s, substeps, limit)
        change = _relative_change(coarse, fine)
        if change <= tolerance or 2 * substeps * len(record) > _MOST_SUBSTEPS:
            return replace(fine, error_estimate=change)
        coarse = fine


def _check(delay_s: float, tolerance: float) -> None:
    """Raise InputError unless the delay is zero or more and the tolerance positive."""
    faults = []
    if not (math.isfinite(delay_s) and delay_s >= 0):
        faults.append(f"delay_s is {delay_s:g} s, but must be finite and 0 s or more: give 0.005, say")
    if not tolerance > 0:
        faults.append(f"tolerance is {tolerance:g}, but it must be positive: give 1e-6, say")
    if faults:
        raise InputError(*faults)


def _first_substeps(building: Building, dt_s: float, delay_s: float) -> int:
    """Return the substeps per sample of the coarsest solution.

    They resolve the fastest mode of either part. With half the interface floor or more on the table the
    force grows at every return, at any frequency: only substeps below the delay show that (such a response
    diverges, and ends, early).
    """
    matrices = (_state_matrices(part)[0] for part in (building.numerical, building.specimen))
    fastest = max(float(np.abs(np.linalg.eigvals(A)).max()) for A in matrices)
    needed = max(1, math.ceil(dt_s * fastest / _LARGEST_PHASE_PER_SUBSTEP))
    if building.interface_experimental_mass_kg >= building.numerical.masses_kg[-1]:
        needed = max(needed, math.ceil(min(dt_s / delay_s, _MOST_SUBSTEPS_PER_SAMPLE)))
    return needed


def _state_matrices(part: Numerical | Specimen) -> tuple[Array, Array]:
    """Return A, B of a substructure for the acceleration of its base."""
    return state_equation(np.diag(part.masses_kg), part.C, part.K)


def _basis(part: Numerical | Specimen) -> _Basis:
    """Return modal coordinates, in which a step costs as much as there are storeys; none where they lose digits."""
    A, _ = _state_matrices(part)
    eigenvalues, vectors = np.linalg.eig(A)
    kept = np.flatnonzero(eigenvalues.imag >= 0.0)
    columns = [
        column for i in kept for column in (vectors[:, i].real, vectors[:, i].imag)[: 2 if eigenvalues[i].imag else 1]
    ]
    T = np.array(columns).T
    if not np.linalg.cond(T) < _LARGEST_CONDITION:
        return _Basis(np.eye(len(A)), None)
    return _Basis(T, eigenvalues[kept].astype(complex))


def _numerical_part(building: Building, basis: _Basis, h_s: float) -> Part:
    """Prepare Eq. 2.3: inputs ground acceleration (linear) and delayed force (cubic), output a1."""
    A, B = _state_matrices(building.numerical)
    p = len(A) // 2
    force_in = np.zeros((2 * p, 1))
    force_in[-1] = 1.0 / building.numerical.masses_kg[-1]
    E, (start, slope) = hold_matrices(A, B, h_s, 1)
    G = np.hstack([start - slope, slope, *_hermite(hold_matrices(A, force_in, h_s, 3)[1])])
    a1 = A[-1:]
    W = np.vstack([a1, h_s * a1 @ A])
    inverse_mass = force_in[-1, 0]
    V = np.array([[0.0, inverse_mass, 0.0], [*(h_s * a1 @ np.hstack([B, force_in]))[0], inverse_mass]])
    return _in_basis(basis, h_s, E, G, W, V)


def _specimen_part(building: Building, basis: _Basis, h_s: float) -> Part:
    """Prepare Eq. 2.5: input a1 (cubic); output the base shear of Eq. 2.6."""
    A, B = _state_matrices(building.specimen)
    E, inputs = hold_matrices(A, B, h_s, 3)
    shear = -building.specimen.masses_kg[None, :] @ A[len(A) // 2 :]
    W = np.vstack([shear, h_s * shear @ A])
    mass = building.interface_experimental_mass_kg
    V = np.array([[-mass, 0.0], [(h_s * shear @ B).item(), -mass]])
    return _in_basis(basis, h_s, E, np.hstack(_hermite(inputs)), W, V)


def _in_basis(basis: _Basis, h_s: float, E: Array, G: Array, W: Array, V: Array) -> Part:
    """Return a part in its coordinates, in the memory order the compiled recursion takes."""
    n = len(E)
    band, first = (E, np.zeros(n, dtype=np.int64)) if basis.eigenvalues is None else _bands(basis.eigenvalues, h_s)
    inputs, outputs = np.asarray(np.linalg.solve(basis.T, G), dtype=float), W @ basis.T
    band, inputs, outputs, V = (np.ascontiguousarray(m) for m in (band, inputs, outputs, V))
    return Part(band, first, inputs, outputs, V, np.zeros(n), np.zeros(n))


def _bands(eigenvalues: ComplexArray, h_s: float) -> tuple[Array, Integers]:
    """Return exp(A h) in real modal form as two neighbours of each row, (n, 2), and the column of the left one (n,)."""
    n = sum(2 if value.imag else 1 for value in eigenvalues)
    full, row = np.zeros((n, n + 1)), 0
    first = np.minimum(np.arange(n), n - 2)
    for value, step in zip(eigenvalues, np.exp(eigenvalues * h_s), strict=True):
        full[row, row] = step.real
        if value.imag:
            full[row, row + 1], full[row + 1, row], full[row + 1, row + 1] = step.imag, -step.imag, step.real
            first[row + 1] = row
        row += 2 if value.imag else 1
    return np.array([full[i, first[i] : first[i] + 2] for i in range(n)]), first


def _hermite(inputs: list[Array]) -> list[Array]:
    """Turn matrices for 1, s, s^2, s^3 into those for the cubic's value and slope at s = 0, then at s = 1."""
    g0, g1, g2, g3 = inputs
    return [g0 - 3 * g2 + 2 * g3, g1 - 2 * g2 + g3, 3 * g2 - 2 * g3, g3 - g2]


def _solve(
    building: Building, bases: tuple[_Basis, _Basis], dt_s: float, record: Array, delay_s: float, substeps: int,
    limit_m_s2: float,
) -> DelayedResponse:  # fmt: skip
    """Integrate with `substeps` per sample and cut where an absolute acceleration passes the limit."""
    h_s = dt_s / substeps
    lag = delay_s / h_s
    numerical, specimen = _numerical_part(building, bases[0], h_s), _specimen_part(building, bases[1], h_s)
    history = np.zeros((math.ceil(min(lag, substeps * len(record))) + 3, 2))
    split, count = numerical.y.size, numerical.y.size + specimen.y.size
    result = np.full((len(record), count + 1), np.nan)
    moving_mass = building.specimen.masses_kg.sum() + building.interface_experimental_mass_kg
    scratch = Scratch(np.zeros(6), np.zeros(4), np.zeros(3), np.zeros(2))
    limit_n = float(limit_m_s2 * moving_mass)
    integrate(record, substeps, lag, limit_n, numerical, specimen, scratch, history, result)
    states = bases[0].T @ result[:, :split].T, bases[1].T @ result[:, split:count].T
    return _response(building, dt_s, h_s, *states, result[:, count], limit_m_s2)


def _response(
    building: Building, dt_s: float, h_s: float, y: Array, z: Array, delayed_force: Array, limit_m_s2: float
) -> DelayedResponse:
    """Assemble the series from the states of both parts (., n) and the delayed force (n,)."""
    p, n = len(building.numerical.masses_kg), len(building.specimen.masses_kg)
    numerical_accel = _state_matrices(building.numerical)[0][p:] @ y
    numerical_accel[-1] += delayed_force / building.numerical.masses_kg[-1]
    specimen_accel = _state_matrices(building.specimen)[0][n:] @ z
    accel = np.concatenate([numerical_accel, specimen_accel])
    disp, vel = np.concatenate([y[:p], z[:n] + y[p - 1]]), np.concatenate([y[p:], z[n:] + y[-1]])
    within = np.abs(accel).max(axis=0) <= limit_m_s2
    end = len(within) if within.all() else int(np.argmin(within))
    for series in (disp, vel, accel):
        series[:, end:] = np.nan
    diverged_at_s = None if within.all() else end * dt_s
    return DelayedResponse(disp, vel, accel, base_shear_n(building, accel), math.nan, h_s, diverged_at_s)


def _relative_change(coarse: DelayedResponse, fine: DelayedResponse) -> float:
    """Return the largest difference of any quantity over its peak, where neither solution has been cut."""
    end = int(np.count_nonzero(np.isfinite(coarse.base_shear_n) & np.isfinite(fine.base_shear_n)))
    names = ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2", "base_shear_n")
    changes = []
    for name in names:
        before, after = getattr(coarse, name)[..., :end], getattr(fine, name)[..., :end]
        changes.append(float(np.abs(after - before).max()) / (float(np.abs(after).max()) or 1.0))
    return max(changes)
