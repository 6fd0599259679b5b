"""A chain of storeys: matrices, modes, damping; numerical substructure, specimen and the total building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rths_cli.numerics.lti import Array, ComplexArray, Integers
from rths_cli.structure.programs import ProgramPart
from rths_cli.structure.storey_laws import Laws, arranged

ROUNDING = float(np.finfo(float).eps)


def storey_matrix(storey_values: Sequence[float] | Array) -> Array:
    """Return the matrix (n, n) of storey stiffnesses in N/m or dashpots in N s/m (n,), as in Eq. 2.1."""
    values = np.asarray(storey_values, dtype=float)
    above = np.append(values[1:], 0.0)
    return np.diag(values + above) - np.diag(values[1:], 1) - np.diag(values[1:], -1)


def storey_values(matrix: Array) -> Array:
    """Return the storey values (n,) of a chain matrix (n, n): the inverse of `storey_matrix`."""
    return np.append(matrix.sum(axis=1)[:1], -np.diag(matrix, -1))


def above_rounding(eigenvalues: Array) -> Array:
    """Return the squared natural frequencies (n,), ascending, of a chain whose eigenvalues were computed as these.

    An eigenvalue is known to rounding of the largest one; one that is lost in it, and may even be negative, is taken as
    that large.
    """
    return np.maximum(eigenvalues, ROUNDING * eigenvalues[-1])


def mode_shapes(M: Array, K: Array) -> tuple[Array, Array]:
    """Return the undamped natural frequencies (n,) in Hz, ascending, and the mode shapes (n, n), a column for each.

    K phi = w^2 M phi with M (n, n) in kg and K (n, n) in N/m; phi^T M phi = 1.
    """
    if np.count_nonzero(M) > np.count_nonzero(np.diag(M)):
        from scipy.linalg import eigh

        squares, shapes = eigh(K, M)
        return np.sqrt(above_rounding(squares)) / (2.0 * np.pi), np.asarray(shapes)
    root = np.sqrt(np.diag(M))
    eigenvalues, shapes = np.linalg.eigh(K / np.outer(root, root))
    return np.sqrt(above_rounding(eigenvalues)) / (2.0 * np.pi), shapes / root[:, None]


def modal_damping_matrix(masses_kg: Array, K: Array, ratios: Sequence[float] | Array) -> Array:
    """Return C = M Phi diag(2 zeta w) Phi^T M in N s/m, (n, n), with mass-normalised mode shapes Phi.

    `masses_kg` (n,), `K` (n, n) in N/m, `ratios` (n,) in the order of ascending frequency.
    """
    root = np.sqrt(masses_kg)
    eigenvalues, shapes = np.linalg.eigh(K / np.outer(root, root))
    omega = np.sqrt(above_rounding(eigenvalues))
    return np.outer(root, root) * ((shapes * (2.0 * np.asarray(ratios) * omega)) @ shapes.T)


def modes(M: Array, C: Array, K: Array) -> tuple[Array, Array]:
    """Return natural frequencies |s| / 2 pi in Hz, ascending, and damping ratios -Re s / |s|, each (n,).

    The s are the complex eigenvalues of M d2x + C dx + K x = 0; M, C, K (n, n) in kg, N s/m, N/m. The two
    real eigenvalues of an overdamped mode count as one mode, with a ratio of one or more.
    """
    s = _eigenvalues(M, C, K)
    oscillating = s[s.imag > 0.0]
    real = np.sort(s[s.imag == 0.0].real)
    fast, slow = real[: len(real) // 2], real[::-1][: len(real) // 2]
    size = np.concatenate([np.abs(oscillating), np.sqrt(np.abs(fast * slow))])
    decay = np.concatenate([-oscillating.real, -0.5 * (fast + slow)])
    order = np.argsort(size)
    return size[order] / (2.0 * np.pi), decay[order] / size[order]


def first_mode_ratio(M: Array, C: Array, K: Array) -> float:
    """Return the damping ratio of the oscillating mode of lowest frequency, 1 if none oscillates."""
    s = _eigenvalues(M, C, K)
    oscillating = s[s.imag > 0.0]
    if len(oscillating) == 0:
        return 1.0
    first = oscillating[np.argmin(np.abs(oscillating))]
    return float(-first.real / np.abs(first))


def _eigenvalues(M: Array, C: Array, K: Array) -> ComplexArray:
    """Return the 2 n complex eigenvalues in rad/s; time is scaled so that both blocks are of one size."""
    stiffness, damping = np.linalg.solve(M, K), np.linalg.solve(M, C)
    scale = np.sqrt(np.linalg.norm(stiffness, 2))
    identity = scale * np.eye(len(M))
    A = np.block([[np.zeros_like(identity), identity], [-stiffness / scale, -damping]])
    return np.linalg.eigvals(A).astype(complex)


@dataclass(frozen=True)
class Specimen:
    """Experimental storeys relative to the table: M d2x + C dx + K x = -M 1 a_table (Eq. 2.5).

    `masses_kg` (n,), `K` (n, n) in N/m, `C` (n, n) in N s/m. An `attached` one stands between the n degrees of freedom
    of the interface and the laboratory's floor: F = M d2x + C dx + K x is what the load cell of an actuator that moves
    it by x shows, its inertia included. n is 1 so far.
    """

    masses_kg: Array
    K: Array
    C: Array
    attached: bool = False

    @property
    def mass_matrix(self) -> Array:
        """Return M (n, n) in kg."""
        return np.diag(self.masses_kg)


@dataclass(frozen=True)
class Numerical:
    """Computed part relative to the ground: M d2x + C dx + K x = -M r a_g + e_p f (Eq. 2.3), e_p the last.

    `masses_kg` (p,) without the interface mass on the table, `K` (p, p) in N/m, `C` (p, p) in N s/m. A chain of storeys
    has M = diag(masses_kg) and r = 1. A frame may have another `M` (p, p), with masses_kg its diagonal, and another
    `influence` r (p,); its coordinates are the degrees of freedom `dofs` (p,) of its matrices. `whole` is what it was
    reduced from.
    """

    masses_kg: Array
    K: Array
    C: Array
    M: Array | None = None
    influence: Array | None = None
    dofs: Integers | None = None
    whole: Unreduced | None = None

    @property
    def mass_matrix(self) -> Array:
        """Return M (p, p) in kg."""
        return np.diag(self.masses_kg) if self.M is None else self.M

    @property
    def inertia_kg(self) -> Array:
        """Return M r (p,), the force per ground acceleration."""
        if self.M is None:
            return self.masses_kg if self.influence is None else self.masses_kg * self.influence
        return np.asarray(self.M @ self.ground)

    @property
    def ground(self) -> Array:
        """Return r (p,): displacement of each coordinate when the ground moves by one."""
        return np.ones(len(self.masses_kg)) if self.influence is None else self.influence

    def per_mass(self, columns: Array) -> Array:
        """Return M^-1 times columns (p, m)."""
        if self.M is None:
            return np.asarray((1.0 / self.masses_kg[:, None]) * columns)
        return np.asarray(np.linalg.solve(self.M, columns), dtype=float)

    @property
    def per_force(self) -> Array:
        """Return M^-1 e_p (p,): the accelerations per force on the interface."""
        return self.per_mass(np.eye(len(self.masses_kg))[:, -1:])[:, 0]

    @property
    def interface_mass_kg(self) -> float:
        """Return the force on the interface per its acceleration at first, before anything has moved."""
        return float(self.masses_kg[-1]) if self.M is None else 1.0 / float(self.per_force[-1])


@dataclass(frozen=True)
class Unreduced:
    """What a reduced frame was reduced from; coordinate i of the reduced one is row `rows[i]` of the whole."""

    numerical: Numerical
    rows: Integers


@dataclass(frozen=True)
class Building:
    """A building of p numerical and n experimental storeys, coupled by the force f of Eq. 2.6.

    `M`, `C`, `K` (p + n, p + n) describe the total structure in displacements relative to the ground;
    `notes` are sentences for the user (for instance the stiffness solutions not taken); `heights_m` (p + n,) are the
    storeys' heights where they are known. `laws` act beside M, C and K, which hold their tangents at rest; those of a
    `program` are what its forces are beside them.
    """

    numerical: Numerical
    specimen: Specimen
    interface_experimental_mass_kg: float
    M: Array
    C: Array
    K: Array
    notes: tuple[str, ...] = ()
    heights_m: Array | None = None
    laws: Laws = field(default_factory=lambda: arranged(()))
    program: ProgramPart | None = None

    @property
    def linear(self) -> bool:
        """Return whether M, C and K describe it at all times. References are chosen by such properties."""
        return self.laws.code.size == 0

    @property
    def reduced(self) -> bool:
        """Return whether its numerical part is a reduction of a larger frame."""
        return self.numerical.whole is not None

    @property
    def unreduced(self) -> Building:
        """Return the same building with all degrees of freedom of its frame."""
        if self.numerical.whole is None:
            return self
        frame, mass = self.numerical.whole.numerical, self.interface_experimental_mass_kg
        return Building(frame, self.specimen, mass, *assemble(frame, self.specimen, mass), self.notes)

    @property
    def rows_of_unreduced(self) -> Integers:
        """Return the rows (p + n,) of the unreduced building that are this one's coordinates."""
        rows, n = np.arange(len(self.numerical.masses_kg)), self.storeys - len(self.numerical.masses_kg)
        if self.numerical.whole is not None:
            rows = self.numerical.whole.rows
        return np.concatenate([rows, rows[-1] + 1 + np.arange(n)])

    @property
    def influence(self) -> Array | None:
        """Return r (p + n,), None where the ground moves all floors alike: the interface moves with it by one."""
        own = self.numerical.influence
        return None if own is None else np.concatenate([own, np.ones(self.storeys - len(own))])

    @property
    def shear_masses_kg(self) -> Array:
        """Return the masses (n_storeys,) of floors, or of a frame the rows (n_storeys, n_storeys) of M along the ground
        motion: times absolute accelerations they are the inertia that storey shears carry."""
        if self.numerical.M is None and self.influence is None:
            return np.diag(self.M)
        return self.M if self.influence is None else self.influence[:, None] * self.M

    @property
    def mass_kg(self) -> float:
        """Return the mass that follows the ground motion, r^T M r."""
        masses, influence = self.shear_masses_kg, self.influence
        return float(np.sum(masses if influence is None else masses @ influence))

    @property
    def has_laws(self) -> bool:
        """Return whether storeys have laws, beside M, C and K."""
        return not self.linear

    @property
    def has_program(self) -> bool:
        """Return whether a program computes the forces of its numerical floors."""
        return self.program is not None

    @property
    def storeys(self) -> int:
        """Return the number of all storeys."""
        above = 0 if self.specimen.attached else len(self.specimen.masses_kg)
        return len(self.numerical.masses_kg) + above


def assemble(numerical: Numerical, specimen: Specimen, interface_mass_kg: float) -> tuple[Array, Array, Array]:
    """Add both substructures up to M, C, K (p + n, p + n) of the total, relative to the ground (Eq. 2.2).

    The specimen enters through its displacements relative to the interface floor, x_hat = x_E - 1 x_I. An attached one
    adds its stiffness and damping to the interface's; `interface_mass_kg` is then its mass.
    """
    p, n = len(numerical.masses_kg), len(specimen.masses_kg)
    if specimen.attached:
        M, C, K = numerical.mass_matrix.copy(), numerical.C.copy(), numerical.K.copy()
        for whole, own in ((M, interface_mass_kg), (C, specimen.C[0, 0]), (K, specimen.K[0, 0])):
            whole[p - 1, p - 1] += own
        return M, C, K
    relative = np.hstack([np.zeros((n, p)), np.eye(n)])
    relative[:, p - 1] = -1.0
    M = np.diag(np.concatenate([numerical.masses_kg, specimen.masses_kg]))
    if numerical.M is not None:
        M[:p, :p] = numerical.M
    M[p - 1, p - 1] += interface_mass_kg
    C, K = relative.T @ specimen.C @ relative, relative.T @ specimen.K @ relative
    C[:p, :p] += numerical.C
    K[:p, :p] += numerical.K
    return M, C, K
