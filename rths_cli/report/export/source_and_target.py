"""Parts that all formats use: the open result as a source of series; files written completely or not at all."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import part_of, remove_leftovers
from rths_cli.files.result_listing import Outline, read_group, read_groups, read_outlines
from rths_cli.files.result_reader import Dataset, Result, read_checked
from rths_cli.files.result_writer import refusal

BYTES = 8  # of a number, as it is written


@dataclass(frozen=True)
class Source:
    """A result to be exported, with its chosen groups by path, each group before those in it."""

    result: Result
    groups: Mapping[str, Outline]

    @property
    def stem(self) -> str:
        """Return the name of the result's file without its suffix."""
        return self.result.path.stem

    def read(self, group: str) -> dict[str, Dataset]:
        """Read the scales and datasets of a group by name; raises InputError."""
        return read_group(self.result.path, self.groups[group])

    def size_bytes(self, group: str) -> int:
        """Return the number of bytes of a group's numbers, without the groups in it."""
        outline = self.groups[group]
        shapes = [*outline.datasets.values(), *outline.scales.values()]
        return BYTES * sum(int(np.prod(shape)) for shape in shapes)

    @property
    def total_bytes(self) -> int:
        """Return the number of bytes of the numbers of all chosen groups."""
        return sum(self.size_bytes(group) for group in self.groups)


def open_source(path: Path, names: Sequence[str] = ()) -> Source:
    """Read the contents of a result without its series; `names`: chosen groups, with the groups in them; (): all.

    Raises InputError unless the file is a whole result file that holds these groups.
    """
    result, outlines = read_checked(path), read_outlines(path)
    wanted = [name.strip("/").replace("-", "_") for name in names]
    missing = [name for name in wanted if name not in outlines]
    if missing:
        status = result.attributes["status"]
        known = ", ".join(result.groups) or "none"
        raise InputError(
            *(f"{path}: holds no group {name} (status {status}); its groups are {known}" for name in missing)
        )
    return Source(result, {key: outline for key, outline in outlines.items() if _chosen(key, wanted)})


def _chosen(group: str, wanted: Sequence[str]) -> bool:
    return not wanted or any(group == name or group.startswith(f"{name}/") for name in wanted)


_AXES_OF_SERIES = (("time_s",), ("frequency_hz",))


def notes(source: Source) -> dict[str, Any]:
    """Return the attributes of a result and, by group, the datasets that are not series; None if not finite."""
    about = {key: _plain(value) for key, value in source.result.attributes.items()}
    read = read_groups(source.result.path, source.groups.values(), lambda item: item.dims[-1:] not in _AXES_OF_SERIES)
    held = {path: _group(outline, read[path]) for path, outline in source.groups.items()}
    return {"attributes": about, "groups": {path: group for path, group in held.items() if group}}


def _group(outline: Outline, held: Mapping[str, Dataset]) -> dict[str, Any]:
    found: dict[str, Any] = {key: _plain(value) for key, value in outline.attributes.items()}
    for name, item in held.items():
        if name in outline.datasets:
            told = {"units": item.units, "long_name": item.long_name, "source": item.source}
            found[name] = {"value": _plain(np.asarray(item.data).tolist()), **told, "dims": list(item.dims)}
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


Tell = Callable[[str], None]
"""Receives how far a file is written, as text."""


@dataclass(frozen=True)
class Target:
    """A file to be written."""

    path: Path
    write: Callable[[Path, Tell], None]  # writes the whole file at a given path


def write_all(targets: Sequence[Target], tell: Tell = lambda _: None) -> None:
    """Write files under temporary names (`part_of`) and rename them when all are complete.

    Raises InputError with path and cause if one cannot be written; then, and after a signal, no file is left behind.
    """
    parts = [part_of(target.path) for target in targets]
    try:
        for target, part in zip(targets, parts, strict=True):
            remove_leftovers(target.path)
            with_reason(target, part, tell)
        for target, part in zip(targets, parts, strict=True):
            os.replace(part, target.path)
    finally:
        for part in parts:
            with suppress(OSError):
                part.unlink()


def with_reason(target: Target, part: Path, tell: Tell) -> None:
    """Write one file to `part`; raises InputError with path and cause if that fails."""
    try:
        tell(str(target.path))
        target.write(part, lambda text: tell(f"{target.path}, {text}"))
    except (OSError, RuntimeError) as error:
        raise InputError(refusal(target.path, "cannot write", error)) from error
