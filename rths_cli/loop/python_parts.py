"""Parts of the step whose work a Python object does, called from compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from rths_cli.control.interface import Interface
from rths_cli.control.python_parts import PythonFeedforward, PythonPart, PythonSubstructure
from rths_cli.errors import InputError
from rths_cli.loop.parts import Room
from rths_cli.numerics.compiled import part, part_class
from rths_cli.numerics.lti import Array
from rths_cli.numerics.user_functions import Callback, call


@part
def fetch(address: int, made: Array) -> None:
    """Have a Python object write what it makes; after a fault it is not a number, by which the guard stops the test."""
    if call(address) == 0:
        for i in range(made.size):
            made[i] = math.nan


@part_class
class CalledSubstructure(NamedTuple):
    """A numerical substructure in Python, as parts.NumericalSubstructure."""

    calls_free: int  # address
    calls_advance: int  # address
    ground: Array  # (3,) handed over
    force: Array  # (i,) handed over
    accel: Array  # (i,) taken over
    made: Array  # (3 i,) taken over
    direct: Array  # (i, i)
    logged: Array  # (l,)

    def free(self, ground: Array, accel: Array) -> None:
        """Write the accelerations (i,) without interface force, as parts.NumericalSubstructure."""
        for q in range(3):
            self.ground[q] = ground[q]
        fetch(self.calls_free, self.accel)
        for i in range(self.accel.size):
            accel[i] = self.accel[i]

    def advance(self, ground: Array, force: Array, motion: Array) -> None:
        """Write the interface's absolute motion (3, i) and go on, as parts.NumericalSubstructure."""
        for i in range(self.force.size):
            self.force[i] = force[i]
        fetch(self.calls_advance, self.made)
        for q in range(3):
            for i in range(self.force.size):
                motion[q, i] = self.made[q * self.force.size + i]


@part_class
class CalledFeedforward(NamedTuple):
    """A feedforward in Python, as parts.Feedforward."""

    calls: int  # address
    motion: Array  # (3, i) handed over
    corrected: Array  # (c,) handed over
    sent: Array  # (., a) handed over
    made: Array  # (a,) taken over
    logged: Array  # (l,)

    def feed_forward(self, motion: Array, corrected: Array, sent: Array, command: Array) -> None:
        """Write the commands (a,) in V for the desired motion (3, i), as parts.Feedforward."""
        for q in range(3):
            for i in range(motion.shape[1]):
                self.motion[q, i] = motion[q, i]
        for c in range(corrected.size):
            self.corrected[c] = corrected[c]
        for k in range(min(sent.shape[0], self.sent.shape[0])):
            for a in range(sent.shape[1]):
                self.sent[k, a] = sent[k, a]
        fetch(self.calls, self.made)
        for a in range(command.size):
            command[a] = self.made[a]


def called_substructure(design: PythonSubstructure, interface: Interface, room: Room) -> CalledSubstructure:
    """Return the part that calls a new Python model; raises InputError if its `direct` is not (i, i) finite numbers."""
    count, model = len(interface.channels), design.make()
    ground, force, accel, made = np.zeros(3), np.zeros(count), np.zeros(count), np.zeros(3 * count)
    logged = np.zeros(len(design.logs))
    direct = np.array(model.direct, dtype=float)
    if direct.shape != (count, count) or not np.isfinite(direct).all():
        raise InputError(f"{design.name}: direct must be finite and of shape {(count, count)}, it is {model.direct!r}")

    def free() -> None:
        accel[:] = given("free", model.free(ground), (count,))

    def advance() -> None:
        made[:] = given("advance", model.advance(ground, force), (3, count)).reshape(-1)
        if design.logs:
            logged[:] = given("logged", getattr(model, "logged", ()), logged.shape)

    failed: list[BaseException] = []

    def until_a_fault(work: Callable[[], None]) -> Callable[[], None]:
        def call() -> None:
            if failed:
                raise failed[0]
            try:
                work()
            except BaseException as fault:
                failed.append(fault)
                logged[:] = math.nan  # the rows that follow are of no step
                raise

        return call

    calls_free, calls_advance = addresses_of(design, until_a_fault(free), until_a_fault(advance))
    return CalledSubstructure(calls_free, calls_advance, ground, force, accel, made, direct, logged)


def called_feedforward(design: PythonFeedforward, interface: Interface, room: Room) -> CalledFeedforward:
    """Return the part that calls a Python compensator."""
    model, count = design.make(), len(interface.channels)
    motion, made, logged = np.zeros((3, count)), np.zeros(interface.actuators), np.zeros(len(design.logs))
    corrected = np.zeros(interface.force.samples.shape[1])
    sent = np.zeros((design.remembers, interface.actuators))

    def command() -> None:
        made[:] = given("command", model.command(motion, corrected, sent), made.shape)
        if design.logs:
            logged[:] = given("logged", getattr(model, "logged", ()), logged.shape)

    (calls,) = addresses_of(design, command)
    return CalledFeedforward(calls, motion, corrected, sent, made, logged)


def addresses_of(design: PythonPart[Any], *functions: Callable[[], None]) -> list[int]:
    """Return the addresses of functions for compiled code; the design keeps them alive and knows their faults."""
    made = tuple(Callback(function) for function in functions)
    design.callbacks.append(made)
    return [one.address for one in made]


def given(what: str, value: object, shape: tuple[int, ...]) -> Array:
    """Return what a Python object gave; raises ValueError unless it is finite numbers of a shape."""
    found = np.asarray(value, dtype=float)
    if found.shape != shape:
        raise ValueError(f"{what} gave an array of shape {found.shape}, {shape} is needed")
    if not np.isfinite(found).all():
        raise ValueError(f"{what} gave a number that is not finite")
    return found
