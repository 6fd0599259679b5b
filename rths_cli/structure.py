"""Shear buildings cut at a storey: numerical and experimental substructure, and the total they add up to.

Storeys count from 1 at the ground. Numerical floors are described by displacements relative to the ground,
experimental floors by displacements relative to the table (the interface floor), as in Eq. 2.3 and 2.5 of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

from rths_cli.lti import Array


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
    """Computed storeys relative to the ground: M d2x + C dx + K x = -M 1 a_g + e_p f (Eq. 2.3), e_p the last floor.

    `masses_kg` (p,) without the interface mass that stands on the table, `K` (p, p) in N/m, `C` (p, p) in N s/m.
    """

    masses_kg: Array
    K: Array
    C: Array


@dataclass(frozen=True)
class Building:
    """A shear building of p numerical and n experimental storeys; f is the force of Eq. 2.6 on the interface floor.

    `M`, `C`, `K` (p + n, p + n) describe the total structure in displacements relative to the ground;
    `notes` are sentences for the user (for instance the stiffness solutions not taken).
    """

    numerical: Numerical
    specimen: Specimen
    interface_experimental_mass_kg: float
    M: Array
    C: Array
    K: Array
    notes: tuple[str, ...] = ()
