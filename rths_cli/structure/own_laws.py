"""A user's own law of a storey: load its code, compile it, and check that it keeps to what a law is.

The code is a Python file, or a module that an installed package names as an entry point of the group `rths.laws`:

    PARAMETERS = ("stiffness_n_per_m", ...)    names of its numbers, in the order of the array
    STATES = 1                                 how many numbers it remembers; they are zero at rest

    def force(parameters, state, next_state, drift_m, velocity_m_s): ...    -> force in N beside the storey's spring
    def tangents(parameters): ...    -> softest, stiffest in N/m beside that spring; least and greatest in N s/m

docs/howto/own_law.md is the manual.
"""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Protocol

import numpy as np

from rths_cli.case.plugin_interface import LAWS
from rths_cli.errors import InputError
from rths_cli.files.user_code import code_of_file, comes_back, installed_module, module_of_text, told, unbounded_work
from rths_cli.numerics.lti import Array
from rths_cli.numerics.user_functions import NOT_COMPILED, UserFunction, compile_force
from rths_cli.structure.storey_laws import NUMBERS, OWN, OWN_PARAMETERS, OWN_STATES, Law, Tangents

GROUP = LAWS
FIELD = "structure.numerical.law"
ARGUMENTS = 5  # of force
LONGEST_CALL_S = 20e-6  # in the step, of which there are up to some thousands per second
LONGEST_TRIAL_S = 10.0  # of all calls of the check
CALLS = 400  # of a trial: five cycles of growing amplitude
RATE_1_S = 2.0 * np.pi * 5.0  # of the largest drift, up to whose velocity a law is tried
AT_REST = 1e-3  # tangent at rest, of the largest one
ROUNDING = 1e-6  # of the largest tangent
SHORTEST = 1e-5  # of the largest drift: ways over which jumps of a force are looked for
TIMED = 200  # calls of which the time is taken, five times


class OwnLawSpec(Protocol):
    """What a structure file states of a user's own law: the file of its code with its checksum, or the name of an entry
    point; its numbers by name."""

    @property
    def file(self) -> Path | None: ...
    @property
    def sha256(self) -> str | None: ...
    @property
    def installed(self) -> str | None: ...
    @property
    def parameters(self) -> Mapping[str, float]: ...
    @property
    def largest_drift_m(self) -> float: ...


@dataclass(frozen=True, eq=False)
class Definition:
    """The code of a law: names of its parameters, number of states, its functions; `who` names it in faults."""

    who: str
    parameters: tuple[str, ...]
    states: int
    force: UserFunction
    tangents: Callable[[Array], Any]


@dataclass(frozen=True)
class Own(Law):
    """A user's own law with its numbers (p,) and the tangents that it declares."""

    code: ClassVar[int] = OWN
    definition: Definition
    parameters: tuple[float, ...]
    declared: Tangents

    @property
    def numbers(self) -> tuple[float, ...]:
        unused = (0.0,) * (NUMBERS - 1 - len(self.parameters))
        return (*self.parameters, *unused, self.declared.dashpot[1])

    @property
    def address(self) -> int:
        return self.definition.force.address

    @property
    def tangents(self) -> Tangents:
        return self.declared

    @property
    def yield_drift_m(self) -> float:
        named = dict(zip(self.definition.parameters, self.parameters, strict=True))
        return named.get("yield_displacement_m", math.nan)


def own_law(spec: OwnLawSpec) -> Own:
    """Return the law of a structure file; its code is run.

    Raises InputError when it cannot be loaded or compiled, with a sentence for every property of a law that it lacks,
    and for parameters that are not its own.
    """
    definition = _of_file(spec.file, spec.sha256) if spec.file is not None else installed_law(str(spec.installed))
    values = _values(definition, spec.parameters)
    return _checked(definition, values, float(spec.largest_drift_m))


def _of_file(path: Path, sha256: str | None) -> Definition:
    """Return the law of a file; raises InputError where it is no longer the one of the checksum."""
    return _definition(str(path), path.name, code_of_file(FIELD, path, sha256))


@lru_cache(maxsize=100)
def _definition(path: str, who: str, text: str) -> Definition:
    """Return the law of a text, run and compiled once."""
    return _of_module(module_of_text(FIELD, "rths_own_law", path, who, text), who, text)


@lru_cache(maxsize=100)
def installed_law(name: str) -> Definition:
    """Return the law of an entry point; raises InputError as `own_law` does."""
    module, who = installed_module(FIELD, GROUP, "law", name)
    return _of_module(module, who, inspect.getsource(module))


def _of_module(module: ModuleType, who: str, text: str) -> Definition:
    """Return the law of a module, compiled; raises InputError with every fault that its text shows."""
    names, states = getattr(module, "PARAMETERS", ()), getattr(module, "STATES", 0)
    force: Any = getattr(module, "force", None)
    tangents: Any = getattr(module, "tangents", None)
    faults = []
    if not isinstance(names, tuple) or not all(isinstance(one, str) for one in names) or len(names) > OWN_PARAMETERS:
        faults.append(f"PARAMETERS must be a tuple of at most {OWN_PARAMETERS} names")
    if not isinstance(states, int) or not 0 <= states <= OWN_STATES:
        faults.append(f"STATES must be a whole number from 0 to {OWN_STATES}")
    if not inspect.isfunction(force) or len(inspect.signature(force).parameters) != ARGUMENTS:
        faults.append("has no function force(parameters, state, next_state, drift_m, velocity_m_s)")
    if not callable(tangents):
        faults.append("has no function tangents(parameters) that returns the softest and the stiffest, in N/m")
    faults += unbounded_work(text, "a force for every drift", ("tangents",))
    if faults:
        raise InputError(*(f"{FIELD}: {who}: {fault}" for fault in faults))
    try:
        made = compile_force(force, len(names), states)
    except NOT_COMPILED as error:
        raise InputError(f"{FIELD}: {who}: numba cannot compile force: {told(error)}") from error
    if made.runtime_calls:
        called = ", ".join(sorted(made.runtime_calls))
        raise InputError(
            f"{FIELD}: {who}: force makes arrays, draws random numbers or calls Python ({called}); compute with "
            "numbers and with the arrays that it is given only"
        )
    return Definition(who, names, states, made, tangents)


def _values(definition: Definition, stated: Mapping[str, float]) -> tuple[float, ...]:
    """Return the numbers in the order of the law."""
    wanted = definition.parameters
    faults = [f"parameters.{name} is missing" for name in wanted if name not in stated]
    known = ", ".join(wanted) or "none"
    faults += [f"parameters.{name}: unknown; the law has {known}" for name in stated if name not in wanted]
    if faults:
        raise InputError(*(f"{FIELD}: {definition.who}: {fault}" for fault in faults))
    return tuple(float(stated[name]) for name in wanted)


@lru_cache(maxsize=1000)
def _checked(definition: Definition, values: tuple[float, ...], largest_drift_m: float) -> Own:
    """Return the law with these numbers, tried once."""
    declared = _declared(definition, np.array(values))
    faults: list[str] = []

    def tried() -> None:
        try:
            faults.extend(dict.fromkeys(_faults(definition, np.array(values), declared, largest_drift_m)))
        except IndexError:
            faults.append(
                f"force reads or writes beyond its arrays: it has {len(values)} PARAMETERS and {definition.states} "
                "STATES"
            )
        except Exception as error:
            faults.append(f"force fails: {told(error)}")

    if not comes_back(tried, LONGEST_TRIAL_S):  # compiled code holds no lock
        faults = [f"force has not come back within {LONGEST_TRIAL_S:g} s; bound its loops"]
    if faults:
        raise InputError(*(f"{FIELD}: {definition.who}: {fault}" for fault in faults))
    return Own(definition, values, declared)


def _declared(definition: Definition, values: Array) -> Tangents:
    """Return the tangents that a law declares."""
    who = f"{FIELD}: {definition.who}: tangents"
    try:
        numbers = [float(one) for one in np.ravel(definition.tangents(values))]
    except Exception as error:
        raise InputError(f"{who} failed: {told(error)}") from error
    if len(numbers) not in (2, 4) or not np.isfinite(numbers).all():
        raise InputError(
            f"{who} must return two finite numbers, softest and stiffest in N/m, or two more, the least and the "
            f"greatest dashpot in N s/m; got {numbers}"
        )
    soft, stiff, least, most = (*numbers, 0.0, 0.0)[:4]
    if not (soft <= 0.0 <= stiff and least <= most):
        raise InputError(
            f"{who} must return softest <= 0 <= stiffest, beside the storey's spring, and least <= greatest; got "
            f"{numbers}"
        )
    return Tangents((soft, stiff), (least, most))


def _faults(definition: Definition, values: Array, declared: Tangents, largest_m: float) -> Iterator[str]:
    """Yield a sentence for each property that a law lacks, as histories of drifts up to the largest one show."""
    called = _time_per_call(definition, values, largest_m)
    if called > LONGEST_CALL_S:
        yield f"force takes {1e6 * called:.3g} us per call, at most {1e6 * LONGEST_CALL_S:g} us; shorten its loops"
        return
    force, states = definition.force.checked, definition.states
    state, new, other, given = np.zeros(states), np.zeros(states), np.zeros(states), values.copy()
    steps = np.arange(1, CALLS + 1)

    def at_no_velocity(drift_m: float) -> float:
        return float(force(given, state, other, drift_m, 0.0))

    drifts = largest_m * steps / CALLS * np.sin(10.0 * np.pi * steps / CALLS)
    velocities = RATE_1_S * largest_m * steps / CALLS * np.cos(10.0 * np.pi * steps / CALLS)
    at_zero = force(given, state, new, 0.0, 0.0)
    if at_zero != 0.0:
        yield "force at rest (no drift, no velocity, states zero) must be 0; shift it"
    for moving in (True, False):  # along a motion, then along the same drifts at no velocity
        state[:], before, last = 0.0, 0.0, at_zero
        for u, speed in zip(drifts.tolist(), velocities.tolist(), strict=True):
            v, kept = speed if moving else 0.0, state.copy()
            new[:], other[:] = 1.0, np.nan
            value = force(given, state, new, u, v)
            again = force(given, state, other, u, v)
            if np.isnan(other).any() and np.isfinite(new).all() and again == value:
                yield f"force must write all {states} numbers of next_state in every call"
                return
            if not (np.isfinite(value) and np.isfinite(new).all()):
                yield f"force or next_state is not finite, at a drift of {u:.4g} m and {v:.4g} m/s"
                return
            if not (np.array_equal(kept, state) and np.array_equal(given, values)):
                yield "force changes parameters or state; it may write to next_state only"
                return
            if again != value or not np.array_equal(new, other):
                yield "force gives another result when it is called again; it may read its arguments only"
                return
            if not moving and u != before:
                for slope in _chords(at_no_velocity, (before, u), (last, value), SHORTEST * largest_m):
                    yield from _outside("stiffness", slope, declared.stiffness, "N/m")
            if moving:
                faster = force(given, state, other, u, v + 1e-3 * RATE_1_S * largest_m)
                slope = (faster - value) / (1e-3 * RATE_1_S * largest_m)
                yield from _outside("dashpot", slope, declared.dashpot, "N s/m")
            before, last = u, value
            state[:] = new
    state[:] = 0.0
    small = 1e-6 * largest_m
    at_rest = (force(given, state, new, small, 0.0) - force(given, state, new, -small, 0.0)) / (2.0 * small)
    if abs(at_rest) > AT_REST * max(map(abs, declared.stiffness)):
        yield (
            f"force has the tangent {at_rest:.4g} N/m at rest, which must be 0: add it to the storey's "
            "stiffness_n_per_m, and take its force k u from this one"
        )


def _chords(
    force: Callable[[float], float], drifts_m: tuple[float, float], forces_n: tuple[float, float], shortest_m: float
) -> list[float]:
    """Return the slopes in N/m of a force between two drifts, and those found by halving towards the steepest and the
    least steep part: a small jump has a slope of its own only over a short way."""
    found = [(forces_n[1] - forces_n[0]) / (drifts_m[1] - drifts_m[0])]
    for side in (1.0, -1.0):
        (a, b), (at_a, at_b) = drifts_m, forces_n
        while abs(b - a) > shortest_m:
            middle = 0.5 * (a + b)
            at_middle = force(middle)
            first, second = (at_middle - at_a) / (middle - a), (at_b - at_middle) / (b - middle)
            found.append(side * max(side * first, side * second))
            if side * first >= side * second:
                b, at_b = middle, at_middle
            else:
                a, at_a = middle, at_middle
    return found


def _outside(what: str, slope: float, declared: tuple[float, float], unit: str) -> Iterator[str]:
    """Yield a sentence on a tangent beyond those declared."""
    margin = ROUNDING * max(abs(slope), *map(abs, declared))
    if not declared[0] - margin <= slope <= declared[1] + margin:
        yield (
            f"force has a {what} outside of what tangents declares, {declared[0]:.4g} to {declared[1]:.4g} {unit}, by "
            "which the test is judged; declare its bounds, and let the force have no jumps"
        )


def _time_per_call(definition: Definition, values: Array, largest_m: float) -> float:
    """Return the time of a call in s, the least of five means."""
    call, means = definition.force.checked, []
    state, new = np.zeros(definition.states), np.zeros(definition.states)
    for _ in range(5):
        start = time.perf_counter()
        for i in range(TIMED):
            call(values, state, new, largest_m * i / TIMED, largest_m)
        means.append((time.perf_counter() - start) / TIMED)
    return min(means)
