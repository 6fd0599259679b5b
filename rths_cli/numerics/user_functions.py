"""Functions that a user supplies, called from compiled code: compiled laws and Python parts.

Machine code that knows addresses only is the same whatever function stands behind them, so that it can be kept; the
user's function is compiled by each process.

A fault does not leave the compiled code, which goes on: the caller's outputs say that there are none, and the fault is
kept for whoever started the run.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numba
from llvmlite import ir
from numba import carray, types
from numba.core.errors import NumbaError, UnsupportedBytecodeError
from numba.extending import intrinsic, register_jitable

from rths_cli.numerics.compiled import calls_of_the_runtime

F = TypeVar("F", bound=Callable[..., Any])
_NUMBERS = types.CPointer(types.float64)
_FORCE = types.float64(_NUMBERS, _NUMBERS, _NUMBERS, types.float64, types.float64)
_COMMAND = types.float64(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, types.float64)
_COUNTS = {"NRT_incref", "NRT_decref"}
_ARRAY = types.Array(types.float64, 1, "C")
# what numba raises of source that it does not know: its own errors, of which one is no NumbaError, and bare ones
NOT_COMPILED = (
    NumbaError, UnsupportedBytecodeError, AssertionError, LookupError, NotImplementedError, TypeError, ValueError,
    AttributeError,
)  # fmt: skip


class UserFunction(NamedTuple):
    """A compiled function of a user, such as `force(parameters, state, next_state, drift_m, velocity_m_s)`.

    `address` is valid as long as `owner` lives, `checked` is the same with every index checked, for calls from Python;
    `runtime_calls` are those of Python or of numba's runtime, which the loop may not make; counts of references are
    left out, its arrays have no owner.
    """

    address: int
    owner: Any
    checked: Callable[..., float]
    runtime_calls: frozenset[str]


def compile_force(function: Callable[..., Any], parameters: int, states: int) -> UserFunction:
    """Return a user's function compiled for arrays of these sizes; numba raises what it does not know, NOT_COMPILED."""

    def at_addresses(inner: Callable[..., Any]) -> Callable[..., Any]:
        def called(numbers: Any, state: Any, next_state: Any, drift: float, velocity: float) -> Any:
            given, kept, new = carray(numbers, parameters), carray(state, states), carray(next_state, states)
            return inner(given, kept, new, drift, velocity)

        return called

    return _compiled(function, (_ARRAY, _ARRAY, _ARRAY, types.float64, types.float64), _FORCE, at_addresses)


def _compiled(
    function: Callable[..., Any], arguments: tuple[Any, ...], called: Any,
    at_addresses: Callable[[Callable[..., Any]], Callable[..., Any]],
) -> UserFunction:  # fmt: skip
    """Return a user's function of these numba types of `arguments`, and as a C function of the type `called`, which
    `at_addresses` makes of it: it takes addresses where the function takes arrays."""
    checked = numba.njit(types.float64(*arguments), boundscheck=True, error_model="numpy", nogil=True)(function)
    made = numba.cfunc(called, error_model="numpy")(at_addresses(numba.njit(error_model="numpy")(function)))
    calls = calls_of_the_runtime(made.inspect_llvm()) - _COUNTS
    return UserFunction(made.address, made, checked, frozenset(calls))


@intrinsic
def call_force(
    typingctx: Any, address: Any, numbers: Any, states: Any, first: Any, after: Any, drift: Any, velocity: Any
) -> Any:
    """Call a `UserFunction` by its address on parameters `numbers`.

    It reads its state at `states[first:]` and writes the next one to `states[after:]`. Arrays are contiguous, and as
    long as it was compiled for.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = ir.DoubleType()
        pointer = number.as_pointer()
        function = ir.FunctionType(number, [pointer, pointer, pointer, number, number]).as_pointer()
        given, kept = (
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[1:3], arguments[1:3], strict=True)
        )
        state, new = (builder.gep(kept, [place]) for place in arguments[3:5])
        return builder.call(builder.inttoptr(arguments[0], function), [given, state, new, arguments[5], arguments[6]])

    index, real = types.int64, types.float64
    return real(index, numbers, states, index, index, real, real), generate


def compile_command(function: Callable[..., Any], parameters: int, states: int, channels: int) -> UserFunction:
    """Return a user's `command(parameters, state, next_state, desired, measured, sent)` compiled for arrays of these
    sizes, `desired` (3,) and `measured` (channels,); numba raises what it does not know, NOT_COMPILED."""

    def at_addresses(inner: Callable[..., Any]) -> Callable[..., Any]:
        def called(numbers: Any, state: Any, next_state: Any, desired: Any, measured: Any, sent: float) -> Any:
            given, kept, new = carray(numbers, parameters), carray(state, states), carray(next_state, states)
            return inner(given, kept, new, carray(desired, 3), carray(measured, channels), sent)

        return called

    return _compiled(function, (*(_ARRAY,) * 5, types.float64), _COMMAND, at_addresses)


@intrinsic
def call_command(
    typingctx: Any, address: Any, numbers: Any, state: Any, next_state: Any, desired: Any, measured: Any, sent: Any
) -> Any:
    """Call a function of `compile_command` by its address; arrays are contiguous, and as long as it was compiled
    for."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = ir.DoubleType()
        pointer = number.as_pointer()
        function = ir.FunctionType(number, [pointer] * 5 + [number]).as_pointer()
        arrays = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[1:6], arguments[1:6], strict=True)
        ]
        return builder.call(builder.inttoptr(arguments[0], function), [*arrays, arguments[6]])

    real = types.float64
    return real(types.int64, numbers, state, next_state, desired, measured, real), generate


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


def callable_in_commands(function: F) -> F:
    """Let a user's compiled command call a function, which stays one of Python."""
    made: F = register_jitable(function)
    return made
