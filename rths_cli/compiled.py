"""How everything that runs while a table moves is compiled: nothing in it can allocate memory.

The compiled code is kept on disk, in a folder of the user's cache named after the text of all sources it comes from:
numba looks only at a function's own file, and a part compiled into a caller in another file must not go stale there.
"""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import njit

from rths_cli.files.user_cache import user_cache

_CONFIG: Any = numba.config
F = TypeVar("F", bound=Callable[..., object])
SOURCES = ("rig_info.py", "compiled.py", "filters.py", "rigs/virtual/plant.py", "rigs/virtual/kernel.py")
SOURCE_FOLDERS = ("loop",)


def entry(function: F) -> F:
    """Compile a function that Python may call."""
    with _kept_in(cache_folder()):
        return njit(cache=True, _nrt=False)(function)  # type: ignore[call-overload, no-any-return]


def part(function: F) -> F:
    """Compile a function into its compiled callers; Python cannot call it."""
    options = {"cache": True, "forceinline": True, "no_cpython_wrapper": True, "_nrt": False}
    with _kept_in(cache_folder()):
        return njit(**options)(function)  # type: ignore[call-overload, no-any-return]


def is_compiled() -> bool:
    """Tell whether this machine has compiled this version before."""
    folder = Path(cache_folder())
    return folder.is_dir() and any(folder.rglob("*.nbi"))


@cache
def cache_folder() -> str:
    """Return the folder of the compiled code for these sources, this Python and this numba."""
    package = Path(__file__).resolve().parents[0]
    files = [package / name for name in SOURCES]
    files += sorted(path for name in SOURCE_FOLDERS for path in (package / name).glob("*.py"))
    digest = hashlib.sha256(f"{platform.python_version()} {numba.__version__}".encode())
    for path in files:
        digest.update(path.read_bytes())
    return str(user_cache() / f"compiled-{digest.hexdigest()[:16]}")


@contextmanager
def _kept_in(folder: str) -> Iterator[None]:
    """Have numba keep what is decorated meanwhile in this folder, unless the user chose one or it cannot be written."""
    before = _CONFIG.CACHE_DIR  # type: ignore[attr-defined]
    if not before and _writable(folder):
        _CONFIG.CACHE_DIR = folder  # type: ignore[attr-defined]
    try:
        yield
    finally:
        _CONFIG.CACHE_DIR = before  # type: ignore[attr-defined]


@cache
def _writable(folder: str) -> bool:
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
