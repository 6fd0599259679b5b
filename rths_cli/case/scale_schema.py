"""The keys of `scale`: the scale of the model in the laboratory, prototype over model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field, ValidationError

from rths_cli.case.field_types import Problem, Range, Strict
from rths_cli.errors import InputError

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


def read_scale(texts: Sequence[str]) -> ScaleSpec | None:
    """Return the scale of `--scale KEY=VALUE` options, None without any; raises InputError with all faults."""
    if not texts:
        return None
    values: dict[str, float] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--scale {text}: must be KEY=NUMBER, for example --scale length=2.4")
        if key in values:
            raise InputError(f"--scale {key}: is given twice; give it once")
        values[key] = number
    try:
        return ScaleSpec.model_validate(values)
    except ValidationError as error:
        places = ((".".join(map(str, one["loc"])), one["msg"]) for one in error.errors(include_url=False))
        raise InputError(*(f"--scale {place}: {said}" for place, said in places)) from error
