"""The keys of `scale`: the scale of the model in the laboratory, prototype over model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field

from rths_cli.case.field_types import Problem, Range, Strict

Factor = Annotated[float, Range(ge=1e-6, le=1e6)]


class ScaleSpec(Strict):
    """Hold the independent scale factors, each the prototype's value over the model's."""

    length: Annotated[float, Range(ge=0.01, le=1000)] = Field(
        description="length of the prototype over that of the model; a model at 1:2.4 has 2.4"
    )
    acceleration: Annotated[float, Range(ge=0.01, le=100)] = Field(
        default=1.0, description="acceleration of the prototype over that of the model; 1 where gravity matters"
    )
    stress: Factor | None = Field(
        default=None, description="stress or elastic modulus; default: 1, the same material (artificial mass)"
    )
    mass: Factor | None = Field(
        default=None, description="instead of stress: mass of a storey of the prototype over that of the model"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        if data.get("stress") is not None and data.get("mass") is not None:
            yield ("mass",), "give mass or stress, not both; the other one follows from length and acceleration"
