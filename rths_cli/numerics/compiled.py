"""Compile everything that runs while a table moves, with numba, and keep the machine code in a folder of the user's.

`entry` marks a function that Python calls, `part` one that compiled code calls; a `kept_part` is compiled once for all
commands, because many entries hold the same large parts. `part_class` marks a NamedTuple whose
methods compiled code calls: `s.numerical.advance(...)` runs the method of whatever class stands in that field, and is
decided when the caller is compiled. Arguments are arrays, int, float, bool and NamedTuples of these; a call releases
the interpreter lock. Compiled code may not allocate memory or call Python: an entry passes its arrays through
`borrowed` first, and `runtime_calls` shows a test what is left.

An entry gets a NamedTuple as an address (`Packed`, of type `Reference`): compiled code reads the one field that it
needs. numba's own tuples are values, which each function takes apart and puts together again, hundreds of numbers
each; that took more than half of the time to compile.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import platform
import re
import shutil
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

import llvmlite
import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, event, imputils
from numba.core.errors import NumbaError
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import (
    NativeValue,
    intrinsic,
    lower_getattr_generic,
    models,
    overload_method,
    register_model,
    unbox,
)
from numba.np.arrayobj import populate_array

from rths_cli.errors import InputError
from rths_cli.numerics.compiler_messages import began, compiles, tell
from rths_cli.user_cache import user_cache

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)
ONLY_CALLED_BY_COMPILED_CODE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # half the time to compile
PART = {"error_model": "numpy", "forceinline": True, **ONLY_CALLED_BY_COMPILED_CODE}  # error_model: 1 / 0 is inf
ENTRY = {"error_model": "numpy", "nogil": True}
FUSED = {"fastmath": {"contract"}}  # the only thing that LLVM may change in the arithmetic of a function
PACKAGE = Path(__file__).resolve().parents[1]
ABOVE = (
    "__main__.py",
    "api",
    "benchmark",
    "cli",
    "experiment",
    "laboratory",
    "report",
    "studies",
)  # compiled code imports none
WITHOUT_EFFECT = ("NUMBA_CACHE_DIR=", "NUMBA_NUM_THREADS=", "NUMBA_THREADING_LAYER=")  # settings, on our machine code
CALLS = "runtime_calls.txt"  # what compiled code calls though it should not, a line each: entry, function
LOCK_S = 60.0  # a process that compiles for longer is taken for stopped
FUNCTION = re.compile(r"^define [^@\n]*@\"?(?!_ZN7cpython|cfunc\.|NRT_).*?^}", re.MULTILINE | re.DOTALL)
RUNTIME_CALL = re.compile(r"(?:call|invoke) [^@\n]*@\"?((?:NRT|Py|numba)_\w+|Py[A-Z]\w+)")
_METHODS: dict[str, inspect.Signature] = {}

if "NUMBA_OPT" not in os.environ:  # one round of LLVM's passes: more take longer and make the step no faster
    numba.config.OPT = type(numba.config.OPT)(1)
numba.config.SLP_VECTORIZE = 1  # four rows of a block in one instruction
numba.config.LOOP_VECTORIZE = 0  # our loops are too short for more: it cost a sixth of the step
llvm.set_option("", "-unroll-runtime=0")  # nor do they reach code for eight rounds at once, a fifth of the step


class Entry:
    """A compiled function that Python calls; `dispatcher` is numba's, `name` that of module and function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.dispatcher: Any = _with_cache(function, ENTRY) or numba.njit(**ENTRY)(function)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self._ready: dict[object, tuple[Any, Any]] = {}  # dispatcher and types of the arguments, by their kinds
        self._not_kept: Any = None  # dispatcher of code that may not be kept

    def __call__(self, *arguments: object) -> Any:
        """Run the function; the first call with arguments of these types compiles it."""
        return self.bind(*arguments)()

    def bind(self, *arguments: object) -> Callable[[], Any]:
        """Compile the function and return it without arguments: it runs on these, the same arrays every time."""
        kind = _kind(arguments)  # numba's dispatcher would not lock the cache
        known = self._ready.get(kind)
        passed = [_passed(value, known[1][place] if known else None) for place, value in enumerate(arguments)]
        if known is None:
            signature = tuple(map(numba.typeof, passed))
            known = self._ready[kind] = self._compiled(signature), signature
        return partial(known[0], *passed)

    def _compiled(self, signature: tuple[Any, ...]) -> Any:
        if any(map(_from_outside, signature)):
            self._not_kept = self._not_kept or numba.njit(**ENTRY)(self.dispatcher.py_func)
            self._not_kept.compile(signature)
            return self._not_kept
        with _lock(cache_folder(), self.name), compiles(self.name):
            _load_or_compile(self.dispatcher, self.dispatcher.compile, signature)
            if signature not in self.dispatcher.overloads:  # or its index names the code of another signature
                self.dispatcher = numba.njit(**ENTRY)(self.dispatcher.py_func)
                self.dispatcher.compile(signature)
            if signature in self.dispatcher.stats.cache_misses:
                _note_calls(self)
        return self.dispatcher


def _from_outside(kind: Any) -> bool:
    """Tell whether a type holds a class whose source the folder's name does not know, such as a user's own part."""
    if isinstance(kind, Reference):
        return _from_outside(kind.to)
    made = getattr(kind, "instance_class", None)
    if made is not None:
        try:
            if not Path(inspect.getfile(made)).resolve().is_relative_to(PACKAGE):
                return True
        except (OSError, TypeError):  # typed in by hand: there is no file
            return True
    return isinstance(kind, types.BaseTuple) and any(map(_from_outside, kind))


def _kind(value: object) -> object:
    """Return what numba's type of a value follows from, in a tenth of the time."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num
    if isinstance(value, tuple):
        return type(value), *map(_kind, value)
    return type(value)


def external(name: str, result: str, *arguments: str) -> Any:
    """Return a C function of the process for compiled code; kinds are named as numba names them."""
    return types.ExternalFunction(name, getattr(types, result)(*(getattr(types, each) for each in arguments)))


def entry(function: Callable[..., Any]) -> Entry:
    """Compile a function that Python calls."""
    return Entry(function)


def part(function: F) -> F:
    """Compile a function into its compiled callers."""
    return _without_constants(numba.njit(**PART)(function))


def fused_part(function: F) -> F:
    """Compile a function into its compiled callers, a product and the sum that takes it in one instruction with one
    rounding, where the processor has it: for sums of products."""
    return _without_constants(numba.njit(**PART, **FUSED)(function))


def _without_constants(made: F) -> F:
    """Have a call with constants use the code for variables: numba would compile the function for both."""
    compile_or_load = made.compile  # type: ignore[attr-defined]

    def compile_for_variables(signature: tuple[Any, ...]) -> Any:
        return compile_or_load(tuple(map(types.unliteral, signature)))

    made.compile = compile_for_variables  # type: ignore[attr-defined]
    return made


def kept_part(function: F) -> F:
    """Compile a function into its compiled callers and keep it for the next ones: a large one that many call."""
    kept, name = _with_cache(function, PART), f"{function.__module__}.{function.__qualname__}"
    if kept is None or fcntl is None:  # without a lock two processes could write into each other's index
        return part(function)
    not_kept, compile_or_load = numba.njit(**PART)(function), kept.compile

    def compile_locked(signature: tuple[Any, ...]) -> Any:
        if signature not in kept.overloads and not any(map(_from_outside, signature)):
            with _lock(cache_folder(), name):
                _load_or_compile(kept, compile_or_load, signature)
        if signature not in kept.overloads:  # it holds a class from outside, or the index names other code
            not_kept.compile(signature)
            kept.add_overload(not_kept.overloads[signature])
        return kept.overloads[signature].entry_point

    kept.compile = compile_locked
    return _without_constants(kept)  # type: ignore[no-any-return]


def shared_part(function: F) -> F:
    """Compile a function once for all its compiled callers: a large one, outside of the step."""
    return _without_constants(numba.njit(error_model="numpy", **ONLY_CALLED_BY_COMPILED_CODE)(function))


def part_class(made: Class) -> Class:
    """Compile the public methods of a NamedTuple into their compiled callers.

    Classes that may take each other's place give a method the same parameters. Raises TypeError where they do not.
    """
    for name, method in vars(made).items():
        if not inspect.isfunction(method) or name.startswith("_"):
            continue
        known = _METHODS.setdefault(name, inspect.signature(method))
        if list(known.parameters) != list(inspect.signature(method).parameters):
            raise TypeError(f"{made.__name__}.{name}: other classes call its parameters {', '.join(known.parameters)}")
        _offer(name, known)
    return made


@cache
def _offer(name: str, signature: inspect.Signature) -> None:
    """Have numba look for a method in the class of the NamedTuple that it is called on."""

    def of_class(*arguments: Any) -> Callable[..., Any] | None:
        kind = arguments[0].to if isinstance(arguments[0], Reference) else arguments[0]
        return getattr(kind.instance_class, name, None)

    of_class.__signature__ = signature  # type: ignore[attr-defined]
    for tuples in (Reference, types.NamedTuple, types.NamedUniTuple):
        overload_method(tuples, name, jit_options=PART, strict=False)(of_class)


class Reference(types.Type):
    """numba's type of a NamedTuple that stands in memory as `Packed` puts it there."""

    def __init__(self, to: Any) -> None:
        self.to = to
        whole = f"{to.instance_class.__module__}.{to.instance_class.__qualname__} {to}"
        digest = hashlib.sha256(whole.encode()).hexdigest()[:12]  # a short name, which LLVM reads in each call
        super().__init__(f"Reference({to.instance_class.__name__}#{digest})")

    @property
    def key(self) -> Any:
        """Return what tells two types apart."""
        return self.to


class Packed:
    """A NamedTuple for compiled code: eight bytes for each number, address, shape and strides of each array.

    It keeps the arrays alive. Compiled code changes the elements of its arrays, and nothing else.
    """

    def __init__(self, value: tuple[object, ...], known: Any = None) -> None:
        self.value = value
        self.memory = np.frombuffer(b"".join(_bytes_of(value)) or bytes(8), dtype=np.int64)
        self.address = self.memory.ctypes.data
        self._numba_type_ = known or Reference(numba.typeof(value))


def _passed(value: object, known: Any) -> object:
    """Return a value as an entry takes it; `known`: its type, which takes longer to find than all the rest."""
    return Packed(value, known) if isinstance(value, tuple) and hasattr(value, "_fields") else value


def _bytes_of(value: object) -> Iterator[bytes]:
    if isinstance(value, tuple):
        for one in value:
            yield from _bytes_of(one)
    elif isinstance(value, np.ndarray):
        yield struct.pack(f"={1 + 2 * value.ndim}q", value.ctypes.data, *value.shape, *value.strides)
    elif isinstance(value, np.generic) and value.dtype.kind in "biuf" and value.nbytes <= 8:
        yield value.tobytes().ljust(8, b"\0")
    elif isinstance(value, bool | int | float):
        yield struct.pack("=d" if isinstance(value, float) else "=q", value)
    else:
        raise TypeError(f"compiled code takes numbers, arrays and NamedTuples of these, not {type(value).__name__}")


def _places(kind: Any) -> int:
    """Return the number of places of eight bytes that a value of a type takes."""
    if isinstance(kind, types.BaseTuple):
        return sum(map(_places, kind))
    return 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


def _read(context: Any, builder: Any, kind: Any, place: Any) -> Any:
    """Return the code that reads a value; what stands there does not change, so that it may be read once."""

    def number(offset: int, of: Any) -> Any:
        there = builder.bitcast(cgutils.gep_inbounds(builder, place, offset), of.as_pointer())
        found = builder.load(there)
        found.set_metadata("invariant.load", builder.module.add_metadata([]))
        return found

    if isinstance(kind, types.BaseTuple):
        items, offset = [], 0
        for one in kind:
            items.append(_read(context, builder, one, cgutils.gep_inbounds(builder, place, offset)))
            offset += _places(one)
        return context.make_tuple(builder, kind, items)
    if isinstance(kind, types.Array):
        array, size = context.make_array(kind)(context, builder), context.get_value_type(types.intp)
        sizes = [number(1 + i, size) for i in range(2 * kind.ndim)]
        item = context.get_data_type(kind.dtype)
        populate_array(
            array, data=number(0, item.as_pointer()), shape=sizes[: kind.ndim], strides=sizes[kind.ndim :],
            itemsize=context.get_constant(types.intp, context.get_abi_sizeof(item)), meminfo=None,
        )  # fmt: skip
        return array._getvalue()
    if isinstance(kind, types.Boolean):
        return cgutils.is_not_null(builder, number(0, context.get_value_type(types.int64)))
    return number(0, context.get_value_type(kind))


@register_model(Reference)
class _Address(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, kind: Any) -> None:
        super().__init__(dmm, kind, ir.IntType(64).as_pointer())


@unbox(Reference)
def _from_packed(kind: Any, value: Any, c: Any) -> Any:
    held = c.pyapi.object_getattr_string(value, "address")
    address = c.pyapi.long_as_longlong(held)
    c.pyapi.decref(held)
    return NativeValue(c.builder.inttoptr(address, ir.IntType(64).as_pointer()))


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    """Types of the fields of a Reference: a NamedTuple in it is a Reference again."""

    key = Reference

    def generic_resolve(self, kind: Any, name: str) -> Any:
        if name not in kind.to.fields:
            return None
        found = kind.to[kind.to.fields.index(name)]
        return Reference(found) if hasattr(found, "fields") else found


@lower_getattr_generic(Reference)
def _field(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    index = kind.to.fields.index(name)
    found, place = kind.to[index], cgutils.gep_inbounds(builder, value, sum(map(_places, list(kind.to)[:index])))
    return place if hasattr(found, "fields") else _read(context, builder, found, place)


def _disowned(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Return the arrays of an array or a tuple without their owner."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for i, one in enumerate(kind):
            item = _disowned(context, builder, one, builder.extract_value(value, i))
            value = builder.insert_value(value, item, i)
    return value


def _borrow(typingctx: Any, value: Any) -> Any:
    """Tell numba the type and the code of `borrowed`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        try:
            return _disowned(context, builder, signature.args[0], arguments[0])
        except AttributeError:  # another numba describes arrays in another way: references are counted
            return imputils.impl_ret_borrowed(context, builder, signature.return_type, arguments[0])

    return value(value), generate


borrowed: Callable[[T], T] = intrinsic(_borrow)
"""Return a value whose arrays compiled code does not count references to: their owner outlives the call.

Counting costs more than the step. It is left out by giving the arrays no owner, as `numba.carray` gives none.
"""


def runtime_calls(made: Entry) -> set[str]:
    """Return the functions of numba's runtime and of Python that the code of an entry calls."""
    folder, noted = cache_folder(), ""
    with suppress(OSError):  # mostly there is no such file
        noted = (folder / CALLS).read_text() if folder is not None else ""
    kept = {call for name, _, call in (line.partition(" ") for line in noted.splitlines()) if name == made.name}
    compiled_here = [kinds for kinds in made.dispatcher.overloads if kinds in made.dispatcher.stats.cache_misses]
    return kept.union(*(calls_of_the_runtime(made.dispatcher.inspect_llvm(kinds)) for kinds in compiled_here))


def calls_of_the_runtime(text: str) -> set[str]:
    """Return the functions of numba's runtime and of Python that code in LLVM's language calls.

    What numba wraps around that code for a call from outside is left out.
    """
    return {name for one in FUNCTION.findall(text) for name in RUNTIME_CALL.findall(one)}


def _note_calls(made: Entry) -> None:
    """Keep the calls of new code for later processes, which load it without them, and tell of them."""
    calls = runtime_calls(made)
    if not calls:
        return
    folder = cache_folder()
    if folder is not None:
        with suppress(OSError), open(folder / CALLS, "a", encoding="utf-8") as file:
            file.writelines(f"{made.name} {call}\n" for call in sorted(calls))
    tell(
        f"numba {numba.__version__} makes {made.name} call {', '.join(sorted(calls))}: each step takes longer, several "
        "times as long where references are counted; please report it"
    )


def nothing_compiled() -> bool:
    """Return whether nothing has been compiled yet for these sources on this machine, or it cannot be kept."""
    folder = cache_folder()
    return folder is None or not any(folder.glob("*/*.nbi"))


@cache
def _announcement() -> str:
    """Return what a process says when it begins to compile: whether nothing was compiled here, or not this part."""
    folder = cache_folder()
    if not nothing_compiled():
        return "compiling real-time code that no command here has used yet"
    why = f"; it is not kept: {_place()[1]}" if folder is None else ""
    return f"first run of this version here: compiling its real-time code, once{why}"


class _Starts(event.Listener):
    """Tells of compilations."""

    def on_start(self, event: object) -> None:
        tell(_announcement())
        began()

    def on_end(self, event: object) -> None:
        """Do nothing."""


event.register("numba:compile", _Starts())


def watched_sources() -> list[Path]:
    """Return the sources from which compiled code may come: all but the layers above the loop.

    numba looks at the file of an entry only, and would keep a stale guard inside an unchanged caller.
    """
    everything = sorted(PACKAGE.rglob("*.py"))
    return [path for path in everything if path.relative_to(PACKAGE).parts[0] not in ABOVE]


def cache_folder() -> Path | None:
    """Return the folder of the compiled code, None where it cannot be written: each process then compiles anew."""
    return _place()[0]


@cache
def _place() -> tuple[Path | None, str]:
    """Return the folder for the code of these sources, this Python, these libraries and this processor, or why none."""
    versions = platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__
    digest = hashlib.sha256(" ".join((*versions, processor())).encode())
    for path in watched_sources():
        digest.update(path.read_bytes())
    try:
        folder = user_cache() / f"compiled-{digest.hexdigest()[:16]}"
        for path in (folder.parent, folder):
            path.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (InputError, OSError) as error:
        return None, str(error)
    return (folder, "") if os.access(folder, os.W_OK) else (None, f"{folder} cannot be written")


@contextmanager
def _lock(folder: Path | None, name: str) -> Iterator[None]:
    """Let one process at a time compile an entry; the others then load what it has compiled.

    Ignored where it cannot be had: code is then compiled twice, and an index that two have written is found out.
    """
    file, end = None, time.monotonic() + LOCK_S
    try:
        if fcntl is not None and folder is not None:
            with suppress(OSError):
                file = os.open(folder / f"{name}.lock", os.O_RDWR | os.O_CREAT, 0o600)
                while not _is_locked(file) and time.monotonic() < end:
                    time.sleep(0.02)
        yield
    finally:
        if file is not None:
            os.close(file)


def _is_locked(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _load_or_compile(made: Any, load_or_compile: Callable[[Any], object], signature: Any) -> None:
    """Load or compile the code of a dispatcher; errors of the cache are ignored, unreadable files in it are removed."""
    with suppress(OSError):
        try:
            load_or_compile(signature)
        except (NumbaError, OSError):
            raise
        except Exception:  # of a file that was cut short
            shutil.rmtree(made.stats.cache_path, ignore_errors=True)
            load_or_compile(signature)


def _with_cache(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return numba's dispatcher of a function with its cache in our folder, None where it cannot be there."""
    folder, before = cache_folder(), numba.config.CACHE_DIR
    if folder is None:
        return None
    numba.config.CACHE_DIR = str(folder)
    try:
        made = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no folder at all, or the function has no source file
        return None
    finally:
        numba.config.CACHE_DIR = before
    return made if Path(made.stats.cache_path).is_relative_to(folder) else None  # numba may take one beside the source


@cache
def processor() -> str:
    """Return what decides which instructions numba chooses: the host, and every setting of numba, from its environment
    variables (NUMBA_CPU_NAME, NUMBA_OPT, ...) or its file in the working directory."""
    settings = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith("NUMBA_")]
    settings = [one for one in settings if not one.startswith(WITHOUT_EFFECT)]
    with suppress(OSError):  # mostly there is no such file
        settings.append(Path(".numba_config.yaml").read_bytes().hex())
    features = ""
    with suppress(RuntimeError):  # LLVM does not know the features of every host
        features = llvm.get_host_cpu_features().flatten()
    return f"{llvm.get_host_cpu_name()} {features} {' '.join(settings)}"
