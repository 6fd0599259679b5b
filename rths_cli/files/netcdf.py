"""Write groups of datasets as a netCDF-4 file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.files.hdf5 import Dataset, Written, add_text, write_group
from rths_cli.files.staged_file import new_hdf5


@dataclass(frozen=True)
class NetcdfGroup:
    """One group to be written: variables and the scales of their axes by name, attributes.

    `comments` stands in the place of the unit of a variable that has none the format knows.
    """

    path: str
    variables: Mapping[str, Dataset]
    scales: Mapping[str, Dataset]
    attributes: Mapping[str, Any]
    comments: Mapping[str, str]


def write_netcdf(path: Path, attributes: Mapping[str, Any], groups: Iterable[NetcdfGroup]) -> None:
    """Write a file; what is the same has the same bytes. Raises OSError or RuntimeError where the disk refuses."""
    written: Written = {}
    with new_hdf5(path) as file:
        _add_attributes(file, attributes)
        for group in groups:
            node = file.require_group(group.path)
            write_group(node, group.variables, group.scales, written)
            _add_attributes(node, group.attributes)
            for name, comment in group.comments.items():
                del node[name].attrs["units"]
                node[name].attrs["comment"] = comment


def _add_attributes(node: Any, attributes: Mapping[str, Any]) -> None:
    """Add numbers, texts and lists of texts."""
    import h5py

    for key, value in attributes.items():
        if isinstance(value, str):
            add_text(node.id, key, value)
        else:
            node.attrs[key] = np.array(value, dtype=h5py.string_dtype()) if isinstance(value, tuple) else value
