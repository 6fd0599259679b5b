"""Check the structure of any HDF5 file before its use (links, sizes, types); all reading goes through it.

A file may come from anywhere. Its links must lead to its own objects, and not in a circle; a dataset holds numbers or
texts, with the bytes it declares in the file itself; an attribute is one text or one finite number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rths_cli.safe_text import LONGEST_NAME

if TYPE_CHECKING:
    import h5py
    from h5py.h5d import DatasetID
    from h5py.h5g import GroupID

DEEPEST = 8  # groups inside each other
MOST_OBJECTS = 20_000
MOST_AXES = 3
MOST_BYTES = 1 << 31  # of a dataset
MOST_TEXTS = 1 << 20  # one for each run of the largest sweep
BEST_COMPRESSION = 1100  # deflate makes a byte of 1032 at best
SMALL_BYTES = 1 << 20  # a dataset that was never written takes no more than this
LARGEST = 1e100  # of a stored number: its square is a number, too
MOST_ATTRIBUTES = 200
MOST_ATTRIBUTE_BYTES = 1 << 20


class LayoutError(ValueError):
    """A file is not what it must be: a clause about the file ("holds a link to ...")."""


def size_of(file: h5py.File) -> int:
    """Return how many bytes an open file has."""
    return int(file.id.get_filesize())


def walk(file: h5py.File, below: str = "") -> Iterator[tuple[str, GroupID | DatasetID]]:
    """Yield every object below the root, or below a group, with its path from there, a group before what is in it;
    raises LayoutError."""
    size, library = size_of(file), _library()
    start = part(file, below) if below else file.id
    count, inside = 0, [(start, "", iter(start))] if isinstance(start, library.group) else []
    while inside:
        group, above, names = inside[-1]
        raw = next(names, None)
        if raw is None:
            inside.pop()
            continue
        count += 1
        if count > MOST_OBJECTS or len(inside) > DEEPEST:
            raise LayoutError(f"holds groups in a circle, more than {DEEPEST} inside each other, or too many objects")
        name = above + _name(raw)
        node = _member(group, raw, name, size)
        yield name, node
        if isinstance(node, library.group):
            inside.append((node, f"{name}/", iter(node)))


def part(file: h5py.File, path: str) -> GroupID | DatasetID | None:
    """Return the object at a path, None where there is none; raises LayoutError."""
    node: Any = file.id
    done, size, library = "", size_of(file), _library()
    for name in path.strip("/").split("/"):
        raw = name.encode(errors="surrogateescape")
        if isinstance(node, library.dataset) or raw not in node:
            return None
        done = f"{done}/{name}".lstrip("/")
        node = _member(node, raw, done, size)
    return node


def is_dataset(node: Any) -> bool:
    """Tell whether an object is a dataset."""
    return isinstance(node, _library().dataset)


def check_storage(node: DatasetID, path: str, size: int) -> None:
    """Raise LayoutError for a dataset whose values are not in its file of `size` bytes, or that declares more of them
    than the file holds."""
    plan = node.get_create_plist()
    if plan.get_external_count() or plan.get_layout() not in _library().layouts:
        raise LayoutError(f"keeps the values of {path} in another file")
    declared = math.prod(node.shape or (0,)) * node.get_type().get_size()
    if declared <= SMALL_BYTES:
        return
    stored = node.get_storage_size()
    if declared > min(MOST_BYTES, BEST_COMPRESSION * stored) or stored > size:
        raise LayoutError(f"declares {declared / 1e6:.0f} MB in {path}, and does not hold them")


def attributes(node: Any, any_number: bool = False) -> dict[str, str | int | float]:
    """Return the attributes of a file or group: texts and finite numbers, or any numbers; raises LayoutError for
    anything else."""
    if len(node.attrs) > MOST_ATTRIBUTES:
        raise LayoutError(f"has more than {MOST_ATTRIBUTES} attributes")
    return {name: _attribute(node, name, any_number) for name in node.attrs}


def attribute(node: Any, name: str) -> str | int | float | None:
    """Return one attribute, None where there is none; raises LayoutError for one that is no text or finite number."""
    return _attribute(node, name) if name in node.attrs else None


def held(node: Any, name: str) -> Any:
    """Return what an attribute holds, numbers or texts; raises LayoutError for anything else.

    It is not even read: the library dies of a list whose declaration is damaged.
    """
    stored, library = node.attrs.get_id(name), _library()
    if stored.get_type().get_class() not in (*library.numbers, library.text) or (
        stored.get_storage_size() > MOST_ATTRIBUTE_BYTES
    ):
        raise LayoutError(f"has an attribute {name[:LONGEST_NAME]!r} that holds neither texts nor numbers")
    return node.attrs[name]


def _attribute(node: Any, name: str, any_number: bool = False) -> str | int | float:
    if node.attrs.get_id(name).shape != ():
        raise LayoutError(f"has an attribute {name[:LONGEST_NAME]!r} that is neither a text nor a finite number")
    return scalar(name, held(node, name), any_number)


def values_of(node: GroupID | DatasetID | None, path: str, any_number: bool = False) -> Any:
    """Return the text, the texts or the numbers of a dataset (any with `any_number`); raises LayoutError."""
    import h5py

    if not isinstance(node, _library().dataset):
        raise LayoutError(f"holds no dataset {path}")
    dataset = h5py.Dataset(node)
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return dataset.asstr()[()]
    if any_number:
        return dataset[()]
    found = quiet(dataset[()])
    check_numbers(path, found)
    return found


def quiet(values: Any) -> Any:
    """Return numbers with every NaN a quiet one: damaged bytes make signalling ones, of which arithmetic complains."""
    return np.where(np.isnan(values), np.nan, values)[()] if values.dtype.kind == "f" else values


def scalar(name: str, value: Any, any_number: bool = False) -> str | int | float:
    """Return an attribute as a text or a finite number, or any number; raises LayoutError."""
    plain = value.item() if isinstance(value, np.generic) else value
    plain = plain.decode() if isinstance(plain, bytes) else plain
    if isinstance(plain, str) or (isinstance(plain, int | float) and (any_number or abs(plain) <= LARGEST)):
        return plain
    raise LayoutError(f"has an attribute {name[:LONGEST_NAME]!r} that is neither a text nor a finite number")


def check_numbers(path: str, values: Any) -> None:
    """Raise LayoutError for numbers beyond any physical range; NaN and infinite ones say that there is none."""
    found = np.asarray(values)
    if found.dtype.kind not in "iufb":
        raise LayoutError(f"holds something else than numbers in {path}")
    if np.any(np.isfinite(found) & (np.abs(found.astype(float, copy=False)) > LARGEST)):
        raise LayoutError(f"holds a number beyond {LARGEST:g} in {path}")


def member(values: Mapping[str, Any], name: str, kind: type | tuple[type, ...]) -> Any:
    """Return a value by its name; raises LayoutError where it is missing or of another kind."""
    if not isinstance(values.get(name), kind) or isinstance(values[name], bool):
        raise LayoutError(f"has no proper {name}")
    return values[name]


def _name(raw: bytes) -> str:
    name = raw.decode(errors="surrogateescape")
    if len(name) > LONGEST_NAME or not name.isprintable():
        raise LayoutError(f"has an object with the name {name[:40]!r}")
    return name


class _Library(NamedTuple):
    """What is asked of h5py for every object: an import in a function costs as much."""

    open: Any
    group: Any
    dataset: Any
    hard_link: int
    layouts: tuple[int, ...]
    numbers: tuple[int, ...]
    text: int


@cache
def _library() -> _Library:
    from h5py import h5d, h5g, h5l, h5o, h5t

    layouts, numbers = (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED), (h5t.INTEGER, h5t.FLOAT, h5t.ENUM)
    return _Library(h5o.open, h5g.GroupID, h5d.DatasetID, h5l.TYPE_HARD, layouts, numbers, h5t.STRING)


def _member(group: GroupID, raw: bytes, path: str, size: int) -> GroupID | DatasetID:
    """Open one object of a group that is really in it."""
    library = _library()
    if group.links.get_info(raw).type != library.hard_link:
        raise LayoutError(f"holds a link to another place or file at {path}")
    node = library.open(group, raw)
    if isinstance(node, library.dataset):
        _check_dataset(node, path, size)
    elif not isinstance(node, library.group):
        raise LayoutError(f"holds neither data nor a group at {path}")
    return node


def _check_dataset(node: DatasetID, path: str, size: int) -> None:
    library, kind, shape = _library(), node.get_type().get_class(), node.shape
    if (kind not in library.numbers and kind != library.text) or shape is None or len(shape) > MOST_AXES:
        raise LayoutError(f"holds something else than numbers or texts in {path}")
    if kind == library.text and math.prod(shape) > MOST_TEXTS:
        raise LayoutError(f"holds more than {MOST_TEXTS} texts in {path}")
    check_storage(node, path, size)
