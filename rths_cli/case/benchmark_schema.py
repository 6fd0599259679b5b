"""Every key of a benchmark file: a test that every compensator is put to, with its plant, cases and scatter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from rths_cli.case.field_types import Problem, Range, Strict, count, listed
from rths_cli.case.virtual_physics_schema import ActuatorNumbers, Positive

Scatter = Annotated[float, Range(ge=0, le=1e9)]
MOST_PLANTS = 100_000


class BenchmarkCase(Strict):
    """Hold the mass of every floor and the damping ratio of every mode of one case."""

    name: str = Field(description="how it is named in tables and by --case")
    floor_mass_kg: Annotated[float, Range(gt=0, le=1e9)] = Field(description="mass of every floor")
    damping_ratio: Annotated[float, Range(ge=0, lt=1)] = Field(description="damping ratio of every mode")


class BenchmarkSpecimen(Strict):
    """Hold the specimen on the actuator, one degree of freedom."""

    mass_kg: Positive = Field(description="its mass")
    stiffness_n_per_m: Positive = Field(description="its stiffness")
    damping_ratio: Annotated[float, Range(ge=0, lt=1)] = Field(description="its damping ratio")


class PlantScatter(Strict):
    """Hold the standard deviations of a perturbed plant."""

    oil_column_rad_s: Scatter = Field(default=0.0, description="of a_3")
    valve_damping_rad_s: Scatter = Field(default=0.0, description="of beta_1")
    valve_stiffness_rad2_s2: Scatter = Field(default=0.0, description="of beta_2")
    stiffness_n_per_m: Scatter = Field(default=0.0, description="of the specimen's stiffness")


class Quantisation(Strict):
    """Hold the converters of the loop."""

    quantum: Annotated[float, Range(ge=0, le=1)] = Field(description="step in the signal's SI unit; 0: none")
    range: Positive = Field(description="largest displacement and command in m")


class NoiseDensities(Strict):
    """Hold the noise of the sensors."""

    displacement_psd: Annotated[float, Range(ge=0, le=1)] = Field(description="in m^2 s")
    force_psd: Annotated[float, Range(ge=0, le=1e9)] = Field(description="in N^2 s")


class PlantChange(Strict):
    """Hold what changes during the test, at one instant."""

    at_s: Positive = Field(description="when")
    specimen_stiffness_factor: Annotated[float, Range(gt=0, le=10)] = Field(
        default=1.0, description="of the specimen's stiffness"
    )
    command_gain_factor: Annotated[float, Range(gt=0, le=10)] = Field(default=1.0, description="of the actuator's gain")
    latency_samples: Annotated[int, Range(ge=0, le=50)] = Field(
        default=0, description="by how many samples commands arrive later"
    )


class BenchmarkCompensator(Strict):
    """Hold a compensator of the table; its options, numbers, stand beside `kind`."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]

    kind: str = Field(description="a compensator of rths or of an installed package, none, or own with a file")
    name: str | None = Field(default=None, description="how it is named in tables; default: its kind")
    file: Path | None = Field(default=None, description="kind own: a Python file, whose code is run")
    sha256: str | None = Field(default=None, description="checksum of that file; default: as it is found")
    frozen: bool = Field(default=False, description="whether the parameters of a law that adapts stay at their start")
    predict_force: bool = Field(
        default=False, description="whether the storeys get the force predicted by the identified specimen"
    )
    lead_samples: Annotated[int, Range(ge=0, le=200)] = Field(
        default=0, description="loop table: by how many samples the desired motion that it is given is ahead"
    )

    @property
    def options(self) -> dict[str, float]:
        """Return the options by name, as stated."""
        return dict(self.__pydantic_extra__ or {})

    @property
    def label(self) -> str:
        """Return how it is named in tables."""
        return self.name or (self.file.stem if self.file else self.kind)


class AnyBenchmark(Strict):
    """Hold what every benchmark has; `loop` names what plays it."""

    name: str = Field(default="inline", description="default: the file's name")
    heading: str = Field(description="heads the table")
    published_in: str = Field(description="where it is published")
    loop: Literal["displacement", "table"] = Field(
        description="the loop that plays it: an actuator that tracks displacement, or the cases of a virtual table"
    )
    plants: Annotated[int, Range(ge=1, le=MOST_PLANTS)] = Field(default=20, description="how many, the nominal one too")
    compensators: tuple[BenchmarkCompensator, ...] = Field(min_length=1, description="those of the table")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        for key in ("cases", "compensators"):
            names = [_name(one) for one in listed(data, key) or ()]
            if repeated := sorted({name for name in names if names.count(name) > 1}):
                yield (key,), f"has {', '.join(repeated)} more than once; give each a name of its own"


class BenchmarkSpec(AnyBenchmark):
    """Hold a benchmark whose actuator tracks displacement."""

    ground_motion: str = Field(description="ground motion, a name or a path")
    ground_motion_factor: Annotated[float, Range(gt=0, le=100)] = Field(description="factor of the record")
    sample_rate_hz: Annotated[float, Range(ge=100, le=20_000)] = Field(description="rate of the loop")
    stiffness_n_per_m: tuple[tuple[float, ...], ...] = Field(min_length=1, description="matrix, the interface first")
    cases: tuple[BenchmarkCase, ...] = Field(min_length=1, description="cases of the table")
    specimen: BenchmarkSpecimen = Field(description="what stands on the actuator")
    actuator: ActuatorNumbers = Field(description="the nominal plant")
    scatter: PlantScatter = Field(default=PlantScatter(), description="normal scatter of perturbed plants")
    quantisation: Quantisation = Field(description="A/D and D/A")
    noise: NoiseDensities = Field(description="of the sensors")
    identified_band_hz: tuple[float, float] = Field(description="band over which the lag of the plant is averaged")
    change: PlantChange | None = Field(
        default=None, description="what changes during the test; figures are those from a second after it"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        rows = listed(data, "stiffness_n_per_m") or ()
        if any(count({"row": row}, "row") not in (None, len(rows)) for row in rows):
            yield ("stiffness_n_per_m",), f"must be a square matrix, {len(rows)} rows of as many numbers"
        yield from super().problems(data)


class TableCase(Strict):
    """Hold a case of a virtual table: a case file, with settings."""

    name: str = Field(description="how it is named in tables and by --case")
    case: str = Field(description="a case, a name or a path; its controller is replaced by each compensator")
    settings: tuple[str, ...] = Field(default=(), description="KEY=VALUE, as --set takes them")


class TableBenchmarkSpec(AnyBenchmark):
    """Hold a benchmark of cases on virtual tables; plant i is played with the seed i, of its laboratory and noise."""

    cases: tuple[TableCase, ...] = Field(min_length=1, description="cases of the table")


def _name(one: Any) -> str:
    given = one if isinstance(one, Mapping) else {}
    return str(given.get("name") or given.get("kind"))
