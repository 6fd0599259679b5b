"""Read the variables of a MATLAB file of versions 5 to 7; other files (HDF5, 7.3): hdf5_files.py.

An own reader, because scipy's crashes the whole process on damaged files. Every length is checked before it is used.
Source: MathWorks, MAT-File Format (R2023b), chapter 1, Level 5.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.files.measured_data.named_variables import Variable

_HEADER_BYTES = 128
_MAX_BYTES = 2_000_000_000
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_NAME, _MATRIX, _COMPRESSED = (1, 16), 14, 15
_CELL, _STRUCT, _CHAR, _NUMERIC = 1, 2, 4, range(6, 16)
_COMPLEX, _LOGICAL = 0x0800, 0x0200

Element = tuple[int, memoryview]


@dataclass(frozen=True)
class _Array:
    """One array of the file: its class, flags, dimensions, name, and the elements of its content."""

    kind: int
    flags: int
    shape: tuple[int, ...]
    name: str
    content: list[Element]


def is_matlab(data: bytes) -> bool:
    """Say whether bytes are those of a MATLAB file of versions 5 to 7."""
    return data[:6] == b"MATLAB" and data[124:128] in (b"\x00\x01IM", b"\x01\x00MI")


def matlab_variables(data: bytes) -> dict[str, Variable]:
    """Return the variables by name, fields of a struct as `struct/field`; raise ValueError or zlib.error for damage."""
    order = "<" if data[126:128] == b"IM" else ">"
    variables: dict[str, Variable] = {}
    for kind, body in _elements(memoryview(data)[_HEADER_BYTES:], order):
        for inner, content in _elements(_inflate(body), order) if kind == _COMPRESSED else [(kind, body)]:
            array = _array(content, order) if inner == _MATRIX else None
            if array is not None and array.name:
                variables |= _variables(array, order)
    return variables


def _inflate(body: memoryview) -> memoryview:
    """Return the content of a compressed element; raise ValueError where it does not end."""
    stream = zlib.decompressobj()
    content = stream.decompress(body, _MAX_BYTES)
    if not stream.eof:
        raise ValueError("a compressed variable is cut off or too large")
    return memoryview(content)


def _elements(data: memoryview, order: str) -> Iterator[Element]:
    """Yield type and bytes of every data element; raise ValueError where one is longer than the file."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise ValueError("a tag is cut off")
        kind, size = struct.unpack_from(f"{order}II", data, at)
        start, short = at + 8, kind >> 16
        if short:  # type and length share four bytes, the data are the other four
            kind, size, start = kind & 0xFFFF, short, at + 4
        if start + size > len(data) or short > 4:
            raise ValueError("an element is cut off")
        yield kind, data[start : start + size]
        at = at + 8 if short else start + size + (0 if kind == _COMPRESSED else -size % 8)


def _array(content: memoryview, order: str) -> _Array | None:
    """Return the head and the elements of an array, None for an empty one or a kind that is laid out otherwise."""
    parts = list(_elements(content, order))
    if not parts:
        return None
    flags = int(np.frombuffer(parts[0][1], f"{order}u4")[0])
    name = next((bytes(body).decode("latin-1") for kind, body in parts[1:] if kind in _NAME), "")
    kind = flags & 0xFF
    if kind not in (_CELL, _STRUCT, _CHAR, *_NUMERIC):
        return _Array(kind, flags, (), name, [])
    shape = tuple(int(length) for length in np.frombuffer(parts[1][1], f"{order}i4"))
    if min(shape, default=-1) < 0:
        raise ValueError("an array has no shape")
    return _Array(kind, flags, shape, name, parts[3:])


def _variables(array: _Array, order: str) -> dict[str, Variable]:
    """Return a variable by its name, or the fields of a struct."""
    if array.kind != _STRUCT or math.prod(array.shape) != 1:
        return {array.name: Variable(_value(array, order))}
    length = int(np.frombuffer(array.content[0][1], f"{order}i4")[0])
    text = bytes(array.content[1][1])
    names = [text[k : k + length].split(b"\0")[0].decode("latin-1") for k in range(0, len(text), max(length, 1))]
    fields = [_array(body, order) for _, body in array.content[2:]]
    values = [Variable(None if field is None else _value(field, order)) for field in fields]
    return {f"{array.name}/{name}": value for name, value in zip(names, values, strict=True)}


def _value(array: _Array, order: str) -> NDArray[Any] | list[str] | None:
    """Return real numbers in their shape, the rows of a text or the texts of a cell array, None for anything else."""
    if array.kind == _CHAR and array.content:
        return _rows(array, order)
    if array.kind == _CELL:
        cells = [_array(body, order) for _, body in array.content]
        texts = [_rows(cell, order) for cell in cells if cell is not None and cell.kind == _CHAR]
        return ["".join(text) for text in texts] if len(texts) == len(cells) else None
    if array.kind not in _NUMERIC or array.flags & (_COMPLEX | _LOGICAL):
        return None
    kind, body = array.content[0]
    if kind not in _NUMBERS:
        raise ValueError("numbers of an unknown type")
    return np.frombuffer(body, f"{order}{_NUMBERS[kind]}").reshape(array.shape, order="F")


def _rows(array: _Array, order: str) -> list[str]:
    """Return the rows of a text, which is stored by columns."""
    if not array.content or math.prod(array.shape) == 0:
        return [""]
    kind, body = array.content[0]
    coding = _TEXTS[kind] + ({"<": "-le", ">": "-be"}[order] if _TEXTS[kind] in ("utf-16", "utf-32") else "")
    letters = np.array(list(bytes(body).decode(coding)))
    if len(array.shape) != 2 or letters.size != math.prod(array.shape):
        raise ValueError("a text does not fit its shape")
    return ["".join(row) for row in letters.reshape(array.shape, order="F")]
