"""Keys of a structure file, of damping and of the scale of a model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
)

from rths_cli.case.field_types import Problem, Range, Strict, count, entry, exactly_one, listed, number, same_length
from rths_cli.case.matrices_schema import MatricesSpec, NamedMatrix, RayleighSpec
from rths_cli.case.program_schema import ProgramSpec
from rths_cli.case.storey_law_schema import StoreyLaws
from rths_cli.errors import InputError

MAX_STOREYS = 200

Mass = Annotated[float, Range(gt=0, le=1e7)]
Stiffness = Annotated[float, Range(gt=0, le=1e12)]
Frequency = Annotated[float, Range(gt=0, le=1000)]
Height = Annotated[float, Range(gt=0, le=1000)]
Dashpot = Annotated[float, Range(ge=0, le=1e9)]
Ratio = Annotated[float, Range(ge=0, lt=1)]
Storeys = Field(min_length=1, max_length=MAX_STOREYS)

Factor = Annotated[float, Range(ge=1e-6, le=1e6)]


def _per_storey(description: str) -> Any:
    """Return the field of a list with an entry per storey, or per mode."""
    return Field(min_length=1, max_length=MAX_STOREYS, description=description)


def _maybe_per_storey(description: str) -> Any:
    """Return the field of such a list that need not be given."""
    return Field(default=None, min_length=1, max_length=MAX_STOREYS, description=description)


def _one_of(*pairs: tuple[str, str]) -> dict[str, Any]:
    """Return the JSON Schema clause that says exactly one key of each pair is given."""
    return {"allOf": [{"oneOf": [{"required": [key]} for key in pair]} for pair in pairs]}


def _word_or_list(value: object) -> str:
    return "word" if isinstance(value, str) else "list"


NumericalStiffness = Annotated[
    Annotated[Literal["mean_of_experimental"], Tag("word")] | Annotated[tuple[Stiffness, ...], Storeys, Tag("list")],
    Discriminator(_word_or_list),
]


OF_MATRICES = ("modal", "rayleigh", "matrix")
"""Keys of the damping of a numerical substructure that is given by matrices."""


def _one_ratio_as_list(value: object) -> object:
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


class DampingSpec(Strict):
    """Hold the numerical substructure's damping: of storeys the total structure's first modal ratio, or dashpots (p,);
    of matrices modal or Rayleigh damping of the frame by itself, or its damping matrix."""

    wanted: ClassVar[str] = "the name of a level, or a mapping such as {first_mode_ratio: 0.03}"

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                {"oneOf": [{"required": [key]} for key in ("first_mode_ratio", "dashpots_n_s_per_m", *OF_MATRICES)]}
            ]
        }
    )

    name: str = Field(default="inline", description="label in tables; a level of a structure is named by its key")
    first_mode_ratio: Annotated[float, Range(gt=0, lt=1)] | None = Field(
        default=None, description="damping ratio of mode 1 of the whole building; equal dashpots are solved for"
    )
    dashpots_n_s_per_m: tuple[Dashpot, ...] | None = _maybe_per_storey(
        "instead of first_mode_ratio: one per numerical storey, from the ground"
    )
    modal: Annotated[tuple[Ratio, ...], BeforeValidator(_one_ratio_as_list)] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_STOREYS,
        description="of matrices: damping ratios of the frame by itself, mode 1 first; the last one, or a single "
        "number, holds for all further modes",
    )
    rayleigh: RayleighSpec | None = Field(default=None, description="of matrices: C = a M + b K of the frame")
    matrix: NamedMatrix | None = Field(default=None, description="of matrices: file of the frame's damping matrix C")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        given = [key for key in ("first_mode_ratio", "dashpots_n_s_per_m", *OF_MATRICES) if data.get(key) is not None]
        if not set(given) & set(OF_MATRICES):
            yield from exactly_one(data, "first_mode_ratio", "dashpots_n_s_per_m")
        elif len(given) > 1:
            yield (given[1],), f"give {' or '.join(given)}, not both"


class NumericalSpec(Strict):
    """Hold the computed storeys 1..p from the ground; the highest is the interface.

    `masses_kg` (p,), the interface floor's whole mass included; `stiffness_n_per_m` (p,), or the mean of the
    experimental storeys' stiffnesses. `matrices` takes the place of both; `masses_kg` then is what rths writes to
    results, the diagonal of the mass matrix that the loop computes.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [{"anyOf": [{"required": ["masses_kg", "stiffness_n_per_m"]}, {"required": ["matrices"]}]}],
        }
    )

    masses_kg: tuple[Mass, ...] = Field(
        default=(),
        validate_default=False,
        min_length=1,
        max_length=MAX_STOREYS,
        description="floor masses from the ground, the interface floor's whole mass included",
    )
    stiffness_n_per_m: NumericalStiffness | None = Field(
        default=None, description="storey stiffnesses from the ground, or the mean of the experimental ones"
    )
    matrices: MatricesSpec | None = Field(
        default=None, description="instead of masses_kg and stiffness_n_per_m: a frame by its matrices"
    )
    law: StoreyLaws | None = Field(
        default=None,
        description="laws of the storeys from the ground: per storey a law, a list of laws in parallel, or nothing; "
        "one law alone is that of the only storey",
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        if data.get("matrices") is not None:
            for key in ("stiffness_n_per_m", "law"):
                if data.get(key) is not None:
                    yield (key,), "belongs to storeys, which matrices take the place of; remove it"
            return
        for key in ("masses_kg", "stiffness_n_per_m"):
            if key not in data:
                yield (key,), f"is missing; add {key}"
        yield from same_length(data, "stiffness_n_per_m", count(data, "masses_kg"), "storey")
        storeys, law = count(data, "masses_kg"), data.get("law")
        if isinstance(law, Mapping) and storeys is not None and storeys > 1:
            yield ("law",), f"is one law, but there are {storeys} storeys; give a list with an entry for each"
        yield from same_length(data, "law", storeys, "storey")


def _storeys_or_program(data: Any, handler: ValidatorFunctionWrapHandler) -> NumericalSpec | ProgramSpec:
    """Return computed storeys or, with a `kind`, a program; raises the faults of that model alone."""
    if isinstance(data, NumericalSpec | ProgramSpec):
        return data
    if isinstance(data, Mapping) and "kind" in data:
        return ProgramSpec.model_validate(data)
    return NumericalSpec.model_validate(data)


class ExperimentalSpec(Strict):
    """Hold the storeys on the table: values (n,) of storeys from the table upwards, or of modes."""

    attached: ClassVar[bool] = False

    model_config = ConfigDict(
        json_schema_extra=_one_of(
            ("natural_frequencies_hz", "stiffness_n_per_m"), ("damping_ratios", "dashpots_n_s_per_m")
        )
    )

    masses_kg: tuple[Mass, ...] = _per_storey("floor masses from the table upwards")
    natural_frequencies_hz: tuple[Frequency, ...] | None = _maybe_per_storey(
        "on a fixed base, mode 1 first (at most 5 storeys)"
    )
    stiffness_n_per_m: tuple[Stiffness, ...] | None = _maybe_per_storey(
        "instead of the frequencies: storey stiffnesses from the table upwards"
    )
    damping_ratios: tuple[Ratio, ...] | None = _maybe_per_storey("modal, on a fixed base, mode 1 first")
    dashpots_n_s_per_m: tuple[Dashpot, ...] | None = _maybe_per_storey(
        "instead of the ratios: storey dashpots from the table upwards"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from exactly_one(data, "natural_frequencies_hz", "stiffness_n_per_m")
        yield from exactly_one(data, "damping_ratios", "dashpots_n_s_per_m")
        for key in ("natural_frequencies_hz", "stiffness_n_per_m", "damping_ratios", "dashpots_n_s_per_m"):
            yield from same_length(data, key, count(data, "masses_kg"), "storey")
        values = [f for f in listed(data, "natural_frequencies_hz") or () if isinstance(f, int | float)]
        if any(high <= low for low, high in pairwise(values)):
            yield ("natural_frequencies_hz",), "must increase from mode to mode; sort them, mode 1 first"


class AttachedSpec(ExperimentalSpec):
    """Hold a specimen between the interface floor and the laboratory's, which an actuator moves: a spring, a dashpot,
    and the part of the interface floor's mass that is on it. Lists have one entry: one degree of freedom."""

    attached: ClassVar[bool] = True

    kind: Literal["attached"] = Field(description="not storeys on a table: what an actuator at the interface moves")
    masses_kg: tuple[Annotated[float, Range(ge=0, le=1e7)], ...] = Field(
        default=(0.0,),
        min_length=1,
        max_length=1,
        description="mass that the load cell moves, part of the interface floor's; default: none, a spring and dashpot",
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from super().problems({"masses_kg": (0.0,), **data})
        if not any(one for one in listed(data, "masses_kg") or ()):
            for key, instead in (
                ("natural_frequencies_hz", "stiffness_n_per_m"), ("damping_ratios", "dashpots_n_s_per_m")
            ):  # fmt: skip
                if data.get(key) is not None:
                    yield (key,), f"needs a mass, and this specimen has none; state {instead}, or masses_kg"


def _storeys_or_attached(data: Any, handler: ValidatorFunctionWrapHandler) -> ExperimentalSpec:
    """Return storeys on a table or, with a `kind`, an attached specimen; raises the faults of that model alone."""
    if isinstance(data, ExperimentalSpec):
        return data
    stated = isinstance(data, Mapping) and "kind" in data
    return (AttachedSpec if stated else ExperimentalSpec).model_validate(data)


class StructureSpec(Strict):
    """Hold a shear building: numerical storeys from the ground, experimental storeys above, on the table, or a specimen
    attached to the interface floor."""

    wanted: ClassVar[str] = "a name or a mapping"

    name: str = Field(default="inline", description="label in tables; default: the file's name")
    numerical: Annotated[NumericalSpec | ProgramSpec, WrapValidator(_storeys_or_program)] = Field(
        description="the computed storeys 1 to p, from the ground, the highest is the interface; with a kind: a "
        "program that computes their forces"
    )
    experimental: Annotated[ExperimentalSpec | AttachedSpec, WrapValidator(_storeys_or_attached)] = Field(
        description="the storeys on the table; with kind: attached a specimen that an actuator moves"
    )
    interface_experimental_mass_kg: Annotated[float, Range(ge=0, le=1e7)] = Field(
        default=0.0, description="part of the interface floor's mass that stands on the table"
    )
    heights_m: tuple[Height, ...] | None = _maybe_per_storey(
        "storey heights of the whole building from the ground, for drift ratios and profiles"
    )
    damping_levels: dict[str, DampingSpec] = Field(default={}, description="what `damping:` in a case may name")

    @field_validator("damping_levels")
    @classmethod
    def _name_levels(cls, levels: dict[str, DampingSpec]) -> dict[str, DampingSpec]:
        return {key: level.model_copy(update={"name": key}) for key, level in levels.items()}

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        masses = listed(data, "numerical", "masses_kg") or ()
        on_table = number(data, "interface_experimental_mass_kg")
        highest = masses[-1] if masses and isinstance(masses[-1], int | float) else None
        if on_table is not None and highest is not None and on_table >= highest:
            limit = f"must be < the interface floor's mass {highest:g} kg, got {on_table:g}"
            yield ("interface_experimental_mass_kg",), limit
        attached = entry(data, "experimental", "kind") == "attached"
        if attached:
            yield from _attached_problems(data, highest)
        parts = ("numerical",) if attached else ("numerical", "experimental")
        storeys = [count(data.get(part) or {}, "masses_kg") for part in parts]
        if entry(data, "numerical", "matrices") is not None:
            if data.get("heights_m") is not None:
                yield ("heights_m",), "belongs to a building of storeys alone, numerical has matrices; remove it"
            return
        if None not in storeys:
            yield from same_length(data, "heights_m", sum(filter(None, storeys)), "storey")
        levels = data.get("damping_levels")
        for key, level in levels.items() if isinstance(levels, Mapping) else ():
            if key in ("", "inline"):
                yield ("damping_levels", key), "is not usable as a level's name; rename it"
            name = entry(level, "name")
            if name not in (None, key, "inline"):
                yield ("damping_levels", key, "name"), f"a level is named by its key {key!r}; remove name"
            if isinstance(level, Mapping):
                for loc, message in same_length(level, "dashpots_n_s_per_m", len(masses) or None, "numerical storey"):
                    yield ("damping_levels", key, *loc), message


def _attached_problems(data: Mapping[str, Any], interface_kg: float | None) -> Iterator[Problem]:
    """Yield faults of a building with an attached specimen; `interface_kg`: mass of its interface floor."""
    if number(data, "interface_experimental_mass_kg"):
        yield ("interface_experimental_mass_kg",), "belongs to a table; state the specimen's mass in its masses_kg"
    own = next(iter(listed(data, "experimental", "masses_kg") or ()), 0.0)
    if interface_kg is not None and isinstance(own, int | float) and own >= interface_kg:
        yield ("experimental", "masses_kg"), f"must be < the interface floor's mass {interface_kg:g} kg, got {own:g}"
    if entry(data, "numerical", "kind") is not None:
        yield ("numerical", "kind"), "a program computes the storeys below a table only; use computed storeys"
    if entry(data, "numerical", "law") is not None:
        yield ("numerical", "law"), "storeys with laws stand below a table only; use linear storeys"
    if entry(data, "numerical", "stiffness_n_per_m") == "mean_of_experimental":
        yield ("numerical", "stiffness_n_per_m"), "an attached specimen is no storey; state the stiffnesses"


def without_dashpots(spec: StructureSpec) -> dict[str, tuple[float, ...]]:
    """Return the damping of a numerical substructure without any, by its key."""
    if spec.numerical.matrices is not None:
        return {"modal": (0.0,)}
    return {"dashpots_n_s_per_m": (0.0,) * len(spec.numerical.masses_kg)}


class ScaleSpec(Strict):
    """Hold the independent scale factors, each the prototype's value over the model's."""

    length: Annotated[float, Range(ge=0.01, le=1000)] = Field(
        description="length of the prototype over that of the model; a model at 1:2.4 has 2.4"
    )
    acceleration: Annotated[float, Range(ge=0.01, le=100)] = Field(
        default=1.0, description="acceleration of the prototype over that of the model; 1 where gravity matters"
    )
    stress: Factor | None = Field(
        default=None, description="stress or elastic modulus; default: 1, the same material (artificial mass)"
    )
    mass: Factor | None = Field(
        default=None, description="instead of stress: mass of a storey of the prototype over that of the model"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        if data.get("stress") is not None and data.get("mass") is not None:
            yield ("mass",), "give mass or stress, not both; the other one follows from length and acceleration"


def read_scale(texts: Sequence[str]) -> ScaleSpec | None:
    """Return the scale of `--scale KEY=VALUE` options, None without any; raises InputError with all faults."""
    if not texts:
        return None
    values: dict[str, float] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--scale {text}: must be KEY=NUMBER, for example --scale length=2.4")
        if key in values:
            raise InputError(f"--scale {key}: is given twice; give it once")
        values[key] = number
    try:
        return ScaleSpec.model_validate(values)
    except ValidationError as error:
        places = ((".".join(map(str, one["loc"])), one["msg"]) for one in error.errors(include_url=False))
        raise InputError(*(f"--scale {place}: {said}" for place, said in places)) from error
