"""The plan of a sweep: its axes, and the rows that they and the seeds make. Pure data.

An axis is a varied key with its values, wherever they come from: `--vary`, a list, a range or a folder of a study, or
samples of a distribution. Axes of one block vary together (samples), blocks are combined. Values of samples stand in
arrays, and a row is made when it is asked for, so that a million rows take little memory.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.case.study_schema import MOST_RUNS
from rths_cli.case.yaml_reader import dump
from rths_cli.errors import InputError


@dataclass(frozen=True)
class Axis:
    """One varied key of a case and its values (n,): numbers, texts, truths, lists or mappings.

    `label`: how faults name it, empty: as an option --vary.
    """

    key: str
    values: tuple[Any, ...] | NDArray[Any]
    label: str = ""

    @property
    def name(self) -> str:
        """Return how faults name the axis."""
        return self.label or f"--vary {self.key}"

    @property
    def sampled(self) -> bool:
        """Tell whether the values are samples of numbers."""
        return isinstance(self.values, np.ndarray) and self.values.dtype.kind == "f"

    def value(self, place: int) -> Any:
        """Return one value."""
        found = self.values[place]
        return found.item() if isinstance(found, np.generic) else found

    def numbers(self) -> NDArray[np.float64] | None:
        """Return the values (n,) as numbers, None where not all of them are."""
        if isinstance(self.values, np.ndarray) and self.values.dtype.kind in "fiu":
            return self.values.astype(float)
        if any(isinstance(value, bool) or not isinstance(value, int | float) for value in self.values):
            return None
        return np.array(self.values, dtype=float)


Block = tuple[Axis, ...]
"""Axes of one length that vary together."""


@dataclass(frozen=True)
class Plan:
    """The rows of a sweep: the last block varies fastest among the points, the seeds within a point.

    `kept`: the numbers of the combinations that are points, None: all of them. `folder`: where relative paths in the
    values start, None: the present folder.
    """

    blocks: tuple[Block, ...]
    seeds: range
    kept: NDArray[np.int64] | None = None
    folder: Path | None = None

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Return the axes, block by block."""
        return tuple(axis for block in self.blocks for axis in block)

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return the number of values of each block."""
        return tuple(len(block[0].values) for block in self.blocks)

    @property
    def points(self) -> int:
        """Return the number of combinations of values that are run."""
        return math.prod(self.lengths) if self.kept is None else len(self.kept)

    @property
    def variants(self) -> int:
        """Return the number of runs."""
        return self.points * len(self.seeds)

    def values(self, point: int) -> tuple[Any, ...]:
        """Return the varied values of a point, in the order of the axes."""
        number = point if self.kept is None else int(self.kept[point])
        found: list[Any] = []
        for block, length in zip(reversed(self.blocks), reversed(self.lengths), strict=True):
            number, place = divmod(number, length)
            found[:0] = [axis.value(place) for axis in block]
        return tuple(found)

    def settings(self, point: int) -> tuple[str, ...]:
        """Return a point as settings KEY=VALUE of a case."""
        values = zip(self.axes, self.values(point), strict=True)
        return tuple(f"{axis.key}={dump(value)}" for axis, value in values)

    def label(self, point: int) -> str:
        """Return a point as a reader would name it."""
        values = zip(self.axes, self.values(point), strict=True)
        return ", ".join(f"{axis.key}={as_text(value)}" for axis, value in values) or "the case as it is"

    def columns(self) -> Iterator[tuple[str, tuple[Any, ...] | NDArray[Any]]]:
        """Yield each varied key with its values (n_variants,), numbers of samples as an array."""
        for block, places in zip(self.blocks, self._places(), strict=True):
            rows = np.repeat(places, len(self.seeds))
            for axis in block:
                if isinstance(axis.values, np.ndarray) and axis.values.dtype.kind == "f":
                    yield axis.key, axis.values[rows]
                else:
                    yield axis.key, tuple(axis.values[place] for place in rows.tolist())

    def digest(self) -> str:
        """Return a hash of the rows."""
        found = hashlib.sha256(repr((self.seeds, self.points)).encode())
        for axis in self.axes:
            sampled = isinstance(axis.values, np.ndarray) and axis.values.dtype.kind == "f"
            found.update(axis.key.encode())
            found.update(axis.values.tobytes() if sampled else json.dumps(list(axis.values)).encode())  # type: ignore[union-attr]
        found.update(b"" if self.kept is None else self.kept.tobytes())
        return found.hexdigest()

    def _places(self) -> list[NDArray[np.int64]]:
        """Return the place in each block (n_points,) of every point."""
        if not self.blocks:
            return []
        numbers = np.arange(self.points) if self.kept is None else self.kept
        return [np.asarray(places) for places in np.unravel_index(numbers, self.lengths)]

    def numbers(self, key: str) -> NDArray[np.float64] | None:
        """Return the values (n_points,) of an axis, None where they are not all numbers."""
        for block, places in zip(self.blocks, self._places(), strict=True):
            for axis in block:
                if axis.key == key:
                    values = axis.numbers()
                    return None if values is None else values[places]
        raise KeyError(key)


def as_text(value: Any) -> str:
    """Return a varied value as it would be typed."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:.10g}"
    return json.dumps(value).replace('"', "")


def checked_plan(plan: Plan, faults: Sequence[str] = ()) -> Plan:
    """Return a plan; raises InputError with faults, and where keys repeat or hold one another or it is too large."""
    found = list(faults)
    axes = plan.axes
    for k, axis in enumerate(axes):
        if any(axis.key == other.key for other in axes[:k]):
            found.append(f"{axis.name}: is given twice; give all its values once")
        found += [
            f"{axis.name}: holds {other.key}, which is varied too; vary one of them"
            for other in axes
            if other.key.startswith(f"{axis.key}.")
        ]
    if math.prod(plan.lengths) * len(plan.seeds) > MOST_RUNS:
        found.append(f"the grid has {plan.variants} runs, at most {MOST_RUNS} are allowed; vary less")
    if found:
        raise InputError(*found)
    return plan
