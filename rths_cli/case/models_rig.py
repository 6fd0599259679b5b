"""Rig files: what every laboratory states of its table, and the hidden physics of a virtual one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from rths_cli.case.fields import Problem, Range, Strict, number
from rths_cli.case.virtual_physics import AfterIdentification, VirtualPhysics

Stroke = Annotated[float, Range(gt=0, le=10)]
Velocity = Annotated[float, Range(gt=0, le=100)]
Acceleration = Annotated[float, Range(gt=0, le=1000)]
Force = Annotated[float, Range(gt=0, le=1e8)]
CommandRate = Annotated[float, Range(gt=0, le=1e7)]
EnergyRatio = Annotated[float, Range(gt=0, le=100)]
LostSamples = Annotated[int, Range(ge=1, le=1000)]
DEFAULT_LOST_SAMPLES = 5
DEFAULT_ENERGY_RATIO = 0.1  # of real rigs: accurate tests stay below 0.005, unstable ones pass it early
Corner = Annotated[float, Range(ge=0, le=1e6)]


def corner_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield a fault when a sensor's low pass lies below its high pass."""
    low, high = number(data, "high_pass_hz"), number(data, "low_pass_hz")
    if low and high and high <= low:
        yield ("low_pass_hz",), f"must be > high_pass_hz = {low:g} or 0 (off), got {high:g}"


class SensorKeys(Strict):
    """Hold what is stated of accelerometers, of whatever rig."""

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from corner_problems(data)


class SensorsSpec(SensorKeys):
    """Hold the accelerometers of a virtual table and its floors; 0 switches a corner or the noise off."""

    sensitivity_mv_per_g: Annotated[float, Range(gt=0, le=1e6)] = 1000.0
    range_g: Annotated[float, Range(gt=0, le=1e4)] = 5.0
    high_pass_hz: Annotated[float, Range(ge=0, le=100)] = 0.024
    low_pass_hz: Corner = 1549.0
    noise_rms_m_s2: Annotated[float, Range(ge=0, le=100)] = 3e-4


class ConvertersSpec(Strict):
    """Hold the converters of command and sensors; `bits: 0` is an ideal converter."""

    bits: Annotated[int, Range(ge=2, le=32, or_zero=True)] = 16
    range_v: Annotated[float, Range(gt=0, le=1000)] = 10.0
    latency_samples: Annotated[int, Range(ge=0, le=100)] = 1


class LimitsSpec(Strict):
    """Hold the limits the guard keeps: displacement from the centre, velocity, acceleration, force, and what further
    ones are stated."""

    stroke_m: Stroke = 0.079
    velocity_m_s: Velocity = 1.0
    acceleration_m_s2: Acceleration = 45.0
    force_n: Force = 445.0
    command_rate_v_s: CommandRate | None = Field(default=None, description="change of the command in V/s")
    tracking_error_m_s2: Acceleration | None = Field(
        default=None, description="desired less measured acceleration of the table"
    )
    lost_samples: LostSamples | None = Field(
        default=None, description=f"how many answers of the rig in a row may be lost; default: {DEFAULT_LOST_SAMPLES}"
    )
    energy_ratio: EnergyRatio | None = Field(
        default=None, description="energy that errors of the table may add, of that exchanged with the specimen"
    )

    def tightened(self, overrides: LimitOverrides) -> Self:
        """Return these limits with the given ones in their place; that they are stricter, the case checks."""
        return self.model_copy(update=overrides.model_dump(exclude_none=True))


class LimitOverrides(Strict):
    """Hold the limits a case sets below its rig's; None leaves the rig's."""

    stroke_m: Stroke | None = None
    velocity_m_s: Velocity | None = None
    acceleration_m_s2: Acceleration | None = None
    force_n: Force | None = None
    command_rate_v_s: CommandRate | None = None
    tracking_error_m_s2: Acceleration | None = None
    lost_samples: LostSamples | None = None
    energy_ratio: EnergyRatio | None = None


class NominalSpec(Strict):
    """Hold the data-sheet values of a table."""

    gain_m_per_v: Annotated[float, Range(gt=0, le=10)] = 0.0079
    moving_mass_kg: Annotated[float, Range(gt=0, le=1e5)] = 7.0
    payload_kg: Annotated[float, Range(gt=0, le=1e6)] = 23.0


class RigSpec(Strict):
    """Hold what the file of every shake table states; each kind of rig adds its own keys."""

    wanted: ClassVar[str] = "a name or a mapping"

    name: str = Field(default="inline", description="label in tables; default: the file's name")
    kind: str
    sensors: SensorKeys | None = None
    converters: ConvertersSpec = ConvertersSpec()
    limits: LimitsSpec = LimitsSpec()
    nominal: NominalSpec = NominalSpec()


class VirtualRigSpec(RigSpec):
    """Hold one virtual shake table; defaults are the APS 400 of the paper."""

    elsewhere: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("channels", "unattended", "watchdog_s", "overrun", "model", "udp", "ni", "options"),
        "belongs to a real rig; remove it, or state the rig's kind",
    )

    kind: Literal["virtual"]
    sensors: SensorsSpec = SensorsSpec()
    physics: VirtualPhysics = VirtualPhysics()
    after_identification: AfterIdentification = AfterIdentification()
