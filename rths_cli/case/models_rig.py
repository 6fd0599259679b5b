"""Rig files: what a laboratory knows of its table, and the hidden physics of a virtual one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails

from rths_cli.case.fields import Problem, Range, Strict, number, refusal, shown
from rths_cli.case.virtual_physics import AfterIdentification, VirtualPhysics

Stroke = Annotated[float, Range(gt=0, le=10)]
Velocity = Annotated[float, Range(gt=0, le=100)]
Acceleration = Annotated[float, Range(gt=0, le=1000)]
Force = Annotated[float, Range(gt=0, le=1e8)]


class SensorsSpec(Strict):
    """Hold the accelerometers of table and floors; 0 switches a corner or the noise off."""

    sensitivity_mv_per_g: Annotated[float, Range(gt=0, le=1e6)] = 1000.0
    range_g: Annotated[float, Range(gt=0, le=1e4)] = 5.0
    high_pass_hz: Annotated[float, Range(ge=0, le=100)] = 0.024
    low_pass_hz: Annotated[float, Range(ge=0, le=1e6)] = 1549.0
    noise_rms_m_s2: Annotated[float, Range(ge=0, le=100)] = 3e-4

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        low, high = number(data, "high_pass_hz"), number(data, "low_pass_hz")
        if low and high and high <= low:
            yield ("low_pass_hz",), f"must be > high_pass_hz = {low:g} or 0 (off), got {high:g}"


class ConvertersSpec(Strict):
    """Hold the converters of command and sensors; `bits: 0` is an ideal converter."""

    bits: Annotated[int, Range(ge=2, le=32, or_zero=True)] = 16
    range_v: Annotated[float, Range(gt=0, le=1000)] = 10.0
    latency_samples: Annotated[int, Range(ge=0, le=100)] = 1


class LimitsSpec(Strict):
    """Hold the limits the guard keeps: displacement from the centre, velocity, acceleration, force."""

    stroke_m: Stroke = 0.079
    velocity_m_s: Velocity = 1.0
    acceleration_m_s2: Acceleration = 45.0
    force_n: Force = 445.0

    def tightened(self, overrides: LimitOverrides) -> LimitsSpec:
        """Return these limits with the given ones in their place; that they are stricter, the case checks."""
        return self.model_copy(update=overrides.model_dump(exclude_none=True))


class LimitOverrides(Strict):
    """Hold the limits a case sets below its rig's; None leaves the rig's."""

    stroke_m: Stroke | None = None
    velocity_m_s: Velocity | None = None
    acceleration_m_s2: Acceleration | None = None
    force_n: Force | None = None


class NominalSpec(Strict):
    """Hold the data-sheet values of a table."""

    gain_m_per_v: Annotated[float, Range(gt=0, le=10)] = 0.0079
    moving_mass_kg: Annotated[float, Range(gt=0, le=1e5)] = 7.0
    payload_kg: Annotated[float, Range(gt=0, le=1e6)] = 23.0


class RigSpec(Strict):
    """Hold one shake table; defaults are the APS 400 of the paper."""

    wanted: ClassVar[str] = "a name or a mapping"

    name: str = Field(default="inline", description="label in tables; default: the file's name")
    kind: Literal["virtual"]
    sensors: SensorsSpec = SensorsSpec()
    converters: ConvertersSpec = ConvertersSpec()
    limits: LimitsSpec = LimitsSpec()
    nominal: NominalSpec = NominalSpec()
    physics: VirtualPhysics = VirtualPhysics()
    after_identification: AfterIdentification = AfterIdentification()

    @model_validator(mode="before")
    @classmethod
    def _virtual_only(cls, data: Any) -> Any:
        """Refuse other kinds in one sentence; their further keys are unknown here and need no fault each."""
        kind = data.get("kind", "virtual") if isinstance(data, Mapping) else "virtual"
        if kind != "virtual":
            fault = refusal(f"this version has only virtual rigs, got {shown(kind)}; write kind: virtual")
            detail = InitErrorDetails(type=fault, loc=("kind",), input=kind)
            raise ValidationError.from_exception_data(cls.__name__, [detail])
        return data
