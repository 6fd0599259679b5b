"""Parts of the step that the caller of the Python interface makes: their designs, and the building one stands for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control.part_designs import PartDesign
from rths_cli.control.storeys_with_laws import computed_storeys
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.structure import Building, Specimen

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup

NUMERICAL = "numerical"
SAME = 1e-9  # largest relative difference of a declared specimen from the case's


def made(place: str, make: Callable[[Any], Any], designed: Any) -> PartDesign:
    """Return the caller's part in place of a designed one; raises InputError for what is no design of a part."""
    design = make(designed)
    if not isinstance(design, PartDesign):
        raise InputError(
            f"parts: what was made for {place} is no design of a part ({type(design).__name__}); return a Block, a "
            "PythonSubstructure, a PythonFeedforward or an object with the same attributes"
        )
    return design


def with_own_storeys(setup: Setup) -> Setup:
    """Return the setup with the caller's numerical substructure, if there is one, and the building that it declares.

    Raises InputError for a building whose number of storeys, specimen or mass on the table are not the case's.
    """
    if NUMERICAL not in setup.parts:
        return setup
    designed = computed_storeys(setup.building, setup.rig.dt_s, setup.case.integration)
    design = made(NUMERICAL, setup.parts[NUMERICAL], designed)
    setup = replace(setup, own_numerical=design)
    declared = getattr(design, "building", None)
    if declared is None:
        return setup
    _check(design.name, declared, setup.building)
    return replace(setup, building=declared, declared=True)


def _matrices(specimen: Specimen) -> tuple[Array, Array, Array]:
    return specimen.masses_kg, specimen.C, specimen.K


def _check(name: str, declared: object, case: Building) -> None:
    """Raise InputError unless a declared building has the specimen and the number of storeys of the case's."""
    if not isinstance(declared, Building):
        raise InputError(
            f"parts: the building that {name} declares is none ({type(declared).__name__}); give a "
            "rths_cli.structure.Building"
        )
    own, wanted = ((len(each.numerical.masses_kg), len(each.specimen.masses_kg)) for each in (declared, case))
    if own != wanted:
        raise InputError(
            f"parts: the building that {name} declares has {own[0]} computed and {own[1]} experimental storeys, the "
            f"case's has {wanted[0]} and {wanted[1]}; declare a building with the case's storeys"
        )
    matrices = zip(_matrices(declared.specimen), _matrices(case.specimen), strict=True)
    if not all(np.allclose(one, other, rtol=SAME, atol=0.0) for one, other in matrices):
        raise InputError(
            f"parts: the building that {name} declares has another specimen than the case, which is what stands on the "
            "table; take the case's: rths_cli.structure.build(case.structure, case.damping).specimen"
        )
    mass, there = (each.interface_experimental_mass_kg for each in (declared, case))
    if mass != there:
        raise InputError(
            f"parts: the building that {name} declares has {mass:g} kg of the interface floor on the table, in the "
            f"case {there:g} kg stand there; declare these"
        )
