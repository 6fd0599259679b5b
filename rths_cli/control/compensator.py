"""Compensators: what a module states to be one, and the part of the step that its law becomes.

A compensator stands in the place of the feedforward: it makes the command from the interface's desired motion, and may
use the corrected samples. Its module, which is one of `control/compensators/`, a user's file or one that an entry point
of `rths.compensators` names, states

    SOURCE = "..."                                  the paper or equation (compensators of rths: always)
    OPTIONS = {"name": (default, least, most, "what it is, with its unit")}     default None: the design chooses
    def design(plant, options): ...                 -> the numbers of the law, or its discrete block

and unless the design gives a block, one of

    STATES = 1
    def command(parameters, state, next_state, desired, measured, sent): ...            -> the command in V
    class Compensator: __init__(parameters), state (n,), command(desired, measured, sent)

A law that adapts states which of its numbers move, the last of its state (control.interface.Adapted):

    ADAPTS = {"gain": "V/m"}                                                            names and units
    def bounds(parameters, dt_s): ...           -> start, least, most, largest change in a second, of each
    def linear(parameters, dt_s, adapted): ...  -> A, B, C, D at these values

docs/howto/own_controller.md is the manual. A law that is linear becomes its block (control.law_block) and runs as one;
another one runs as compiled code, or where numba cannot compile it in Python.
"""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from rths_cli.case.compensator_schema import OWN, STATE_SPACE, built_in_compensators
from rths_cli.case.plugin_interface import COMPENSATORS
from rths_cli.control.block_files import placed_block, read_block
from rths_cli.control.interface import Adapted, Logged, PartDesign, not_judged
from rths_cli.control.law_block import Law, declared_block, derived_block, samples_of_motion, with_sent_before
from rths_cli.control.law_trial import code_and_block
from rths_cli.control.python_parts import PythonFeedforward
from rths_cli.errors import InputError
from rths_cli.files.user_code import (
    changed,
    code_of_file,
    comes_back,
    imported,
    installed_module,
    module_of_text,
    told,
    unbounded_work,
    variables,
)
from rths_cli.numerics.lti import Array, Block, Model
from rths_cli.numerics.user_functions import NOT_COMPILED, UserFunction, compile_command
from rths_cli.structure import Specimen

FIELD = "controller"
MOST_STATES, MOST_PARAMETERS = 500, 5000
LONGEST_TRIAL_S = 10.0  # of the calls by which a law is tried
DESIGNED_AGAIN_S = 1.0  # the longest design that is made twice, to see that it gives the same
COMPILED_AS_PYTHON = 1e-9  # of the largest number that a law gives: how near compiled code is to it
NEVER_TWICE_THE_SAME = {"time", "datetime", "random", "secrets"}  # modules
PHASE_LINES = 200  # of the compared band, over which the lag of the table is averaged


class CompensatorSpec(Protocol):
    """What a case states of a compensator."""

    @property
    def kind(self) -> str: ...
    @property
    def file(self) -> Path | None: ...
    @property
    def sha256(self) -> str | None: ...
    @property
    def lead_samples(self) -> int: ...
    @property
    def options(self) -> Mapping[str, float]: ...


@dataclass(frozen=True)
class Plant:
    """What the design of a compensator may know: the identified table and specimen, and the loop's rates.

    `band_hz`: where model and data were compared. `lead_samples`: by how many samples the desired motion is ahead of
    the table. `channels`: number of accelerometers, the table's first. `interface` "displacement": an actuator whose
    command is a displacement in m, not in V, and whose two measured channels are its displacement in m and the force in
    N; the model is that of its acceleration all the same.
    """

    model: Model
    specimen: Specimen
    dt_s: float
    band_hz: tuple[float, float]
    lead_samples: int = 0
    channels: int = 1
    interface: Literal["acceleration", "displacement"] = "acceleration"

    def needs_displacement(self, kind: str) -> None:
        """Raise InputError on a table of which accelerations are measured; `kind` uses the measured displacement."""
        if self.interface != "displacement":
            raise InputError(
                f"{FIELD}: {kind} uses the measured displacement of an actuator, of this table accelerations are "
                "measured; use another kind (rths benchmark silva2020 has such an actuator)"
            )

    @property
    def gain_m_per_v(self) -> float:
        """Return the displacement of the table per V of a slow command."""
        return self.model.low_frequency_gain_m_per_v

    @cached_property
    def lag_s(self) -> float:
        """Return by how much the table is late in the compared band, less the lead of the desired motion: the
        least-squares slope of the phase of the identified displacement per command."""
        frequency = np.linspace(*self.band_hz, PHASE_LINES)
        angle = 2.0 * np.pi * frequency
        displacement = -self.model.response(frequency) / angle**2
        phase = np.unwrap(np.angle(displacement))
        phase -= 2.0 * np.pi * np.round(phase[0] / (2.0 * np.pi))
        return float(-(angle @ phase) / (angle @ angle)) - self.lead_samples * self.dt_s

    def block(self, system: Block) -> Block:
        """Return a filter of the desired displacement (m to m) as the block of a compensator: over the table's gain."""
        c, d = system.C / self.gain_m_per_v, system.D / self.gain_m_per_v
        return replace(system, C=c, D=d, inputs=("desired_disp_m",), outputs=("command_v",))


class Option(NamedTuple):
    """An option of a compensator: its default (None: the design chooses), range, and what it is."""

    default: float | None
    least: float
    most: float
    what: str


@dataclass(frozen=True, eq=False)
class Definition:
    """The code of a compensator, as its module states it; `who` names it in faults."""

    who: str
    text: str
    source: str
    options: Mapping[str, Option]
    states: int
    design: Callable[[Plant, dict[str, float | None]], Any] | None
    command: Callable[..., float] | None
    made: Callable[[Array], Any] | None
    linear: Callable[..., Any] | None
    adapts: Mapping[str, str]
    bounds: Callable[[Array, float], Any] | None
    module: ModuleType
    loaded: Mapping[str, Any]  # what the module's variables held at first

    def changed(self) -> str:
        """Return the sentence for variables of the module that are no longer what they were, "" for none."""
        names = ", ".join(changed(self.loaded, variables(self.module)))
        return names and (
            f"design or command changes the module's {names}, of which compiled code keeps the first value; return "
            "numbers from design, and keep what changes during calls in state"
        )

    def values(self, stated: Mapping[str, float]) -> dict[str, float | None]:
        """Return every option; raises InputError for unknown ones and for those out of their range."""
        faults = []
        for name, value in stated.items():
            known = self.options.get(name)
            if known is None:
                near = get_close_matches(name, self.options, n=1)
                advice = f"did you mean {near[0]}?" if near else f"it has {', '.join(self.options) or 'none'}"
                faults.append(f"{FIELD}.{name}: {self.who} has no such option; {advice}")
            elif not known.least <= value <= known.most:
                limits = f"from {known.least:g} to {known.most:g}"
                faults.append(f"{FIELD}.{name}: must be {limits} ({known.what}), got {value:g}")
        if faults:
            raise InputError(*faults)
        return {name: stated.get(name, option.default) for name, option in self.options.items()}


@dataclass(frozen=True)
class CompiledLaw:
    """The design of a compensator that is not linear, as compiled code; `judged`: its linear block, which it declares
    itself where `declares`; `at`: the same with other values of the parameters that move, `adapted`."""

    name: str
    function: UserFunction
    parameters: Array
    states: int
    judged: Block | None
    declares: bool = False
    affine: bool = True
    linear: bool = False
    adapted: Adapted | None = None
    at: Callable[[Array], Block] | None = field(default=None, compare=False)
    multiplications: int = 0
    units_per_v: float = 1.0  # of its command; metres per V of an actuator

    @property
    def logs(self) -> tuple[Logged, ...]:
        """Return the parameters that move: the log has their values."""
        return () if self.adapted is None else tuple(map(Logged, self.adapted.names, self.adapted.units))

    def linearised(self, at: Array | None = None) -> Block:
        """Return the declared linear block; raises InputError where there is none."""
        if self.judged is None:
            raise not_judged(self.name)
        return self.judged


@dataclass(frozen=True)
class CalledLaw(PythonFeedforward):
    """The same as a Python object; `why` it is not compiled."""

    declares: bool = False
    why: str = ""


@dataclass(frozen=True)
class Compensator:
    """A compensator as a case states it: the code of a law with its options, or a block from a file."""

    name: str
    lead_samples: int
    definition: Definition | None = None
    options: Mapping[str, float | None] = field(default_factory=dict)
    block: Block | None = None

    def designed(self, plant: Plant) -> PartDesign:
        """Return the part of the step; raises InputError for a law that does not keep to the contract."""
        if self.definition is None:
            assert self.block is not None
            return placed_block(FIELD, self.block, plant.dt_s, plant.channels)
        made = designed_law(self.definition, self.options, plant)
        if isinstance(made, Block):
            return made
        part = part_of_law(self.definition, made, plant.dt_s)
        if isinstance(part, CompiledLaw | CalledLaw) and part.judged is not None:
            _agree(made, part.judged, plant)
        return part


def _agree(law: Law, judged: Block, plant: Plant) -> None:
    """Raise InputError where the block by which a law is judged is another one than its code, for small motions."""
    try:
        of_displacement = plant.interface == "displacement"
        off = code_and_block(law, judged, plant.channels, plant.lag_s / plant.dt_s, False, of_displacement)
    except Exception as error:  # whatever the user's code raises
        off = f"the code failed: {told(error)}"
    if off:
        raise InputError(
            f"{FIELD}: {law.name}: the block by which the check judges it is not its code for a motion of 1 um: {off}; "
            "correct linear or command (rths plugin test tries both)"
        )


def compensator_of(spec: CompensatorSpec) -> Compensator:
    """Return the compensator that a case states; a user's code is run. Raises InputError with every fault."""
    if spec.kind == STATE_SPACE:
        assert spec.file is not None
        return Compensator(STATE_SPACE, spec.lead_samples, block=read_block(FIELD, spec.file, spec.sha256))
    definition = definition_of(spec.kind, spec.file, spec.sha256)
    return Compensator(definition.who, spec.lead_samples, definition, definition.values(spec.options))


def definition_of(kind: str, file: Path | None = None, sha256: str | None = None) -> Definition:
    """Return the code of a kind of compensator, that of a `file` for kind own."""
    if kind == OWN:
        assert file is not None
        return _of_text(str(file), file.name, code_of_file(FIELD, file, sha256))
    if kind in built_in_compensators():
        return _built_in(kind)
    module, who = installed_module(FIELD, COMPENSATORS, "compensator", kind)
    return _of_module(module, who, inspect.getsource(module))


@lru_cache(maxsize=100)
def _built_in(name: str) -> Definition:
    module = import_module(f"rths_cli.control.compensators.{name}")
    return _of_module(module, name, inspect.getsource(module))


@lru_cache(maxsize=100)
def _of_text(path: str, who: str, text: str) -> Definition:
    return _of_module(module_of_text(FIELD, "rths_own_compensator", path, who, text), who, text)


def _of_module(module: ModuleType, who: str, text: str) -> Definition:
    """Return the compensator of a module; raises InputError with all that it lacks."""
    design, command, made, linear = (
        getattr(module, name, None) for name in ("design", "command", "Compensator", "linear")
    )
    adapts, bounds = getattr(module, "ADAPTS", {}), getattr(module, "bounds", None)
    states, options = getattr(module, "STATES", 0), getattr(module, "OPTIONS", {})
    faults = list(_faults_of_options(options))
    if command is not None and (not inspect.isfunction(command) or len(inspect.signature(command).parameters) != 6):
        faults.append("command must be a function (parameters, state, next_state, desired, measured, sent)")
    if command is None and made is None and not callable(design):
        faults.append("has no function command, no class Compensator, and no function design that gives a block")
    if not isinstance(states, int) or not 0 <= states <= MOST_STATES:
        faults.append(f"STATES must be a whole number from 0 to {MOST_STATES}")
    faults += [f"{name} must be a function" for name, one in (("design", design), ("linear", linear))
               if one is not None and not callable(one)]  # fmt: skip
    faults += _faults_of_adapting(adapts, bounds, command, linear, states)
    if clocks := ", ".join(sorted(imported(text) & NEVER_TWICE_THE_SAME)):
        faults.append(f"imports {clocks}: what a law gives may not depend on clock or chance; remove it")
    if faults:
        raise InputError(*(f"{FIELD}: {who}: {fault}" for fault in faults))
    known = {name: Option(*one) for name, one in options.items()}
    source = str(getattr(module, "SOURCE", ""))
    return Definition(
        who, text, source, known, states, design, command, made, linear, adapts, bounds, module, _at_first(module)
    )


@lru_cache(maxsize=100)
def _at_first(module: ModuleType) -> Mapping[str, Any]:
    """Return what the variables of a module held when it was used first in this process."""
    return variables(module)


def _faults_of_options(options: object) -> Sequence[str]:
    """Return what is wrong with the OPTIONS of a module."""
    if not isinstance(options, dict):
        return ('OPTIONS must be a mapping such as {"gain": (1.0, 0.0, 10.0, "what it is")}',)
    faults = []
    for name, one in options.items():
        if not isinstance(one, tuple) or len(one) != 4 or not isinstance(one[3], str) or not _is_range(*one[:3]):
            faults.append(f'OPTIONS: {name} must be (default or None, least, most, "what it is"), least <= most')
        elif name in ("kind", "file", "sha256", "lead_samples") or not str(name).isidentifier():
            faults.append(f"OPTIONS: {name} cannot be a key of a case beside kind, file, sha256 and lead_samples")
    return faults


def _faults_of_adapting(adapts: object, bounds: object, command: object, linear: object, states: object) -> list[str]:
    """Return what a module lacks whose law adapts."""
    if adapts == {}:
        return []
    if not isinstance(adapts, dict) or not all(isinstance(one, str) for pair in adapts.items() for one in pair):
        return ['ADAPTS must be a mapping of names to units such as {"gain": "V/m"}']
    if not all(callable(one) for one in (bounds, command, linear)):
        return ["ADAPTS needs the functions command, bounds(parameters, dt_s) and linear(parameters, dt_s, adapted)"]
    if not isinstance(states, int) or states < len(adapts):
        return [f"ADAPTS has {len(adapts)} names, the last states of the law, and STATES is {states}"]
    return []


def adapted_of(definition: Definition, law: Law, dt_s: float) -> Adapted | None:
    """Return the parameters of a law that move, None for one that does not adapt; raises InputError for bounds that
    are none."""
    if not definition.adapts:
        return None
    assert definition.bounds is not None
    who, k = f"{FIELD}: {definition.who}", len(definition.adapts)
    try:
        numbers = np.array([np.asarray(one, float) for one in definition.bounds(law.parameters.copy(), dt_s)])
    except Exception as error:  # whatever the user's code raises
        raise InputError(f"{who}: bounds failed: {told(error)}") from error
    shaped = numbers.shape == (4, k) and np.isfinite(numbers).all()
    if not shaped or np.any(numbers[1] > numbers[0]) or np.any(numbers[0] > numbers[2]) or np.any(numbers[3] < 0.0):
        raise InputError(
            f"{who}: bounds must give start, least, most and largest change in a second, {k} finite numbers each, "
            f"least <= start <= most; got {numbers.round(6).tolist()}"
        )
    start, least, most, rate = numbers
    return Adapted(tuple(definition.adapts), tuple(definition.adapts.values()), start, least, most, rate * dt_s)


def _is_range(default: object, least: object, most: object) -> bool:
    numbers = [one for one in (least, default, most) if one is not None]
    return all(isinstance(one, int | float) for one in numbers) and least is not None and numbers == sorted(numbers)  # type: ignore[type-var]


def designed_law(definition: Definition, options: Mapping[str, float | None], plant: Plant) -> Law | Block:
    """Return the law of a definition with its numbers, or the block that its design gives.

    Raises InputError for a design that fails, and for a law that is not at rest, not finite or not determined by its
    state and inputs.
    """
    who = f"{FIELD}: {definition.who}"
    started = time.perf_counter()
    given = _given(definition, options, plant)
    short = definition.design is not None and time.perf_counter() - started <= DESIGNED_AGAIN_S
    again = _given(definition, options, plant) if short else given
    if told_of := definition.changed():
        raise InputError(f"{who}: {told_of}")
    if not _same(given, again):
        raise InputError(f"{who}: design gives another result when it is called again; use plant and options only")
    if isinstance(given, Block):
        return placed_block(who, given, plant.dt_s, plant.channels, plant.interface)
    if definition.command is None and definition.made is None:
        raise InputError(f"{who}: design gives numbers, but there is no function command and no class Compensator")
    law = Law(definition.who, given, definition.states, plant.channels, definition.command, definition.made)
    faults: list[str] = []
    if not comes_back(lambda: faults.extend(_faults_of(law)), LONGEST_TRIAL_S):
        faults = [f"command has not come back within {LONGEST_TRIAL_S:g} s; bound its loops"]
    faults += [told_of] if (told_of := definition.changed()) and not faults else []
    if faults:
        raise InputError(*(f"{who}: {fault}" for fault in faults))
    return law


def _given(definition: Definition, options: Mapping[str, float | None], plant: Plant) -> Array | Block:
    """Return the numbers (p,) of a law, or its block, as its design gives them; raises InputError for anything else."""
    who = f"{FIELD}: {definition.who}"
    given: Any = list(options.values()) if definition.design is None else _called(definition, options, plant)
    if isinstance(given, Block):
        return given
    try:
        numbers = np.array([float(one) for one in given], dtype=float)
    except (TypeError, ValueError):
        told_of = "has an option without a default, and no design that chooses it" if definition.design is None else (
            f"design must give numbers or a Block, got {str(given)[:60]!r}"
        )  # fmt: skip
        raise InputError(f"{who}: {told_of}") from None
    if numbers.size > MOST_PARAMETERS or not np.isfinite(numbers).all():
        raise InputError(f"{who}: design must give at most {MOST_PARAMETERS} finite numbers")
    return numbers


def _same(one: Array | Block, other: Array | Block) -> bool:
    """Return whether two designs are the same."""
    if isinstance(one, Block) and isinstance(other, Block):
        return all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in "ABCD")
    return not isinstance(one, Block) and not isinstance(other, Block) and np.array_equal(one, other)


def _faults_of(law: Law) -> Sequence[str]:
    try:
        return law.faults()
    except InputError as error:
        return [fault.removeprefix(f"{FIELD}: {law.name}: ") for fault in error.faults]


def _called(definition: Definition, options: Mapping[str, float | None], plant: Plant) -> Any:
    assert definition.design is not None
    try:
        return definition.design(plant, dict(options))
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{FIELD}: {definition.who}: design failed: {told(error)}") from error


def part_of_law(definition: Definition, law: Law, dt_s: float) -> PartDesign:
    """Return the part of a law: its block where it is linear, else compiled code, else Python.

    A law that uses the command that was sent is judged as a block whose command is sent as it is, and runs as code.
    """
    derived = derived_block(law, dt_s)
    if derived is not None and not derived.B[:, -1].any() and not derived.D[:, -1].any():
        return placed_block(FIELD, without_sent(derived), dt_s, law.channels)
    judged, made_at, adapted = None, None, adapted_of(definition, law, dt_s)
    if derived is not None:
        judged = placed_block(FIELD, with_sent_before(derived), dt_s, law.channels)
    elif definition.linear is not None:
        made_at = _placed_at(definition, law, dt_s)
        judged = made_at(adapted.start) if adapted else made_at(None)
    function = compiled_function(definition, law)
    if told_of := definition.changed() or law.remembers():
        raise InputError(f"{FIELD}: {law.name}: {told_of}")
    if isinstance(function, UserFunction):
        _compiled_is_the_law(function, law)
        return CompiledLaw(
            definition.who, function, law.parameters, law.states, judged, declares=derived is None, adapted=adapted,
            at=made_at,
        )  # fmt: skip
    if adapted is not None:
        raise InputError(f"{FIELD}: {law.name}: a law that adapts (ADAPTS) must be compiled: {function}")
    return CalledLaw(definition.who, law.in_step, judged, remembers=1, declares=derived is None, why=function)


def _placed_at(definition: Definition, law: Law, dt_s: float) -> Callable[[Array | None], Block]:
    """Return what gives the declared block of a law at values of the parameters that move."""

    def at(adapted: Array | None) -> Block:
        assert definition.linear is not None
        return placed_block(FIELD, declared_block(definition.linear, law, dt_s, adapted), dt_s, law.channels)

    return at


def _compiled_is_the_law(function: UserFunction, law: Law) -> None:
    """Raise InputError where compiled code gives other numbers than the same code in Python."""
    after = np.zeros(law.states)
    for state, given in samples_of_motion(law.states, law.channels):
        wanted = law.evaluated(state, given)
        command = function.checked(law.parameters, state, after, given[:3], given[3:-1], float(given[-1]))
        off = np.abs(np.concatenate([[command], after]) - wanted).max()
        if not off <= COMPILED_AS_PYTHON * np.abs(wanted).max():
            raise InputError(
                f"{FIELD}: {law.name}: compiled, it gives {command:.6g} V, in Python {wanted[0]:.6g} V (largest "
                f"difference, with its states: {off:.3g}); keep its numbers in parameters, and integers small"
            )


def without_sent(block: Block) -> Block:
    """Return a derived block whose last input, the command that was sent, has no effect, without that input."""
    return replace(block, B=block.B[:, :-1], D=block.D[:, :-1], inputs=block.inputs[:-1])


def compiled_function(definition: Definition, law: Law) -> UserFunction | str:
    """Return the compiled command of a law, or why it runs in Python."""
    if definition.command is None:
        return "a class is not compiled"
    return _compiled(definition, len(law.parameters), law.channels)


@lru_cache(maxsize=100)
def _compiled(definition: Definition, parameters: int, channels: int) -> UserFunction | str:
    """Return a compiled command; what is kept here lives as long as the process, as its address must."""
    if unbounded := tuple(unbounded_work(definition.text, "a command for every motion", ("design", "linear"))):
        return unbounded[0]
    assert definition.command is not None
    try:
        made = compile_command(definition.command, parameters, definition.states, channels)
    except NOT_COMPILED as error:
        return f"numba cannot compile command: {told(error)}"
    if made.runtime_calls:
        called = ", ".join(sorted(made.runtime_calls))
        return f"command makes arrays, draws random numbers or calls Python ({called})"
    return made


def made_up_plant(channels: int = 3, dt_s: float = 5e-4) -> Plant:
    """Return a table of second order, 30 Hz and 70 %, 1 ms of delay, with two floors, for trials without a rig."""
    angle = 2.0 * math.pi * 30.0
    poles = angle * np.exp(1j * np.array([1.0, -1.0]) * math.acos(-0.7))
    model = Model(np.zeros(2, complex), poles.astype(complex), 0.0079 * angle**2, 2.0 * dt_s, (0.7, 60.0), dt_s=dt_s)
    specimen = Specimen(np.array([7.0, 7.0]), np.array([[2.0, -1.0], [-1.0, 1.0]]) * 7000.0, 4.0 * np.eye(2))
    return Plant(model, specimen, dt_s, (0.7, 11.0), channels=channels)
