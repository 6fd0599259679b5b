"""Code that a case file or an installed package brings: load it, and see what in its text has no bounded work.

Loading runs the code, with the user's rights.
"""

from __future__ import annotations

import ast
import hashlib
import pickle
import sys
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from rths_cli.case.plugin_interface import stated_interface
from rths_cli.errors import InputError


def code_of_file(field: str, path: Path, sha256: str | None) -> str:
    """Return the text of a Python file; raises InputError where it is no longer the one of the checksum."""
    try:
        content = path.read_bytes()
        text = content.decode()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{field}: {path} cannot be read: {error}") from error
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise InputError(f"{field}: {path} has changed since the case was read; start again")
    return text


def module_of_text(field: str, name: str, path: str, who: str, text: str) -> ModuleType:
    """Return the module that a text makes when it is run; raises InputError where it fails."""
    module = ModuleType(f"{name}_{hashlib.sha256(f'{path}{text}'.encode()).hexdigest()[:16]}")
    module.__file__ = path
    sys.modules[module.__name__] = module  # dataclasses look there for the module of a class
    try:
        exec(compile(text, path, "exec"), vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[module.__name__]
        raise InputError(f"{field}: {who} cannot be loaded: {told(error)}{_neighbour(error, Path(path))}") from error
    return module


def _neighbour(error: BaseException, path: Path) -> str:
    """Return what to do where a file imports one beside it."""
    name = (error.name or "").split(".")[0] if isinstance(error, ImportError) else ""
    if not name or not ((path.parent / f"{name}.py").exists() or (path.parent / name).is_dir()):
        return ""
    return (
        f"; the {name} beside it cannot be imported, since a case keeps the checksum of one file: write what it holds "
        "into that file, or install it as a package"
    )


def variables(module: ModuleType) -> dict[str, Any]:
    """Return what the variables of a module hold, to be compared with what they hold later."""
    return contents({name: one for name, one in vars(module).items() if not name.startswith("__")}, module.__name__)


def contents(values: Mapping[str, Any], own: str) -> dict[str, Any]:
    """Return what each value holds; `own`: the name of the module whose classes and functions are looked into."""
    return {name: _content(one, own) for name, one in values.items()}


def _content(value: Any, own: str) -> Any:
    if isinstance(value, type | FunctionType):
        attributes = {name: one for name, one in vars(value).items() if not name.startswith("__")}
        return id(value), contents(attributes, own) if value.__module__ == own else None
    if isinstance(value, ModuleType) or type(value).__module__.startswith("numba"):
        return id(value)
    try:
        return pickle.dumps(value)
    except Exception:  # whatever an object of the user raises
        return contents(vars(value), own) if type(value).__module__ == own and hasattr(value, "__dict__") else id(value)


def changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Return the names whose values are no longer what they were, or that came or went."""
    return [name for name in {**before, **after} if (name in before) != (name in after) or before[name] != after[name]]


def installed_module(field: str, group: str, what: str, name: str) -> tuple[ModuleType, str]:
    """Return the module of an entry point, and what names it in faults; raises InputError where it is none."""
    found = tuple(entry_points(group=group, name=name))
    if len(found) != 1:
        known = ", ".join(sorted({point.name for point in entry_points(group=group)})) or "none"
        raise InputError(
            f"{field}: {len(found)} installed packages bring a {what} {name!r}, it must be one; installed: {known}"
        )
    who = f"{what} {name} ({found[0].value})"
    try:
        module = found[0].load()
    except (Exception, SystemExit) as error:
        raise InputError(f"{field}: {who} cannot be loaded: {told(error)}; repair its package") from error
    if not isinstance(module, ModuleType):
        raise InputError(f"{field}: {who} must name a module, not {type(module).__name__}")
    stated_interface(found[0], f"{field}: {who}")
    return module, who


def unbounded_work(text: str, instead: str, left_out: Collection[str] = ()) -> Iterator[str]:
    """Yield what in the functions of a text, but for those `left_out`, has no bounded work or raises; `instead`: what
    to return instead of raising."""
    for one in ast.parse(text).body:
        if not isinstance(one, ast.FunctionDef) or one.name in left_out:
            continue
        for node in ast.walk(one):
            line = getattr(node, "lineno", 0)
            if isinstance(node, ast.While):
                yield f"line {line}: while has no bound of its work; write for ... in range(n), left by break"
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == one.name:
                yield f"line {line}: {one.name} calls itself, which has no bound of its work; write a loop"
            elif isinstance(node, ast.Raise | ast.Assert):
                yield f"line {line}: nothing may be raised while a table moves; return {instead}"


def imported(text: str) -> set[str]:
    """Return the names of the modules that a text imports, without those inside of packages."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {one.name.partition(".")[0] for one in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition(".")[0])
    return found


def comes_back(work: Callable[[], object], seconds: float) -> bool:
    """Do a work in a thread, and return whether it has come to its end in time; one that has not goes on, because code
    cannot be stopped."""
    trial = threading.Thread(target=work, daemon=True)
    trial.start()
    trial.join(seconds)
    return not trial.is_alive()


def told(error: BaseException) -> str:
    """Return an exception as part of a sentence, on one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}"[:300] if text else type(error).__name__
