"""Model files (HDF5, format version 1): write and read an identification's datasets, with a hash of the content.

A file is built in memory, written under a temporary name in its own folder and renamed, so that a file with the
final name is always whole. It begins with an HDF5 user block of 512 bytes, a line of text with the SHA-256 of all
bytes after it: the HDF5 library can hang on damaged bytes, so it never sees any. Numbers are stored as float64; the
only integers are the index scales of axes that have no scale of their own (pole 1, 2, ...), which are no content.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files import hdf5_safety as layout
from rths_cli.files.durable_files import Stamp, make_folder, open_regular, part_of, publish
from rths_cli.files.hdf5 import Dataset, numbers, write_group
from rths_cli.files.hdf5_opening import HELD, RESTORE, SIGNATURE, is_held, unreadable
from rths_cli.files.result_writer import Attribute, refusal

if TYPE_CHECKING:
    import h5py
    from h5py.h5d import DatasetID

FORMAT = "rths-model"
FORMAT_VERSION = 1
HASH = "sha256"
HEADER = ("format", "format_version", HASH)
NOT_HASHED = ("created_utc", "path")
PARTS = ("_real", "_imag")
BLOCK = 512
END_OF_FILE = 40  # place of the file's size in a superblock of version 0 (HDF5 File Format Specification 3.0, II.A)
MOST_BYTES = 100_000_000
LEAD = b"rths-model, SHA-256 of all bytes after the first 512: "
RESULT = b"rths-result"
AGAIN = f"{RESTORE}."
WANTED = "give a model file written by rths identify."

Contents = dict[str, dict[str, Any]]
"""Group name -> dataset name -> float, complex, text, tuple of texts, float64 or complex128 array."""


@dataclass(frozen=True)
class ModelFile:
    """Hold what a model file states: `attributes` and `groups` as they were given to `write_model`.

    `groups`: group name ("table/best") -> dataset name -> number, text, tuple of texts, or float64 or complex128
    array, bit for bit. `sha256` is the hash of the content, which does not depend on when and where it was written.
    """

    path: Path
    attributes: dict[str, Attribute]
    groups: Contents
    sha256: str


class Written(NamedTuple):
    """Where a model was written, and the hash of its content."""

    path: Path
    sha256: str


def write_model(
    path: Path,
    attributes: Mapping[str, Attribute],
    groups: Mapping[str, Mapping[str, Dataset]],
    replaces: Stamp | Literal["any"] = "any",
) -> Written:
    """Write a model file, folders above it included, and return its name and the hash of its content.

    It takes the place of any file of that name, or of that with the stamp `replaces` alone: another one stays, and the
    model gets the next free name.

    A dataset that another one of its group (or itself) names in `dims` is a scale; complex data become NAME_real
    and NAME_imag. Raises InputError when the disk refuses; ValueError for a name that cannot be read back, a missing
    unit, or an axis that fits no scale.
    """
    path = Path(path)
    stated = {name: _plain(value) for name, value in attributes.items()}
    canonical = {group: _canonical(group, datasets) for group, datasets in groups.items() if datasets}
    if reserved := [name for name in HEADER if name in stated]:
        raise ValueError(f"attribute {reserved[0]} belongs to the file format; name it otherwise.")
    sha256 = _content_hash(stated, {group: _values(datasets) for group, datasets in canonical.items()})
    image = _image({**stated, "format": FORMAT, "format_version": FORMAT_VERSION, HASH: sha256}, canonical)
    try:
        with suppress(FileExistsError):  # a file in the folder's place: opening the part says so better
            make_folder(path.parent)
        name = _publish(path, image, replaces)
    except OSError as error:
        sentence = refusal(path, "cannot write the model file", error, advice=False).removesuffix(".")
        raise InputError(f"{sentence}; free space or choose another folder.") from error
    return Written(name, sha256)


def read_model(path: Path) -> ModelFile:
    """Read a model file; raise InputError unless it is whole, of a known version, and as it was written."""
    path = Path(path)
    image = _unsealed(path)
    attributes, groups = _contents(path, image)
    stated = {name: value for name, value in attributes.items() if name not in HEADER}
    sha256 = _content_hash(stated, groups)
    if attributes[HASH] != sha256:
        raise InputError(f"{path}: holds other content than its attribute {HASH} says; {AGAIN}")
    return ModelFile(path, stated, groups, sha256)


def _canonical(group: str, datasets: Mapping[str, Dataset]) -> dict[str, Dataset]:
    """Return datasets of float64, complex128 or text; raise ValueError for names that cannot be read back."""
    for name in datasets:
        if not all(group.split("/")) or not name or "/" in name or name.endswith(PARTS):
            raise ValueError(
                f"{group}/{name} cannot be read back: a part is empty, or the name ends with _real, _imag."
            )
    return {name: dataclasses.replace(item, data=_data(item)) for name, item in datasets.items()}


def _data(item: Dataset) -> Any:
    """Return the values of a dataset in the type they are stored in."""
    data: Any = np.asarray(item.data)
    return data if data.dtype.kind == "U" else data.astype(complex if np.iscomplexobj(data) else float)


def _values(datasets: Mapping[str, Dataset]) -> dict[str, Any]:
    """Return the values of datasets as `read_model` gives them back."""
    return {name: _value(item.data) for name, item in datasets.items()}


def _value(data: Any) -> Any:
    """Return an array without axes as number or text, texts as a tuple."""
    if np.ndim(data) == 0:
        return data.item() if isinstance(data, np.ndarray | np.generic) else data
    return tuple(data.tolist()) if data.dtype.kind in "UO" else data


def _image(attributes: Mapping[str, Attribute], groups: Mapping[str, Mapping[str, Dataset]]) -> bytes:
    """Return the bytes of the HDF5 file; groups are written from the root down, so that scales are compared."""
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=BLOCK) as file:
        file.attrs.update(dict(sorted(attributes.items())))
        for name in sorted(groups):
            datasets = dict(groups[name])
            named = {axis for item in datasets.values() for axis in item.dims}
            scales = {axis: datasets.pop(axis) for axis in sorted(named) if axis in datasets}
            write_group(file.require_group(name), datasets, scales)
    after = buffer.getvalue()[BLOCK:]
    return _block(after) + after


def _block(after: bytes) -> bytes:
    """Return the user block that goes with the bytes after it."""
    return (LEAD + hashlib.sha256(after).hexdigest().encode() + b"\n").ljust(BLOCK, b"\0")


def _publish(path: Path, image: bytes, seen: Stamp | Literal["any"]) -> Path:
    """Write bytes under a temporary name, rename and return the name; whatever happens, no part stays unless the
    process is killed."""
    part = part_of(path)
    try:
        with open(part, "wb") as file:
            file.write(image)
            file.flush()
            os.fsync(file.fileno())
        return publish(part, path, seen)
    except BaseException:  # a signal too must leave no half file
        with suppress(OSError):
            part.unlink()
        raise


def _unsealed(path: Path) -> bytes:
    """Return the bytes of a model file that are as they were written; raise InputError for any other file."""
    import h5py

    try:
        with open_regular(path) as file:
            image = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        raise InputError(unreadable(path, error)) from error
    if len(image) > MOST_BYTES:
        raise InputError(f"{path}: is larger than {MOST_BYTES / 1e6:.0f} MB; {WANTED}")
    if image.startswith(LEAD):
        if image[:BLOCK] == _block(image[BLOCK:]):
            return image
        if is_held(path):
            raise InputError(f"{path}: {HELD}")
        whole = _whole_bytes(image)
        if len(image) < whole:
            raise InputError(f"{path}: is truncated: {len(image)} of {whole} bytes are there; {AGAIN}")
        raise InputError(f"{path}: is damaged or edited; {AGAIN}")
    if LEAD.startswith(image):
        raise InputError(f"{path}: is empty or truncated: {len(image)} bytes are there; {AGAIN}")
    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: is not an HDF5 file; {WANTED}")
    if RESULT in image:
        raise InputError(f"{path}: is a result file of rths run; {WANTED}")
    raise InputError(f"{path}: is HDF5, but not a model file of rths, or a damaged one; {WANTED}")


def _whole_bytes(image: bytes) -> int:
    """Return how many bytes the superblock (version 0) of a model file states, all of it where that is cut off."""
    start, end = BLOCK + END_OF_FILE, BLOCK + END_OF_FILE + 8
    if len(image) < end:
        return max(end, len(image) + 1)
    return int.from_bytes(image[start:end], "little") if image[BLOCK:].startswith(SIGNATURE + b"\0") else 0


def _contents(path: Path, image: bytes) -> tuple[dict[str, Attribute], Contents]:
    """Return root attributes and groups of a model file; raise InputError unless this version can read it."""
    import h5py

    try:
        with h5py.File(io.BytesIO(image), "r") as file:
            attributes = layout.attributes(file, any_number=True)
            if attributes["format"] != FORMAT or int(attributes["format_version"]) > FORMAT_VERSION:
                stated = f"{attributes['format']} version {attributes['format_version']}"
                raise InputError(f"{path}: is {stated}, this rths reads {FORMAT} up to {FORMAT_VERSION}; update rths.")
            return {HASH: "", **attributes}, _read_groups(file)
    except (OSError, RuntimeError, LookupError, ValueError, TypeError) as error:
        raise InputError(f"{path}: holds something else than a model; {AGAIN}") from error


def _read_groups(file: h5py.File) -> Contents:
    """Return the values of every dataset that is content, by group; real and imaginary parts put together."""
    groups: Contents = {}
    for name, node in layout.walk(file):
        if layout.is_dataset(node) and node.dtype.kind not in "iu":
            group, _, leaf = name.rpartition("/")
            groups.setdefault(group, {})[leaf] = _read(node)
    return {group: _joined(values) for group, values in groups.items()}


def _read(node: DatasetID) -> Any:
    import h5py

    if node.dtype == np.float64:
        return _value(numbers(node))
    stored = h5py.Dataset(node)
    return _value(stored.asstr()[()] if h5py.check_string_dtype(node.dtype) else stored[()])


def _joined(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with NAME_real and NAME_imag as one complex NAME, every bit kept (-0.0, NaN)."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        stem = name[: -len(PARTS[0])] if name.endswith(PARTS) else ""
        if not stem:
            result[name] = value
        elif name.endswith(PARTS[0]):
            both = np.empty(np.shape(value), dtype=complex)
            both.real, both.imag = value, values[stem + PARTS[1]]
            result[stem] = _value(both)
    return result


def _content_hash(attributes: Mapping[str, Attribute], groups: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the SHA-256 of attributes (without time and place) and of every dataset's name, type, shape and bytes."""
    digest = hashlib.sha256()
    for name in sorted(set(attributes) - set(NOT_HASHED)):
        digest.update(repr((name, attributes[name])).encode())
    for group in sorted(groups):
        for name in sorted(groups[group]):
            kind, content = _bytes(groups[group][name])
            digest.update(repr((group, name, kind, len(content))).encode() + content)
    return digest.hexdigest()


def _bytes(value: Any) -> tuple[str, bytes]:
    """Return type and shape of a value as text, and its bytes, little-endian."""
    if isinstance(value, str | tuple):
        return type(value).__name__, repr(value).encode()
    data: Any = np.asarray(value)
    little = data.astype("<c16" if np.iscomplexobj(data) else "<f8")
    return f"{little.dtype.str} {data.shape}", little.tobytes()


def _plain(value: Any) -> Attribute:
    """Return an attribute as a plain Python value; what of a file's name is no Unicode text is escaped."""
    plain: Attribute = value.item() if isinstance(value, np.generic) else value
    return plain.encode(errors="backslashreplace").decode() if isinstance(plain, str) else plain
