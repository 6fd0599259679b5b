"""The keys of a compensator in `controller:` of a case: all kinds but FF, FF+FB and none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import iter_modules
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from rths_cli.case.field_types import Problem, Range, Strict
from rths_cli.case.plugin_interface import COMPENSATORS

OWN, STATE_SPACE = "own", "state_space"
BUILT_IN = Path(__file__).parents[1] / "control" / "compensators"
"""Each module of this folder is a compensator, which has the module's name."""
KEYS = ("kind", "file", "sha256", "lead_samples")


def built_in_compensators() -> tuple[str, ...]:
    """Return the names of the compensators of rths, sorted."""
    return tuple(sorted(found.name for found in iter_modules([str(BUILT_IN)])))


def compensator_kinds() -> tuple[str, ...]:
    """Return every kind of compensator: those of rths and of installed packages, and the two that name a file."""
    brought = sorted({point.name for point in entry_points(group=COMPENSATORS)})
    return tuple(dict.fromkeys((*built_in_compensators(), OWN, STATE_SPACE, *brought)))


class CompensatorSpec(Strict):
    """Hold a compensator; `kind` decides which options there are, each a number beside the keys below."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]

    wanted: ClassVar[str] = "a name or a mapping"
    feedback_bandwidth_hz: ClassVar[None] = None
    max_sensitivity: ClassVar[float] = 1.5
    disturbance_hz: ClassVar[None] = None
    command_weight: ClassVar[None] = None
    feedback_limit_v: ClassVar[None] = None
    reaction_feedforward: ClassVar[Literal[False]] = False
    friction_compensation: ClassVar[Literal[False]] = False
    inverts: ClassVar[bool] = False

    kind: str = Field(
        description="a compensator of rths or of an installed package; own: that of a Python file; state_space: a "
        "discrete block from a file",
        json_schema_extra={"not": {"enum": ["FF", "FF+FB", "none"]}},
    )
    file: Path | None = Field(
        default=None,
        description="kind own: a Python file, whose code is run; kind state_space: a .mat, .npz or .json file; "
        "relative to the file that names it",
    )
    sha256: str | None = Field(
        default=None,
        description="checksum of that file; default: as it is found. A file with another one is not used",
        json_schema_extra={"pattern": "^[0-9a-f]{64}$"},
    )
    lead_samples: Annotated[int, Range(ge=0, le=200)] = Field(
        default=0,
        description="by how many samples the desired motion that it is given is ahead of the table; the interface "
        "force is predicted that far",
    )

    @property
    def options(self) -> dict[str, float]:
        """Return the options by name, as stated."""
        return dict(self.__pydantic_extra__ or {})

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        kind, named = data.get("kind"), data.get("file") is not None
        if kind in (OWN, STATE_SPACE) and not named:
            yield ("file",), f"is missing; add the file of the compensator, kind {kind} reads it"
        elif kind not in (OWN, STATE_SPACE) and named:
            yield ("file",), f"belongs to the kinds {OWN} and {STATE_SPACE}, kind {kind} reads none; remove it"
        elif data.get("sha256") is not None and not named:
            yield ("sha256",), "is the checksum of file, which is not given; remove it"
        if kind == STATE_SPACE:
            for key in (key for key in data if key not in KEYS):
                yield (key,), f"unknown key; kind {STATE_SPACE} has no options"
