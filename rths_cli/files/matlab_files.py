"""Variables of a MATLAB file: versions 4 to 7 by scipy, 7.3 by h5py.

Measured files of version 7.3 are read as the HDF5 files that they are (measured_data/hdf5_files.py).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.files.hdf5_safety import held
from rths_cli.files.sandboxed_reading import read_in_copy

if TYPE_CHECKING:
    import h5py

DEEPEST = 8  # cells and structures in each other; what is deeper is left out
HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class MatlabObject:
    """An object of MATLAB, of which only its class can be read."""

    class_name: str


Value = NDArray[Any] | list[str] | tuple[Any, ...] | dict[str, Any] | MatlabObject | None
"""Numbers in their shape (logical: bool), the rows of a text, the entries of a cell array, the fields of a single
structure, the structures of an array of them, an object, None for anything else: each entry and field is a Value."""


def is_matlab(head: bytes) -> bool:
    """Say whether the first 128 bytes are those of a MATLAB file of versions 5 to 7."""
    return head[:6] == b"MATLAB" and head[124:128] in (b"\x00\x01IM", b"\x01\x00MI")


def matlab_variables(path: Path, wanted: Sequence[str] | None = None) -> dict[str, Value]:
    """Return all variables of a MATLAB file by name, with the values of those wanted (None: all; others None).

    The class of an object is told of every variable. The file is read in a copy of this process. Raises ValueError for
    a damaged one.
    """
    return read_in_copy(lambda: variables_read_here(path, wanted))


def variables_read_here(path: Path, wanted: Sequence[str] | None = None) -> dict[str, Value]:
    """Do what `matlab_variables` does, in this process; raises anything for a damaged file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with open(path, "rb") as file:
            is_hdf5 = HDF5 in file.read(1024)  # behind MATLAB's block of 512 bytes
        found = _of_v73(path, wanted) if is_hdf5 else _of_v5(path)
    asked = found if wanted is None else wanted
    return {name: value if name in asked or isinstance(value, MatlabObject) else None for name, value in found.items()}


def _of_v5(path: Path) -> dict[str, Value]:
    """Return the variables of a MATLAB file of version 4 to 7.

    scipy gives logical arrays as small integers; only `whosmat` tells them. (`mat_dtype` would, but drops imaginary
    parts.) Those in structures and cells stay integers.
    """
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatlabOpaque

    variables: dict[str, Value] = {}
    logical: set[str] = set()
    with suppress(Exception):  # objects, which loadmat names
        logical = {name for name, _, kind in whosmat(path) if kind == "logical"}
    for name, raw in loadmat(path).items():
        if isinstance(raw, MatlabOpaque) and "_Class" in raw.dtype.names:
            variables[name] = MatlabObject(raw["_Class"].item())
        elif isinstance(raw, MatlabOpaque):  # scipy before 1.18 names it None; its own name stands in it
            variables[raw["s0"].item().decode()] = MatlabObject(raw["s2"].item().decode())
        elif not name.startswith("__"):
            variables[name] = raw.astype(bool) if name in logical else _value(raw)
    return variables


def _value(raw: Any, depth: int = 0) -> Value:
    """Return a variable as scipy gives it as a Value."""
    from scipy.io.matlab import MatlabFunction
    from scipy.io.matlab import MatlabObject as Described

    if isinstance(raw, Described):
        return MatlabObject(raw.classname)
    if not isinstance(raw, np.ndarray) or isinstance(raw, MatlabFunction) or depth > DEEPEST:
        return None
    if raw.dtype.names is not None:
        every = [{name: _value(one[name], depth + 1) for name in raw.dtype.names} for one in raw.reshape(-1, order="F")]
        return every[0] if len(every) == 1 else tuple(every)
    if raw.dtype.kind == "O":
        return tuple(_value(entry, depth + 1) for entry in raw.reshape(-1, order="F"))
    if raw.dtype.kind == "U":
        return [str(row) for row in raw.reshape(-1)]
    return np.array(raw) if raw.dtype.kind in "biufc" else None


def _of_v73(path: Path, wanted: Sequence[str] | None) -> dict[str, Value]:
    """Return the variables of a MATLAB file of version 7.3, which is HDF5."""
    import h5py

    variables: dict[str, Value] = {}
    with h5py.File(path, "r") as file:
        for name, node in file.items():
            if "MATLAB_object_decode" in node.attrs:
                variables[name] = MatlabObject(_class_of(node))
            elif not name.startswith("#"):
                variables[name] = hdf5_value(file, node) if wanted is None or name in wanted else None
    return variables


def _class_of(node: h5py.Dataset | h5py.Group) -> str:
    declared = held(node, "MATLAB_class") if "MATLAB_class" in node.attrs else b""
    return declared.decode() if isinstance(declared, bytes) else str(declared)


def hdf5_value(file: h5py.File, node: h5py.Dataset | h5py.Group, depth: int = 0) -> Value:
    """Return one variable of a MATLAB 7.3 file as a Value; dimensions are stored in the opposite order."""
    import h5py

    if depth > DEEPEST:
        return None
    if not isinstance(node, h5py.Dataset):
        fields = {name: hdf5_value(file, part, depth + 1) for name, part in node.items()}
        return _structures(node, fields)
    if "MATLAB_empty" in node.attrs:
        return [] if _class_of(node) == "char" else np.zeros((0, 0))
    data: Any = np.transpose(node[()])
    if node.dtype.kind == "O":
        entries = data.reshape(-1, order="F")
        return tuple(hdf5_value(file, file[reference], depth + 1) for reference in entries)
    if _class_of(node) == "char":
        return ["".join(map(chr, row)) for row in np.atleast_2d(data)]
    if node.dtype.names == ("real", "imag"):
        return np.asarray(data["real"] + 1j * data["imag"])
    return np.asarray(data) if data.dtype.kind in "biufc" else None


def _structures(node: h5py.Group, fields: dict[str, Any]) -> Value:
    """Return a structure, or the structures of an array: there each field is a set of references without a class."""
    if not fields or any(part.dtype.kind != "O" or "MATLAB_class" in part.attrs
                         if hasattr(part, "dtype") else True for part in node.values()):  # fmt: skip
        return fields
    return tuple(dict(zip(fields, each, strict=True)) for each in zip(*fields.values(), strict=True))


def series(value: Value) -> NDArray[Any] | list[str] | None:
    """Return what a recording uses: real numbers, the rows of a text or the texts of a cell array, None otherwise."""
    if isinstance(value, tuple):
        texts = ["".join(entry) for entry in value if isinstance(entry, list)]
        return texts if len(texts) == len(value) else None
    if isinstance(value, np.ndarray):
        return value if value.dtype.kind in "iuf" else None
    return (value or [""]) if isinstance(value, list) else None
