"""Every key of a further channel of a rig: a displacement sensor, load cell, strain gauge or one more accelerometer."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator

from rths_cli.case.field_types import Problem, Range, Strict, listed, number, refusal
from rths_cli.numerics.constants import FACTORS

UNITS: Mapping[str, Mapping[str, float]] = {
    "acceleration": {unit: FACTORS["acceleration"][unit] for unit in ("m/s^2", "g")},
    **{kind: FACTORS[kind] for kind in ("displacement", "force", "strain")},
}
"""The units a channel of each kind may be stated in, each with its size in that unit which stands first."""
DEFAULT_UNCERTAINTY = 0.01  # of a sensitivity that states none
CONTROL = "control uses the accelerometers of table and floors"

Relative = Annotated[float, Range(ge=0, le=0.5)]
Size = Annotated[float, Range(gt=0, le=1e9)]
Use = Literal["guard", "shear", "log"]


def corner_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield a fault when a sensor's low pass lies below its high pass."""
    low, high = number(data, "high_pass_hz"), number(data, "low_pass_hz")
    if low and high and high <= low:
        yield ("low_pass_hz",), f"must be > high_pass_hz = {low:g} or 0 (off), got {high:g}"


class FurtherChannelSpec(Strict):
    """Hold a channel beside the accelerometers of table and floors."""

    elsewhere: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("sensitivity_mv_per_g", "sensitivity_v_per_m_s2", "range_g", "warning_m_s2", "abort_m_s2"),
        "belongs to an accelerometer of table or floors, which has no kind; state unit, sensitivity_v_per_unit and "
        "range",
    )

    kind: Literal["acceleration", "displacement", "force", "strain"] = Field(description="what it measures")
    position: str = Field(
        description="where: table, floor_N (counted from the ground) or storey_N (between floors N - 1 and N)"
    )
    unit: str = Field(description="of range, sensitivity, levels and noise: m/s^2 or g, m or mm, N or kN, 1 or um/m")
    sensitivity_v_per_unit: Annotated[float, Range(gt=0, le=1e9)] = Field(description="V per unit")
    sensitivity_uncertainty: Relative = Field(
        default=DEFAULT_UNCERTAINTY, description="of the sensitivity, relative, one standard deviation"
    )
    range: Size = Field(description="+-, beyond which the sensor clips")
    use: Use | tuple[Use, ...] = Field(
        default="log", description="guard: watched; shear: base shear of the test; log: only stored; one or a list"
    )
    high_pass_hz: Annotated[float, Range(ge=0, le=100)] = Field(
        default=0.0, description="first-order corner of AC coupling; 0: none"
    )
    low_pass_hz: Annotated[float, Range(ge=0, le=1e6)] = Field(default=0.0, description="first-order corner; 0: none")
    sign: Literal[1, -1] = Field(default=1, description="-1: mounted against the positive direction")
    height_m: Annotated[float, Range(ge=0, le=1000)] | None = Field(
        default=None, description="height of the sensor above its table or floor; stored with the channel"
    )
    warning: Size | None = Field(default=None, description="level that is shown as a warning")
    abort: Size | None = Field(default=None, description="level at which the guard stops; needs use: guard")
    noise_rms: Annotated[float, Range(ge=0, le=1e9)] | None = Field(
        default=None, description="white noise per sample, of a virtual rig only; default: none"
    )
    plate_mass_kg: Annotated[float, Range(ge=0, le=1e6)] | None = Field(
        default=None, description="of a load cell: mass above it that is no part of the building; default: 0"
    )
    name: str = Field(default="", max_length=60, description="label in messages, such as the sensor's serial number")
    terminal: str | None = Field(
        default=None, min_length=1, max_length=40, description="input of an NI card, such as ai0"
    )

    @property
    def uses(self) -> tuple[Use, ...]:
        """Return what it is used for, without repetition."""
        return (self.use,) if isinstance(self.use, str) else tuple(dict.fromkeys(self.use))

    @property
    def unit_si(self) -> float:
        """Return the size of its unit in the SI unit of its kind."""
        return UNITS[self.kind][self.unit]

    @field_validator("position")
    @classmethod
    def _a_position(cls, position: str) -> str:
        if not re.fullmatch(r"table|(floor|storey)_[1-9][0-9]{0,3}", position):
            raise refusal(f"must be table, floor_N or storey_N such as floor_2, got {position[:40]!r}")
        return position

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from corner_problems(data)
        yield from _unit_problems(data)
        yield from _level_problems(data)
        uses = [data.get("use", "log")] if isinstance(data.get("use", "log"), str) else listed(data, "use") or []
        if "control" in uses:
            yield ("use",), f"{CONTROL}; a further channel is for guard, shear or log"
        if data.get("abort") is not None and "guard" not in uses:
            yield ("abort",), "needs use: guard, or the guard does not watch this channel; add it, or remove abort"
        kind, position = data.get("kind"), data.get("position")
        if "shear" in uses and (kind != "force" or position != "table"):
            yield ("use",), "shear needs a load cell under the specimen, kind: force at position: table"
        if kind == "strain" and isinstance(position, str) and not position.startswith("storey_"):
            yield ("position",), f"a strain is that of a storey; state storey_N, got {position[:40]!r}"
        if kind == "force" and isinstance(position, str) and position.startswith("floor_"):
            yield ("position",), f"a force is that under the specimen (table) or of a storey, got {position[:40]!r}"
        if kind in ("acceleration", "displacement") and isinstance(position, str) and position.startswith("storey_"):
            yield ("position",), f"{kind} is that of the table or of a floor, got {position[:40]!r}"
        if data.get("plate_mass_kg") is not None and (kind != "force" or position != "table"):
            yield ("plate_mass_kg",), "belongs to a load cell under the specimen, kind: force at position: table"


def _unit_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    kind, unit = data.get("kind"), data.get("unit")
    if isinstance(kind, str) and kind in UNITS and isinstance(unit, str) and unit not in UNITS[kind]:
        yield ("unit",), f"must be {' or '.join(UNITS[kind])} for kind: {kind}, got {unit[:20]!r}"


def _level_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    warning, abort, span = (number(data, key) for key in ("warning", "abort", "range"))
    if warning is not None and abort is not None and warning >= abort:
        yield ("warning",), f"must be < abort = {abort:g}, got {warning:g}"
    if abort is not None and span is not None and abort > span:
        yield ("abort",), f"must be <= range = {span:g}, got {abort:g}; the sensor would not show it"
