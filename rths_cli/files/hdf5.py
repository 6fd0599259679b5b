"""Datasets with units and dimension scales in an open HDF5 group: the only place that knows HDF5's ways.

The last axis of a series is time (or frequency). Every group carries its own scales, so that each opens by
itself in xarray; a subgroup's agree with those of the groups above it, so that the file opens as a tree.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import h5py

Source = Literal["computed", "measured", "estimated", "true"]
SOURCES = ("computed", "measured", "estimated", "true")
CHUNK = 16384
PROBE = 8192
WORTH_COMPRESSING = 0.75  # gzip spends about 17 ms on a series of 108,000 samples: only where it saves a quarter


@dataclass(frozen=True)
class Dataset:
    """Hold what one HDF5 dataset states: values, unit, meaning, origin and (optional) the names of its axes.

    `data`: number, text or array, real or complex, time on the last axis. `dims` names one scale per axis;
    empty means the scales of the group whose lengths fit. A name without a scale becomes an index from 1.
    """

    data: ArrayLike
    units: str
    long_name: str
    source: Source
    dims: tuple[str, ...] = ()


def write_group(group: h5py.Group, datasets: Mapping[str, Dataset], scales: Mapping[str, Dataset]) -> None:
    """Write scales, then datasets attached to them; complex data become NAME_real and NAME_imag.

    Raises ValueError when an axis fits no scale, or a scale of that name exists with other values.
    """
    for name, scale in scales.items():
        write_scale(group, name, scale)
    sizes = {name: int(np.size(np.asarray(scale.data))) for name, scale in scales.items()}
    for name, item in _real_parts(datasets).items():
        shape = np.shape(np.asarray(item.data))
        dims = item.dims or match_axes(f"{group.name}/{name}", shape, sizes)
        node = create(group, name, item)
        _attach(group, node, dims)


def write_scale(group: h5py.Group, name: str, scale: Dataset) -> None:
    """Write a dimension scale, once; raise ValueError where it or its like above has other values."""
    for above in _upwards(group):
        if name in above and not np.array_equal(above[name][()], np.asarray(scale.data)):
            raise ValueError(f"{above.name}/{name} has other values than in {group.name}; name the axis otherwise.")
    if name not in group:
        create(group, name, scale).make_scale(name)


def _upwards(group: h5py.Group) -> Iterator[h5py.Group]:
    """Yield the group and every group above it."""
    yield group
    while group.name != "/":
        group = group.parent
        yield group


def create(group: h5py.Group, name: str, item: Dataset) -> h5py.Dataset:
    """Create one dataset with units, long_name and source and no time stamp, compressed where that pays.

    Raises ValueError when units, long_name or source is missing.
    """
    import h5py

    if not item.units or not item.long_name or item.source not in SOURCES:
        raise ValueError(f"{group.name}/{name} needs units, long_name and a source among {', '.join(SOURCES)}.")
    data: NDArray[Any] = np.asarray(item.data)
    if data.dtype.kind in "US":
        node = group.create_dataset(name, data=data.astype(object), dtype=h5py.string_dtype(), track_times=False)
    elif compresses_well(data):
        chunks = (1,) * (data.ndim - 1) + (min(CHUNK, data.shape[-1]),)
        node = group.create_dataset(
            name,
            data=data,
            chunks=chunks,
            compression="gzip",
            compression_opts=1,
            shuffle=True,
            track_times=False,
        )
    else:
        node = group.create_dataset(name, data=data, track_times=False)
    node.attrs.update({"units": item.units, "long_name": item.long_name, "source": item.source})
    return node


def compresses_well(data: NDArray[Any]) -> bool:
    """Return whether gzip saves a quarter, judged by 8192 values from the middle of the array."""
    if data.size < PROBE:
        return False
    start = (data.size - PROBE) // 2
    sample = np.ascontiguousarray(data.reshape(-1)[start : start + PROBE])
    shuffled = sample.view(np.uint8).reshape(PROBE, -1).T.tobytes()
    return len(zlib.compress(shuffled, 1)) < WORTH_COMPRESSING * len(shuffled)


def match_axes(name: str, shape: tuple[int, ...], sizes: Mapping[str, int]) -> tuple[str, ...]:
    """Return a scale for every axis by length: time_s for the last axis where it fits, never for another.

    Raises ValueError for an axis that fits no scale.
    """
    dims: list[str] = []
    for axis, length in enumerate(shape):
        last = axis == len(shape) - 1
        fitting = [key for key, size in sizes.items() if size == length and key not in dims]
        fitting = [key for key in fitting if last or key != "time_s"]
        if not fitting:
            raise ValueError(f"{name}: axis {axis} of length {length} fits no scale; name it in dims or scales.")
        dims.append("time_s" if last and "time_s" in fitting else fitting[0])
    return tuple(dims)


def _attach(group: h5py.Group, node: h5py.Dataset, dims: tuple[str, ...]) -> None:
    """Attach a scale to every axis; names without a scale become an index from 1."""
    if len(dims) != node.ndim:
        raise ValueError(f"{node.name} has {node.ndim} axes, dims names {len(dims)}.")
    for axis, name in enumerate(dims):
        if name not in group:
            write_scale(group, name, _index(name, node.shape[axis]))
        if group[name].shape != (node.shape[axis],):
            raise ValueError(f"{node.name}: axis {axis} has {node.shape[axis]} values, scale {name} does not.")
        node.dims[axis].attach_scale(group[name])


def _index(name: str, length: int) -> Dataset:
    """Return the scale 1, 2, ... of an axis that counts something."""
    return Dataset(np.arange(1, length + 1), "1", f"{name}, counted from 1", "computed")


def _real_parts(datasets: Mapping[str, Dataset]) -> dict[str, Dataset]:
    """Return the datasets with complex ones split into NAME_real and NAME_imag."""
    result: dict[str, Dataset] = {}
    for name, item in datasets.items():
        data = np.asarray(item.data)
        if np.iscomplexobj(data):
            result[f"{name}_real"] = replace(item, data=data.real, long_name=f"{item.long_name}, real part")
            result[f"{name}_imag"] = replace(item, data=data.imag, long_name=f"{item.long_name}, imaginary part")
        else:
            result[name] = item
    return result
