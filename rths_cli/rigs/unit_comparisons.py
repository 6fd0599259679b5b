"""What the numbers of a rig file must agree with: its limits, data sheet, converters and sensors with one another."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import TYPE_CHECKING

from rths_cli.case.further_channel_schema import FurtherChannelSpec
from rths_cli.case.rig_schema import SensorsSpec, VirtualRigSpec
from rths_cli.case.unit_comparison import Comparison
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.case.rig_schema import RealSensorsSpec, RigSpec

STROKE, VELOCITY, ACCELERATION = (
    "table.limits.stroke_m",
    "table.limits.velocity_m_s",
    "table.limits.acceleration_m_s2",
)
FORCE, RATE = "table.limits.force_n", "table.limits.command_rate_v_s"
GAIN, MOVING, PAYLOAD = "table.nominal.gain_m_per_v", "table.nominal.moving_mass_kg", "table.nominal.payload_kg"
RANGE_V = "table.converters.range_v"


def of_rig(case: Case) -> Iterator[Comparison]:
    """Yield what the numbers of a case's rig are compared with, its limits as the rig states them: a case may make them
    as strict as it likes."""
    rig = case.table if case.rig_limits is None else case.table.model_copy(update={"limits": case.rig_limits})
    yield from (*_of_limits(rig), *_of_sensors(rig), *_of_further_channels(rig))
    if isinstance(rig, VirtualRigSpec):
        from rths_cli.rigs.virtual.unit_comparisons import of_physics

        yield from of_physics(rig)


def _of_limits(rig: RigSpec) -> Iterator[Comparison]:
    """Yield the comparisons of the limits with what the command can reach and with one another.

    A limit far above what it is compared with cannot trip, one far below stops every test.
    """
    limits, sheet, range_v = rig.limits, rig.nominal, rig.converters.range_v
    moving, payload, fastest = sheet.moving_mass_kg, sheet.payload_kg, limits.acceleration_m_s2
    reach, over_band = sheet.gain_m_per_v * range_v, sqrt(limits.stroke_m * fastest)
    yield Comparison(
        STROKE, limits.stroke_m, "m", "what the range of the command reaches", reach, 0.5, 1.45, (GAIN, RANGE_V)
    )
    yield Comparison(
        VELOCITY, limits.velocity_m_s, "m/s", "the velocity at which stroke and acceleration limit meet", over_band,
        0.2, 1.05, (STROKE, ACCELERATION),
    )  # fmt: skip
    yield Comparison(
        FORCE, limits.force_n, "N", "what the moving mass needs at the acceleration limit", moving * fastest,
        0.35, 1.3 * (1.0 + payload / moving), (MOVING, ACCELERATION, PAYLOAD),
    )  # fmt: skip
    yield Comparison(PAYLOAD, payload, "kg", "the moving mass", moving, 0.4, 16.0, (MOVING,))
    yield Comparison(RANGE_V, range_v, "V", "the usual range of converters", 10.0, 0.09, 2.5)
    if limits.command_rate_v_s is not None:
        rate = limits.velocity_m_s / sheet.gain_m_per_v
        yield Comparison(
            RATE, limits.command_rate_v_s, "V/s", "that of the velocity limit", rate, 0.2, 5.0, (VELOCITY, GAIN)
        )
    if limits.tracking_error_m_s2 is not None:
        key, tracking = "table.limits.tracking_error_m_s2", limits.tracking_error_m_s2
        yield Comparison(key, tracking, "m/s^2", "the acceleration limit", fastest, 0.005, 1.0, (ACCELERATION,))


def _of_sensors(rig: RigSpec) -> Iterator[Comparison]:
    """Yield the comparisons of the accelerometers with the acceleration limit and the converters."""
    limit_g, range_v = rig.limits.acceleration_m_s2 / STANDARD_GRAVITY_M_S2, rig.converters.range_v
    for key, one in _accelerometers(rig):
        yield Comparison(
            f"{key}.range_g", one.range_g, "g", "the acceleration limit", limit_g, 0.5, 12.0, (ACCELERATION,)
        )
        stated = "sensitivity_mv_per_g"
        if isinstance(one, SensorsSpec):
            volts = one.range_g * one.sensitivity_mv_per_g / 1e3
        else:
            volts = one.range_g * STANDARD_GRAVITY_M_S2 * one.volts_per_m_s2
            stated = stated if one.sensitivity_v_per_m_s2 is None else "sensitivity_v_per_m_s2"
        yield _of_full_scale(f"{key}.{stated}", volts, range_v, f"{key}.range_g")
        if one.low_pass_hz > 0.0:
            what = "the usual corner of accelerometers"
            yield Comparison(f"{key}.low_pass_hz", one.low_pass_hz, "Hz", what, 1500.0, 0.12, 8.0)
        if one.high_pass_hz > 0.0:
            what = "the usual corner of AC coupling"
            yield Comparison(f"{key}.high_pass_hz", one.high_pass_hz, "Hz", what, 0.05, 0.02, 10.0)
        if isinstance(one, SensorsSpec):
            if one.noise_rms_m_s2 > 0.0:
                span = one.range_g * STANDARD_GRAVITY_M_S2
                of = (f"{key}.range_g",)
                yield Comparison(
                    f"{key}.noise_rms_m_s2", one.noise_rms_m_s2, "m/s^2", "the range", span, 5e-7, 1e-3, of
                )
            continue
        for level, low in (("warning_m_s2", 0.02), ("abort_m_s2", 0.1)):
            if (value := getattr(one, level)) is not None:
                limit = rig.limits.acceleration_m_s2
                what = "the acceleration limit"
                yield Comparison(f"{key}.{level}", value, "m/s^2", what, limit, low, 2.0, (ACCELERATION,))


def _accelerometers(rig: RigSpec) -> Iterator[tuple[str, SensorsSpec | RealSensorsSpec]]:
    if rig.sensors is not None:
        yield "table.sensors", rig.sensors  # type: ignore[misc]
    for i, one in enumerate(getattr(rig, "accelerometers", ())):
        yield f"table.channels[{i + 1}]", one


def _of_further_channels(rig: RigSpec) -> Iterator[Comparison]:
    """Yield the comparisons of displacement sensors, load cells and further accelerometers with limits and converters;
    strains have no limit that they could be compared with."""
    limits, range_v = rig.limits, rig.converters.range_v
    against = {
        "displacement": (limits.stroke_m, "m", "the stroke limit", STROKE, 0.3, 10.0),
        "force": (limits.force_n, "N", "the force limit", FORCE, 0.1, 20.0),
        "acceleration": (limits.acceleration_m_s2, "m/s^2", "the acceleration limit", ACCELERATION, 0.1, 12.0),
    }
    for i, one in enumerate(getattr(rig, "channels", None) or ()):
        if not isinstance(one, FurtherChannelSpec):
            continue
        key = f"table.channels[{i + 1}]"
        yield _of_full_scale(f"{key}.sensitivity_v_per_unit", one.range * one.sensitivity_v_per_unit, range_v,
                             f"{key}.range")  # fmt: skip
        if one.kind in against:
            figure, unit, what, limit, low, high = against[one.kind]
            yield Comparison(f"{key}.range", one.range * one.unit_si, unit, what, figure, low, high, (limit,))
        for level in ("warning", "abort"):
            if (value := getattr(one, level)) is not None:
                yield Comparison(
                    f"{key}.{level}", value, one.unit, "the sensor's range", one.range, 0.05, 1.0, (f"{key}.range",)
                )
        if one.noise_rms:
            of = (f"{key}.range",)
            yield Comparison(
                f"{key}.noise_rms", one.noise_rms, one.unit, "the sensor's range", one.range, 1e-8, 1e-2, of
            )
        if one.plate_mass_kg:
            payload = rig.nominal.payload_kg
            yield Comparison(
                f"{key}.plate_mass_kg", one.plate_mass_kg, "kg", "the payload", payload, 2e-3, 1.0, (PAYLOAD,)
            )


def _of_full_scale(key: str, volts: float, range_v: float, of: str) -> Comparison:
    asked = "are sensitivity and range in their units?"
    what = "the range of the converters"
    return Comparison(key, volts, "V", what, range_v, 0.09, 1.06, (of, RANGE_V), "the sensor's full scale", asked)
