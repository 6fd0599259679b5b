"""Datasets and texts in an HDF5 file by the library's own calls: for small ones h5py's shell costs many times as much.

What is written is what h5py would write: the same types, no time stamp. Only the place differs: a small array stands in
its header, and a series is compressed where that halves it.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rths_cli.files.hdf5_layout import walk

if TYPE_CHECKING:
    import h5py
    from h5py.h5a import AttrID
    from h5py.h5d import DatasetID
    from h5py.h5g import GroupID
    from h5py.h5p import PropDCID
    from h5py.h5s import SpaceID
    from h5py.h5t import TypeID

CHUNK = 16384
LEAST_COMPRESSED = 8192
SHORTEST = 64  # a row of fewer values is no chunk
PROBE = 1024
WORTH_COMPRESSING = 0.5  # gzip takes up to 25 ms for a series of 108,000 samples, writing it takes half a millisecond
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
    if data.dtype.kind in "US":
        node = kit.dataset(group, name.encode(), kit.text, space, kit.plain)
        node.write(kit.all, kit.all, data.astype(object), mtype=kit.text_in_memory)
        return node
    stored = _stored_type(data.dtype)
    node = kit.dataset(group, name.encode(), stored, space, _layout(data))
    node.write(kit.all, kit.all, np.asarray(data, order="C"), mtype=stored)
    return node


def add_copy(group: GroupID, name: str, like: DatasetID) -> DatasetID:
    """Add a dataset with the numbers of another; compressed ones are copied as they stand in the file."""
    from h5py import h5d

    node = h5d.create(group, name.encode(), like.get_type(), like.get_space(), like.get_create_plist())
    for i in range(like.get_num_chunks()):
        place = like.get_chunk_info(i).chunk_offset
        mask, packed = like.read_direct_chunk(place)
        node.write_direct_chunk(place, packed, mask)
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
    if not compresses_well(data):
        return _kit().in_header if data.nbytes <= IN_HEADER_BYTES else _kit().plain
    chunked = _kit().plain.copy()
    chunked.set_chunk((1,) * (data.ndim - 1) + (min(CHUNK, data.shape[-1]),))
    chunked.set_shuffle()
    chunked.set_deflate(1)
    return chunked


def compresses_well(data: NDArray[Any]) -> bool:
    """Return whether gzip halves an array, judged by 1024 values from its middle."""
    if data.size < LEAST_COMPRESSED or data.shape[-1] < SHORTEST:
        return False
    start = (data.size - PROBE) // 2
    sample = np.ascontiguousarray(data.reshape(-1)[start : start + PROBE])
    shuffled = sample.view(np.uint8).reshape(PROBE, -1).T.tobytes()
    return len(zlib.compress(shuffled, 1)) < WORTH_COMPRESSING * len(shuffled)
