"""How everything that runs while a table moves is compiled: nothing in it can allocate memory.

The compiled code is kept on disk per file: after a change here or in a part, remove the `__pycache__` folders, because
a caller in another file does not notice.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., object])


def entry(function: F) -> F:
    """Compile a function that Python may call."""
    return njit(cache=True, _nrt=False)(function)  # type: ignore[call-overload, no-any-return]


def part(function: F) -> F:
    """Compile a function into its compiled callers; Python cannot call it."""
    options = {"cache": True, "forceinline": True, "no_cpython_wrapper": True, "_nrt": False}
    return njit(**options)(function)  # type: ignore[call-overload, no-any-return]
