"""The work of `rths structure`: a building's modes, damping, mass split and stiffness sets, before any case is run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.case.load import load_structure
from rths_cli.case.shipped_files import is_shipped
from rths_cli.case.structure_schema import DampingSpec, StructureSpec, without_dashpots
from rths_cli.case.yaml_reader import display
from rths_cli.errors import InputError
from rths_cli.experiment.unit_plausibility import building_doubts
from rths_cli.interrupts import interruptible
from rths_cli.numerics.lti import Array, Integers
from rths_cli.programs import described, step_times
from rths_cli.structure import (
    Building,
    Similitude,
    build,
    frame_of,
    mode_shapes,
    modes,
    reduced_of,
    similitude_of,
    stiffness_sets,
    storey_values,
)

SIDEWAYS = 0.1  # of the weight, whose displacements a program is asked for
UNDAMPED = "without dashpots"  # of the numerical storeys, where no level is stated


@dataclass(frozen=True)
class Level:
    """A damping level of a building; arrays are empty if `fault` says why the building cannot have it."""

    name: str
    first_mode_ratio: float | None  # as stated; None: dashpots are stated
    dashpots_n_s_per_m: Array  # (p,) of the numerical storeys; of a frame empty
    natural_frequency_hz: Array  # (n,) |s| / 2 pi of the damped modes of the whole building, ascending
    damping_ratio: Array  # (n,) of these modes
    fault: str = ""


@dataclass(frozen=True)
class StiffnessSet:
    """Storey stiffnesses of the specimen that have its natural frequencies, and what they make of the building."""

    stiffness_n_per_m: Array  # (n_exp,)
    natural_frequency_hz: Array  # (n,) of the whole building


@dataclass(frozen=True)
class InspectedFrame:
    """What is known of a frame by its matrices, and of its reduction."""

    mass_file: str
    degrees_of_freedom: int  # of the files
    massless: int  # of these, condensed
    mass_kg: float  # that follows the ground
    interface: int  # degree of freedom, from 1
    dofs: Integers  # (p,) degrees of freedom that the loop computes
    reduction: str  # none, static or craig_bampton
    modes_kept: int  # from the first, with their frequency to 0.1 %
    fixed_modes: int  # with the interface held, that the reduction has
    ground_shape: bool  # whether one more shape lets all mass follow the ground
    natural_frequency_hz: Array  # (n,) of the whole frame by itself
    reduced_frequency_hz: Array  # (p,) of the reduced one


@dataclass(frozen=True)
class InspectedProgram:
    """What is known of computed floors that are a program, p in all, and what an answer takes here."""

    name: str
    version: str
    floors: tuple[str, ...]  # (p,) the interface last
    mass_kg: Array  # (p, p) of the program alone
    damping_n_s_per_m: Array  # (p, p) of the first level, or without dashpots
    stiffness_n_per_m: Array  # (p, p) condensed, at rest
    natural_frequency_hz: Array  # (p,) of the program by itself
    interface_kg: tuple[float, float, float]  # the program's, that on the table, both
    step_time_s: tuple[float, float, float]  # median, 99th percentile, largest
    amplitude_m: Array  # (p,) up to which displacements went meanwhile: those under a tenth of the weight sideways


@dataclass(frozen=True)
class Inspected:
    """What is known of a building of p numerical and n_exp experimental storeys, n in all, from the ground."""

    name: str
    file: str  # path as a user would type it; "" for a shipped one
    numerical_storeys: int  # p; the highest is the interface
    floor_mass_kg: Array  # (n,) whole masses
    stiffness_n_per_m: Array  # (n,) of the storeys; of a frame the diagonal of its stiffness matrix
    heights_m: Array | None  # (n,) of the storeys
    interface_experimental_mass_kg: float
    natural_frequency_hz: Array  # (n,) undamped
    mode_shapes: Array  # (n, n) a column for each mode, relative to the ground, the largest floor 1
    effective_mass_ratio: Array  # (n,) of the modes, over the whole mass
    specimen_frequency_hz: Array  # (n_exp,) on a fixed base
    specimen_damping_ratio: Array  # (n_exp,)
    levels: tuple[Level, ...]
    stiffness_sets: tuple[StiffnessSet, ...]  # the first is used; (): stiffnesses are stated
    warnings: tuple[str, ...]  # doubts on units
    mass_kg: float  # of the whole building
    frame: InspectedFrame | None = None  # None: the numerical part is a chain of storeys
    program: InspectedProgram | None = None  # None: no program computes it
    scale: Similitude | None = None  # of the model that the building is, prototype over model; None: of no case

    @property
    def experimental_mass_kg(self) -> float:
        """Return the mass that stands on the table."""
        return float(self.floor_mass_kg[self.numerical_storeys :].sum()) + self.interface_experimental_mass_kg

    @property
    def prototype(self) -> Inspected | None:
        """Return storeys and modes of the whole building in prototype scale; None where the case states no scale."""
        if self.scale is None:
            return None
        return replace(
            self,
            floor_mass_kg=self.scale.factor("kg") * self.floor_mass_kg,
            mass_kg=self.scale.factor("kg") * self.mass_kg,
            stiffness_n_per_m=self.scale.factor("N/m") * self.stiffness_n_per_m,
            heights_m=None if self.heights_m is None else self.scale.factor("m") * self.heights_m,
            natural_frequency_hz=self.scale.factor("Hz") * self.natural_frequency_hz,
            scale=None,
        )

    @property
    def exit_code(self) -> int:
        """Return 1 if the building cannot have a damping level, else 0."""
        return 1 if any(level.fault for level in self.levels) else 0


def inspect_structure(name: str) -> Inspected:
    """Return what is known of the building that a name or path of a structure or case stands for.

    Raises InputError with all faults of its file, and if no stiffnesses give its natural frequencies.
    """
    spec, damping, path, scale = load_structure(name)
    if spec.experimental.attached:
        raise InputError(
            f"{display(path)}: its specimen is moved by an actuator, and rths structure shows only buildings whose "
            "specimen stands on a table; rths check of its case shows modes and damping"
        )
    try:
        found = interruptible(lambda: _inspected(spec, damping, "" if is_shipped(path) else display(path)))
        found = replace(found, warnings=tuple(f"{display(path)}: {doubt}" for doubt in found.warnings))
        return found if scale is None else replace(found, scale=similitude_of(scale))
    except InputError as error:
        raise InputError(*(f"{display(path)}: {fault}" for fault in error.faults)) from error


def _inspected(spec: StructureSpec, damping: Sequence[DampingSpec], file: str) -> Inspected:
    building = _undamped(spec)
    specimen, masses = building.specimen, np.diag(building.M)
    frequency, shapes = mode_shapes(building.M, building.K)
    weights = shapes.T @ (masses if building.numerical.dofs is None else building.M @ _ground(building))
    spring = (
        np.diag(building.numerical.K) if building.numerical.dofs is not None else storey_values(building.numerical.K)
    )
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(len(masses))]
    own = modes(np.diag(specimen.masses_kg), specimen.C, specimen.K)
    levels = [_level(spec, level) for level in damping] or [_level(spec, _no_dashpots(spec))]
    return Inspected(
        name=spec.name,
        file=file,
        numerical_storeys=len(building.numerical.masses_kg),
        floor_mass_kg=masses,
        stiffness_n_per_m=np.concatenate([spring, storey_values(specimen.K)]),
        heights_m=building.heights_m,
        interface_experimental_mass_kg=building.interface_experimental_mass_kg,
        natural_frequency_hz=frequency,
        mode_shapes=shapes / largest,
        effective_mass_ratio=weights**2 / building.mass_kg,
        specimen_frequency_hz=own[0],
        specimen_damping_ratio=own[1],
        levels=tuple(levels),
        stiffness_sets=_sets(spec),
        warnings=building_doubts(spec, damping, building),
        mass_kg=building.mass_kg,
        frame=_frame(spec),
        program=_program(building if not damping else build(spec, damping[0])),
    )


def _program(building: Building) -> InspectedProgram | None:
    """Return what is known of a building's program, and measure its answers; None without one."""
    if building.program is None:
        return None
    stated, part, on_table = building.program.description, building.numerical, building.interface_experimental_mass_kg
    found, own = described(stated), np.diag(part.masses_kg)
    amplitude = np.abs(np.linalg.solve(found.stiffness, SIDEWAYS * 9.81 * part.masses_kg))
    taken = step_times(stated, amplitude)
    own_kg = float(part.masses_kg[-1])
    return InspectedProgram(
        stated.name, found.version, found.floors, own, part.C, found.stiffness, mode_shapes(own, found.stiffness)[0],
        (own_kg, on_table, own_kg + on_table),
        (float(np.median(taken)), float(np.percentile(taken, 99.0)), float(taken.max())), amplitude,
    )  # fmt: skip


def _ground(building: Building) -> Array:
    return np.ones(len(building.M)) if building.influence is None else building.influence


def _frame(spec: StructureSpec) -> InspectedFrame | None:
    """Return what is known of the frame of a structure; None without one."""
    matrices = spec.numerical.matrices
    if matrices is None:
        return None
    frame, reduced = frame_of(matrices), reduced_of(matrices)
    whole_hz = frame.frequency_hz
    return InspectedFrame(
        mass_file=matrices.mass.file.name,
        degrees_of_freedom=len(frame.dofs) + len(frame.condensed.massless),
        massless=len(frame.condensed.massless),
        mass_kg=frame.mass_kg,
        interface=matrices.interface,
        dofs=frame.dofs if reduced is None else frame.dofs[reduced.rows],
        reduction=matrices.reduction.kind,
        modes_kept=len(whole_hz) if reduced is None else reduced.modes,
        fixed_modes=0 if reduced is None else reduced.fixed_modes,
        ground_shape=False if reduced is None else reduced.adds_ground_shape,
        natural_frequency_hz=whole_hz,
        reduced_frequency_hz=whole_hz if reduced is None else reduced.frequency_hz,
    )


def _no_dashpots(spec: StructureSpec) -> DampingSpec:
    return DampingSpec.model_validate({"name": UNDAMPED, **without_dashpots(spec)})


def _undamped(spec: StructureSpec) -> Building:
    """Return the building without dashpots in its numerical storeys."""
    return build(spec, _no_dashpots(spec))


def _level(spec: StructureSpec, damping: DampingSpec) -> Level:
    """Return the damping of the building at a level; one that it cannot have is returned with its fault."""
    try:
        building = build(spec, damping)
    except InputError as error:
        return Level(damping.name, damping.first_mode_ratio, np.empty(0), np.empty(0), np.empty(0), str(error))
    found = modes(building.M, building.C, building.K)
    dashpots = storey_values(building.numerical.C) if building.numerical.dofs is None else np.empty(0)
    return Level(damping.name, damping.first_mode_ratio, dashpots, *found)


def _sets(spec: StructureSpec) -> tuple[StiffnessSet, ...]:
    """Return the sets of stiffnesses with the stated natural frequencies, () where stiffnesses are stated."""
    experimental = spec.experimental
    if experimental.natural_frequencies_hz is None:
        return ()
    found = []
    for stiffness in stiffness_sets(experimental.masses_kg, experimental.natural_frequencies_hz):
        stated = {"natural_frequencies_hz": None, "stiffness_n_per_m": tuple(stiffness.tolist())}
        building = _undamped(spec.model_copy(update={"experimental": experimental.model_copy(update=stated)}))
        found.append(StiffnessSet(stiffness, mode_shapes(building.M, building.K)[0]))
    return tuple(found)
