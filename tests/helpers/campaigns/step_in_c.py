"""The step in C (step.c): compiled here, called on the same arrays as the compiled step."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from campaigns.step_run import Inputs, State

SOURCE = Path(__file__).parent / "step.c"
OPTIONS = ("-O3", "-march=native", "-fPIC", "-shared")
DIMENSIONS = 4  # of an array, as step.c knows them


class CArray(ctypes.Structure):
    """The first place of an array and its first four sizes."""

    _fields_ = (("at", ctypes.c_void_p), ("shape", ctypes.c_int64 * DIMENSIONS))


def compiler() -> str | None:
    """Return the path of the C compiler, None when there is none."""
    return shutil.which(os.environ.get("CC", "cc"))


def compiled(folder: Path, source: Path = SOURCE) -> ctypes.CDLL:
    """Compile step.c into a folder and load it; raises CalledProcessError when the compiler refuses it."""
    library = folder / "step.so"
    subprocess.run([str(compiler()), *OPTIONS, "-o", str(library), str(source), "-lm"], check=True)
    return ctypes.CDLL(str(library))


@cache
def _kind(name: str, fields: tuple[tuple[str, type], ...]) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": list(fields)})


def in_c(value: Any) -> Any:
    """Return an array, a number or a NamedTuple of these as step.c takes it; the array stays where it is."""
    if isinstance(value, np.ndarray):
        sizes = (*value.shape, *[0] * DIMENSIONS)[:DIMENSIONS]
        return CArray(value.ctypes.data, (ctypes.c_int64 * DIMENSIONS)(*sizes))
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return (ctypes.c_int64 * len(value))(*value)
    if isinstance(value, tuple):
        parts = [in_c(item) for item in value]
        fields = zip(value._fields, map(type, parts), strict=True)  # type: ignore[attr-defined]
        return _kind(type(value).__name__, tuple(fields))(*parts)
    return ctypes.c_int64(int(value)) if isinstance(value, int | np.integer) else ctypes.c_double(value)


def bound(library: ctypes.CDLL, given: Inputs, state: State) -> Callable[[], int]:
    """Return a function that plays the run in C on these arrays and returns the number of steps done.

    Raises ValueError when a structure of step.c has another size than its NamedTuple.
    """
    tuples: tuple[NamedTuple, ...] = (
        given.plant,
        state.table,
        state.step,
        given.limits,
        state.guard,
        state.log,
    )
    parts = [in_c(value) for value in tuples]
    sizes = list((ctypes.c_int64 * len(parts)).in_dll(library, "sizes"))
    for value, part, size in zip(tuples, parts, sizes, strict=True):
        if ctypes.sizeof(part) != size:
            raise ValueError(f"{type(value).__name__} has {ctypes.sizeof(part)} bytes, in step.c {size}: adapt step.c")
    pointers = tuple(map(ctypes.byref, parts))
    drive, noise = (ctypes.c_void_p(array.ctypes.data) for array in (given.drive, given.noise))
    steps = ctypes.c_int64(len(given.drive))
    library.run.restype = ctypes.c_int64

    def run(_kept: object = (given, state, parts)) -> int:  # the arrays live as long as the function
        return int(library.run(*pointers[:-1], drive, noise, pointers[-1], steps))

    return run
