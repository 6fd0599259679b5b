"""A hash of any frozen data, for caches: equal values have equal keys in every process."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from hashlib import _Hash


def content_key(*values: object) -> bytes:
    """Return the SHA-256 of values: plain ones, arrays, and tuples and dataclasses of them.

    Of a dataclass every declared field counts, of an array its type, shape and elements, bit by bit: 0.0 and -0.0
    differ, a NaN equals itself. Raises TypeError for anything else, as a dictionary or an object with hidden state.
    """
    digest = hashlib.sha256()
    for value in values:
        _add(digest, value)
    return digest.digest()


def _add(digest: _Hash, value: Any) -> None:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | complex | str):
        _add_part(digest, type(value).__name__, _bits(value))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biufcSU":
        _add_part(digest, f"array {value.dtype.str} {value.shape}", value.tobytes())
    elif is_dataclass(value) and not isinstance(value, type):
        _add_all(digest, type(value).__qualname__, [getattr(value, field.name) for field in fields(value)])
    elif isinstance(value, tuple):
        _add_all(digest, type(value).__qualname__, value)
    else:
        raise TypeError(f"a key is made of plain values, arrays, tuples and dataclasses, not of {type(value).__name__}")


def _bits(value: bool | int | float | complex | str | None) -> bytes:
    """Return a plain value as bytes, a float with all its bits."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, complex):
        return struct.pack("<dd", value.real, value.imag)
    return str(value).encode()


def _add_part(digest: _Hash, kind: str, content: bytes) -> None:
    """Add a part whose end is known from its length, so that no two lists of parts are the same bytes."""
    digest.update(f"{kind} {len(content)}:".encode())
    digest.update(content)


def _add_all(digest: _Hash, kind: str, values: Any) -> None:
    digest.update(f"{kind} {len(values)}(".encode())
    for each in values:
        _add(digest, each)
