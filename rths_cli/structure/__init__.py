"""Shear buildings cut at a storey: numerical and experimental substructure, and the total they add up to.

Storeys count from 1 at the ground. Numerical floors are described by displacements relative to the ground,
experimental floors by displacements relative to the table (the interface floor): the paper's Eq. 2.3 and 2.5.
"""

from rths_cli.structure.building import (
    DampingSpec,
    ExperimentalSpec,
    NumericalSpec,
    StructureSpec,
    build,
    stiffness_sets,
)
from rths_cli.structure.frame import frame_of
from rths_cli.structure.frame_reduction import masses_of, reduced_of, with_masses
from rths_cli.structure.shear_chain import (
    Building,
    Numerical,
    Specimen,
    above_rounding,
    assemble,
    first_mode_ratio,
    modal_damping_matrix,
    mode_shapes,
    modes,
    storey_matrix,
    storey_values,
)
from rths_cli.structure.similitude import Similitude, similitude_of
from rths_cli.structure.stiffness_from_frequencies import stiffness_from_frequencies

__all__ = [
    "Building",
    "DampingSpec",
    "ExperimentalSpec",
    "Numerical",
    "NumericalSpec",
    "Similitude",
    "Specimen",
    "StructureSpec",
    "above_rounding",
    "assemble",
    "build",
    "first_mode_ratio",
    "frame_of",
    "masses_of",
    "modal_damping_matrix",
    "mode_shapes",
    "modes",
    "reduced_of",
    "similitude_of",
    "stiffness_from_frequencies",
    "stiffness_sets",
    "storey_matrix",
    "storey_values",
    "with_masses",
]
