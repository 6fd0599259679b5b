"""Compile everything that runs while a table moves, and cache its machine code; allocation is switched off.

`entry` marks a function that Python may call, `part` one that compiled code calls; numba translates them at the first
call with arguments of a new kind. The machine code is kept in a folder of the user's cache that is named after the
text of all sources it comes from, and later processes load it as it is: numba is then not imported at all.
Arguments are C-contiguous arrays, int, float, bool and NamedTuples of these; the call releases the interpreter lock.
"""

from __future__ import annotations

import ctypes
import hashlib
import inspect
import json
import os
import platform
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rths_cli.user_cache import user_cache

F = TypeVar("F", bound=Callable[..., object])
SOURCES = (
    "analysis/metrics/response_errors.py",
    "analysis/metrics/zero_phase_high_pass.py",
    "analysis/sim_delay.py",
    "numerics/clock.py",
    "numerics/compiled.py",
    "numerics/filters.py",
    "numerics/tiled_products.py",
    "rigs/description.py",
    "rigs/udp/handshake.py",
    "rigs/udp/late_command_trajectory.py",
    "rigs/udp/link.py",
    "rigs/udp/packets.py",
    "rigs/udp/siphash.py",
    "rigs/virtual/plant.py",
    "rigs/virtual/plant_kernel.py",
)
SOURCE_FOLDERS = ("loop",)
WRAPPERS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
OPTIONS = {"_nrt": False, "error_model": "numpy", **WRAPPERS}  # no allocation; 1 / 0 is inf
RESULTS = {"none": ctypes.c_void_p, "float64": ctypes.c_double, "int64": ctypes.c_int64, "bool": ctypes.c_bool}
WITHOUT_EFFECT = ("NUMBA_CACHE_DIR=", "NUMBA_NUM_THREADS=", "NUMBA_THREADING_LAYER=")  # settings, on our machine code
_LOCK = threading.RLock()
_LISTENERS: list[Callable[[str], object]] = []
_ENGINES: list[Any] = []  # loaded machine code lives as long as the process


class Part:
    """A function for numba: a dispatcher that is made when compiled code asks for it."""

    def __init__(self, function: Callable[..., object], **options: bool) -> None:
        self.function, self._options = function, options
        self._made: Any = None

    @property
    def dispatcher(self) -> Any:
        """Return numba's dispatcher of the function."""
        if self._made is None:
            import numba

            translator: Any = numba
            translator.config.SLP_VECTORIZE = 1  # four rows of a block in one instruction
            translator.config.LOOP_VECTORIZE = 0  # our loops are too short for more: it cost a sixth of the step
            self._made = translator.njit(**OPTIONS, **self._options)(self.function)
        return self._made

    @property
    def _numba_type_(self) -> Any:
        """Return what numba takes for this object where compiled code names it."""
        return self.dispatcher._numba_type_


class External:
    """A C function of the process, for compiled code."""

    def __init__(self, name: str, result: str, *arguments: str) -> None:
        self._name, self._result, self._arguments = name, result, arguments

    @property
    def _numba_type_(self) -> Any:
        """Return what numba takes for this object where compiled code names it."""
        from numba import types

        arguments = [getattr(types, argument) for argument in self._arguments]
        return types.ExternalFunction(self._name, getattr(types, self._result)(*arguments))


class Entry(Part):
    """A function that Python calls: machine code from the cache, or compiled at the first call."""

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        self._loaded: dict[str, Callable[[list[Any]], object]] = {}

    def __call__(self, *arguments: object) -> Any:
        """Run the compiled function."""
        return self.bind(*arguments)()

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of arguments it has run with."""
        return tuple(self._loaded)

    def bind(self, *arguments: object) -> Callable[[], Any]:
        """Return a function without arguments that runs on these, the same arrays every time."""
        flat: list[Any] = []
        kind = ",".join(_flatten(argument, flat) for argument in arguments)
        run = self._loaded.get(kind) or self._load(kind, arguments)

        def bound(_kept: object = arguments) -> Any:  # the arrays live as long as the function
            return run(flat)

        return bound

    def _load(self, kind: str, arguments: tuple[object, ...]) -> Callable[[list[Any]], object]:
        with _LOCK:
            if kind not in self._loaded:
                path = self._path(kind)
                kept = _read(path)
                if kept is None:
                    kept = self._compile(arguments)
                    _keep(path, kept)
                self._loaded[kind] = _callable(kept)
            return self._loaded[kind]

    def _path(self, kind: str) -> Path:
        """Return where the machine code for arguments of this kind is kept."""
        source = Path(inspect.getfile(self.function)).read_bytes()
        digest = hashlib.sha256(f"{self.function.__qualname__} {kind} {processor()} ".encode() + source).hexdigest()
        return Path(cache_folder()) / f"{self.function.__name__.strip('_')}-{digest[:24]}.native"

    def _compile(self, arguments: tuple[object, ...]) -> bytes:
        """Return symbol, kind of result and machine code."""
        import numba

        while _LISTENERS:
            _LISTENERS.pop()("first run of this version here: compiling its real-time code, about 20 s more in all")

        signature = tuple(numba.typeof(argument) for argument in arguments)
        self.dispatcher.compile(signature)
        made = self.dispatcher.overloads[signature]
        about = {"symbol": made.fndesc.llvm_func_name, "result": _plain(made.signature.return_type)}
        code = made.library._get_compiled_object()
        if b"\0numba_" in code:  # calls into numba, for memory or Python objects
            raise TypeError(f"{self.function.__qualname__} could allocate or call Python: compiled code must not")
        return json.dumps(about).encode() + b"\n" + code


def entry(function: Callable[..., object]) -> Entry:
    """Compile a function that Python may call."""
    return Entry(function)


def part(function: F) -> F:
    """Compile a function into its compiled callers; Python cannot call it."""
    return Part(function, forceinline=True)  # type: ignore[return-value]


def announce(listener: Callable[[str], object]) -> None:
    """Have a sentence told once, before the first compilation of this process starts."""
    _LISTENERS[:] = [listener]


@cache
def cache_folder() -> str:
    """Return the folder of the compiled code for these sources, this Python and this numba."""
    package = Path(__file__).resolve().parents[1]
    files = [package / name for name in SOURCES]
    files += sorted(path for name in SOURCE_FOLDERS for path in (package / name).glob("*.py"))
    digest = hashlib.sha256(
        f"{sys.platform} {platform.python_version()} {version('numba')} {version('llvmlite')}".encode()
    )
    for path in files:
        digest.update(path.read_bytes())
    return str(user_cache() / f"compiled-{digest.hexdigest()[:16]}")


@cache
def processor() -> str:
    """Return what decides which instructions numba chooses: the host, and every setting of numba, from its environment
    variables (NUMBA_CPU_NAME, NUMBA_OPT, ...) or its file in the working directory."""
    import llvmlite.binding as llvm

    settings = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith("NUMBA_")]
    settings = [one for one in settings if not one.startswith(WITHOUT_EFFECT)]
    with suppress(OSError):  # mostly there is no such file
        settings.append(Path(".numba_config.yaml").read_bytes().hex())
    features = ""
    with suppress(RuntimeError):  # LLVM does not know the features of every host
        features = llvm.get_host_cpu_features().flatten()
    return f"{llvm.get_host_cpu_name()} {features} {' '.join(settings)}"


def _flatten(value: object, flat: list[Any]) -> str:
    """Append what the machine code takes for an argument; return its kind."""
    if isinstance(value, np.ndarray):
        if not (value.flags.c_contiguous and value.flags.aligned):
            raise TypeError("compiled code takes C-contiguous arrays only")
        place = value.__array_interface__["data"][0]
        flat += [None, None, ctypes.c_ssize_t(value.size), ctypes.c_ssize_t(value.itemsize), ctypes.c_void_p(place)]
        flat += [ctypes.c_ssize_t(number) for number in (*value.shape, *value.strides)]
        return f"{value.dtype.str}{value.ndim}{'' if value.flags.writeable else ' read only'}"
    if isinstance(value, tuple):
        return f"{type(value).__name__}({','.join(_flatten(item, flat) for item in value)})"
    if isinstance(value, bool | np.bool_):
        flat.append(ctypes.c_uint8(bool(value)))
        return "bool"
    if isinstance(value, int | np.int64):
        flat.append(ctypes.c_int64(int(value)))
        return "int"
    if not isinstance(value, float):  # numba would compile float32 or int32 in the name of float or int, for ever
        raise TypeError(f"compiled code takes int, float, bool, arrays and tuples of these, not {type(value).__name__}")
    flat.append(ctypes.c_double(value))
    return "float"


def _plain(kind: Any) -> str:
    """Return the name of a result's kind; a constant counts as its kind."""
    return str(getattr(kind, "literal_type", kind))


def _callable(kept: bytes) -> Callable[[list[Any]], object]:
    """Return a function that takes flat arguments, from kept machine code.

    numba's own calling convention: pointers for result and error, then all arguments taken apart.
    """
    head, _, code = kept.partition(b"\n")
    about = json.loads(head)
    function = ctypes.CFUNCTYPE(ctypes.c_int)(_address(about["symbol"], code))
    kind = RESULTS[about["result"]]

    def run(flat: list[Any]) -> object:
        result: Any = kind()
        error = ctypes.c_void_p()
        if function(ctypes.byref(result), ctypes.byref(error), *flat) not in (0, -2):
            raise RuntimeError(f"compiled {about['symbol']} failed")
        return result.value

    return run


def _address(symbol: str, code: bytes) -> int:
    """Load machine code into the process and return where the function stands."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(codemodel="jitdefault", jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _ENGINES.append(engine)
    return int(engine.get_function_address(symbol))


def _read(path: Path) -> bytes | None:
    """Return what is kept, None where nothing is or where it is damaged."""
    try:
        check, kept = path.read_bytes().split(b"\n", 1)
    except (OSError, ValueError):
        return None
    return kept if check == _check(kept) else None


def _check(kept: bytes) -> bytes:
    return hashlib.sha256(kept).hexdigest().encode()


def _keep(path: Path, kept: bytes) -> None:
    """Write machine code for later processes, whole or not at all; a cache that cannot be written is no fault."""
    part_file = path.with_suffix(f".{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part_file.write_bytes(_check(kept) + b"\n" + kept)
        os.replace(part_file, path)
    except OSError:
        with suppress(OSError):  # a read-only file system, or a file where the folder should be
            part_file.unlink()
