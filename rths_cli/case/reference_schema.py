"""Every key of a reference file: published numbers to print beside ours."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from rths_cli.case.field_types import Problem, Range, Strict

METRIC_PATH = r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)+$"

Value = Annotated[float, Range(ge=0, le=1e9)]
Figure = Annotated[
    Annotated[Value, Tag("number")] | Annotated[tuple[Value, ...], Field(min_length=1), Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
]


class ReferenceEntry(Strict):
    """Hold the figures published for one record, damping and controller; an absent key stands for any."""

    record: str | None = Field(default=None, description="record they belong to; without it any")
    damping: str | None = Field(default=None, description="damping level they belong to; without it any")
    controller: Literal["FF", "FF+FB", "none"] | None = Field(
        default=None, description="controller they belong to; without it any"
    )
    scaling: Annotated[float, Range(gt=0, le=100)] | None = Field(
        default=None, description="scaling they belong to; without it any"
    )
    figures: dict[str, Figure] = Field(
        description="by metric path, one number or one per storey",
        json_schema_extra={"propertyNames": {"pattern": METRIC_PATH}},
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        figures = data.get("figures")
        for path in figures if isinstance(figures, Mapping) else ():
            if not re.match(METRIC_PATH, path):
                yield ("figures", path), "must be a figure's path such as exp_rths.rms_error_m_s2"


class ReferenceSpec(Strict):
    """Hold a publication's figures."""

    wanted: ClassVar[str] = "a name or a mapping"

    name: str = Field(default="inline", description="default: the file's name")
    title: str = Field(description="stands under the tables")
    source: str = Field(description="where the figures are published")
    entries: tuple[ReferenceEntry, ...] = Field(
        min_length=1, description="the figures, by what they were published for"
    )

    def figures_for(
        self, record: str, damping: str, controller: str, scaling: float | None = None
    ) -> dict[str, float | tuple[float, ...]]:
        """Return the published figures of a case by metric path, empty when none was published.

        With `scaling` given, figures published for another scaling are left out.
        """
        found: dict[str, float | tuple[float, ...]] = {}
        for entry in self.entries:
            same = (
                entry.record in (None, record)
                and entry.damping in (None, damping)
                and entry.controller in (None, controller)
                and (scaling is None or entry.scaling in (None, scaling))
            )
            found |= entry.figures if same else {}
        return found
