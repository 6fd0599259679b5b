"""Data classes of the numerical substructure, the specimen and the total building, with their mass, damping, stiffness
matrices."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.structure.storey_laws import Laws, arranged


@dataclass(frozen=True)
class Specimen:
    """Experimental storeys relative to the table: M d2x + C dx + K x = -M 1 a_table (Eq. 2.5).

    `masses_kg` (n,), `K` (n, n) in N/m, `C` (n, n) in N s/m.
    """

    masses_kg: Array
    K: Array
    C: Array


@dataclass(frozen=True)
class Numerical:
    """Computed storeys relative to the ground: M d2x + C dx + K x = -M 1 a_g + e_p f (Eq. 2.3), e_p the last.

    `masses_kg` (p,) without the interface mass on the table, `K` (p, p) in N/m, `C` (p, p) in N s/m.
    """

    masses_kg: Array
    K: Array
    C: Array


@dataclass(frozen=True)
class Building:
    """A shear building of p numerical and n experimental storeys, coupled by the force f of Eq. 2.6.

    `M`, `C`, `K` (p + n, p + n) describe the total structure in displacements relative to the ground;
    `notes` are sentences for the user (for instance the stiffness solutions not taken); `heights_m` (p + n,) are the
    storeys' heights where they are known. `laws` act beside M, C and K, which hold their tangents at rest.
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

    @property
    def linear(self) -> bool:
        """Return whether M, C and K describe it at all times. References are chosen by such properties."""
        return self.laws.code.size == 0

    @property
    def has_laws(self) -> bool:
        """Return whether storeys have laws, beside M, C and K."""
        return not self.linear

    @property
    def storeys(self) -> int:
        """Return the number of all storeys."""
        return len(self.numerical.masses_kg) + len(self.specimen.masses_kg)


def assemble(numerical: Numerical, specimen: Specimen, interface_mass_kg: float) -> tuple[Array, Array, Array]:
    """Add both substructures up to M, C, K (p + n, p + n) of the total, relative to the ground (Eq. 2.2).

    The specimen enters through its displacements relative to the interface floor, x_hat = x_E - 1 x_I.
    """
    p, n = len(numerical.masses_kg), len(specimen.masses_kg)
    relative = np.hstack([np.zeros((n, p)), np.eye(n)])
    relative[:, p - 1] = -1.0
    M = np.diag(np.concatenate([numerical.masses_kg, specimen.masses_kg]))
    M[p - 1, p - 1] += interface_mass_kg
    C, K = relative.T @ specimen.C @ relative, relative.T @ specimen.K @ relative
    C[:p, :p] += numerical.C
    K[:p, :p] += numerical.K
    return M, C, K
