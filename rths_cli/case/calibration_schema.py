"""Every key of a calibration file, which `rths calibrate` writes and a rig file names under `calibration`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Annotated, Any, ClassVar

from pydantic import Field, field_validator

from rths_cli.case.field_types import Problem, Range, Strict, listed, refusal
from rths_cli.case.further_channel_schema import Relative, Size

TIME = "%Y-%m-%dT%H:%M:%SZ"
OfMass = Annotated[float, Range(ge=0, le=0.1)]


class CalibratedChannel(Strict):
    """Hold what a calibration found of one channel, per m/s^2, m, N or 1 as its kind has it."""

    name: str = Field(description="role of the channel: table, floor_2, table_force ...")
    declared_v_per_unit: Size = Field(description="sensitivity in the rig file that was calibrated")
    sensitivity_v_per_unit: Size = Field(description="sensitivity that was found; it takes the place of the declared")
    sensitivity_uncertainty: Relative = Field(
        description="of that sensitivity by itself, relative, one standard deviation: the prior of identifications"
    )
    joint_uncertainty: Relative = Field(
        description="of that sensitivity together with the ratios that a model showed; for people to read"
    )


class CalibratedMass(Strict):
    """Hold what a balance showed of one floor on the table."""

    floor: str = Field(description="floor_N, counted from the ground")
    mass_kg: Size = Field(description="mass that was found; the structure file must state it")
    mass_uncertainty: OfMass = Field(
        description="of that mass by itself, relative, one standard deviation: the prior of identifications"
    )


class CalibrationSpec(Strict):
    """Hold a calibration of a rig: when, by whom, its channels and what was weighed."""

    wanted: ClassVar[str] = "the name of a calibration file or a mapping"

    rig: str = Field(description="name of the rig that it belongs to")
    made_utc: str = Field(description="when it was made, such as 2026-11-24T09:30:00Z")
    by: str = Field(default="", max_length=200, description="who made it")
    model: str = Field(default="", max_length=300, description="model file whose ratios were used; empty: none")
    channels: tuple[CalibratedChannel, ...] = Field(min_length=1, description="channels of the rig")
    specimen: str = Field(
        default="", description="structure that was weighed; its masses count for no other ones; empty: for all"
    )
    masses: tuple[CalibratedMass, ...] = Field(default=(), description="floors that were weighed")

    @property
    def told(self) -> str:
        """Return what it is in words: day and person."""
        return f"{self.made_utc[:10]}{f' by {self.by}' if self.by else ''}"

    @field_validator("made_utc")
    @classmethod
    def _a_time(cls, text: str) -> str:
        try:
            datetime.strptime(text, TIME)
        except ValueError:
            raise refusal(f"must be a time in UTC such as 2026-11-24T09:30:00Z, got {text[:40]!r}") from None
        return text

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        for key, name in (("channels", "name"), ("masses", "floor")):
            seen: set[object] = set()
            for i, one in enumerate(listed(data, key) or ()):
                stated = one.get(name) if isinstance(one, Mapping) else None
                if isinstance(stated, str) and stated in seen:
                    yield (key, i, name), f"{stated[:40]!r} is listed before; keep one"
                seen.add(stated)
