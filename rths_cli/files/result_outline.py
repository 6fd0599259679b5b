"""What the groups of a result file hold, without their data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.files.results import Dataset, _dataset, _reading

if TYPE_CHECKING:
    import h5py

About = str | float | tuple[str, ...]


@dataclass(frozen=True)
class Outline:
    """One group by its path without a leading slash: shapes of its datasets and scales by name, names of the groups in
    it, its attributes (a block's `name`, `dt_s`, `inputs`, `outputs`)."""

    path: str
    datasets: Mapping[str, tuple[int, ...]]
    scales: Mapping[str, tuple[int, ...]]
    groups: tuple[str, ...]
    attributes: Mapping[str, About]


def read_outlines(path: Path) -> dict[str, Outline]:
    """Read what every group of a result file holds, by path, a group before those in it.

    Raises InputError unless the file is a whole result file.
    """
    return _reading(Path(path), _outlines)


def read_group(path: Path, outline: Outline) -> dict[str, Dataset]:
    """Read the scales and datasets of a group by name; raises InputError."""
    names = (*outline.scales, *outline.datasets)
    return _reading(path, lambda file: {name: _dataset(path, file, f"{outline.path}/{name}") for name in names})


def _outlines(file: h5py.File) -> dict[str, Outline]:
    import h5py

    found: dict[str, Outline] = {}

    def collect(name: str, node: Any) -> None:
        if isinstance(node, h5py.Group):
            found[name] = _outline(name, node)

    file.visititems(collect)
    return found


def _outline(name: str, group: h5py.Group) -> Outline:
    import h5py

    datasets: dict[str, tuple[int, ...]] = {}
    scales: dict[str, tuple[int, ...]] = {}
    for key, node in group.items():
        if isinstance(node, h5py.Dataset):
            (scales if node.is_scale else datasets)[key] = tuple(node.shape)
    inner = tuple(key for key, node in group.items() if isinstance(node, h5py.Group))
    return Outline(name, datasets, scales, inner, {key: _about(value) for key, value in group.attrs.items()})


def _about(value: Any) -> About:
    """Return an attribute of a group as a text, a number or texts."""
    if isinstance(value, np.ndarray):
        return tuple(str(item) for item in value)
    return value if isinstance(value, str) else float(value)
