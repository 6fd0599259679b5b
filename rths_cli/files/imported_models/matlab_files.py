"""Named numbers and texts of a MATLAB file (scipy, h5py), read in a process of its own.

Damaged bytes can crash scipy's reader and hang the HDF5 library; then only that process ends, and the file is
called damaged.
"""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.files.hdf5_heaps import check_heaps
from rths_cli.files.hdf5_safety import held
from rths_cli.numerics.lti import ComplexArray

if TYPE_CHECKING:
    import h5py

TIME_LIMIT_S = 60.0
MAX_NUMBERS = 1000
DEPTH = 3
HDF5 = b"\x89HDF\r\n\x1a\n"
CHILD = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from rths_cli.files.imported_models.matlab_files import tell
tell(*sys.argv[2:])
"""


@dataclass(frozen=True)
class Variable:
    """One variable: numbers (n,), text, or why it is neither (`fault`); `object_class` names a MATLAB object's class.

    A variable that was not asked for has no value.
    """

    value: ComplexArray | str | None = None
    fault: str = ""
    object_class: str = ""


def read_variables(path: Path, wanted: Sequence[str]) -> dict[str, Variable] | None:
    """Return all variables of a MATLAB file by name, those wanted with their values; None for a damaged file.

    Cells of one entry are opened. Raises RuntimeError when the reading process cannot work at all.
    """
    command = [sys.executable, "-c", CHILD, json.dumps(sys.path), str(path.absolute()), *wanted]
    try:
        done = subprocess.run(command, capture_output=True, timeout=TIME_LIMIT_S, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return None
    if done.returncode > 0:
        raise RuntimeError(f"reading {path} failed: {done.stderr.decode(errors='replace')[-500:]}")
    told = json.loads(done.stdout) if done.returncode == 0 else None
    return None if told is None else {name: _variable(entry) for name, entry in told.items()}


def tell(path: str, *wanted: str) -> None:
    """Print the variables of a MATLAB file as JSON, null for a damaged one: what the child process does."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with open(path, "rb") as file:
                is_hdf5 = HDF5 in file.read(1024)  # behind MATLAB's block of 512 bytes
            found = _of_v73(path, wanted) if is_hdf5 else _of_v5(path, wanted)
    except Exception:  # a damaged file makes the readers raise nearly anything
        found = None
    print(json.dumps(found))


def _variable(told: dict[str, Any]) -> Variable:
    """Return a variable as the child process told it."""
    if "real" in told:
        value: ComplexArray = np.array(told["real"], dtype=complex)
        value.imag = told["imag"]
        return Variable(value)
    return Variable(told.get("text"), told.get("fault", ""), told.get("object_class", ""))


def _of_v5(path: str, wanted: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the variables of a MATLAB file of version 4 to 7."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabObject, MatlabOpaque

    variables: dict[str, dict[str, Any]] = {}
    for name, raw in loadmat(path).items():
        if isinstance(raw, MatlabOpaque):  # scipy names it None; its own name stands in it
            variables[raw["s0"].item().decode()] = _object(raw["s2"].item().decode())
        elif isinstance(raw, MatlabObject):
            variables[name] = _object(raw.classname)
        elif not name.startswith("__"):
            variables[name] = _told(raw) if name in wanted else {}
    return variables


def _of_v73(path: str, wanted: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the variables of a MATLAB file of version 7.3, which is HDF5."""
    import h5py

    check_heaps(Path(path))
    variables: dict[str, dict[str, Any]] = {}
    with h5py.File(path, "r") as file:
        for name, node in file.items():
            if "MATLAB_object_decode" in node.attrs:
                variables[name] = _object(_class_of(node))
            elif not name.startswith("#"):
                variables[name] = _told(_hdf5_value(file, node)) if name in wanted else {}
    return variables


def _object(class_name: str) -> dict[str, Any]:
    return {"object_class": class_name, "fault": f"must be numbers, got a MATLAB {class_name} object"}


def _class_of(node: h5py.Dataset | h5py.Group) -> str:
    declared = held(node, "MATLAB_class") if "MATLAB_class" in node.attrs else b""
    return declared.decode() if isinstance(declared, bytes) else str(declared)


def _hdf5_value(file: h5py.File, node: h5py.Dataset | h5py.Group, depth: int = 0) -> Any:
    """Return one variable of a MATLAB 7.3 file as scipy would of an older one; a structure is None."""
    import h5py

    if not isinstance(node, h5py.Dataset):
        return None
    if "MATLAB_empty" in node.attrs:
        return np.zeros(0)
    if node.size > MAX_NUMBERS:
        return np.broadcast_to(np.zeros(()), node.shape)
    data: Any = node[()]
    if node.dtype.kind == "O" and depth < DEPTH:
        cells = np.empty(np.size(data), dtype=object)
        cells[:] = [_hdf5_value(file, file[reference], depth + 1) for reference in np.reshape(data, -1)]
        return cells
    if _class_of(node) == "char":
        return "".join(map(chr, np.reshape(data, -1)))
    if node.dtype.names == ("real", "imag"):
        return data["real"] + 1j * data["imag"]
    return data


def _told(raw: Any, depth: int = 0) -> dict[str, Any]:
    """Return numbers or text as JSON can hold them, or the sentence that says why it is neither."""
    data = np.asarray(raw)
    kind, size = data.dtype.kind, data.size
    if kind == "O" and raw is not None and size == 1 and depth < DEPTH:
        return _told(data.reshape(-1)[0], depth + 1)
    if kind == "O" and size > 1:
        return {"fault": f"is a cell array of {size} entries; save one input and one output of the model"}
    if kind == "U" and size == 1:
        return {"text": str(data.reshape(-1)[0])}
    if kind not in "biufc" and size:
        return {"fault": "must be numbers, got a structure or something else"}
    if size > MAX_NUMBERS or (size and size != max((1, *data.shape))):
        return {"fault": f"must be a vector of at most {MAX_NUMBERS}, got {' x '.join(map(str, data.shape))} numbers"}
    values = data.reshape(-1).astype(complex) if size else np.zeros(0, dtype=complex)
    return {"real": values.real.tolist(), "imag": values.imag.tolist()}
