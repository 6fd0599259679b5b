"""A result that is exported: what it says about itself, and those of its groups that were asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.result_outline import Outline, read_group, read_outlines
from rths_cli.files.results import Dataset, Result
from rths_cli.metrics.stored import read_checked

BYTES = 8  # of a number, as it is written


@dataclass(frozen=True)
class Source:
    """A result and its chosen groups by path, a group before those in it."""

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
        """Return how many bytes the numbers of a group take, without the groups in it."""
        outline = self.groups[group]
        shapes = [*outline.datasets.values(), *outline.scales.values()]
        return BYTES * sum(int(np.prod(shape)) for shape in shapes)

    @property
    def total_bytes(self) -> int:
        """Return how many bytes the numbers of all chosen groups take."""
        return sum(self.size_bytes(group) for group in self.groups)


def open_source(path: Path, names: Sequence[str] = ()) -> Source:
    """Read what a result is about; `names` chooses groups with all that is in them (none: every group).

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
