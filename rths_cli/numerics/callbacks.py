"""Call a Python function from compiled code, which holds no interpreter lock: a `Callback` has the address for `call`.

A fault does not leave the compiled code, which goes on: the caller's outputs say that there are none, and the fault is
kept for whoever started the run.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


class Callback:
    """A Python function without arguments for compiled code; `fault` is what it raised first, after which it is not
    called again."""

    def __init__(self, function: Callable[[], object]) -> None:
        self.fault: BaseException | None = None
        self._function = function
        self._c = ctypes.CFUNCTYPE(ctypes.c_int)(self._run)

    @property
    def address(self) -> int:
        """Return the address that `call` takes; it is valid as long as this object lives."""
        return ctypes.cast(self._c, ctypes.c_void_p).value or 0

    def _run(self) -> int:
        if self.fault is not None:
            return 0
        try:
            self._function()
        except BaseException as fault:  # compiled code cannot be left: whoever started it raises the fault
            self.fault = fault
            return 0
        return 1


@intrinsic
def call(typingctx: Any, address: Any) -> Any:
    """Call a `Callback` by its address; return 1, or 0 after a fault."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = ir.FunctionType(ir.IntType(32), []).as_pointer()
        return builder.sext(builder.call(builder.inttoptr(arguments[0], function), []), ir.IntType(64))

    return types.int64(types.int64), generate
