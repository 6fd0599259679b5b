"""From a structure file to matrices: storey stiffnesses, damping, both substructures and their total."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.structure.frame_reduction import numerical_of
from rths_cli.structure.programs import laws_of_program, program_of, tangent_of_program
from rths_cli.structure.shear_chain import (
    Building,
    Numerical,
    Specimen,
    assemble,
    first_mode_ratio,
    modal_damping_matrix,
    storey_matrix,
    storey_values,
)
from rths_cli.structure.stiffness_from_frequencies import stiffness_from_frequencies
from rths_cli.structure.storey_laws import Law, LawSpec, arranged, law_of

LIGHTEST_KG = 1e-9  # floor: a microgram
FASTEST_1_S = 1e11  # of a floor on its own springs and dashpots
MOST_SOLVED_STOREYS = 200  # in all, of a building whose dashpots are solved for: 100 eigenvalue problems, 10 s
SLOWEST_1_S = 1e-6  # of the heaviest floor on the softest storey: a period of 70 days


class NumericalSpec(Protocol):
    """The `numerical` part of a structure file: storeys 1..p from the ground, the last is the interface."""

    @property
    def masses_kg(self) -> Sequence[float]: ...
    @property
    def stiffness_n_per_m(
        self,
    ) -> str | Sequence[float] | None: ...  # None: matrices, a program


class ExperimentalSpec(Protocol):
    """The `experimental` part of a structure file: the storeys on the table, from the table up."""

    @property
    def masses_kg(self) -> Sequence[float]: ...
    @property
    def natural_frequencies_hz(self) -> Sequence[float] | None: ...
    @property
    def stiffness_n_per_m(self) -> Sequence[float] | None: ...
    @property
    def damping_ratios(self) -> Sequence[float] | None: ...
    @property
    def dashpots_n_s_per_m(self) -> Sequence[float] | None: ...


class StructureSpec(Protocol):
    """What `build` reads of a structure file."""

    @property
    def numerical(self) -> NumericalSpec: ...
    @property
    def experimental(self) -> ExperimentalSpec: ...
    @property
    def interface_experimental_mass_kg(self) -> float: ...


class DampingSpec(Protocol):
    """A damping level: the first mode's ratio or the dashpots of the numerical storeys, the other is None."""

    @property
    def first_mode_ratio(self) -> float | None: ...
    @property
    def dashpots_n_s_per_m(self) -> Sequence[float] | None: ...


def build(spec: StructureSpec, damping: DampingSpec) -> Building:
    """Build both substructures and their total from a structure file and a damping level.

    The damping level is that of the building without its laws.
    Raises InputError when a list's length differs from the number of storeys, when the interface mass is not
    less than its floor's, when no stiffnesses give the natural frequencies, or when the first mode's ratio is
    out of reach.
    """
    if getattr(spec.numerical, "matrices", None) is not None:
        return _with_frame(spec, damping)
    _check(spec, damping)
    specimen, notes = _build_specimen(spec.experimental)
    interface_mass = _interface_mass_kg(spec)
    numerical = _undamped_numerical(spec, specimen)
    M, C, K = assemble(numerical, specimen, interface_mass)
    _check_rates("structure, all floors", "stiffness_n_per_m", np.diag(M), K, 0.5)
    _check_rates("structure, all floors", "dashpots_n_s_per_m", np.diag(M), C, 1.0)
    dashpots = damping.dashpots_n_s_per_m
    if damping.first_mode_ratio is not None:
        c = _equal_dashpot(numerical, specimen, interface_mass, damping.first_mode_ratio)
        dashpots = [c] * len(numerical.masses_kg)
    assert dashpots is not None  # _check
    numerical = replace(numerical, C=storey_matrix(dashpots))
    _check_rates("damping", "dashpots_n_s_per_m", numerical.masses_kg, numerical.C, 1.0)
    stated = getattr(spec, "heights_m", None)  # no one needs to know the heights
    heights = None if stated is None else np.asarray(stated, dtype=float)
    laws = _laws(spec, numerical, specimen)
    numerical = _with_tangents_at_rest(numerical, laws)
    total = assemble(numerical, specimen, interface_mass)
    if (program := program_of(spec.numerical)) is not None:
        forces = laws_of_program(len(numerical.masses_kg))
        return Building(numerical, specimen, interface_mass, *total, notes, heights, forces, program)
    return Building(numerical, specimen, interface_mass, *total, notes, heights, arranged(laws))


def _with_frame(spec: StructureSpec, damping: DampingSpec) -> Building:
    """Return the building whose numerical part is a frame by its matrices."""
    faults = [*_faults_of_experimental(spec.experimental)]
    if faults:
        raise InputError(*faults)
    specimen, notes = _build_specimen(spec.experimental)
    mass = _interface_mass_kg(spec)
    numerical = numerical_of(spec.numerical.matrices, damping, mass)  # type: ignore[attr-defined, arg-type]
    return Building(numerical, specimen, mass, *assemble(numerical, specimen, mass), notes)


def is_attached(spec: ExperimentalSpec) -> bool:
    """Return whether the specimen is one that an actuator at the interface moves, not storeys on a table."""
    return bool(getattr(spec, "attached", False))


def _interface_mass_kg(spec: StructureSpec) -> float:
    """Return the part of the interface floor's mass that is not computed: on the table, or of an attached specimen."""
    attached = is_attached(spec.experimental)
    return float(spec.experimental.masses_kg[0] if attached else spec.interface_experimental_mass_kg)


def _laws(spec: StructureSpec, numerical: Numerical, specimen: Specimen) -> tuple[tuple[Law, ...], ...]:
    """Return the laws of the numerical storeys from the ground."""
    stated: Sequence[Sequence[LawSpec]] = getattr(spec.numerical, "law", None) or ()  # no building needs laws
    masses = np.concatenate([spec.numerical.masses_kg, specimen.masses_kg])
    weights = STANDARD_GRAVITY_M_S2 * np.cumsum(masses[::-1])[::-1]
    storeys = zip(stated, storey_values(numerical.K).tolist(), weights.tolist(), strict=False)
    return tuple(tuple(law_of(one, k, weight) for one in laws) for laws, k, weight in storeys)


def _with_tangents_at_rest(numerical: Numerical, laws: tuple[tuple[Law, ...], ...]) -> Numerical:
    """Return the storeys with what their laws add to springs and dashpots at rest."""
    stiffness, dashpots = storey_values(numerical.K), storey_values(numerical.C)
    if not any(laws):
        return numerical
    for i, of_storey in enumerate(laws):
        stiffness[i] += sum(law.at_rest[0] for law in of_storey)
        dashpots[i] += sum(law.at_rest[1] for law in of_storey)
    return replace(numerical, K=storey_matrix(stiffness), C=storey_matrix(dashpots))


def _check(spec: StructureSpec, damping: DampingSpec) -> None:
    """Raise one InputError with every list of a wrong length and an interface mass out of its range."""
    numerical, experimental = spec.numerical, spec.experimental
    p = len(numerical.masses_kg)
    stated = numerical.stiffness_n_per_m
    from rths_cli.case.structure_schema import OF_MATRICES

    of_frames = [key for key in OF_MATRICES if getattr(damping, key, None) is not None]
    faults = [
        *_length("structure.numerical.stiffness_n_per_m", None if isinstance(stated, str) else stated, p),
        *_faults_of_experimental(experimental),
        *(
            f"damping.{key}: belongs to a frame by its matrices, numerical has storeys; give first_mode_ratio or "
            "dashpots_n_s_per_m"
            for key in of_frames
        ),
        *([] if of_frames else _one_of("damping", damping, "first_mode_ratio", "dashpots_n_s_per_m")),
        *_length("damping.dashpots_n_s_per_m", damping.dashpots_n_s_per_m, p),
    ]
    for where, masses in (("numerical", numerical.masses_kg), ("experimental", experimental.masses_kg)):
        if min(masses) < LIGHTEST_KG and not (masses is experimental.masses_kg and is_attached(experimental)):
            faults.append(
                f"structure.{where}.masses_kg: {min(masses):g} kg must be at least {LIGHTEST_KG:g} kg; raise it"
            )
    mass = spec.interface_experimental_mass_kg
    if not 0.0 <= mass < numerical.masses_kg[-1]:
        faults.append(
            f"structure.interface_experimental_mass_kg: {mass:g} kg must be at least 0 and less than the "
            f"interface floor's whole mass, numerical.masses_kg[{p}] = {numerical.masses_kg[-1]:g} kg"
        )
    if faults:
        raise InputError(*faults)


def _faults_of_experimental(spec: ExperimentalSpec) -> list[str]:
    """Return a sentence for every list of the specimen of a wrong length, and what is stated twice or not."""
    where, n = "structure.experimental", len(spec.masses_kg)
    lists = ("natural_frequencies_hz", "stiffness_n_per_m", "damping_ratios", "dashpots_n_s_per_m")
    return [
        *_one_of(where, spec, *lists[:2]),
        *_one_of(where, spec, *lists[2:]),
        *(fault for key in lists for fault in _length(f"{where}.{key}", getattr(spec, key), n)),
    ]


def _length(field: str, values: Sequence[float] | None, storeys: int) -> list[str]:
    """Return a sentence if a list is stated and has not one value per storey."""
    if values is None or len(values) == storeys:
        return []
    return [f"{field}: {len(values)} values for {storeys} storeys; state one value per mass"]


def _one_of(where: str, spec: object, first: str, second: str) -> list[str]:
    """Return a sentence unless exactly one of two fields is stated."""
    if (getattr(spec, first) is None) != (getattr(spec, second) is None):
        return []
    return [f"{where}: state either {first} or {second}"]


def _build_specimen(spec: ExperimentalSpec) -> tuple[Specimen, tuple[str, ...]]:
    """Return the specimen and sentences on the stiffness solutions not taken."""
    masses, stiffness = np.asarray(spec.masses_kg, dtype=float), spec.stiffness_n_per_m
    notes: tuple[str, ...] = ()
    if spec.natural_frequencies_hz is not None:
        solutions = stiffness_sets(tuple(spec.masses_kg), tuple(spec.natural_frequencies_hz))
        stiffness, notes = solutions[0].tolist(), _notes_on(solutions)
    assert stiffness is not None  # _check
    K, attached = storey_matrix(stiffness), is_attached(spec)
    if masses[0] > 0.0 or not attached:
        _check_stiffness("structure.experimental", masses, K)
    if spec.damping_ratios is not None:
        return Specimen(masses, K, modal_damping_matrix(masses, K, spec.damping_ratios), attached), notes
    assert spec.dashpots_n_s_per_m is not None  # _check
    C = storey_matrix(spec.dashpots_n_s_per_m)
    if masses[0] > 0.0 or not attached:
        _check_rates("structure.experimental", "dashpots_n_s_per_m", masses, C, 1.0)
    return Specimen(masses, K, C, attached), notes


@lru_cache(maxsize=100)
def stiffness_sets(masses_kg: tuple[float, ...], frequencies_hz: tuple[float, ...]) -> Array:
    """Return every set of storey stiffnesses in N/m (n_sets, n) of a specimen, found once: the first one is used."""
    return stiffness_from_frequencies(masses_kg, frequencies_hz)


def _notes_on(solutions: Array) -> tuple[str, ...]:
    """Name the stiffness sets that have the same natural frequencies and were not taken."""
    texts = ["(" + ", ".join(f"{k:.5g}" for k in solution) + ")" for solution in solutions]
    if len(texts) == 1:
        return ()
    return (
        f"{len(texts)} sets of experimental storey stiffnesses have the declared frequencies: {texts[0]} N/m is used, "
        f"not {' or '.join(texts[1:])}; if another is yours, state structure.experimental.stiffness_n_per_m",
    )


def _undamped_numerical(spec: StructureSpec, specimen: Specimen) -> Numerical:
    """Return the numerical substructure without dashpots, its mass without what stands on the table."""
    masses = np.array(spec.numerical.masses_kg, dtype=float)
    if (program := program_of(spec.numerical)) is not None:  # its model has the computed part's mass alone
        return Numerical(masses, tangent_of_program(program, masses), np.zeros((len(masses), len(masses))))
    masses[-1] -= _interface_mass_kg(spec)
    stiffness = spec.numerical.stiffness_n_per_m
    if isinstance(stiffness, str):
        stiffness = [float(np.mean(storey_values(specimen.K)))] * len(masses)
    assert stiffness is not None  # without matrices and programs
    K = storey_matrix(stiffness)
    _check_stiffness("structure.numerical", masses, K)
    return Numerical(masses, K, np.zeros((len(masses), len(masses))))


def _check_stiffness(where: str, masses_kg: Array, K: Array) -> None:
    """Raise InputError for storeys too stiff or too soft for the masses of their part."""
    _check_rates(where, "stiffness_n_per_m", masses_kg, K, 0.5)
    stiffness, heaviest = storey_values(K), float(masses_kg.max())
    if not np.sqrt(stiffness.min() / heaviest) >= SLOWEST_1_S:
        softest = int(np.argmin(stiffness))
        raise InputError(
            f"{where}: storey {softest + 1} of {stiffness[softest]:.3g} N/m lets a mass of {heaviest:.3g} kg move at "
            f"{np.sqrt(stiffness[softest] / heaviest):.1e} 1/s, the limit is {SLOWEST_1_S:.0e} 1/s; raise "
            "stiffness_n_per_m or lower masses_kg"
        )


def _check_rates(where: str, what: str, masses_kg: Array, matrix: Array, power: float) -> None:
    """Raise InputError with every floor so light beside its springs or dashpots that nothing can be computed with it.

    The rate is sqrt(k / m) or c / m of the floor alone; beyond the limit double precision keeps no six digits of the
    motions that matter, of some hertz.
    """
    faults = []
    for i, (mass, value) in enumerate(zip(masses_kg.tolist(), np.diag(matrix).tolist(), strict=True)):
        rate = (value / mass) ** power
        if not rate <= FASTEST_1_S:
            faults.append(
                f"{where}: floor {i + 1} of {mass:.3g} kg moves at {rate:.1e} 1/s on its {what} of {value:.3g}, "
                f"the limit is {FASTEST_1_S:.0e} 1/s; raise masses_kg or lower {what}"
            )
    if faults:
        raise InputError(*faults[:5])


def _equal_dashpot(numerical: Numerical, specimen: Specimen, interface_mass: float, target: float) -> float:
    """Return the dashpot in N s/m, equal in all numerical storeys, that gives the first mode its ratio.

    The ratio is that of the complex eigenvalue; it rises with the dashpot up to a greatest value, then falls
    because the numerical storeys lock. Raises InputError when the target is outside the rising branch, and for a
    building too tall.
    """
    storeys = len(numerical.masses_kg) + len(specimen.masses_kg)
    if storeys > MOST_SOLVED_STOREYS:
        raise InputError(
            f"damping.first_mode_ratio: dashpots are solved for up to {MOST_SOLVED_STOREYS} storeys in all, this "
            f"building has {storeys}; state dashpots_n_s_per_m"
        )
    chain = storey_matrix(np.ones(len(numerical.masses_kg)))

    def ratio(dashpot: float) -> float:
        return first_mode_ratio(*assemble(replace(numerical, C=dashpot * chain), specimen, interface_mass))

    from scipy.optimize import brentq  # takes half a second, and dashpots may be stated

    lowest = ratio(0.0)
    if abs(lowest - target) < 1e-12:
        return 0.0
    first_step = 1e-3 * _critical_dashpot(numerical, chain)
    low, high = _rising_bracket(ratio, target if target > lowest else np.inf, first_step)
    greatest = ratio(high)
    if lowest < target <= greatest:
        c = brentq(
            lambda dashpot: ratio(dashpot) - target, low, high, xtol=1e-300, rtol=1e-12, maxiter=1000
        )  # xtol: relative alone
        if abs(ratio(c) - target) < 1e-9:
            return float(c)
    raise InputError(
        f"damping.first_mode_ratio: equal dashpots in the numerical storeys cannot give {target:g}, only "
        f"{np.ceil(lowest * 1e4) / 1e4:g} to {np.floor(greatest * 1e4) / 1e4:g}; state a ratio in "
        "that range, or dashpots_n_s_per_m"
    )


def _critical_dashpot(numerical: Numerical, chain: Array) -> float:
    """Return 2 sqrt(k m) of the numerical storeys in N s/m, the size of dashpots that lock them."""
    stiffness = np.trace(numerical.K) / np.trace(chain)
    return float(2.0 * np.sqrt(stiffness * numerical.masses_kg.sum()))


def _rising_bracket(ratio: Callable[[float], float], target: float, first_step: float) -> tuple[float, float]:
    """Return two dashpots with the target between their ratios, or an interval up to the greatest ratio."""
    before, low, high = 0.0, 0.0, first_step
    previous, current = ratio(low), ratio(high)
    while previous < current < target:
        before, low, high = low, high, 1.25 * high
        previous, current = current, ratio(high)
    if current >= target:
        return low, high
    from scipy.optimize import minimize_scalar

    within = {"xatol": 1e-7 * (high - before)}
    found = minimize_scalar(lambda dashpot: -ratio(dashpot), bounds=(before, high), method="bounded", options=within)
    return before, float(found.x)
