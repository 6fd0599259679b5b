"""Substructure real-time hybrid simulation (RTHS) with a uni-axial shake table.

`resolve`, `run`, `load`, `check`, `identify` and `plot` are what a script needs, `open_loop`, `to_control` and
`from_control` connect it to python-control; docs/reference/python.md shows each. Nothing heavy is imported before one
of them is used.
"""

from __future__ import annotations

from rths_cli.version import __version__

TYPE_CHECKING = False  # typing takes longer to import than all else that is done before signals are taken
if TYPE_CHECKING:
    from typing import Any

    from rths_cli.api import check, from_control, identify, load, open_loop, plot, resolve, run, to_control
    from rths_cli.api.results import CheckResult, Group, ModelResult, RunResult
    from rths_cli.errors import InputError, LimitError, RigError, RthsError


__all__ = [
    "CheckResult",
    "Group",
    "InputError",
    "LimitError",
    "ModelResult",
    "RigError",
    "RthsError",
    "RunResult",
    "__version__",
    "check",
    "from_control",
    "identify",
    "load",
    "open_loop",
    "plot",
    "resolve",
    "run",
    "to_control",
]

_FUNCTIONS = ("check", "from_control", "identify", "load", "open_loop", "plot", "resolve", "run", "to_control")
_ERRORS = ("InputError", "LimitError", "RigError", "RthsError")


def __getattr__(name: str) -> Any:
    """Return a public name, its module imported when it is first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # by name, so that no layer below counts as importing those above

    module = "api" if name in _FUNCTIONS else "errors" if name in _ERRORS else "api.results"
    return getattr(import_module(f"{__name__}.{module}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
