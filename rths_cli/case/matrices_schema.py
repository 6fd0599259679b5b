"""Keys of a numerical substructure that is given by matrices: files, units, interface, damping and reduction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from rths_cli.case.field_types import Problem, Range, Strict, entry, exactly_one, listed

MOST_DOFS = 20_000  # of the files
MOST_KEPT = 200  # that the loop computes, as many as storeys of a chain

Dof = Annotated[int, Range(ge=1, le=MOST_DOFS)]
Dofs = Annotated[tuple[Dof, ...], Field(min_length=1, max_length=MOST_KEPT)]
Ratio = Annotated[float, Range(ge=0, lt=1)]
Hz = Annotated[float, Range(gt=0, le=10_000)]


class MatrixFile(Strict):
    """Hold the file of a matrix or vector; the name alone stands for {file: NAME}."""

    wanted: ClassVar[str] = "the name of a file, or a mapping such as {file: frame.mat, variable: K}"

    file: Path = Field(
        description=".csv, .txt (numbers in rows), .mtx (Matrix Market), .mat, .npz or .npy; relative to the file that "
        "names it"
    )
    variable: str | None = Field(
        default=None, description="of a .mat or .npz file that holds several; default: M, K, C or r, or the only one"
    )
    sha256: str | None = Field(
        default=None,
        description="checksum of that file; default: as it is found. A file with another one is not used",
        json_schema_extra={"pattern": "^[0-9a-f]{64}$"},
    )


class _OrName:
    """Describes a file in JSON Schema as it may be stated: by its name, or by a mapping."""

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [{"type": "string"}, handler(core)]}


NamedMatrix = Annotated[MatrixFile, _OrName]


class MatrixUnits(Strict):
    """Hold the units of the files; rotations are in rad."""

    length: Literal["m", "cm", "mm", "in", "ft"] = Field(default="m", description="of displacements")
    force: Literal["N", "kN", "MN", "kgf", "lbf", "kip"] = Field(default="N", description="of forces")
    mass: Literal["kg", "t", "g", "lb", "consistent"] = Field(
        default="kg", description="of masses; consistent: force times s^2 over length, as SAP2000 and OpenSees have it"
    )


class Reduction(Strict):
    """Hold what a large frame is reduced to before the loop computes it; SIM computes all of it."""

    kind: Literal["none", "static", "craig_bampton"] = Field(
        description="none; static: to `dofs` (Guyan); craig_bampton: to the interface and modes with it held"
    )
    dofs: Dofs | None = Field(
        default=None,
        description="degrees of freedom that results show, as rows of the matrices; static keeps these, craig_bampton "
        "chooses further ones by itself",
    )
    modes: Annotated[int, Range(ge=1, le=MOST_KEPT - 2)] | None = Field(
        default=None, description="craig_bampton: how many of the frame's first modes are kept, to 0.1 % in frequency"
    )
    up_to_hz: Hz | None = Field(default=None, description="instead of modes: all of the frame's modes up to there")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        kind = data.get("kind")
        if kind == "craig_bampton":
            yield from exactly_one(data, "modes", "up_to_hz")
        elif kind in ("none", "static"):
            for key in ("modes", "up_to_hz"):
                if data.get(key) is not None:
                    yield (key,), f"belongs to kind craig_bampton, kind is {kind}; remove it"
        if kind == "static" and data.get("dofs") is None:
            yield ("dofs",), "is missing; add the degrees of freedom that kind static keeps"
        if kind == "none" and data.get("dofs") is not None:
            yield ("dofs",), "belongs to kinds static and craig_bampton, kind is none; remove it"
        stated = listed(data, "dofs") or ()
        if len(set(map(str, stated))) != len(stated):
            yield ("dofs",), "names a degree of freedom twice; name each once"


class MatricesSpec(Strict):
    """Hold a numerical substructure M d2x + C dx + K x = -M r a_g + e f, x relative to the ground.

    Degrees of freedom are numbered from 1, as rows of the matrices. C is a damping level's.
    """

    mass: NamedMatrix = Field(description="mass matrix M, the whole mass of the interface included")
    stiffness: NamedMatrix = Field(description="stiffness matrix K of the frame on its supports")
    interface: Dof = Field(
        description="degree of freedom on which the experimental storeys stand: a displacement along the ground motion"
    )
    influence: Literal["ones"] | NamedMatrix = Field(
        default="ones",
        description="vector r: displacement of each degree of freedom when the ground moves by 1, 0 for rotations and "
        "for displacements across the ground motion; ones, or a file",
    )
    units: MatrixUnits = Field(default=MatrixUnits(), description="of all files, those of damping included")
    reduction: Reduction = Field(default=Reduction(kind="none"), description="what the loop computes of the frame")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        kept, interface = entry(data, "reduction", "dofs"), data.get("interface")
        if isinstance(kept, list | tuple) and interface in kept:
            yield ("reduction", "dofs"), f"names the interface {interface}, which is always kept; remove it"


class RayleighSpec(Strict):
    """Hold Rayleigh damping: C = mass_1_per_s M + stiffness_s K, stated or by a ratio at two frequencies."""

    ratio: Ratio | None = Field(default=None, description="damping ratio at both frequencies_hz")
    frequencies_hz: tuple[Hz, Hz] | None = Field(default=None, description="two frequencies with that ratio")
    mass_1_per_s: Annotated[float, Range(ge=0, le=1e4)] | None = Field(
        default=None, description="instead of ratio: factor of M"
    )
    stiffness_s: Annotated[float, Range(ge=0, le=1)] | None = Field(
        default=None, description="instead of frequencies_hz: factor of K"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        pairs = (("ratio", "frequencies_hz"), ("mass_1_per_s", "stiffness_s"))
        given = [[data.get(key) is not None for key in pair] for pair in pairs]
        if sorted(map(all, given)) != [False, True] or sum(map(any, given)) != 1:
            yield (), "give ratio and frequencies_hz, or mass_1_per_s and stiffness_s"
        ends = listed(data, "frequencies_hz") or ()
        if len(ends) == 2 and ends[0] == ends[1]:
            yield ("frequencies_hz",), "must be two different frequencies"
