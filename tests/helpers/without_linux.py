"""Show the package another system in a process on Linux: modules and functions that are missing there are hidden.

Libraries keep the system that they were built for. Compiled code keeps Linux's clock, so that it is the code that the
user's cache holds. The names of a standard module on a system are those that typeshed declares, which mypy brings.
"""

from __future__ import annotations

import ast
import builtins
import importlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import mypy

PACKAGE = "rths_cli"
UNIX_MODULES = (
    "crypt", "curses", "fcntl", "grp", "posix", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty",
)  # fmt: skip
ABSENT_MODULES = {"win32": UNIX_MODULES, "darwin": ()}
CLOCK = f"{PACKAGE}.numerics.clock"
NARROWER = ("mmap", "os", "select", "signal", "socket", "sys", "time")  # modules with less in them elsewhere
OS_NAME = {"win32": "nt", "darwin": "posix"}
STUBS = Path(mypy.__file__).parent / "typeshed" / "stdlib"


class View(ModuleType):
    """A module as another system has it: some names are missing, some have other values, the rest is the module."""

    def __init__(self, module: ModuleType, missing: set[str], other: dict[str, object]) -> None:
        super().__init__(module.__name__)
        self.__dict__.update({"of": (module, missing, other)})

    def __getattr__(self, name: str) -> Any:
        module, missing, other = self.__dict__["of"]
        if name in missing:
            raise AttributeError(f"this system has no {module.__name__}.{name}")
        return other[name] if name in other else getattr(module, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self.__dict__["of"][0], name, value)


def declared(module: str, system: str) -> set[str]:
    """Return the names of a standard module on a system ("linux", "darwin", "win32")."""
    path = STUBS / f"{module}.pyi"
    text = (path if path.exists() else STUBS / module / "__init__.pyi").read_text(encoding="utf-8")
    return set(_names(ast.parse(text).body, system))


def _names(statements: Sequence[ast.stmt], system: str) -> Iterator[str]:
    about = type("sys", (), {"platform": system, "version_info": sys.version_info})
    for node in statements:
        if isinstance(node, ast.If):
            yield from _names(node.body if eval(ast.unparse(node.test), {"sys": about}) else node.orelse, system)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id
        elif isinstance(node, ast.Assign):
            yield from (target.id for target in node.targets if isinstance(target, ast.Name))
        elif isinstance(node, ast.ImportFrom):
            yield from (one.asname or one.name for one in node.names)


def view(module: str, system: str) -> View:
    """Return a standard module as this package would find it on a system."""
    other: dict[str, object] = {"os": {"name": OS_NAME[system]}, "sys": {"platform": system}}.get(module, {})
    return View(importlib.import_module(module), declared(module, "linux") - declared(module, system), other)


def become(system: str) -> None:
    """Let this process be one on another system for every module of the package that is imported from now on."""
    assert not any(name.split(".")[0] == PACKAGE for name in sys.modules), "the package saw Linux already"
    views = {name: view(name, system) for name in NARROWER}
    real_import = builtins.__import__

    def imported(
        name: str, globals: Any = None, locals: Any = None, fromlist: Sequence[str] = (), level: int = 0
    ) -> ModuleType:
        if level == 0 and str((globals or {}).get("__name__", "")).split(".")[0] == PACKAGE:
            if name.split(".")[0] in ABSENT_MODULES[system]:
                raise ModuleNotFoundError(f"this system has no module {name}")
            if name in views and (globals or {})["__name__"] != CLOCK:
                return views[name]
        return real_import(name, globals, locals, fromlist, level)

    builtins.__import__ = imported
    importlib.import_module(CLOCK).REAL_TIME = False


def forbid_network() -> None:
    """Raise from now on where a socket is made, bound or used, or a name is looked up."""

    def heard(event: str, arguments: object) -> None:
        if event.startswith("socket."):
            raise AssertionError(f"the network was used: {event} {arguments}")

    sys.addaudithook(heard)
