"""The child's side of a program's process: build what is asked for, then answer until the connection closes.

What a program prints goes to a file that the parent reads; Ctrl-C is the parent's. A call that hangs is ended by the
kernel's alarm, whatever it does, and a child without parent ends itself.
"""

from __future__ import annotations

import importlib
import math
import mmap
import os
import pickle
import signal
import sys
import threading
import time
from importlib.metadata import entry_points
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.programs import integration
from rths_cli.programs.process import FORCE, MOST_FLOORS, Described, Description

GROUP, INTERFACE = "rths.programs", 1
BUILT_IN = {"python": "rths_cli.programs.python_model", "opensees": "rths_cli.programs.opensees_model"}
GRACE_S = 5.0  # beyond the parent's patience, after which the kernel ends a call
PROBE = 1e-4  # of the displacement under the floors' weight sideways, over which the tangent at rest is taken
FIRST_PROBE_M = 1e-7


class Model(Protocol):
    """What the module of a kind has to make: `make(description)` returns a model that is built and at rest."""

    masses_kg: Array  # (p,)
    floors: tuple[str, ...]  # (p,) in words
    version: str

    def force(self, displacement_m: Array) -> Array:
        """Return the restoring forces (p,) in N at displacements (p,) in m from rest, and keep that state."""

    def first_hz(self) -> float:
        """Return the first natural frequency by the model's own analysis at rest, NaN where it has none."""


class Child:
    """The model, and what the parent may ask of it."""

    def __init__(self, shared: Array) -> None:
        self.shared = shared
        self.patience_s = 10.0

    def build(self, description: Description) -> Described:
        """Build the model of a description."""
        self.description, self.patience_s = description, description.silent_after_s
        self.module = _module_of(description.kind)
        self.restart()
        stiffness = tangent_at_rest(self.model)
        first_hz = float(self.model.first_hz())
        self.restart()
        masses = np.asarray(self.model.masses_kg, dtype=float)
        return Described(masses, stiffness, tuple(self.model.floors), first_hz, self.model.version)

    def restart(self) -> None:
        """Build the model anew."""
        self.model: Model = self.module.make(self.description)
        self.floors = len(self.model.masses_kg)

    def answer(self) -> None:
        """Answer to the displacements in shared memory."""
        found = np.asarray(self.model.force(self.shared[0, : self.floors].copy()), dtype=float)
        if found.shape != (self.floors,):
            raise ValueError(f"force gave an array of shape {found.shape}, {(self.floors,)} is needed")
        self.shared[1, : self.floors] = found

    def response(self, *arguments: Any) -> Any:
        """Return the response of the whole structure, computed by the model's own program."""
        return self.model.response(*arguments)  # type: ignore[attr-defined]

    def whole(self, *arguments: Any) -> Any:
        """Return the response of the undivided structure, as `integration.whole`."""
        return integration.whole(self.model.force, *arguments)

    def divided(self, *arguments: Any) -> Any:
        """Return the response of the divided structure, as `integration.divided`."""
        return integration.divided(self.model.force, *arguments)


def tangent_at_rest(model: Model) -> Array:
    """Return the condensed stiffness (p, p) in N/m at rest, by central differences over displacements that are small
    beside those under the floors' weight sideways. Raises ValueError where no floor resists."""
    masses = np.asarray(model.masses_kg, dtype=float)
    first = _differences(model, np.full(len(masses), FIRST_PROBE_M))
    weight = 9.81 * masses
    with np.errstate(all="ignore"):
        sideways = np.abs(np.linalg.lstsq(first, weight, rcond=None)[0])
    if not (np.isfinite(first).all() and (np.diag(first) > 0.0).all()):
        raise ValueError(f"no stiffness at rest: the forces over small displacements are {first.tolist()} N/m")
    stiffness = _differences(model, np.maximum(PROBE * sideways.max(), 1e-10) * np.ones(len(masses)))
    return np.asarray(0.5 * (stiffness + stiffness.T))


def _differences(model: Model, steps_m: Array) -> Array:
    columns = []
    for i, step in enumerate(steps_m):
        moved = np.zeros(len(steps_m))
        moved[i] = step
        columns.append((np.asarray(model.force(moved)) - np.asarray(model.force(-moved))) / (2.0 * step))
    model.force(np.zeros(len(steps_m)))
    return np.array(columns).T


def _module_of(kind: str) -> Any:
    """Return the module of a kind: ours, or that of a package's entry point."""
    if kind in BUILT_IN:
        return importlib.import_module(BUILT_IN[kind])
    found = tuple(entry_points(group=GROUP, name=kind))
    if len(found) != 1:
        known = ", ".join([*BUILT_IN, *sorted({one.name for one in entry_points(group=GROUP)})])
        raise LookupError(f"{len(found)} installed packages bring a program {kind!r}, it must be one; known: {known}")
    module = found[0].load()
    stated = getattr(module, "RTHS_INTERFACE", 1)  # as case.plugin_interface, which stands above
    if stated not in range(1, INTERFACE + 1):
        raise LookupError(
            f"program {kind} ({found[0].value}) states RTHS_INTERFACE = {str(stated)[:40]!r}, this rths has "
            f"{INTERFACE}; update rths, or take an older version of its package"
        )
    return module


def _watch(parent: int) -> None:
    """End this process once its parent is gone."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _answer(child: Child, message: bytes) -> tuple[str, Any]:
    """Return what came of a message: ("done", value), or ("fault", what a sentence on it says)."""
    try:
        if message == FORCE:
            signal.alarm(math.ceil(child.patience_s + GRACE_S))
            child.answer()
            return "done", None
        operation, longest_s, arguments = pickle.loads(message)
        signal.alarm(math.ceil(longest_s + GRACE_S))
        return "done", getattr(child, operation)(*arguments)
    except SystemExit as error:
        return "fault", f"called exit({error.code if error.code is not None else ''})"
    except BaseException as error:  # whatever a user's code raises
        text = " ".join(str(error).split())[:300]
        return "fault", f"failed: {type(error).__name__}: {text}" if text else f"failed: {type(error).__name__}"
    finally:
        signal.alarm(0)


def main() -> None:
    """Serve the connection and the shared memory whose file descriptors are the arguments."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection, memory = Connection(int(sys.argv[1])), mmap.mmap(int(sys.argv[2]), 0)
    threading.Thread(target=_watch, args=(os.getppid(),), daemon=True).start()
    child = Child(np.frombuffer(memory, dtype=float).reshape(2, MOST_FLOORS))
    sys.path[0] = os.getcwd()
    while True:
        try:
            message = connection.recv_bytes()
        except (EOFError, OSError):
            os._exit(0)  # without what a program does at exit
        answer = _answer(child, message)
        sys.stdout.flush()
        connection.send_bytes(pickle.dumps(answer))


if __name__ == "__main__":
    main()
