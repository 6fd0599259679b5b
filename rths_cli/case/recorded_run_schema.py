"""The keys of a run that was made elsewhere: its recording takes the place of a run on the table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, WithJsonSchema

from rths_cli.case.field_types import Problem, Range, Strict, refusal

RECORDED_RUNS = ("shake_table", "exp_rths")


def _named(channel: object) -> object:
    """Return a channel's name alone as name and unit; raise the sentence for what is neither."""
    words = (channel,) if isinstance(channel, str) else channel
    if not isinstance(words, tuple | list) or len(words) not in (1, 2) or not all(isinstance(w, str) for w in words):
        raise refusal("must be the name of a channel, or [NAME, UNIT]")
    return tuple(words)


RecordedChannel = Annotated[
    tuple[str, ...],
    BeforeValidator(_named),
    WithJsonSchema(
        {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1, "maxItems": 2}]}
    ),
]


class RecordedRunSpec(Strict):
    """Hold the recording of a run that another controller or computer made, and which of its channels is what."""

    recording: Path = Field(description="file with the measured time histories (rths data FILE shows what it holds)")
    channels: dict[str, RecordedChannel] = Field(
        default={},
        description="channel of each role, a name or [NAME, UNIT], as rths data prints them: ground, desired, command, "
        "table, floor_N, base_shear, floor_N_displacement; a minus before the unit turns the sign; default: by name",
    )
    rate_hz: Annotated[float, Range(gt=0, le=1e6)] | None = Field(
        default=None, description="sample rate, where the file does not state it"
    )
    until_s: Annotated[float, Range(gt=0, le=1e6)] | None = Field(
        default=None, description="time of the record up to which the run is judged; default: all that is recorded"
    )

    @property
    def choices(self) -> dict[str, tuple[str, str]]:
        """Return name and unit ("": as the file states it) of each role that is stated."""
        return {role: (words[0], words[1] if len(words) > 1 else "") for role, words in self.channels.items()}


def recorded_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield a fault where a case with a recording has a run on the table without one, or does not name its run."""
    recorded, runs = [run for run in RECORDED_RUNS if data.get(run) is not None], data.get("runs")
    if not recorded or not isinstance(runs, tuple):
        return
    named = [run.replace("-", "_") for run in runs if isinstance(run, str)]
    for run in RECORDED_RUNS:
        if run in named and run not in recorded:
            told = f"{run} has no recording and the case has one ({recorded[0]}), so nothing moves"
            yield ("runs",), f"{told}; remove {run}, or give its recording under {run}"
        elif run in recorded and run not in named:
            yield (run,), f"is the recording of a run that runs does not name; add {run} to runs"
