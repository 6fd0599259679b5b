"""Write and read datasets with units and scales in an open HDF5 group: types, compression, layout.

What is written is what h5py would write: the same types, no time stamp. Only the place differs: a small array stands in
its header, and a series is compressed.

The last axis of a series is time (or frequency). Every group carries its own scales, so that each opens by
itself in xarray; a subgroup's agree with those of the groups above it, so that the file opens as a tree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rths_cli.files.compressed_chunks import LEVEL, chunk_at, chunk_length, put_chunk, write_chunks
from rths_cli.files.hdf5_safety import walk
from rths_cli.quantities import AXES, DatasetDeclaration, Interval, Source
from rths_cli.quantities.declaration import ROUNDED_BITS

if TYPE_CHECKING:
    import h5py
    from h5py.h5a import AttrID
    from h5py.h5d import DatasetID
    from h5py.h5g import GroupID
    from h5py.h5p import PropDCID
    from h5py.h5s import SpaceID
    from h5py.h5t import TypeID

LEAST_COMPRESSED = 4096
SHORTEST = 64  # a row of fewer values is no chunk
IN_HEADER_BYTES = 2048


class _Kit(NamedTuple):
    """Types, spaces and properties that every dataset and text share, and the calls that make them: an import in a
    function costs as much as either."""

    attribute: Callable[..., AttrID]
    dataset: Callable[..., DatasetID]
    all: int
    text: TypeID
    text_in_memory: TypeID
    single: SpaceID
    plain: PropDCID
    in_header: PropDCID


def add_text(node: DatasetID | GroupID, name: str, text: str) -> None:
    """Add a new attribute holding a text."""
    kit = _kit()
    held = np.empty((), dtype=object)
    held[()] = text
    kit.attribute(node, name.encode(), kit.text, kit.single).write(held, mtype=kit.text_in_memory)


def _add_numbers(node: DatasetID, name: str, values: ArrayLike) -> None:
    """Add a new attribute holding a number or an array of numbers."""
    held = np.array(values, dtype=float)
    _kit().attribute(node, name.encode(), _stored_type(held.dtype), _space(held.shape)).write(held)


def text(node: DatasetID, name: str) -> str:
    """Return the text that an attribute holds; raises KeyError where there is none."""
    from h5py import h5a

    held = np.empty((), dtype=object)
    h5a.open(node, name.encode()).read(held, mtype=_kit().text_in_memory)
    value = held.item()
    return value.decode() if isinstance(value, bytes) else str(value)


def numbers(node: DatasetID) -> NDArray[np.float64]:
    """Return the numbers of a dataset."""
    kit, held = _kit(), np.empty(node.shape)
    node.read(kit.all, kit.all, held, mtype=_stored_type(held.dtype))
    return held


def datasets(file: h5py.File, below: str = "") -> Iterator[tuple[str, DatasetID]]:
    """Yield the datasets below a group, without scales, with their paths; raises LayoutError."""
    from h5py import h5d, h5ds

    for path, node in walk(file, below):
        if isinstance(node, h5d.DatasetID) and not h5ds.is_scale(node):
            yield path, node


def add_dataset(group: GroupID, name: str, data: NDArray[Any]) -> DatasetID:
    """Add a dataset of numbers or texts."""
    kit, space = _kit(), _space(data.shape)
    if data.dtype.kind in "OSU":
        node = kit.dataset(group, name.encode(), kit.text, space, kit.plain)
        node.write(kit.all, kit.all, data.astype(object), mtype=kit.text_in_memory)
        return node
    stored = _stored_type(data.dtype)
    node = kit.dataset(group, name.encode(), stored, space, _layout(data))
    if is_long(data):
        write_chunks(node, data)
    else:
        node.write(kit.all, kit.all, np.asarray(data, order="C"), mtype=stored)
    return node


def add_copy(group: GroupID, name: str, like: DatasetID) -> DatasetID:
    """Add a dataset with the numbers of another; compressed ones are copied as they stand in the file."""
    from h5py import h5d

    node = h5d.create(group, name.encode(), like.get_type(), like.get_space(), like.get_create_plist())
    for i in range(like.get_num_chunks()):
        place = like.get_chunk_info(i).chunk_offset
        mask, packed = chunk_at(like, place)
        put_chunk(node, place, packed, mask)
    return node


def is_compressed(node: DatasetID) -> bool:
    """Return whether a dataset stands in compressed chunks."""
    return bool(node.get_create_plist().get_nfilters())


@cache
def _kit() -> _Kit:
    import h5py
    from h5py import h5a, h5d, h5p, h5s, h5t

    plain = h5p.create(h5p.DATASET_CREATE)
    plain.set_obj_track_times(False)
    in_header = plain.copy()
    in_header.set_layout(h5d.COMPACT)
    text = h5py.string_dtype()
    types = h5t.py_create(text, logical=True), h5t.py_create(text)
    return _Kit(h5a.create, h5d.create, h5s.ALL, *types, h5s.create(h5s.SCALAR), plain, in_header)


@lru_cache(maxsize=64)
def _space(shape: tuple[int, ...]) -> SpaceID:
    from h5py import h5s

    return h5s.create_simple(shape)


@cache
def _stored_type(dtype: np.dtype[Any]) -> TypeID:
    from h5py import h5t

    return h5t.py_create(dtype)


def _layout(data: NDArray[Any]) -> PropDCID:
    """Return where and how the values of a dataset stand in the file."""
    if not is_long(data):
        return _kit().in_header if data.nbytes <= IN_HEADER_BYTES else _kit().plain
    chunked = _kit().plain.copy()
    chunked.set_chunk((1,) * (data.ndim - 1) + (chunk_length(data.shape[-1]),))
    chunked.set_shuffle()
    chunked.set_deflate(LEVEL)
    return chunked


def is_long(data: NDArray[Any]) -> bool:
    """Return whether an array is compressed."""
    return data.size >= LEAST_COMPRESSED and data.shape[-1] >= SHORTEST


SOURCES = get_args(Source)
INTERVAL = ("low", "high", "probability")
"""Attributes of a metric that carries an interval; the ends have the shape of the metric."""
Written = MutableMapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Dataset:
    """Hold what one HDF5 dataset states: values, unit, meaning, origin and (optional) the names of its axes.

    `data`: number, text or array, real or complex, time on the last axis. `dims` names one scale per axis;
    empty means the scales of the group whose lengths fit. A name without a scale becomes an index from 1.
    `definition` becomes an attribute where it is stated, `interval` the three of INTERVAL.
    """

    data: ArrayLike
    units: str
    long_name: str
    source: Source
    dims: tuple[str, ...] = ()
    definition: str = ""
    interval: Interval | None = None  # of a metric


def as_declared(
    declared: DatasetDeclaration, value: ArrayLike, remarks: tuple[str, ...] = (), single: bool = False
) -> Dataset:
    """Return a value with what is declared of it, in single precision where asked.

    Raises ValueError where it is of another kind or has other axes.
    """
    data, about = declared.checked(value), declared.meaning(remarks)
    if declared.follows:
        data = _rounded(data)
    if single:
        data = data.astype(np.float32)
    return Dataset(data, declared.units, about, declared.source, declared.axes)


def _rounded(rows: NDArray[Any]) -> NDArray[Any]:
    """Return rows (..., n) to ROUNDED_BITS binary digits of each row's largest value; zeros below compress away."""
    largest = np.max(np.abs(rows), axis=-1, keepdims=True, initial=0.0, where=np.isfinite(rows))
    step = np.ldexp(1.0, np.frexp(largest)[1] - ROUNDED_BITS)
    return np.asarray(np.rint(rows / step) * step)


def write_group(
    group: h5py.Group, datasets: Mapping[str, Dataset], scales: Mapping[str, Dataset], written: Written | None = None
) -> None:
    """Write scales, then datasets attached to them; complex data become NAME_real and NAME_imag.

    `written` holds the values of the file's scales by their path and takes new ones; without it they are read from the
    file. Raises ValueError when an axis fits no scale, or a scale of that name exists with other values.
    """
    axes = _Axes(group, _scales_around(group) if written is None else written)
    for name, scale in scales.items():
        axes.add(name, scale)
    sizes = {name: int(np.size(np.asarray(scale.data))) for name, scale in scales.items()}
    for name, item in _real_parts(datasets).items():
        shape = np.shape(np.asarray(item.data))
        dims = item.dims or match_axes(f"{axes.path}/{name}", shape, sizes)
        if len(dims) != len(shape):
            raise ValueError(f"{axes.path}/{name} has {len(shape)} axes, dims names {len(dims)}.")
        node = _create(axes.path, group, name, item)
        for axis, dim in enumerate(dims):
            axes.attach(f"{axes.path}/{name}", node, axis, shape[axis], dim)


class _Axes:
    """The scales of one group: what was written of them, and those open."""

    def __init__(self, group: h5py.Group, written: Written) -> None:
        self.path = group.name.rstrip("/")
        self._group, self._written = group, written
        self._open: dict[str, DatasetID] = {}

    def add(self, name: str, scale: Dataset) -> None:
        """Write a dimension scale, once; raise ValueError where it or its like above has other values."""
        from h5py import h5ds

        values = np.asarray(scale.data)
        for above in _upwards(self.path):
            known = self._written.get(f"{above}/{name}")
            if known is not None and known is not values and not np.array_equal(known, values):
                raise ValueError(f"{above}/{name} has other values than in {self.path}; name the axis otherwise.")
        if f"{self.path}/{name}" not in self._written:
            self._open[name] = _create(self.path, self._group, name, scale, self._twin(name, values))
            h5ds.set_scale(self._open[name], name.encode())
            self._written[f"{self.path}/{name}"] = values

    def _twin(self, name: str, values: NDArray[Any]) -> DatasetID | None:
        """Return a compressed scale of that name with the same values: the record's time is compressed once."""
        from h5py import h5d

        if values.size < LEAST_COMPRESSED:
            return None
        for path, known in self._written.items():
            if path.endswith(f"/{name}") and known.dtype == values.dtype and np.array_equal(known, values):
                node = h5d.open(self._group.id, path.encode())
                return node if is_compressed(node) else None
        return None

    def attach(self, path: str, node: DatasetID, axis: int, length: int, name: str) -> None:
        """Attach a scale to an axis of the dataset `path`; a name without a scale becomes an index from 1."""
        from h5py import h5d, h5ds

        if f"{self.path}/{name}" not in self._written:
            about = AXES[name].text if name in AXES and AXES[name].counted else f"{name}, counted from 1"
            self.add(name, Dataset(np.arange(1, length + 1), "1", about, "computed"))
        if self._written[f"{self.path}/{name}"].shape != (length,):
            raise ValueError(f"{path}: axis {axis} has {length} values, scale {name} does not.")
        if name not in self._open:
            self._open[name] = h5d.open(self._group.id, name.encode())
        h5ds.attach_scale(node, self._open[name], axis)


def _upwards(path: str) -> Iterator[str]:
    """Yield the path of a group and of every group above it, the root's being empty."""
    yield path
    while path:
        path = path.rpartition("/")[0]
        yield path


def _scales_around(group: h5py.Group) -> dict[str, NDArray[Any]]:
    """Return the values of the scales in a group and in those above it by their paths."""
    found = {}
    for path in _upwards(group.name.rstrip("/")):
        for name, node in group.file[path or "/"].items():
            if getattr(node, "is_scale", False):
                found[f"{path}/{name}"] = node[()]
    return found


def scales_of(file: h5py.File) -> dict[str, NDArray[Any]]:
    """Return the values of every scale in a file by its path."""
    found: dict[str, NDArray[Any]] = {}

    def collect(name: str, node: Any) -> None:
        if getattr(node, "is_scale", False):
            found[f"/{name}"] = node[()]

    file.visititems(collect)
    return found


def _create(path: str, group: h5py.Group, name: str, item: Dataset, like: DatasetID | None = None) -> DatasetID:
    """Create one dataset with its attributes; `like` has its values already.

    Raises ValueError when units, long_name or source is missing.
    """
    if not item.units or not item.long_name or item.source not in SOURCES:
        raise ValueError(f"{path}/{name} needs units, long_name and a source among {', '.join(SOURCES)}.")
    node = add_copy(group.id, name, like) if like else add_dataset(group.id, name, np.asarray(item.data))
    add_text(node, "units", item.units)
    add_text(node, "long_name", item.long_name)
    add_text(node, "source", item.source)
    if item.definition:
        add_text(node, "definition", item.definition)
    if item.interval is not None:
        for key in INTERVAL:
            _add_numbers(node, key, getattr(item.interval, key))
    return node


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
