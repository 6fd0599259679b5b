"""Keys of a virtual rig's hidden imperfections; only rigs/virtual/ may read them. A key that is 0 or absent is off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from pydantic import (
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
)
from pydantic_core import CoreSchema, core_schema

from rths_cli.case.field_types import Range, Strict, refusal

LARGEST_DRAW = 4.0  # standard deviations within which values are drawn


class Values(Strict):
    """Hold one value for all places, one for each place, or a normal distribution from which each is drawn."""

    wanted: ClassVar[str] = "a number, a list of numbers, or a mapping of mean and std"

    mean: tuple[float, ...] = Field(default=(0.0,), min_length=1, description="exact value, or mean of the draws")
    std: Annotated[float, Range(ge=0)] = Field(default=0.0, description="standard deviation of the draws; 0: exact")

    @property
    def off(self) -> bool:
        """Return whether every value is exactly zero."""
        return self.std == 0.0 and not any(self.mean)

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> Any:
        """Write values as a file states them."""
        data: dict[str, Any] = write(self)
        mean = data["mean"][0] if len(self.mean) == 1 else data["mean"]
        return {"mean": mean, "std": self.std} if self.std else mean


@dataclass(frozen=True)
class Each(Range):
    """Annotation of values: the range of each, and of what may be drawn."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        checked = core_schema.no_info_after_validator_function(self._checked, handler(source))
        return core_schema.no_info_before_validator_function(_as_mapping, checked)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        limits = {"exclusiveMinimum": self.gt, "minimum": self.ge, "exclusiveMaximum": self.lt, "maximum": self.le}
        stated = {"type": "number", **{key: limit for key, limit in limits.items() if limit is not None}}
        one: dict[str, Any] = {"anyOf": [{"const": 0}, stated]} if self.or_zero else stated
        listed = {"type": "array", "minItems": 1, "items": one}
        drawn = {
            "type": "object",
            "additionalProperties": False,
            "properties": {"mean": {"anyOf": [one, listed]}, "std": {"type": "number", "minimum": 0}},
        }
        return {"anyOf": [one, listed, drawn]}

    def _checked(self, values: Values) -> Values:
        for mean in values.mean:
            for value in (mean, mean - LARGEST_DRAW * values.std, mean + LARGEST_DRAW * values.std):
                if not self.holds(value):
                    drawn = f" (mean {mean:g}, std {values.std:g}, drawn within {LARGEST_DRAW:g} std)"
                    raise refusal(f"must be {self}, got {value:.10g}{drawn if values.std else ''}")
        return values


def _as_mapping(data: Any) -> Any:
    """Return a number or a list as the mapping of exact values."""
    if isinstance(data, Mapping):
        mean = data.get("mean")
        return {**data, "mean": (mean,)} if isinstance(mean, int | float) and not isinstance(mean, bool) else data
    if isinstance(data, list | tuple):
        return {"mean": tuple(data)}
    return {"mean": (data,)} if isinstance(data, int | float) and not isinstance(data, bool) else data


NONE = Values()
Ratio = Annotated[Values, Each(gt=-0.5, lt=1)]


class Imperfection(Strict):
    """Hold the keys of one part of the laboratory."""

    @property
    def off(self) -> bool:
        """Return whether every imperfection of the part is off."""
        return all(value.off for value in (getattr(self, name) for name in self.switches()))

    @classmethod
    def switches(cls) -> tuple[str, ...]:
        """Return the names of the keys that switch something on; further keys only shape it."""
        return tuple(name for name, field in cls.model_fields.items() if field.default == NONE)


class ChannelImperfections(Imperfection):
    """Hold what sensors and their conditioning do beside what the rig file declares; a list has an entry per channel,
    the table's first."""

    gain_error: Ratio = Field(default=NONE, description="true over declared sensitivity, less 1")
    high_pass_error: Ratio = Field(default=NONE, description="true over declared corner of the AC coupling, less 1")
    low_pass_error: Ratio = Field(default=NONE, description="true over declared corner of the low pass, less 1")
    skew_s: Annotated[Values, Each(ge=-1e-3, le=1e-3)] = Field(
        default=NONE, description="by how much the channel is sampled after its clock"
    )
    offset_v: Annotated[Values, Each(ge=-10, le=10)] = Field(default=NONE, description="zero of the conditioning")
    transverse_sensitivity: Annotated[Values, Each(ge=-1, le=1)] = Field(
        default=NONE, description="of accelerometers: sensitivity across over that along the axis"
    )
    hum_v: Annotated[Values, Each(ge=-10, le=10)] = Field(
        default=NONE, description="amplitude of the mains' hum; its phase is drawn for each run"
    )
    hum_hz: Annotated[float, Range(gt=0, le=1000)] = Field(default=50.0, description="frequency of the mains")
    offset_walk_v_per_sqrt_s: Annotated[Values, Each(ge=0, le=1, or_zero=True)] = Field(
        default=NONE, description="drift within a run: standard deviation of the zero's random walk after 1 s"
    )
    gain_change_between_runs: Ratio = Field(
        default=NONE, description="drift between runs: further gain error, drawn for each run"
    )


class ConverterImperfections(Imperfection):
    """Hold when the converters act, against their common clock."""

    command_skew_s: Annotated[Values, Each(ge=-1e-3, le=1e-3)] = Field(
        default=NONE,
        description="by how much the command changes after its clock, on a rig with latency within 0.45 of a sample "
        "interval",
    )
    command_jitter_s: Annotated[Values, Each(ge=0, le=1e-3)] = Field(
        default=NONE, description="standard deviation of that instant"
    )
    sample_jitter_s: Annotated[Values, Each(ge=0, le=1e-3)] = Field(
        default=NONE, description="standard deviation of the sampling instant, common to all channels"
    )


class MassImperfections(Imperfection):
    """Hold what weighing got wrong."""

    weighing_error: Ratio = Field(default=NONE, description="true over declared mass of each floor, less 1")


class DeckImperfections(Imperfection):
    """Hold the deck that stands on the coil by a spring; the displacement loop is closed on the coil."""

    frequency_hz: Annotated[Values, Each(ge=5, le=2000, or_zero=True)] = Field(
        default=NONE, description="of the deck without specimen, the coil held; 0: deck and coil are one mass"
    )
    coil_mass_kg: Annotated[float, Range(gt=0, le=1e5)] = Field(
        default=1.5, description="part of physics.moving_mass_kg that is the coil's"
    )
    damping_ratio: Annotated[float, Range(ge=0, le=1)] = Field(default=0.02, description="of that deck, the coil held")


class AmplifierImperfections(Imperfection):
    """Hold what the amplifier does to command and force."""

    crossover_n: Annotated[Values, Each(ge=0, le=1e6)] = Field(
        default=NONE, description="d of F_ref abs(F_ref) / (abs(F_ref) + d)"
    )
    distortion: Annotated[Values, Each(ge=-0.5, le=0.5)] = Field(
        default=NONE, description="cubic distortion of the command: share at distortion_at_v"
    )
    distortion_at_v: Annotated[float, Range(gt=0, le=1000)] = Field(default=3.0, description="command of that share")
    gain_drift_per_s: Annotated[Values, Each(ge=-1, le=1)] = Field(
        default=NONE, description="relative change of the command's gain per second of each run"
    )


class FrictionImperfections(Imperfection):
    """Hold friction beyond Coulomb's, whose force is physics.coulomb_n."""

    presliding_m: Annotated[Values, Each(ge=1e-6, le=0.1, or_zero=True)] = Field(
        default=NONE, description="coulomb_n over the bristles' stiffness: LuGre's law in place of tanh(v / v_s)"
    )
    bristle_damping_n_s_per_m: Annotated[float, Range(ge=0, le=1e5)] = Field(
        default=0.0, description="sigma_1 of LuGre's law; 0 and no excess: Dahl's law"
    )
    stribeck_excess: Annotated[Values, Each(ge=0, le=20)] = Field(
        default=NONE, description="static over Coulomb friction, less 1"
    )
    stribeck_velocity_m_s: Annotated[float, Range(gt=0, le=10)] = Field(
        default=0.005, description="velocity over which that excess falls"
    )


class SuspensionImperfections(Imperfection):
    """Hold the springs that keep the table in its middle."""

    stiffness_n_per_m: Annotated[Values, Each(ge=0, le=1e9)] = Field(default=NONE, description="at the middle")
    cubic_n_per_m3: Annotated[Values, Each(ge=0, le=1e15)] = Field(default=NONE, description="their hardening")


class ForceFactorImperfections(Imperfection):
    """Hold how the force of the coil falls away from the middle: 1 - drop (x / at_m)^2."""

    drop: Annotated[Values, Each(ge=0, le=0.9)] = Field(default=NONE, description="share that is lost at at_m")
    at_m: Annotated[float, Range(gt=0, le=10)] = Field(default=0.079, description="stroke of that drop")


class PitchImperfections(Imperfection):
    """Hold how table and specimen pitch: I th'' + c th' + k th = -sum h m a + moment of the weights."""

    frequency_hz: Annotated[Values, Each(ge=5, le=2000, or_zero=True)] = Field(
        default=NONE, description="of pitch, the specimen rigid; 0: none"
    )
    damping_ratio: Annotated[float, Range(ge=0, le=1)] = Field(default=0.03, description="of that motion")
    inertia_kg_m2: Annotated[float, Range(gt=0, le=1e6)] = Field(
        default=3.0, description="rotary inertia of the table about the axis of pitch, without m h^2 of the floors"
    )
    storey_height_m: Annotated[Values, Each(ge=0, le=100)] = Field(
        default=Values(mean=(0.2,)), description="height of each storey on the table; the axis is at the table's drive"
    )
    sensor_arm_m: Annotated[float, Range(ge=-10, le=10)] = Field(
        default=0.1, description="of the accelerometers from the axis along the table: th'' times it is vertical"
    )


class GuideImperfections(Imperfection):
    """Hold what the guides let through."""

    lateral_share: Annotated[Values, Each(ge=-1, le=1)] = Field(
        default=NONE, description="acceleration across over that along the table, of every accelerometer"
    )


class SpecimenImperfections(Imperfection):
    """Hold what the storeys on the table do beside k u; a list has an entry per storey, from the table."""

    softening: Annotated[Values, Each(ge=0, lt=1)] = Field(
        default=NONE, description="a of k u (1 - a abs(u) / (abs(u) + softening_drift_m))"
    )
    softening_drift_m: Annotated[float, Range(gt=0, le=1)] = Field(
        default=0.001, description="drift at which half of the softening has come"
    )
    joint_friction_n: Annotated[Values, Each(ge=0, le=1e6)] = Field(
        default=NONE, description="friction of the joints of each storey"
    )
    joint_sticking_m: Annotated[float, Range(gt=0, le=1)] = Field(
        default=5e-5, description="drift of the spring by which joints stick until they slide"
    )


class VirtualImperfections(Strict):
    """Hold how a virtual laboratory differs from what its files declare; nobody but the rig knows of it."""

    laboratory: Annotated[int, Range(ge=0, le=2**31 - 1)] | None = Field(
        default=None, description="number of the laboratory, from which values are drawn; default: the seed of the case"
    )
    channels: ChannelImperfections = Field(default=ChannelImperfections(), description="sensors and their conditioning")
    converters: ConverterImperfections = Field(default=ConverterImperfections(), description="instants of converters")
    masses: MassImperfections = Field(default=MassImperfections(), description="masses of the floors on the table")
    deck: DeckImperfections = Field(default=DeckImperfections(), description="a deck on a flexible drive")
    amplifier: AmplifierImperfections = Field(default=AmplifierImperfections(), description="amplifier of the drive")
    friction: FrictionImperfections = Field(default=FrictionImperfections(), description="presliding and Stribeck")
    suspension: SuspensionImperfections = Field(default=SuspensionImperfections(), description="springs of the table")
    force_factor: ForceFactorImperfections = Field(
        default=ForceFactorImperfections(), description="force of the coil over the stroke"
    )
    pitch: PitchImperfections = Field(default=PitchImperfections(), description="pitch of table and specimen")
    guides: GuideImperfections = Field(default=GuideImperfections(), description="guides of the table")
    specimen: SpecimenImperfections = Field(default=SpecimenImperfections(), description="storeys on the table")

    @property
    def off(self) -> bool:
        """Return whether the laboratory is as declared."""
        return all(part.off for _, part in self.parts())

    def parts(self) -> Iterator[tuple[str, Imperfection]]:
        """Yield the parts of the laboratory by their keys."""
        for name in type(self).model_fields:
            part = getattr(self, name)
            if isinstance(part, Imperfection):
                yield name, part


class ActuatorImperfections(Strict):
    """Hold how a virtual actuator and its specimen differ from what their files declare; off by default."""

    laboratory: Annotated[int, Range(ge=0, le=2**32 - 1)] | None = Field(
        default=None, description="number from which values are drawn; default: the seed of the case"
    )
    displacement_gain_error: Ratio = Field(default=NONE, description="true over declared sensitivity, less 1")
    force_gain_error: Ratio = Field(default=NONE, description="true over declared sensitivity of the load cell, less 1")
    stiffness_error: Ratio = Field(default=NONE, description="true over declared stiffness of the specimen, less 1")
    damping_error: Ratio = Field(default=NONE, description="true over declared dashpot of the specimen, less 1")
    oil_column_rad_s: Annotated[Values, Each(ge=-1e6, le=1e6)] = Field(default=NONE, description="added to a_3")
    valve_damping_error: Ratio = Field(default=NONE, description="true beta_1 over that of physics, less 1")
    valve_stiffness_error: Ratio = Field(default=NONE, description="true beta_2 over that of physics, less 1")

    @property
    def drawn(self) -> dict[str, Values]:
        """Return the values by key."""
        return {name: value for name in type(self).model_fields if isinstance(value := getattr(self, name), Values)}

    @property
    def off(self) -> bool:
        """Return whether every imperfection is off."""
        return all(value.off for value in self.drawn.values())
