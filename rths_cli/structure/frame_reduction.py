"""Reduction of a frame for the loop: static or Craig-Bampton, in degrees of freedom of the frame as coordinates.

A reduced frame moves as x = B y. Whatever spans the columns of B, as many degrees of freedom of the frame can be taken
for y, so that results show displacements of the frame, and none of modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Integers
from rths_cli.structure.frame import FIELD, Frame, damping_of, even, frame_of, stamps
from rths_cli.structure.shear_chain import Numerical, Unreduced, above_rounding

if TYPE_CHECKING:
    from rths_cli.case.matrices_schema import MatricesSpec
    from rths_cli.case.structure_schema import DampingSpec, StructureSpec

KEPT_WITHIN = 1e-3  # relative, in frequency, of the frame's modes that a reduction keeps
LEFT_MASS = 1e-9  # of the frame's mass; more than this is given to one more shape
MOST_CONDITION = 1e5  # of the shapes in the degrees of freedom that describe them
WELL_APART = 0.05  # of the largest displacement: part of a shape that no other degree of freedom along the ground shows
SAME_MASS = 1e-6  # relative, of masses that a result states


@dataclass(frozen=True, eq=False)
class Reduced:
    """A frame in fewer coordinates: x = shapes inverse y, y its degrees of freedom `rows` (p,), the interface last."""

    shapes: Array  # (n, p) modes and static shapes
    inverse: Array  # (p, p) of their rows
    rows: Integers
    frequency_hz: Array  # (p,) of the reduced frame by itself
    whole_hz: Array  # (n,) of the frame
    modes: int  # of the frame that it has to 0.1 %, from the first
    fixed_modes: int  # with the interface held
    adds_ground_shape: bool  # whether one more shape lets all mass follow the ground

    def matrix(self, whole: Array) -> Array:
        """Return what a matrix (n, n) of the frame is in its coordinates, (p, p)."""
        inner = even(self.shapes.T @ whole @ self.shapes)  # before the inverse: the frame's stiffest parts cancel there
        return even(self.inverse.T @ inner @ self.inverse)


def numerical_of(spec: MatricesSpec, damping: DampingSpec, interface_mass_kg: float) -> Numerical:
    """Return the numerical substructure of a frame at a damping level, without the interface mass on the table.

    Raises InputError for matrices, damping or a reduction that cannot be used, and where more mass stands on the table
    than the interface has.
    """
    frame, C = frame_of(spec), damping_of(spec, damping)
    whole = _numerical(frame, frame.M, C, frame.K, np.arange(len(frame.M)), frame.influence, interface_mass_kg)
    reduced = reduced_of(spec)
    if reduced is None:
        return whole
    M, C, K = (reduced.matrix(one) for one in (frame.M, C, frame.K))
    own = _numerical(frame, M, C, K, reduced.rows, frame.influence[reduced.rows], interface_mass_kg)
    return replace(own, whole=Unreduced(whole, reduced.rows))


def _numerical(
    frame: Frame, M: Array, C: Array, K: Array, rows: Integers, influence: Array, interface_mass_kg: float
) -> Numerical:
    M = M.copy()
    M[-1, -1] -= interface_mass_kg
    full = M if np.any(M - np.diag(np.diag(M))) else None
    found = Numerical(np.diag(M).copy(), K, C, full, None if np.all(influence == 1.0) else influence, frame.dofs[rows])
    if not (M[-1, -1] > 0.0 and np.linalg.eigvalsh(M)[0] > 0.0):
        raise InputError(
            f"structure.interface_experimental_mass_kg: {interface_mass_kg:g} kg must be less than the mass of the "
            f"interface, degree of freedom {frame.dofs[-1]} of {FIELD}"
        )
    return found


def reduced_of(spec: MatricesSpec) -> Reduced | None:
    """Return how a frame is reduced, None where the loop computes all of it; raises InputError."""
    return _reduced(spec, stamps(spec))


@lru_cache(maxsize=8)
def _reduced(spec: MatricesSpec, _: tuple[tuple[int, int], ...]) -> Reduced | None:
    frame, asked = frame_of(spec), spec.reduction
    n = len(frame.M)
    if asked.kind == "none":
        from rths_cli.case.matrices_schema import MOST_KEPT

        if n > MOST_KEPT:
            raise InputError(
                f"{FIELD}.reduction: {n} degrees of freedom have mass, the loop computes at most {MOST_KEPT}; reduce "
                "them, for example reduction: {kind: craig_bampton, up_to_hz: 60}"
            )
        return None
    stated = _rows_of(frame, asked.dofs or ())
    if asked.kind == "static":
        return _finished(frame, _static_shapes(frame, stated), stated, 0)
    whole_hz = frame.frequency_hz
    modes = asked.modes or int(np.count_nonzero(whole_hz <= (asked.up_to_hz or 0.0)))
    if not 1 <= modes <= n:
        key = "modes" if asked.modes else "up_to_hz"
        value = asked.modes or f"{asked.up_to_hz:g} Hz"
        raise InputError(
            f"{FIELD}.reduction.{key}: {value} keeps {modes} modes, the frame has {n}, from {whole_hz[0]:.4g} to "
            f"{whole_hz[-1]:.4g} Hz"
        )
    return _craig_bampton(frame, whole_hz, modes, stated)


def _rows_of(frame: Frame, dofs: tuple[int, ...]) -> Integers:
    """Return the rows of stated degrees of freedom; raises InputError for those without mass or not there."""
    places = {int(dof): row for row, dof in enumerate(frame.dofs)}
    lacking = [dof for dof in dofs if dof not in places]
    if lacking:
        raise InputError(
            f"{FIELD}.reduction.dofs: {', '.join(map(str, lacking))} have no mass, or are no degrees of freedom; "
            f"those with mass are {_listed(frame.dofs)}"
        )
    return np.array(sorted(places[dof] for dof in dofs), dtype=np.int64)


def _listed(dofs: Integers) -> str:
    numbers = [str(dof) for dof in sorted(dofs.tolist())]
    return ", ".join(numbers if len(numbers) <= 30 else [*numbers[:28], "...", numbers[-1]])


def _static_shapes(frame: Frame, masters: Integers) -> Array:
    """Return the shapes (n, m + 1) of unit displacements of masters, then the interface, the rest without load."""
    from scipy.linalg import cho_factor, cho_solve

    n = len(frame.M)
    held = np.append(masters, n - 1)
    free = np.setdiff1d(np.arange(n), held)
    shapes = np.zeros((n, len(held)))
    shapes[held, np.arange(len(held))] = 1.0
    if free.size:
        shapes[free] = -cho_solve(cho_factor(frame.K[np.ix_(free, free)]), frame.K[np.ix_(free, held)])
    return shapes


def _craig_bampton(frame: Frame, whole_hz: Array, modes: int, stated: Integers) -> Reduced:
    """Return the reduction with as few modes of the held interface as keep the frame's first `modes` to 0.1 %."""
    from scipy.linalg import eigh

    inner = len(frame.M) - 1
    _, held = eigh(frame.K[:-1, :-1], frame.M[:-1, :-1]) if inner else (None, np.zeros((0, 0)))
    fixed = min(max(modes, len(stated)), inner)
    while True:
        shapes = np.zeros((inner + 1, fixed + 1))
        shapes[:-1, :-1] = held[:, :fixed]
        shapes[:, -1] = _static_shapes(frame, np.empty(0, dtype=np.int64))[:, -1]
        shapes, _ = _with_ground(frame, shapes)
        squares = eigh(even(shapes.T @ frame.K @ shapes), even(shapes.T @ frame.M @ shapes), eigvals_only=True)
        found_hz = np.sqrt(above_rounding(squares)) / (2.0 * np.pi)
        if fixed == inner or _kept(found_hz, whole_hz) >= modes:
            break
        fixed = min(fixed + max(1, modes // 8), inner)
    return _finished(frame, shapes[:, _without_ground(shapes, fixed)], stated, fixed, modes)


def _without_ground(shapes: Array, fixed: int) -> Integers:
    """Return the columns of the modes and of the interface, without that of the ground."""
    return np.append(np.arange(fixed), shapes.shape[1] - 1)


def _kept(found_hz: Array, whole_hz: Array) -> int:
    """Return how many of the frame's modes, from the first, have their frequency to 0.1 %."""
    count = min(len(found_hz), len(whole_hz))
    wrong = np.flatnonzero(np.abs(found_hz[:count] / whole_hz[:count] - 1.0) > KEPT_WITHIN)
    return int(wrong[0]) if wrong.size else count


def _with_ground(frame: Frame, shapes: Array) -> tuple[Array, bool]:
    """Return shapes with one more, the part of the ground's motion that they lack, before the last; and whether.

    With it all of the frame's mass follows the ground: absolute accelerations have no part of modes that are left out.
    """
    momenta = frame.M @ shapes
    share = np.linalg.solve(shapes.T @ momenta, momenta.T @ frame.influence)
    rest = frame.influence - shapes @ share
    rest = rest - rest[-1] * shapes[:, -1]
    size = float(rest @ frame.M @ rest)
    if size <= LEFT_MASS * frame.mass_kg:
        return shapes, False
    return np.column_stack([shapes[:, :-1], rest / np.sqrt(size), shapes[:, -1]]), True


def _finished(frame: Frame, shapes: Array, stated: Integers, fixed: int, least: int = 0) -> Reduced:
    """Return the reduction to shapes (n, m), the last that of the interface, in coordinates of the frame."""
    from scipy.linalg import eigh

    shapes, added = _with_ground(frame, shapes)
    from rths_cli.case.matrices_schema import MOST_KEPT

    if shapes.shape[1] > MOST_KEPT:
        raise InputError(
            f"{FIELD}.reduction: needs {shapes.shape[1]} coordinates, the loop computes at most {MOST_KEPT}; keep "
            "fewer modes"
        )
    rows = _coordinates(frame, shapes[:-1, :-1], stated)
    every = np.append(rows, len(frame.M) - 1)
    whole_hz, none = frame.frequency_hz, np.empty(0)
    reduced = Reduced(shapes, np.linalg.inv(shapes[every]), every, none, whole_hz, 0, fixed, added)
    squares = eigh(reduced.matrix(frame.K), reduced.matrix(frame.M), eigvals_only=True)
    found_hz = np.sqrt(above_rounding(squares)) / (2.0 * np.pi)
    return replace(reduced, frequency_hz=found_hz, modes=_kept(found_hz, whole_hz))


def _coordinates(frame: Frame, shapes: Array, stated: Integers) -> Integers:
    """Return the rows, as many as columns of shapes (n - 1, m), that describe them best, the stated ones among them.

    Displacements along the ground motion are preferred. Raises InputError for stated ones that say the same.
    """
    from scipy.linalg import qr

    size, rows = shapes.shape[1], stated
    along = np.flatnonzero(frame.influence[:-1] == 1.0)
    for candidates, least in ((along, WELL_APART), (np.arange(len(shapes)), 0.0)):
        left = np.setdiff1d(candidates, rows)
        basis = np.linalg.qr(shapes[rows].T)[0] if rows.size else np.zeros((size, 0))
        rest = shapes[left] - shapes[left] @ basis @ basis.T
        if rows.size < size and left.size:
            triangle, order = qr(rest.T, mode="r", pivoting=True)
            apart = np.abs(np.diag(triangle)) > least * np.abs(shapes).max()
            rows = np.concatenate([rows, left[order[: np.count_nonzero(apart)]]])[:size]
    rows = np.sort(rows).astype(np.int64)
    if rows.size == size and np.linalg.cond(shapes[rows]) < MOST_CONDITION:
        return rows
    raise InputError(
        f"{FIELD}.reduction.dofs: {_listed(frame.dofs[stated])} hardly move independently of each other in the modes "
        "that are kept; keep more modes, or state fewer degrees of freedom"
    )


def masses_of(spec: StructureSpec) -> tuple[float, ...]:
    """Return the masses (p,) in kg of the computed storeys: of a frame the diagonal of the mass matrix that the loop
    computes, the interface's whole mass included; raises InputError."""
    matrices = spec.numerical.matrices
    if matrices is None:
        return spec.numerical.masses_kg
    frame, reduced = frame_of(matrices), reduced_of(matrices)
    M = frame.M if reduced is None else reduced.matrix(frame.M)
    return tuple(np.diag(M).tolist())


def with_masses(spec: StructureSpec) -> StructureSpec:
    """Return a structure whose numerical part states its masses, those of a frame read from its matrices.

    Raises InputError where a frame states other ones.
    """
    if spec.numerical.matrices is None:
        return spec
    found, stated = masses_of(spec), spec.numerical.masses_kg
    if stated and not (len(stated) == len(found) and np.allclose(stated, found, rtol=SAME_MASS, atol=0.0)):
        raise InputError("structure.numerical.masses_kg: differ from the diagonal of the mass matrix; remove them")
    return spec.model_copy(update={"numerical": spec.numerical.model_copy(update={"masses_kg": found})})
