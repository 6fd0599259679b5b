"""List groups, datasets and attributes of a result file without reading their data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.files.hdf5_safety import held, is_dataset, scalar, walk
from rths_cli.files.result_reader import Dataset, _dataset, _reading

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
    if not outline.scales and not outline.datasets:
        return {}
    return read_groups(path, [outline])[outline.path]


def read_groups(
    path: Path, outlines: Iterable[Outline], wanted: Callable[[Dataset], bool] = lambda _: True
) -> dict[str, dict[str, Dataset]]:
    """Read the scales and datasets of groups by path and name, those that are wanted; raises InputError."""
    return _reading(path, lambda file: {one.path: dict(_datasets(path, file, one, wanted)) for one in outlines})


def _datasets(
    path: Path, file: h5py.File, outline: Outline, wanted: Callable[[Dataset], bool]
) -> Iterator[tuple[str, Dataset]]:
    for name in (*outline.scales, *outline.datasets):
        found = _dataset(path, file, f"{outline.path}/{name}")
        if wanted(found):
            yield name, found


def _outlines(file: h5py.File) -> dict[str, Outline]:
    found: dict[str, _Open] = {}
    for path, node in walk(file):
        above, _, name = path.rpartition("/")
        if not is_dataset(node):
            found[path] = _Open({}, {}, [], _attributes(node))
        if above in found:
            found[above].add(name, node)
    return {path: Outline(path, one.datasets, one.scales, tuple(one.groups), one.about) for path, one in found.items()}


@dataclass
class _Open:
    """An outline while its group is walked through."""

    datasets: dict[str, tuple[int, ...]]
    scales: dict[str, tuple[int, ...]]
    groups: list[str]
    about: dict[str, About]

    def add(self, name: str, node: Any) -> None:
        """Take note of an object in the group."""
        from h5py import h5ds

        if is_dataset(node):
            (self.scales if h5ds.is_scale(node) else self.datasets)[name] = tuple(node.shape)
        else:
            self.groups.append(name)


def _attributes(node: Any) -> dict[str, About]:
    """Return the attributes of a group: texts, numbers and lists of texts; raises LayoutError."""
    import h5py

    group = h5py.Group(node)
    return {name: _about(name, held(group, name)) for name in group.attrs}


def _about(name: str, value: Any) -> About:
    """Return an attribute of a group as a text, a number or texts; raises LayoutError."""
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "OSU":
        return tuple(str(scalar(name, item)) for item in value)
    plain = scalar(name, value)
    return plain if isinstance(plain, str) else float(plain)
