"""A program as the numerical substructure of a building: what the building knows of it, and its linear part.

The linear part is the tangent at rest, as the program's own small displacements give it. What the program's forces are
beside it counts as laws of the storeys between its floors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.programs import Description, ProgramFault, described
from rths_cli.structure.storey_laws import NUMBERS, PROGRAM, Laws

SAME_MASS = 1e-6  # largest relative difference of stated masses from the model's
SAME_HZ = 1e-3  # the same of the first natural frequency from that of the program's own analysis


@dataclass(frozen=True)
class ProgramPart:
    """A program and how it is asked: `rate_hz`, what an answer takes in simulated time (None: an interval of that
    rate), the factor of the linear part's stiffness over the tangent at rest, and stalls (at, lasts) in s."""

    description: Description
    rate_hz: float
    compute_time_s: float | None = None
    stiffness_factor: float = 1.0
    stalls: tuple[tuple[float, float], ...] = ()

    @property
    def answer_s(self) -> float:
        """Return what an answer takes in simulated time."""
        return 1.0 / self.rate_hz if self.compute_time_s is None else self.compute_time_s


def program_of(spec: Any) -> ProgramPart | None:
    """Return the program that a structure file states in the place of computed storeys, None for storeys."""
    if getattr(spec, "description", None) is None:
        return None
    stalls = tuple((one.at_s, one.lasts_s) for one in spec.stalls)
    return ProgramPart(spec.description, spec.rate_hz, spec.compute_time_s, spec.stiffness_factor, stalls)


def tangent_of_program(program: ProgramPart, masses_kg: Array) -> Array:
    """Return the condensed stiffness (p, p) in N/m at rest of a program whose floors have `masses_kg` (p,).

    Raises InputError where the program cannot be built, its masses are others, it does not stand, or its own first
    natural frequency is another: then masses are elsewhere than at its floors.
    """
    found, name = described(program.description), program.description.name
    if found.masses_kg.size != masses_kg.size or not np.allclose(found.masses_kg, masses_kg, rtol=SAME_MASS, atol=0.0):
        own, stated = (np.array2string(one, precision=6) for one in (found.masses_kg, masses_kg))
        raise InputError(
            f"structure.numerical.masses_kg: {stated} kg; the floors of {name} "
            f"({', '.join(found.floors)}) have {own} kg by structure.numerical.units; correct the one or the other"
        )
    root = 1.0 / np.sqrt(masses_kg)
    least = float(np.linalg.eigvalsh(root[:, None] * found.stiffness * root)[0])
    if least <= 0.0:
        raise ProgramFault(f"{name} does not stand by itself: its floors have no stiffness against some motion at rest")
    hz = float(np.sqrt(least) / (2.0 * np.pi))
    if np.isfinite(found.first_hz) and abs(hz / max(found.first_hz, 1e-12) - 1.0) > SAME_HZ:
        raise ProgramFault(
            f"{name}: its first natural frequency is {found.first_hz:.5g} Hz by its own analysis and {hz:.5g} Hz by "
            f"the masses of {', '.join(found.floors)}; it has mass elsewhere (density of elements, other degrees of "
            "freedom): give all mass to these nodes"
        )
    return found.stiffness


def laws_of_program(floors: int, tangents: Array | None = None) -> Laws:
    """Return what a program's forces are beside its linear part, as laws of the storeys between its floors.

    `tangents` (floors, 2) in N/m: the least and the greatest that they add, as met in a motion; None: not known.
    """
    none = np.full(floors, np.nan)
    stiffness = np.zeros((floors, 2)) if tangents is None else tangents
    codes = np.full(floors, PROGRAM, dtype=np.int64)
    index = np.arange(floors, dtype=np.int64)
    return Laws(index, codes, np.zeros((floors, NUMBERS)), stiffness, np.zeros((floors, 2)), none, 0 * index)


def storey_forces(floor_forces_n: Array) -> Array:
    """Return the forces (p, n) in the storeys below floors on which forces (p, n) act."""
    return np.cumsum(floor_forces_n[::-1], axis=0)[::-1]
