"""Every key of a rig file, virtual or real, with its unit, range and description."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_serializer,
)
from pydantic_core import InitErrorDetails

from rths_cli.case.calibration_schema import CalibrationSpec
from rths_cli.case.field_types import Problem, Range, Strict, entry, exactly_one, listed, near, number, refusal, shown
from rths_cli.case.further_channel_schema import DEFAULT_UNCERTAINTY, FurtherChannelSpec, Relative, corner_problems
from rths_cli.case.plugin_interface import GROUP, plugin_kinds
from rths_cli.case.rig_capabilities import DEFAULT_KIND
from rths_cli.case.virtual_imperfections_schema import ActuatorImperfections, VirtualImperfections
from rths_cli.case.virtual_physics_schema import AfterIdentification, ServoHydraulicPhysics, VirtualPhysics
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2

Stroke = Annotated[float, Range(gt=0, le=10)]
Velocity = Annotated[float, Range(gt=0, le=100)]
Acceleration = Annotated[float, Range(gt=0, le=1000)]
Force = Annotated[float, Range(gt=0, le=1e8)]
CommandRate = Annotated[float, Range(gt=0, le=1e7)]
EnergyRatio = Annotated[float, Range(gt=0, le=100)]
MOST_CHANNELS = 62  # of a packet: 48 bytes and 8 for each, in one datagram of the smallest size that all networks carry
LostSamples = Annotated[int, Range(ge=1, le=1000)]
DEFAULT_LOST_SAMPLES = 5
DEFAULT_ENERGY_RATIO = 0.1  # of real rigs: accurate tests stay below 0.005, unstable ones pass it early
Corner = Annotated[float, Range(ge=0, le=1e6)]

SENSITIVITY = "sensitivity of every channel"
UNCERTAINTY = f"of the sensitivity, relative, one standard deviation; default: {DEFAULT_UNCERTAINTY}"
FURTHER = "channels beside the accelerometers of table and floors, each with its kind"
CLIPS = "+-, beyond which the sensor clips"
HIGH_PASS = "first-order corner of AC coupling; 0: none"
LOW_PASS = "first-order corner; 0: none"
BITS = "resolution; 0: ideal"
RANGE = "+-, of command and samples"
LATENCY = "intervals from samples to the command computed from them"
GAIN = "displacement per command at low frequency"
MOVING_MASS = "armature and table, without specimen"
PAYLOAD = "heaviest specimen"
KIND = "what the rig is; decides which keys there are"
SENSORS = "accelerometers on table and floors"
CONVERTERS = "converters of command and samples"
LIMITS = "what the guard keeps"
NOMINAL = "values of the data sheet"
STROKE = "displacement from the centre, +-, with room to brake"
VELOCITY = "velocity of the table, +-"
ACCELERATION = "acceleration of every channel, +-"
FORCE = "force of the actuator, +-, estimated from accelerations and masses"
COMMAND_RATE = "change of the command per second"
TRACKING_ERROR = "desired less measured acceleration of the table, +-"
LOST_SAMPLES = f"how many answers of the rig in a row may be lost; default: {DEFAULT_LOST_SAMPLES}"
CALIBRATION = (
    "file of a calibration (rths calibrate), relative to this file; what it found takes the place of sensitivities and "
    "uncertainties here"
)
ENERGY_RATIO = (
    "energy that errors of the table may add, of that exchanged with the specimen; "
    f"default of a real rig: {DEFAULT_ENERGY_RATIO}"
)


class SensorKeys(Strict):
    """Hold what is stated of accelerometers, of whatever rig."""

    sensitivity_uncertainty: Relative | None = Field(default=None, description=UNCERTAINTY)

    @property
    def uncertainty(self) -> float:
        """Return the relative standard uncertainty of the sensitivity."""
        return DEFAULT_UNCERTAINTY if self.sensitivity_uncertainty is None else self.sensitivity_uncertainty

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from corner_problems(data)


class SensorsSpec(SensorKeys):
    """Hold the accelerometers of a virtual table and its floors; 0 switches a corner or the noise off."""

    sensitivity_uncertainty: Relative = Field(default=0.0, description=f"{UNCERTAINTY}; default: 0, as declared")
    sensitivity_mv_per_g: Annotated[float, Range(gt=0, le=1e6)] = Field(default=1000.0, description=SENSITIVITY)
    range_g: Annotated[float, Range(gt=0, le=1e4)] = Field(default=5.0, description=CLIPS)
    high_pass_hz: Annotated[float, Range(ge=0, le=100)] = Field(default=0.024, description=HIGH_PASS)
    low_pass_hz: Corner = Field(default=1549.0, description=LOW_PASS)
    noise_rms_m_s2: Annotated[float, Range(ge=0, le=100)] = Field(
        default=3e-4, description="white noise per sample; 0: none"
    )


class ConvertersSpec(Strict):
    """Hold the converters of command and sensors; `bits: 0` is an ideal converter."""

    bits: Annotated[int, Range(ge=2, le=32, or_zero=True)] = Field(default=16, description=BITS)
    range_v: Annotated[float, Range(gt=0, le=1000)] = Field(default=10.0, description=RANGE)
    latency_samples: Annotated[int, Range(ge=0, le=100)] = Field(default=1, description=LATENCY)


class LimitsSpec(Strict):
    """Hold the limits the guard keeps: displacement from the centre, velocity, acceleration, force, and what further
    ones are stated."""

    stroke_m: Stroke = Field(default=0.079, description=STROKE)
    velocity_m_s: Velocity = Field(default=1.0, description=VELOCITY)
    acceleration_m_s2: Acceleration = Field(default=45.0, description=ACCELERATION)
    force_n: Force = Field(default=445.0, description=FORCE)
    command_rate_v_s: CommandRate | None = Field(default=None, description=COMMAND_RATE)
    tracking_error_m_s2: Acceleration | None = Field(default=None, description=TRACKING_ERROR)
    lost_samples: LostSamples | None = Field(default=None, description=LOST_SAMPLES)
    energy_ratio: EnergyRatio | None = Field(default=None, description=ENERGY_RATIO)

    def tightened(self, overrides: LimitOverrides) -> Self:
        """Return these limits with the given ones in their place; that they are stricter, the case checks."""
        return self.model_copy(update=overrides.model_dump(exclude_none=True))


class LimitOverrides(Strict):
    """Hold the limits a case sets below its rig's; None leaves the rig's."""

    stroke_m: Stroke | None = Field(default=None, description=STROKE)
    velocity_m_s: Velocity | None = Field(default=None, description=VELOCITY)
    acceleration_m_s2: Acceleration | None = Field(default=None, description=ACCELERATION)
    force_n: Force | None = Field(default=None, description=FORCE)
    command_rate_v_s: CommandRate | None = Field(default=None, description=COMMAND_RATE)
    tracking_error_m_s2: Acceleration | None = Field(default=None, description=TRACKING_ERROR)
    lost_samples: LostSamples | None = Field(default=None, description=LOST_SAMPLES)
    energy_ratio: EnergyRatio | None = Field(default=None, description=ENERGY_RATIO)


class NominalSpec(Strict):
    """Hold the data-sheet values of a table."""

    gain_m_per_v: Annotated[float, Range(gt=0, le=10)] = Field(default=0.0079, description=GAIN)
    moving_mass_kg: Annotated[float, Range(gt=0, le=1e5)] = Field(default=7.0, description=MOVING_MASS)
    payload_kg: Annotated[float, Range(gt=0, le=1e6)] = Field(default=23.0, description=PAYLOAD)


TABLE_GAIN = (
    "of the table's gain, relative, from the verification before a test to its end; a loop must tolerate three, and "
    "where the verification is coarse two in any direction (from 1 to 6 %)"
)


class UncertaintySpec(Strict):
    """Hold standard uncertainties of what is declared, beside those of sensitivities; 0: exactly as declared."""

    corner: Annotated[float, Range(ge=0, le=0.5)] = Field(
        default=0.1, description="of the corner of an AC coupling, relative"
    )
    skew_s: Annotated[float, Range(ge=0, le=1e-3)] = Field(
        default=25e-6, description="of the instant at which a channel is sampled, its low pass included"
    )
    mass: Annotated[float, Range(ge=0, le=0.1)] = Field(default=0.003, description="of a weighed floor mass, relative")
    drift: Annotated[float, Range(ge=0, le=0.1)] = Field(
        default=0.0005, description="of a sensitivity, relative, from the identification to the test"
    )
    specimen: Annotated[float, Range(ge=0, le=0.5)] = Field(
        default=0.005, description="of the specimen's stiffness, relative, from the identification to the test"
    )
    table_gain: Annotated[float, Range(ge=0, le=0.1)] = Field(default=0.03, description=TABLE_GAIN)


class VirtualUncertaintySpec(UncertaintySpec):
    """Hold the uncertainties of a virtual rig, whose masses and sensitivities are as its file declares."""

    mass: Annotated[float, Range(ge=0, le=0.1)] = Field(default=0.0, description="of a weighed floor mass, relative")
    drift: Annotated[float, Range(ge=0, le=0.1)] = Field(
        default=0.0, description="of a sensitivity, relative, from the identification to the test"
    )
    table_gain: Annotated[float, Range(ge=0, le=0.1)] = Field(default=0.01, description=TABLE_GAIN)


# as virtual rigs were by default before rths 0.2; their table's gain had to be tolerated a tenth larger or smaller
CERTAIN = VirtualUncertaintySpec(corner=0.0, skew_s=0.0, table_gain=0.1 / 3.0)
DECLARED = "standard uncertainties of what is declared; what the identification shows better, it corrects"


class RigSpec(Strict):
    """Hold what the file of every shake table states; each kind of rig adds its own keys."""

    wanted: ClassVar[str] = "a name or a mapping"
    elsewhere: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("sample_rate_hz", "test_band_hz", "seed"), "belongs to the case, not to its rig"
    )

    name: str = Field(default="inline", description="label in tables; default: the file's name")
    kind: str = Field(description=KIND)
    sensors: SensorKeys | None = Field(default=None, description=SENSORS)
    converters: ConvertersSpec = Field(default=ConvertersSpec(), description=CONVERTERS)
    limits: LimitsSpec = Field(default=LimitsSpec(), description=LIMITS)
    nominal: NominalSpec = Field(default=NominalSpec(), description=NOMINAL)
    uncertainty: UncertaintySpec = Field(default=UncertaintySpec(), description=DECLARED)
    calibration: CalibrationSpec | None = Field(default=None, description=CALIBRATION)

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is not stated, so that models of older versions stay those of their rig."""
        data: dict[str, Any] = write(self)
        left_out = self.unstated()
        return {key: data[key] for key in data if key not in left_out}

    def unstated(self) -> set[str]:
        """Return the keys that are left out of the rig as it is written."""
        return {"calibration"} if self.calibration is None else set()


ONLY_REAL = "belongs to a real rig; remove it"


class VirtualRigSpec(RigSpec):
    """Hold one virtual shake table; defaults are the APS 400 of the paper."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        **RigSpec.elsewhere,
        **dict.fromkeys(
            ("unattended", "watchdog_s", "overrun", "model", "udp", "link", "clock", "ni", "options"),
            "belongs to a real rig; remove it, or state the rig's kind",
        ),
    }

    kind: Literal["virtual"] = Field(description=KIND)
    sensors: SensorsSpec = Field(default=SensorsSpec(), description=SENSORS)
    channels: tuple[FurtherChannelSpec, ...] | None = Field(
        default=None, min_length=1, max_length=MOST_CHANNELS - 2, description=FURTHER
    )
    uncertainty: VirtualUncertaintySpec = Field(default=VirtualUncertaintySpec(), description=DECLARED)
    physics: VirtualPhysics = Field(default=VirtualPhysics(), description="what only the virtual table itself knows")
    after_identification: AfterIdentification = Field(
        default=AfterIdentification(), description="what changes on the rig after it was identified; 1 changes nothing"
    )
    imperfections: VirtualImperfections = Field(
        default=VirtualImperfections(), description="how the laboratory differs from what its files declare"
    )

    def unstated(self) -> set[str]:
        """Return the keys that are left out of the rig as it is written: also imperfections that there are none of."""
        return super().unstated() | ({"imperfections"} if self.imperfections.off else set())

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        for i, channel in enumerate(listed(data, "channels") or ()):
            for key in ("high_pass_hz", "low_pass_hz"):
                if number(channel, key):
                    yield ("channels", i, key), "a virtual rig shows its further channels as they are; remove it"
            for key in ("sign", "terminal"):
                if entry(channel, key) not in (None, 1):
                    yield ("channels", i, key), ONLY_REAL


ONLY_VIRTUAL = "belongs to a virtual rig; remove it"
Sign = Annotated[int, AfterValidator(lambda value: _sign(value))]


def _sign(value: int) -> int:
    if value not in (1, -1):
        raise refusal(f"must be 1 or -1 (mounted against the positive direction), got {value}")
    return value


class RealSensorsSpec(SensorKeys):
    """Hold the accelerometers of a real rig where all are alike; a corner of 0 says that there is none."""

    elsewhere: ClassVar[Mapping[str, str]] = {"noise_rms_m_s2": ONLY_VIRTUAL}

    sensitivity_mv_per_g: Annotated[float, Range(gt=0, le=1e6)] | None = Field(default=None, description=SENSITIVITY)
    sensitivity_v_per_m_s2: Annotated[float, Range(gt=0, le=1e3)] | None = Field(
        default=None, description="instead of sensitivity_mv_per_g"
    )
    range_g: Annotated[float, Range(gt=0, le=1e4)] = Field(description=CLIPS)
    high_pass_hz: Annotated[float, Range(ge=0, le=100)] = Field(description=HIGH_PASS)
    low_pass_hz: Corner = Field(description=LOW_PASS)
    sign: Sign = Field(
        default=1,
        description="-1: mounted against the positive direction",
        json_schema_extra={"enum": [1, -1]},
    )
    warning_m_s2: Acceleration | None = Field(default=None, description="level that is shown as a warning")
    abort_m_s2: Acceleration | None = Field(default=None, description="level at which the guard stops")

    @property
    def volts_per_m_s2(self) -> float:
        """Return the sensitivity in V per m/s^2, from whichever key it is stated in."""
        if self.sensitivity_v_per_m_s2 is not None:
            return self.sensitivity_v_per_m_s2
        return float(self.sensitivity_mv_per_g or 0.0) / 1000.0 / STANDARD_GRAVITY_M_S2

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from corner_problems(data)
        yield from exactly_one(data, "sensitivity_mv_per_g", "sensitivity_v_per_m_s2")
        warning, abort, span = number(data, "warning_m_s2"), number(data, "abort_m_s2"), number(data, "range_g")
        if warning is not None and abort is not None and warning >= abort:
            yield ("warning_m_s2",), f"must be < abort_m_s2 = {abort:g}, got {warning:g}"
        if abort is not None and span is not None and abort > span * STANDARD_GRAVITY_M_S2:
            limit = f"{span * STANDARD_GRAVITY_M_S2:.4g}, the sensor's range"
            yield ("abort_m_s2",), f"must be <= {limit}, got {abort:g}; the sensor would not show it"


class ChannelSpec(RealSensorsSpec):
    """Hold one channel of a real rig: its sensor, and where it is connected."""

    sensitivity_mv_per_g: Annotated[float, Range(gt=0, le=1e6)] | None = Field(
        default=None, description="sensitivity of this channel, from its calibration"
    )
    name: str = Field(default="", max_length=60, description="label in messages, such as the sensor's serial number")
    terminal: str | None = Field(
        default=None, min_length=1, max_length=40, description="input of an NI card, such as ai0"
    )


def read_channel(data: Any, handler: ValidatorFunctionWrapHandler) -> ChannelSpec | FurtherChannelSpec:
    """Return a channel of checked or unchecked data: one that states its kind is a further one."""
    if isinstance(data, ChannelSpec | FurtherChannelSpec):
        return data
    further = isinstance(data, Mapping) and "kind" in data
    return FurtherChannelSpec.model_validate(data) if further else ChannelSpec.model_validate(data)


AnyChannel = Annotated[ChannelSpec | FurtherChannelSpec, WrapValidator(read_channel)]


class RealConvertersSpec(ConvertersSpec):
    """Hold the converters of a real rig."""

    bits: Annotated[int, Range(ge=2, le=32, or_zero=True)] = Field(description=BITS)
    range_v: Annotated[float, Range(gt=0, le=1000)] = Field(description=RANGE)
    latency_samples: Annotated[int, Range(ge=1, le=100)] = Field(default=1, description=LATENCY)


class RealLimitsSpec(LimitsSpec):
    """Hold the limits of a real rig: the four that every table has must be stated."""

    stroke_m: Stroke = Field(description=STROKE)
    velocity_m_s: Velocity = Field(description=VELOCITY)
    acceleration_m_s2: Acceleration = Field(description=ACCELERATION)
    force_n: Force = Field(description=FORCE)


class RealNominalSpec(NominalSpec):
    """Hold the data-sheet values of a real table."""

    gain_m_per_v: Annotated[float, Range(gt=0, le=10)] = Field(description=GAIN)
    moving_mass_kg: Annotated[float, Range(gt=0, le=1e5)] = Field(description=MOVING_MASS)
    payload_kg: Annotated[float, Range(gt=0, le=1e6)] = Field(description=PAYLOAD)


Watchdog = Annotated[
    float,
    Range(ge=0.001, le=10),
    Field(description="without a command for so long, the rig leads its table to rest by itself"),
]


class RealRigSpec(RigSpec):
    """Hold what the file of every rig but a virtual one states."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        **RigSpec.elsewhere,
        "physics": ONLY_VIRTUAL,
        "after_identification": ONLY_VIRTUAL,
        "udp": "belongs to kind: udp",
        "link": "belongs to kind: udp_plain or target",
        "clock": "belongs to kind: udp_plain",
        "ni": "belongs to kind: ni",
        "options": "belongs to the kind of a plug-in",
    }

    sensors: RealSensorsSpec | None = Field(default=None, description="all channels, where they are alike")
    channels: tuple[AnyChannel, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=MOST_CHANNELS,
        description="without sensors the accelerometers of table and floors, upwards; then further channels, each with "
        "its kind",
    )
    converters: RealConvertersSpec = Field(description=CONVERTERS)
    limits: RealLimitsSpec = Field(description=LIMITS)
    nominal: RealNominalSpec = Field(description=NOMINAL)
    unattended: bool = Field(default=False, description="true: --yes may move this rig with nobody asked")
    overrun: Literal["hold", "skip", "stop"] = Field(
        default="skip", description="a missed deadline: the record waits, its steps are caught up, or the run ends"
    )
    model: Path | None = Field(default=None, description="the model file of cases that name none")

    @property
    def accelerometers(self) -> tuple[RealSensorsSpec, ...]:
        """Return the listed accelerometers of table and floors; none where `sensors` stands for all."""
        return tuple(one for one in self.channels or () if isinstance(one, ChannelSpec))

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        channels = listed(data, "channels")
        own = [entry(one, "kind") is None for one in channels or ()]
        if channels is None or any(own) or data.get("sensors") is None:
            yield from exactly_one(data, "channels", "sensors")
        if channels is not None and data.get("sensors") is None and sum(own) < 2:
            yield ("channels",), "must list the accelerometers of the table and of each floor first, without kind"
        if own != sorted(own, reverse=True):
            yield (
                ("channels", own.index(False)),
                "is a further channel, but accelerometers of table or floors follow; list it after them",
            )
        for i, channel in enumerate(channels or ()):
            if entry(channel, "noise_rms") is not None:
                yield ("channels", i, "noise_rms"), ONLY_VIRTUAL


class InterfaceSpec(Strict):
    """Hold what a rig makes of the interface floor's motion, and what it returns; without it: a table that follows its
    absolute acceleration and returns accelerations, of which the base shear is made."""

    command: Literal["displacement"] = Field(description="the actuator follows the displacement relative to the ground")
    feedback: Literal["force"] = Field(description="a load cell between actuator and specimen returns the force")


class ActuatorSensorsSpec(SensorKeys):
    """Hold the displacement sensor and the load cell of an actuator."""

    sensitivity_uncertainty: Relative = Field(default=0.0, description=f"{UNCERTAINTY}; default: 0, as declared")
    displacement_range_m: Stroke = Field(description="of the displacement sensor, +-")
    displacement_v_per_m: Annotated[float, Range(gt=0, le=1e6)] = Field(description="its sensitivity")
    displacement_noise_m: Annotated[float, Range(ge=0, le=1)] = Field(default=0.0, description="white, rms per sample")
    force_range_n: Force = Field(description="of the load cell, +-")
    force_v_per_n: Annotated[float, Range(gt=0, le=1e6)] = Field(description="its sensitivity")
    force_noise_n: Annotated[float, Range(ge=0, le=1e8)] = Field(default=0.0, description="white, rms per sample")


class ActuatorLimitsSpec(RealLimitsSpec):
    """Hold the limits of an actuator."""

    elsewhere: ClassVar[Mapping[str, str]] = {"tracking_error_m_s2": "a displacement is commanded: tracking_error_m"}

    acceleration_m_s2: Acceleration = Field(description="by which the guard brakes the command, +-")
    force_n: Force = Field(description="of the load cell, +-")
    tracking_error_m: Stroke | None = Field(default=None, description="desired less measured displacement, +-")


class VirtualActuatorSpec(RigSpec):
    """Hold one virtual servo-hydraulic actuator with its load cell, kind virtual with an interface."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        **VirtualRigSpec.elsewhere,
        "channels": "an actuator has a displacement sensor and a load cell, described under sensors; remove it",
        "after_identification": "belongs to a virtual table; remove it",
        "calibration": "belongs to a table; remove it",
    }

    kind: Literal["virtual"] = Field(description=KIND)
    interface: InterfaceSpec = Field(description="what is commanded and what comes back")
    sensors: ActuatorSensorsSpec = Field(description="displacement sensor and load cell")
    limits: ActuatorLimitsSpec = Field(description=LIMITS)
    uncertainty: VirtualUncertaintySpec = Field(default=VirtualUncertaintySpec(), description=DECLARED)
    physics: ServoHydraulicPhysics = Field(description="what only the virtual actuator itself knows")
    imperfections: ActuatorImperfections = Field(
        default=ActuatorImperfections(), description="how the laboratory differs from what its files declare"
    )

    def unstated(self) -> set[str]:
        """Return the keys that are left out of the rig as it is written: also imperfections that there are none of."""
        return super().unstated() | ({"imperfections"} if self.imperfections.off else set())


class UdpSpec(Strict):
    """Hold where a target listens, and the secret shared with it."""

    host: str = Field(min_length=1, max_length=253, description="name or address")
    port: Annotated[int, Range(ge=1, le=65535)] = Field(description="port of the target")
    key_file: Path | None = Field(
        default=None, description="the shared secret; default: the file that RTHS_KEY_FILE names"
    )
    timeout_s: Annotated[float, Range(ge=1e-5, le=0.1)] | None = Field(
        default=None, description="how long an answer may take; default, and most: 0.7 of the sample interval"
    )

    @field_validator("host")
    @classmethod
    def _a_host(cls, host: str) -> str:
        if not (_is_address(host) or re.fullmatch(r"(?!-)[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*\.?", host)):
            raise refusal(f"must be a host's name or address, without port, got {host[:40]!r}")
        return host

    @property
    def is_loopback(self) -> bool:
        """Tell whether the target runs on this machine."""
        return self.host == "localhost" or (_is_address(self.host) and ipaddress.ip_address(self.host).is_loopback)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


class UdpRigSpec(RealRigSpec):
    """Hold a rig whose target exchanges UDP packets with the runner."""

    elsewhere: ClassVar[Mapping[str, str]] = {k: v for k, v in RealRigSpec.elsewhere.items() if k != "udp"}

    kind: Literal["udp"] = Field(description=KIND)
    udp: UdpSpec = Field(description="where the target listens")
    watchdog_s: Watchdog = 0.1


class PlainLinkSpec(Strict):
    """Hold the two ends of a private cable, on which frames carry no key."""

    kind: Literal["udp_plain"] = Field(default="udp_plain", description="frames of docs/reference/plain_link.md")
    interface: str = Field(description="address of this machine at that cable, private or loopback")
    own_port: Annotated[int, Range(ge=1, le=65535)] = Field(default=47811, description="port of this machine")
    host: str = Field(description="address of the target, private or loopback")
    port: Annotated[int, Range(ge=1, le=65535)] = Field(default=47810, description="port of the target")

    @field_validator("interface", "host")
    @classmethod
    def _private(cls, address: str) -> str:
        if fault := not_private(address):
            raise refusal(fault)
        return address

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        here, there = data.get("interface"), data.get("host")
        if not all(isinstance(one, str) and not not_private(one) for one in (here, there)):
            return
        if is_loopback(str(here)) != is_loopback(str(there)):
            yield ("host",), f"must be reached through interface {here}, got {there}: only one of them is loopback"
        ports = [number(data, key) or cls.model_fields[key].default for key in ("own_port", "port")]
        if here == there and ports[0] == ports[1]:
            yield ("own_port",), f"must differ from port where both are on {here}, got {ports[0]:g} twice"


PRIVATE = ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "169.254.0.0/16", "127.0.0.0/8")


def not_private(address: str) -> str:
    """Return why an address may not be an end of a plain link, empty when it may."""
    anybody = "frames carry no key, so whoever reaches the address moves the table"
    try:
        found = ipaddress.IPv4Address(address)
    except ValueError:
        told = "one IPv4 address in numbers, such as 192.168.7.2"
        return f"must be {told}, got {address[:40]!r}; the plain link has one peer and looks no names up"
    if found.is_unspecified:
        return f"must be one address of one interface, got {address}, which is every interface; {anybody}"
    if not any(found in ipaddress.IPv4Network(network) for network in PRIVATE):
        return f"must be private ({', '.join(PRIVATE)}), got {address}; {anybody}. Use kind: udp, which has a key"
    return ""


def is_loopback(address: str) -> bool:
    """Tell whether an address in numbers is of this machine alone."""
    return ipaddress.ip_address(address).is_loopback


class UdpPlainRigSpec(RealRigSpec):
    """Hold a rig whose target exchanges plain frames with the runner, over a private cable."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        key: said for key, said in RealRigSpec.elsewhere.items() if key not in ("link", "clock")
    }

    kind: Literal["udp_plain"] = Field(description=KIND)
    link: PlainLinkSpec = Field(description="the two ends of the cable")
    clock: Literal["runner", "target"] = Field(
        description="who has the sample clock; a target that has it sends its samples by itself"
    )
    watchdog_s: Watchdog = 0.1

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from super().problems(data)
        yield from _attended(data)


class TargetRigSpec(RealRigSpec):
    """Hold a rig whose own computer steps a test that rths designed, and sends its log over a private cable."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        **{key: said for key, said in RealRigSpec.elsewhere.items() if key != "link"},
        "clock": "is the target's own, which steps the test; remove it",
    }

    kind: Literal["target"] = Field(description=KIND)
    link: PlainLinkSpec = Field(description="the two ends of the cable")
    watchdog_s: Watchdog = 0.5

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from super().problems(data)
        yield from _attended(data)


def _attended(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield the fault of a rig on a plain link that may move with nobody asked."""
    if data.get("unattended") is True:
        said = "must not be true on a plain link, whose frames carry no key: somebody stands beside the table"
        yield ("unattended",), f"{said}; remove it, or use kind: udp"


class NiSpec(Strict):
    """Hold the terminals of an NI card with hardware-timed single point."""

    device: Annotated[str, Field(min_length=1, max_length=60, description="its name in NI MAX, such as Dev1")]
    command_channel: str = Field(default="ao0", min_length=1, max_length=40, description="output of the command")
    enable_line: str | None = Field(
        default=None, min_length=1, max_length=60, description="digital line that is high while motion is enabled"
    )
    wiring: Literal["default", "rse", "nrse", "differential", "pseudodifferential"] = Field(
        default="default", description="how the inputs are connected"
    )
    timeout_s: Annotated[float, Range(ge=0.01, le=60)] = Field(
        default=1.0, description="how long the sample clock may fail to come"
    )


class NiRigSpec(RealRigSpec):
    """Hold a rig on an NI card in this machine."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        **{k: v for k, v in RealRigSpec.elsewhere.items() if k != "ni"},
        "watchdog_s": "an NI card has no watchdog, it holds its last voltage; remove this and wire an independent one",
    }

    kind: Literal["ni"] = Field(description=KIND)
    ni: NiSpec = Field(description="terminals of the card")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        if "sensors" in data:
            yield ("sensors",), "an NI card needs the terminal of each channel; list them under channels"
        else:
            yield from super().problems(data)
        terminals: list[object] = []
        for i, channel in enumerate(listed(data, "channels") or ()):
            terminal = entry(channel, "terminal")
            if terminal is None and isinstance(channel, Mapping):
                yield ("channels", i), "needs the input it is connected to; add terminal, such as terminal: ai0"
            elif terminal in terminals:
                first = terminals.index(terminal) + 1
                yield ("channels", i, "terminal"), f"is that of channels[{first}] already; give each its own"
            terminals.append(terminal)


class PluginRigSpec(RealRigSpec):
    """Hold a rig that another package brings; its own keys stand under `options` and are checked there."""

    elsewhere: ClassVar[Mapping[str, str]] = {k: v for k, v in RealRigSpec.elsewhere.items() if k != "options"}

    options: Mapping[str, Any] = Field(default_factory=dict, description="what the plug-in itself reads")
    watchdog_s: Watchdog = 0.1


KINDS: dict[str, type[RigSpec]] = {
    "virtual": VirtualRigSpec,
    "udp": UdpRigSpec,
    "udp_plain": UdpPlainRigSpec,
    "target": TargetRigSpec,
    "ni": NiRigSpec,
}


def read_rig(data: Any, handler: ValidatorFunctionWrapHandler) -> RigSpec:
    """Return the rig of checked or unchecked data; raises the faults of its kind's model alone."""
    if isinstance(data, RigSpec):
        return data
    kind = data.get("kind", DEFAULT_KIND) if isinstance(data, Mapping) else DEFAULT_KIND
    if kind == "udp" and entry(data, "link", "kind") == "udp_plain":  # the longer way to say it
        data, kind = {**data, "kind": "udp_plain"}, "udp_plain"
    fault = kind_fault(kind)
    if fault:
        detail = InitErrorDetails(type=refusal(fault), loc=("kind",), input=kind)
        raise ValidationError.from_exception_data(RigSpec.__name__, [detail])
    if isinstance(data, Mapping) and "interface" in data:
        if kind != DEFAULT_KIND:
            told = refusal("belongs to a virtual rig so far; no driver of another kind commands displacements yet")
            detail = InitErrorDetails(type=told, loc=("interface",), input=kind)
            raise ValidationError.from_exception_data(RigSpec.__name__, [detail])
        return VirtualActuatorSpec.model_validate(data)
    return KINDS.get(kind, PluginRigSpec).model_validate(data)


def kind_fault(kind: object) -> str:
    """Return why no rig is of this kind, empty when one is; further keys need no fault each then."""
    if not isinstance(kind, str):
        return f"must be text, got {shown(kind)}"
    found = {} if kind in KINDS else plugin_kinds()
    if kind not in (*KINDS, *found):
        return (
            f"no kind of rig is called {kind[:40]!r}{near(kind, {*KINDS, *found})}; "
            f"a further kind comes with a package that has an entry point of that name in the group {GROUP}"
        )
    points = found.get(kind, ())
    if len(points) > 1:
        return f"{kind!r} is brought by several packages ({', '.join(p.value for p in points)}); remove all but one"
    return ""


AnyRig = Annotated[
    VirtualRigSpec | VirtualActuatorSpec | UdpRigSpec | UdpPlainRigSpec | TargetRigSpec | NiRigSpec | PluginRigSpec,
    WrapValidator(read_rig),
]
