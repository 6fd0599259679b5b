"""The keys of a numerical substructure that is a program (`numerical` of a structure file, with a `kind`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from rths_cli.case.field_types import Problem, Range, Strict

if TYPE_CHECKING:
    from rths_cli.programs import Description

LENGTHS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
FORCES_N = {"N": 1.0, "kN": 1e3, "MN": 1e6, "lbf": 4.4482216152605, "kip": 4448.2216152605}
MOST_STALLS = 100

Mass = Annotated[float, Range(gt=0, le=1e7)]
Seconds = Annotated[float, Range(gt=0, le=100)]


class InterfaceSpec(Strict):
    """Hold the degree of freedom of an OpenSees model at which the specimen stands."""

    node: Annotated[int, Range(ge=1, le=10**9)] = Field(description="tag of the node; it has the computed mass")
    dof: Annotated[int, Range(ge=1, le=3)] = Field(description="its degree of freedom in which the table moves")


class UnitsSpec(Strict):
    """Hold the units of an OpenSees model, which itself knows none; its mass is force times time^2 over length."""

    length: Literal["m", "cm", "mm", "in", "ft"] = Field(description="unit of coordinates and displacements")
    force: Literal["N", "kN", "MN", "lbf", "kip"] = Field(description="unit of forces")
    time: Literal["s"] = Field(description="unit of time")


class StallSpec(Strict):
    """Hold a stall of the program in simulated time: its next answer takes so much longer."""

    at_s: Annotated[float, Range(ge=0, le=1e5)] = Field(description="instant of the record from which on it comes next")
    lasts_s: Seconds = Field(description="by how much that answer is late")


class ProgramSpec(Strict):
    """Hold computed floors whose restoring forces a program computes, in a process of its own. Its code is run."""

    stiffness_n_per_m: ClassVar[None] = None
    law: ClassVar[None] = None
    matrices: ClassVar[None] = None

    kind: str = Field(
        min_length=1, max_length=100, description="opensees, python, or the name of an entry point of rths.programs"
    )
    file: Path | None = Field(
        default=None,
        description="kinds opensees and python: the script, relative to the file that names it; its code is run",
    )
    sha256: str | None = Field(
        default=None,
        description="checksum of that file; default: as it is found. A file with another one is not run",
        json_schema_extra={"pattern": "^[0-9a-f]{64}$"},
    )
    function: Annotated[str, Field(min_length=1, max_length=100)] = Field(
        default="build", description="what builds the model: a function (opensees), a class (python)"
    )
    interface: InterfaceSpec | None = Field(default=None, description="kind opensees: where the specimen stands")
    units: UnitsSpec | None = Field(default=None, description="kind opensees: the units of the model")
    masses_kg: tuple[Mass, ...] = Field(
        default=(), max_length=200, description="of the computed floors upwards, the interface last; kind opensees: "
        "default: as in the model, otherwise compared with it",
    )  # fmt: skip
    parameters: dict[str, float] = Field(default={}, description="kind python: numbers that the class is given")
    rate_hz: Annotated[float, Range(gt=0, le=1e5)] = Field(
        description="at which it is asked for forces; the sample rate is a whole multiple of it"
    )
    compute_time_s: Seconds | None = Field(
        default=None, description="what an answer takes in simulated time; default: an interval of rate_hz"
    )
    stiffness_factor: Annotated[float, Range(ge=0.1, le=10)] = Field(
        default=1.0, description="of the linear part, over the tangent at rest; the residual makes up for it"
    )
    silent_after_s: Annotated[float, Range(ge=0.1, le=3600)] = Field(
        default=10.0, description="time on the clock after which a program that does not answer is ended"
    )
    stalls: tuple[StallSpec, ...] = Field(default=(), max_length=MOST_STALLS, description="in simulated time")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        kind = data.get("kind")
        if kind in ("opensees", "python") and data.get("file") is None:
            yield ("file",), f"is missing; add the script, kind {kind} runs it"
        if data.get("sha256") is not None and data.get("file") is None:
            yield ("sha256",), "is the checksum of file, which is not given; remove it"
        needed = ("interface", "units") if kind == "opensees" else ("masses_kg",)
        for key in needed:
            if not data.get(key):
                yield (key,), f"is missing; add it, kind {kind} needs it"
        for key in () if kind == "opensees" else ("interface", "units"):
            if data.get(key) is not None:
                yield (key,), f"belongs to kind opensees, kind {kind} works in m and N; remove it"
        if kind == "opensees" and data.get("parameters"):
            yield ("parameters",), "belongs to kind python; write the numbers into the script"

    @property
    def description(self) -> Description:
        """Return what the program's process needs to know."""
        from rths_cli.programs import Description  # numpy, which no case without a program needs

        units, interface = self.units, self.interface
        return Description(
            self.kind, str(self.file or ""), self.sha256 or "", self.function,
            interface.node if interface else 0, interface.dof if interface else 0,
            LENGTHS_M[units.length] if units else 1.0, FORCES_N[units.force] if units else 1.0,
            () if self.kind == "opensees" else self.masses_kg, tuple(sorted(self.parameters.items())),
            self.silent_after_s,
        )  # fmt: skip
