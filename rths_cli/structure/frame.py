"""A frame by its matrices: read and checked, degrees of freedom without mass condensed, damped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.matrix_files import read_matrix
from rths_cli.numerics.lti import Array, Integers
from rths_cli.structure.shear_chain import above_rounding

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from rths_cli.case.matrices_schema import MatricesSpec, MatrixFile, MatrixUnits
    from rths_cli.case.structure_schema import DampingSpec

FIELD = "structure.numerical.matrices"
LENGTH_M = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
FORCE_N = {"N": 1.0, "kN": 1e3, "MN": 1e6, "kgf": 9.80665, "lbf": 4.4482216152605, "kip": 4448.2216152605}
MASS_KG = {"kg": 1.0, "t": 1e3, "g": 1e-3, "lb": 0.45359237}
MOST_WITH_MASS = 1000  # SIM takes all of their modes: 20 s
UNEQUAL = 1e-6  # of two entries that must be equal by symmetry, beside the ninth digit of the largest one
SINGULAR = 1e-12  # pivot of a matrix with ones on its diagonal
DENSE = 2000  # rows up to which the direction of a motion without resistance is found
ALONG = 1e-9  # from the one with which the interface must follow the ground


@dataclass(frozen=True, eq=False)
class Condensed:
    """How degrees of freedom without mass follow the others: x_s = S x_m, from K_ss x_s + K_sm x_m = 0."""

    kept: Integers  # (n,) rows of the file's matrices, the interface last
    massless: Integers  # (s,)
    S: Array  # (s, n)

    def matrix(self, full: csr_array) -> Array:
        """Return what is left (n, n) of a matrix of the files."""
        own = np.asarray(full[self.kept][:, self.kept].toarray())
        if not self.massless.size:
            return own
        across = full[self.kept][:, self.massless] @ self.S
        beyond = self.S.T @ (full[self.massless][:, self.massless] @ self.S)
        return np.asarray(own + across + across.T + beyond)


@dataclass(frozen=True, eq=False)
class Frame:
    """Degrees of freedom with mass of a frame, the interface last: M (n, n) in kg, K (n, n) in N/m, r (n,)."""

    M: Array
    K: Array
    influence: Array
    condensed: Condensed

    @property
    def dofs(self) -> Integers:
        """Return their numbers (n,) in the files, from 1."""
        return self.condensed.kept + 1

    @property
    def mass_kg(self) -> float:
        """Return the mass that follows the ground, r^T M r."""
        return float(self.influence @ self.M @ self.influence)

    @property
    def frequency_hz(self) -> Array:
        """Return the undamped natural frequencies (n,) of the frame by itself."""
        from scipy.linalg import eigh

        return np.sqrt(above_rounding(eigh(self.K, self.M, eigvals_only=True))) / (2.0 * np.pi)


def units_of(spec: MatrixUnits) -> tuple[float, float, float]:
    """Return the factors of mass, stiffness and damping to kg, N/m and N s/m."""
    stiffness = FORCE_N[spec.force] / LENGTH_M[spec.length]
    return stiffness if spec.mass == "consistent" else MASS_KG[spec.mass], stiffness, stiffness


def frame_of(spec: MatricesSpec) -> Frame:
    """Return the frame of a structure file.

    Raises InputError, with all faults of a stage in one go, for files that cannot be read, for matrices that are not
    square, of one size, symmetric and positive definite, for a frame that can move freely, and for an interface without
    mass or that does not follow the ground.
    """
    return _frame(spec, stamps(spec))


def stamps(spec: MatricesSpec) -> tuple[tuple[int, int], ...]:
    """Return time and size of the files of a frame, by which one that has changed is read anew."""
    files = [spec.mass, spec.stiffness, *([] if isinstance(spec.influence, str) else [spec.influence])]
    found = [one.file.stat() if one.file.exists() else None for one in files]
    return tuple((0, 0) if one is None else (one.st_mtime_ns, one.st_size) for one in found)


@lru_cache(maxsize=8)
def _frame(spec: MatricesSpec, _: tuple[tuple[int, int], ...]) -> Frame:
    from scipy.sparse import csr_array

    of_mass, of_stiffness, _damping = units_of(spec.units)
    faults: list[str] = []
    M, K = _square("mass", spec.mass, "M", faults), _square("stiffness", spec.stiffness, "K", faults)
    if M is not None and K is not None and M.shape != K.shape:
        faults.append(
            f"{FIELD}: mass ({spec.mass.file.name}) has {M.shape[0]} rows, stiffness ({spec.stiffness.file.name}) "
            f"{K.shape[0]}; both need a row for each degree of freedom"
        )
    rows = 0 if K is None else K.shape[0]
    if rows and spec.interface > rows:
        faults.append(f"{FIELD}.interface: {spec.interface} is no degree of freedom, the matrices have {rows} rows")
    influence = _influence(spec, rows, faults)
    if faults or M is None or K is None:
        raise InputError(*faults)
    M, K = csr_array(of_mass * M), csr_array(of_stiffness * K)
    return _checked_frame(spec, M, K, influence)


def _checked_frame(spec: MatricesSpec, M: csr_array, K: csr_array, influence: Array) -> Frame:
    """Return the frame of symmetric matrices in kg and N/m."""
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import splu

    mass, stiffness = spec.mass.file.name, spec.stiffness.file.name
    used = np.asarray(abs(M).sum(axis=1)).ravel() > 0.0
    at = spec.interface - 1
    faults = []
    if not used[at]:
        faults.append(
            f"{FIELD}.interface: degree of freedom {spec.interface} has no mass (row {spec.interface} of {mass} is "
            "zero); give its floor the mass, or take another degree of freedom"
        )
    faults += _indefinite(f"{FIELD}.mass", mass, csr_array(M[used][:, used]), np.flatnonzero(used), "mass")
    faults += _indefinite(f"{FIELD}.stiffness", stiffness, K, np.arange(K.shape[0]), "stiffness")
    if np.count_nonzero(used) > MOST_WITH_MASS:
        faults.append(
            f"{FIELD}.mass: {np.count_nonzero(used)} degrees of freedom of {mass} have mass, at most {MOST_WITH_MASS} "
            "can be solved as a reference; lump the masses at the floors"
        )
    if faults:
        raise InputError(*faults)
    kept = np.concatenate([np.setdiff1d(np.flatnonzero(used), [at]), [at]])
    massless = np.flatnonzero(~used)
    S = np.zeros((0, len(kept)))
    if massless.size:
        S = -splu(K[massless][:, massless].tocsc()).solve(K[massless][:, kept].toarray())
    condensed = Condensed(kept, massless, S)
    full = M[kept][:, kept].toarray()
    return Frame(even(full), even(condensed.matrix(K)), influence[kept], condensed)


def _square(key: str, file: MatrixFile, usual: str, faults: list[str]) -> csr_array | None:
    """Return a symmetric matrix of a file, None with its faults."""
    from scipy.sparse import csr_array

    field = f"{FIELD}.{key}"
    try:
        matrix = read_matrix(field, file, usual)
    except InputError as error:
        faults += error.faults
        return None
    rows, columns = matrix.shape
    if rows != columns:
        faults.append(f"{field}: {file.file.name} has {rows} rows and {columns} columns; it must be square")
        return None
    from rths_cli.case.matrices_schema import MOST_DOFS

    if rows > MOST_DOFS:
        faults.append(f"{field}: {file.file.name} has {rows} rows, at most {MOST_DOFS}")
        return None
    found = unequal_pair(matrix)
    if found:
        faults.append(f"{field}: {file.file.name} is not symmetric: {found}; export the whole matrix again")
        return None
    return csr_array(0.5 * (matrix + matrix.T))


def unequal_pair(matrix: csr_array) -> str:
    """Return in words the pair of entries that differ most although symmetry makes them equal, "" without one."""
    apart = (matrix - matrix.T).tocoo()
    if not apart.nnz:
        return ""
    rows, columns = apart.coords
    there, back = (np.asarray(one).ravel() for one in (matrix[rows, columns], matrix[columns, rows]))
    allowed = UNEQUAL * np.maximum(np.abs(there), np.abs(back)) + 1e-3 * UNEQUAL * np.abs(matrix.data).max()
    worst = int(np.argmax(np.abs(apart.data) / allowed))
    if abs(apart.data[worst]) <= allowed[worst]:
        return ""
    i, j = int(rows[worst]) + 1, int(columns[worst]) + 1
    return f"row {i}, column {j} is {there[worst]:.9g}, row {j}, column {i} is {back[worst]:.9g}"


def _influence(spec: MatricesSpec, rows: int, faults: list[str]) -> Array:
    """Return the influence vector (n,) of the file's degrees of freedom."""
    if isinstance(spec.influence, str) or not rows:
        return np.ones(rows)
    field, name = f"{FIELD}.influence", spec.influence.file.name
    try:
        found = read_matrix(field, spec.influence, "r").toarray()
    except InputError as error:
        faults += error.faults
        return np.ones(rows)
    if min(found.shape) != 1 or found.size != rows:
        faults.append(f"{field}: {name} has {found.shape[0]} rows and {found.shape[1]} columns, wanted {rows} numbers")
        return np.ones(rows)
    vector = found.ravel()
    at = min(spec.interface, rows) - 1
    if abs(vector[at] - 1.0) > ALONG:
        faults.append(
            f"{field}: {name} gives the interface (entry {at + 1}) {vector[at]:g}, it must be 1: the table shakes "
            "along the ground motion; choose another interface, or repair the vector"
        )
    return vector


def _indefinite(field: str, name: str, matrix: csr_array, rows: Integers, what: str) -> list[str]:
    """Return a sentence unless a symmetric matrix is positive definite; `rows` are its rows in the file."""
    from scipy.linalg import eigh
    from scipy.sparse import diags_array, eye_array
    from scipy.sparse.linalg import splu

    diagonal = matrix.diagonal()
    least = int(np.argmin(diagonal)) if diagonal.size else 0
    if not diagonal.size or diagonal[least] <= 0.0:
        place = rows[least] + 1 if diagonal.size else 1
        value = float(diagonal[least]) if diagonal.size else 0.0
        why = "no mass" if what == "mass" else "nothing that holds this degree of freedom"
        return [f"{field}: {name}, row {place}, column {place}: {value:.6g} is {why}; it must be > 0"]
    scale = diags_array(1.0 / np.sqrt(diagonal))
    scaled = (scale @ matrix @ scale + 1e-15 * eye_array(matrix.shape[0])).tocsc()
    factors = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    pivots = factors.U.diagonal()
    worst = int(np.argmin(pivots))
    if pivots[worst] > SINGULAR:
        return []
    at, least_value = int(np.argsort(factors.perm_c)[worst]), float(pivots[worst])
    if matrix.shape[0] <= DENSE:
        values, vectors = eigh(scaled.toarray(), subset_by_index=[0, 0])
        at, least_value = int(np.argmax(np.abs(vectors[:, 0]))), float(values[0])
    place = rows[at] + 1
    if least_value < -SINGULAR:
        why = f"is indefinite (least eigenvalue {least_value:.3g} with ones on the diagonal), most in row {place}"
        return [f"{field}: {name} {why}, column {place}: {diagonal[at]:.6g}; check the signs around it"]
    if what == "mass":
        return [f"{field}: {name} is singular, most in row {place}, column {place}: {diagonal[at]:.6g}; a motion "
                "has no mass; lump the masses, or condense it away before the export"]  # fmt: skip
    return [
        f"{field}: {name} lets the frame move freely, most in degree of freedom {place} (row {place}, column {place}: "
        f"{diagonal[at]:.6g}); export it with its supports, or hold that motion"
    ]


def even(matrix: Array) -> Array:
    """Return a matrix symmetric to the last digit."""
    return np.asarray(0.5 * (matrix + matrix.T))


def damping_of(spec: MatricesSpec, damping: DampingSpec) -> Array:
    """Return C (n, n) in N s/m of a frame at a damping level; raises InputError for a level of storeys."""
    frame = frame_of(spec)
    if damping.matrix is not None:
        return _stated_damping(spec, damping.matrix, frame)
    if damping.rayleigh is not None:
        of = damping.rayleigh
        a, b = of.mass_1_per_s, of.stiffness_s
        if of.ratio is not None and of.frequencies_hz is not None:
            low, high = (2.0 * np.pi * hz for hz in of.frequencies_hz)
            a, b = 2.0 * of.ratio * low * high / (low + high), 2.0 * of.ratio / (low + high)
        return np.asarray((a or 0.0) * frame.M + (b or 0.0) * frame.K)
    if damping.modal is not None:
        return _modal(frame, damping.modal)
    key = "first_mode_ratio" if damping.first_mode_ratio is not None else "dashpots_n_s_per_m"
    raise InputError(
        f"damping.{key}: belongs to numerical storeys, structure.numerical has matrices; give modal, rayleigh or matrix"
    )


def _modal(frame: Frame, ratios: Sequence[float]) -> Array:
    """Return M Phi diag(2 zeta w) Phi^T M of the frame by itself; the last ratio holds for all further modes."""
    from scipy.linalg import eigh

    squares, shapes = eigh(frame.K, frame.M)
    omega = np.sqrt(above_rounding(squares))
    all_ratios = np.full(len(omega), ratios[-1], dtype=float)
    all_ratios[: len(ratios)] = ratios[: len(omega)]
    momenta = frame.M @ shapes
    return even(momenta * (2.0 * all_ratios * omega) @ momenta.T)


def _stated_damping(spec: MatricesSpec, file: MatrixFile, frame: Frame) -> Array:
    from scipy.linalg import eigh

    faults: list[str] = []
    full = _square("damping", file, "C", faults)
    rows = len(frame.dofs) + len(frame.condensed.massless)
    if full is not None and full.shape[0] != rows:
        faults.append(f"damping.matrix: {file.file.name} has {full.shape[0]} rows, the mass matrix {rows}")
    if full is None or faults:
        raise InputError(*(fault.replace(f"{FIELD}.damping", "damping.matrix") for fault in faults))
    C = even(units_of(spec.units)[2] * frame.condensed.matrix(full))
    values, vectors = eigh(C)
    if values[0] < -UNEQUAL * max(abs(values[-1]), abs(values[0])):
        at = int(np.argmax(np.abs(vectors[:, 0])))
        place = frame.dofs[at]
        raise InputError(
            f"damping.matrix: {file.file.name} feeds energy into the frame (least eigenvalue {values[0]:.4g} N s/m), "
            f"most in row {place}, column {place}: {C[at, at]:.6g} N s/m; check its signs"
        )
    return C
