"""What the numbers of a building must agree with: masses, stiffnesses, damping, heights and laws with one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import inf
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.unit_comparison import Comparison, among_equals
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.structure.shear_chain import mode_shapes, storey_values

if TYPE_CHECKING:
    from rths_cli.case.matrices_schema import MatricesSpec
    from rths_cli.case.structure_schema import DampingSpec, StructureSpec
    from rths_cli.numerics.lti import Array
    from rths_cli.structure.shear_chain import Building

LARGEST_DRIFT_M = 10.0  # of a storey under 1 g sideways; by P-Delta, a storey lower than this drift does not stand
STIFFEST_HZ = 35.0  # first mode of the whole building; a table that shakes a stiffer one moves like the ground
LIGHTEST_SPECIMEN_KG = 0.1
RATIOS = (0.0015, 0.3)  # of critical damping: bare steel to a strongly damped absorber
STIFFNESS_OF_PARTS = (1.0 / 300.0, 1e4)  # of the median numerical storey over the median one on the table
LEAST_MODE_RATIO = 1e-4  # of a building's first mode; less than its specimen alone adds is refused
IN_A_PART = 8.0  # masses of one substructure, and damping ratios of a specimen, over the median of the others
FRAME_OVER_FLOOR = 3e4  # whole mass of a frame over the mean floor on the table: 200 floors of 150 times its mass
NUMERICAL, EXPERIMENTAL = "structure.numerical", "structure.experimental"
OVER_DRIFT = {  # keys of laws that are a drift, over that of the storey under 1 g sideways
    "yield_displacement_m": (3e-3, 2.0), "gap_m": (1e-3, 5.0), "sticking_displacement_m": (1e-5, 0.3),
    "largest_drift_m": (0.05, 100.0), "softening_drift_m": (1e-3, 5.0),
}  # fmt: skip
OVER_WEIGHT = {"force_n": (1e-3, 1.5), "coefficient": (1e-3, 5.0)}  # that are a force, over the weight above the storey
OVER_STIFFNESS = {"contact_n_per_m": (0.01, 1e3), "spring_n_per_m": (0.01, 1e3)}  # over the storey's stiffness


def drift_under_1_g(building: Building) -> Array:
    """Return the drift (n,) in m of each storey, from the ground, under the weight of the floors above it sideways."""
    return np.asarray(_weights(building) / _stiffness(building))


def of_building(spec: StructureSpec, building: Building) -> Iterator[Comparison]:
    """Yield what the numbers of a building are compared with."""
    if spec.numerical.matrices is not None:
        yield from _of_frame(spec, spec.numerical.matrices, building)
        yield from _of_stiffness_on_table(spec)
        return
    yield from _of_masses(spec)
    yield from _of_drifts(spec, building)
    yield from _of_stiffness(spec, building)
    yield from _of_table(spec)
    yield from _of_heights(spec, building)
    yield from _of_laws(spec, building)


def of_damping(spec: StructureSpec, damping: Sequence[DampingSpec], building: Building) -> Iterator[Comparison]:
    """Yield what the damping of a specimen and of the levels of its numerical storeys is compared with."""
    experimental = spec.experimental
    ratios = {f"{EXPERIMENTAL}.damping_ratios": list(experimental.damping_ratios or ())}
    for key, values in ratios.items():
        yield from (_of_ratio(key, value, i, len(values)) for i, value in enumerate(values, 1) if value > 0.0)
        yield from _against_others(key, values, "", "damping ratios", 1.0 / IN_A_PART, IN_A_PART)
    if spec.numerical.matrices is not None:
        return
    masses, stiffness = np.diag(building.M), _stiffness(building)
    critical = 2.0 * np.sqrt(masses * stiffness)
    p = len(spec.numerical.masses_kg)
    of_table = tuple(f"{EXPERIMENTAL}.{key}" for key in ("masses_kg", "stiffness_n_per_m"))
    of_own = tuple(f"{NUMERICAL}.{key}" for key in ("masses_kg", "stiffness_n_per_m"))
    key = f"{EXPERIMENTAL}.dashpots_n_s_per_m"
    yield from _of_dashpots(key, experimental.dashpots_n_s_per_m or (), critical[p:], of_table)
    for level in damping:
        named = f"structure.damping_levels.{level.name}" if level.name in spec.damping_levels else "damping"
        if level.first_mode_ratio is not None:
            yield _of_ratio(f"{named}.first_mode_ratio", level.first_mode_ratio, 1, 1, LEAST_MODE_RATIO)
        yield from _of_dashpots(f"{named}.dashpots_n_s_per_m", level.dashpots_n_s_per_m or (), critical[:p], of_own)


def _of_frame(spec: StructureSpec, matrices: MatricesSpec, building: Building) -> Iterator[Comparison]:
    """Yield the comparisons of a frame's mass and stiffness, each by what no other file changes alike."""
    frame, on_table = building.unreduced.numerical, spec.experimental.masses_kg
    keys = tuple(f"{NUMERICAL}.matrices.{key}" for key in ("mass", "stiffness"))
    asked = f"are the files in {matrices.units.length}, {matrices.units.force} and {matrices.units.mass} (units)?"
    drift = float(np.max(np.abs(np.linalg.solve(frame.K, STANDARD_GRAVITY_M_S2 * frame.inertia_kg) * frame.ground)))
    hz, mean = float(mode_shapes(frame.mass_matrix, frame.K)[0][0]), sum(on_table) / len(on_table)
    said = f"mode 1 of the frame {hz:.2g} Hz, largest displacement under 1 g sideways"
    yield Comparison(keys[1], drift, "m", "1 m", 1.0, 0.0, LARGEST_DRIFT_M, (keys[0],), said, asked)
    said = "the first mode of the frame"
    yield Comparison(keys[0], hz, "Hz", "1 Hz", 1.0, 0.0, STIFFEST_HZ, (keys[1],), said, asked, power=0.5)
    whole = float(frame.ground @ frame.inertia_kg)
    key = f"{EXPERIMENTAL}.masses_kg"
    said = "the mass of the frame"
    against = "the mean floor on the table"
    yield Comparison(keys[0], whole, "kg", against, mean, 0.01, FRAME_OVER_FLOOR, (key,), said, asked)
    yield from _of_table_alone(spec)


def _weights(building: Building) -> Array:
    """Return the weight (n,) in N of the floors above each storey."""
    return np.asarray(STANDARD_GRAVITY_M_S2 * np.cumsum(np.diag(building.M)[::-1])[::-1])


def _stiffness(building: Building) -> Array:
    return np.concatenate([storey_values(building.numerical.K), storey_values(building.specimen.K)])


def _of_drifts(spec: StructureSpec, building: Building) -> Iterator[Comparison]:
    """Yield the comparisons of the whole building's mass and stiffness."""
    drift = drift_under_1_g(building)
    worst = int(np.argmax(drift))
    part = NUMERICAL if worst < len(spec.numerical.masses_kg) else EXPERIMENTAL
    hz = float(mode_shapes(building.M, building.K)[0][0])
    by_frequency = spec.experimental.natural_frequencies_hz is not None
    derived = by_frequency and (part == EXPERIMENTAL or isinstance(spec.numerical.stiffness_n_per_m, str))
    springs = f"{EXPERIMENTAL}.natural_frequencies_hz" if derived else f"{part}.stiffness_n_per_m"
    masses = tuple(f"{one}.masses_kg" for one in (NUMERICAL, EXPERIMENTAL))
    units = "frequencies in Hz" if derived else "stiffnesses in N/m"
    asked = f"are masses in kg, {units}?"
    said = f"mode 1 {hz:.2g} Hz, drift {worst + 1} under 1 g sideways"
    yield Comparison(springs, float(drift[worst]), "m", "1 m", 1.0, 0.0, LARGEST_DRIFT_M, masses, said, asked)
    yield Comparison(
        masses[0], hz, "Hz", "1 Hz", 1.0, 0.0, STIFFEST_HZ, (masses[1], springs), "the first mode", asked, power=0.5
    )


def _of_masses(spec: StructureSpec) -> Iterator[Comparison]:
    own, on_table = spec.numerical.masses_kg, spec.experimental.masses_kg
    keys = (f"{NUMERICAL}.masses_kg", f"{EXPERIMENTAL}.masses_kg")
    mean = sum(on_table) / len(on_table)
    asked = "are masses in kg in both parts?"
    for i, mass in enumerate(own, 1):
        said = f"floor {i}"
        yield Comparison(keys[0], mass, "kg", "the mean floor on the table", mean, 0.01, 150.0, (keys[1],), said, asked)
    yield from among_equals({keys[0]: list(own), keys[1]: list(on_table)}, "kg")
    for key, masses in zip(keys, (own, on_table), strict=True):
        yield from _against_others(key, masses, "kg", "floors of this part", 1.0 / IN_A_PART, IN_A_PART)


def _of_table(spec: StructureSpec) -> Iterator[Comparison]:
    """Yield the comparisons of what stands on the table."""
    own = spec.numerical.masses_kg
    keys = (f"{NUMERICAL}.masses_kg", f"{EXPERIMENTAL}.masses_kg")
    yield from _of_table_alone(spec)
    if spec.interface_experimental_mass_kg > 0.0:
        key, mass = "structure.interface_experimental_mass_kg", spec.interface_experimental_mass_kg
        yield Comparison(key, mass, "kg", "the whole interface floor", own[-1], 0.005, 1.0, (keys[0],))


def _of_table_alone(spec: StructureSpec) -> Iterator[Comparison]:
    weight = sum(spec.experimental.masses_kg) + spec.interface_experimental_mass_kg
    key, lightest = f"{EXPERIMENTAL}.masses_kg", "the lightest specimen that a table shakes"
    yield Comparison(key, weight, "kg", lightest, LIGHTEST_SPECIMEN_KG, 1.0, inf, (), "the specimen")


def _of_stiffness(spec: StructureSpec, building: Building) -> Iterator[Comparison]:
    stated = {
        f"{NUMERICAL}.stiffness_n_per_m": spec.numerical.stiffness_n_per_m,
        f"{EXPERIMENTAL}.stiffness_n_per_m": spec.experimental.stiffness_n_per_m,
    }
    values = {key: list(of) for key, of in stated.items() if of is not None and not isinstance(of, str)}
    yield from among_equals(values, "N/m")
    for key, springs in values.items():
        yield from _against_others(key, springs, "N/m", "storeys of this part", 1.0 / 500.0, 500.0)
    # a soft specimen on a stiff building is usual, a building far softer than its specimen is not
    own, on_table = (float(np.median(storey_values(part.K))) for part in (building.numerical, building.specimen))
    if (key := f"{NUMERICAL}.stiffness_n_per_m") in values:
        against, others = "that on the table", (f"{EXPERIMENTAL}.stiffness_n_per_m",)
        said = "the median of the list"
        yield Comparison(key, own, "N/m", against, on_table, *STIFFNESS_OF_PARTS, others, said)
    yield from _of_stiffness_on_table(spec)


def _of_stiffness_on_table(spec: StructureSpec) -> Iterator[Comparison]:
    modes_hz = spec.experimental.natural_frequencies_hz or ()
    for i, (low, high) in enumerate(pairwise(modes_hz), 2):
        key = f"{EXPERIMENTAL}.natural_frequencies_hz"
        yield Comparison(key, high, "Hz", f"mode {i - 1}", low, 1.0, 6.0, (), f"mode {i}")


def _of_heights(spec: StructureSpec, building: Building) -> Iterator[Comparison]:
    heights = spec.heights_m or ()
    yield from among_equals({"structure.heights_m": list(heights)}, "m")
    for i, (height, drift) in enumerate(zip(heights, drift_under_1_g(building), strict=False), 1):
        said = f"storey {i}"
        yield Comparison("structure.heights_m", height, "m", "the usual height of storeys", 1.0, 0.02, 10.0, (), said)
        springs = (f"{NUMERICAL}.stiffness_n_per_m", f"{NUMERICAL}.masses_kg")
        against = "its drift under 1 g sideways, which it must stand"
        yield Comparison("structure.heights_m", height, "m", against, float(drift), 1.0, inf, springs, f"storey {i}")


def _of_laws(spec: StructureSpec, building: Building) -> Iterator[Comparison]:
    """Yield the comparisons of drifts, forces and stiffnesses of laws with those of their storey."""
    weights, stiffness, drifts = _weights(building), _stiffness(building), drift_under_1_g(building)
    for i, laws in enumerate(spec.numerical.law or ()):
        for law in laws:
            for key, value in law.model_dump(exclude_none=True).items():
                ranges = (
                    (OVER_DRIFT, drifts[i], "m", "the storey's drift under 1 g sideways"),
                    (OVER_WEIGHT, weights[i], "N", "the weight above the storey"),
                    (OVER_STIFFNESS, stiffness[i], "N/m", "the storey's stiffness"),
                )
                for limits, figure, unit, against in ranges:
                    if key in limits and value and not (key == "coefficient" and law.kind == "friction"):
                        said = f"{key} of storey {i + 1}"
                        yield Comparison(
                            f"{NUMERICAL}.law", value, unit, against, float(figure), *limits[key], (), said
                        )


def _of_ratio(key: str, ratio: float, number: int, count: int, low: float = RATIOS[0]) -> Comparison:
    said = f"entry {number}" if count > 1 else ""
    return Comparison(
        key, ratio, "", "the usual damping ratio", 0.02, low / 0.02, RATIOS[1] / 0.02, (), said, "is it a ratio?"
    )


def _of_dashpots(key: str, dashpots: Sequence[float], critical: Array, others: tuple[str, ...]) -> Iterator[Comparison]:
    for i, (own, full) in enumerate(zip(dashpots, critical, strict=False), 1):
        if own > 0.0:
            said = f"entry {i}" if len(dashpots) > 1 else ""
            against = "critical damping of floor and storey, 2 sqrt(k m)"
            yield Comparison(key, own, "N s/m", against, float(full), 1e-4, 10.0, others, said)
    yield from among_equals({key: list(dashpots)} if all(dashpots) else {}, "N s/m")


def _against_others(
    key: str, values: Sequence[float], unit: str, what: str, low: float, high: float
) -> Iterator[Comparison]:
    """Yield the comparison of each number of a list with the median of the others."""
    for i, value in enumerate(values):
        others = [one for j, one in enumerate(values) if j != i and one > 0.0]
        if others and value > 0.0:
            yield Comparison(
                key, value, unit, f"the median of the other {what}", median(others), low, high, (), f"entry {i + 1}"
            )
