"""A user's law as a function of its state and inputs, and the linear block that it is, found by exciting it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rths_cli.control.feedforward import INPUTS as DESIRED
from rths_cli.errors import InputError
from rths_cli.files.user_code import changed, contents
from rths_cli.numerics.lti import Array, Block

SENT = "sent_v"
TRIALS = 60  # random states and inputs, of 1e-6 to 1e3 each, on which superposition is tested
SMALLEST, LARGEST = -6.0, 3.0  # powers of ten
IN_A_ROW, FOLLOWS = 2000, 1e-9  # inputs one after another, and how near block and law are then
ROUNDING = 1e-9  # of the sum of the terms' sizes
TYPICAL = np.array([10.0, 0.5, 0.05])  # m/s^2, m/s, m: a desired motion near a table's limits
TIMED = 200  # calls of which the time is taken, five times
STEP_SHARE = 0.2  # of the loop's interval: the longest time of a law in Python on a real rig


def measured_names(channels: int, interface: str = "acceleration") -> tuple[str, ...]:
    """Return the names of the corrected accelerations of table and floors, or what an actuator that tracks displacement
    returns."""
    if interface == "displacement":
        return "measured_disp_m", "measured_force_n"
    return ("table_accel_m_s2", *(f"floor_accel_{i}_m_s2" for i in range(1, channels)))


@dataclass(frozen=True)
class Law:
    """A law with its numbers (p,): `command(parameters, state, next_state, desired, measured, sent)`, or a class `made`
    from the numbers, with an array `state` and `command(desired, measured, sent)`."""

    name: str
    parameters: Array
    declared_states: int
    channels: int
    command: Callable[..., float] | None
    made: Callable[[Array], Any] | None

    @property
    def states(self) -> int:
        """Return how many numbers it remembers."""
        return self.declared_states if self.command is not None else self.tried.state.size

    def new(self) -> Any:
        """Return an object with `state` and `command(desired, measured, sent)`, at rest."""
        if self.command is not None:
            return _OfFunction(self.command, self.parameters.copy(), np.zeros(self.declared_states))
        assert self.made is not None
        made = self.made(self.parameters.copy())
        state = getattr(made, "state", None)
        if not isinstance(state, np.ndarray) or state.ndim != 1 or state.dtype != float:
            raise InputError(
                f"controller: {self.name}: class Compensator has {_instead(state)} state, an array (n,) of floats with "
                "all that it remembers; write self.state = np.zeros(n) in __init__"
            )
        if "state" in vars(type(made)):
            raise InputError(
                f"controller: {self.name}: state belongs to the class, so that its objects share it; write "
                "self.state = np.zeros(n) in __init__"
            )
        return made

    @cached_property
    def tried(self) -> Any:
        """Return the one object that is tried: what it remembers beside its state must show."""
        return self.new()

    @cached_property
    def beside_state(self) -> dict[str, Any]:
        """Return what the one object holds beside its state when it is new."""
        return self._beside_state()

    def _beside_state(self) -> dict[str, Any]:
        held = {} if self.made is None else getattr(self.tried, "__dict__", {})
        own = type(self.tried).__module__
        return contents({name: one for name, one in held.items() if name != "state"}, own)

    def remembers(self) -> str:
        """Return the sentence for attributes beside its state that calls have changed, "" for none."""
        names = ", ".join(changed(self.beside_state, self._beside_state()))
        return names and f"remembers {names} beside state; keep all that changes during calls in state"

    def evaluated(self, state: Array, given: Array) -> Array:
        """Return the command, then the next state, (1 + n,), for a state (n,) and inputs (3 + c + 1,): desired motion,
        measured accelerations, command that was sent."""
        made = self.tried
        made.state[:] = state
        made_v = float(made.command(given[:3].copy(), given[3:-1].copy(), float(given[-1])))
        return np.concatenate([[made_v], made.state])

    def in_step(self) -> _InStep:
        """Return the law at rest as the step calls a Python feedforward."""
        return _InStep(self.new())

    def faults(self) -> list[str]:
        """Return a sentence for each property that the law lacks, as a few states and inputs show."""
        try:
            return list(dict.fromkeys(self._faults()))
        except InputError:
            raise
        except Exception as error:
            told = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            stated = self.command is None or "size 0" not in told
            return [f"command failed: {told}{'' if stated else '; STATES, how many numbers it remembers, is 0'}"]

    def _faults(self) -> Iterator[str]:
        n, m = self.states, 3 + self.channels + 1
        new, another = self.new(), self.new()
        if np.shares_memory(new.state, another.state):
            yield "its objects share one array state; make it in __init__"
            return
        if new.state.any():
            yield f"state must be zero at rest, got {new.state[:5].tolist()}; a test begins there"
            return
        _ = self.beside_state  # as it is before the first call
        if np.any(self.evaluated(np.zeros(n), np.zeros(m)) != 0.0):
            yield "at rest (state and inputs zero) command and next_state must be 0: a test begins there without a jump"
        for state, given in samples_of_motion(n, self.channels):
            kept, numbers = given.copy(), self.parameters.copy()
            first, again = self.evaluated(state, given), self.evaluated(state, given)
            if not np.isfinite(first).all():
                asked = f"the desired motion {given[:3].round(4).tolist()}"
                yield f"command or next_state is not finite for {asked}; write all of next_state in every call"
                return
            if not np.array_equal(first, again):
                yield "gives another result when it is called again from the same state; keep all memory in state"
                return
            if not (np.array_equal(kept, given) and np.array_equal(numbers, self.parameters)):
                yield "changes its inputs or parameters; write to next_state only"
                return
        if told := self.remembers():
            yield told


def _instead(state: Any) -> str:
    """Return what an object has that has no array of floats as its state."""
    if state is None:
        return "no attribute"
    kind = f"{state.ndim}-dimensional array of {state.dtype}" if isinstance(state, np.ndarray) else type(state).__name__
    return f"a {kind} as its"


class _OfFunction:
    """A law that is a function, with its state."""

    def __init__(self, function: Callable[..., float], parameters: Array, state: Array) -> None:
        self.function, self.parameters, self.state = function, parameters, state
        self.after = np.full(len(state), np.nan)

    def command(self, desired: Array, measured: Array, sent: float) -> float:
        """Return the command in V, and make the next state the state."""
        self.after[:] = np.nan  # what is not written is told
        made = float(self.function(self.parameters, self.state, self.after, desired, measured, sent))
        self.state[:] = self.after
        return made


class _InStep:
    """A law at rest, as control.python_parts.Compensator."""

    def __init__(self, made: Any) -> None:
        self.made = made

    def command(self, motion: Array, corrected: Array, sent: Array) -> Array:
        """Return the command (1,) in V for the desired motion (3, 1)."""
        return np.array([self.made.command(motion[:, 0].copy(), corrected.copy(), float(sent[0, 0]))])


def seconds_per_call(command: Callable[[Array, Array, Array], Array], channels: int) -> float:
    """Return the time in s of a call as the step makes it, the least of five means."""
    motion, measured, sent, means = TYPICAL[:, None].copy(), np.ones(channels), np.full((1, 1), 0.1), []
    for _ in range(5):
        start = time.perf_counter()
        for _ in range(TIMED):
            command(motion, measured, sent)
        means.append((time.perf_counter() - start) / TIMED)
    return min(means)


def samples_of_motion(states: int, channels: int) -> Iterator[tuple[Array, Array]]:
    """Yield states (n,) and inputs (3 + c + 1,) of a table that moves, zero states first."""
    rng = np.random.default_rng(0)
    sizes = np.concatenate([TYPICAL, np.full(channels, TYPICAL[0]), [5.0]])
    for i in range(20):
        given = sizes * rng.uniform(-1.0, 1.0, sizes.size)
        yield (0.01 * rng.standard_normal(states) if i > 5 else np.zeros(states)), given


def derived_block(law: Law, dt_s: float) -> Block | None:
    """Return the block from desired motion, measured accelerations and sent command that a law is, None where
    superposition does not hold: unit states and inputs give its matrices, random ones test them."""
    n, m = law.states, 3 + law.channels + 1
    rng = np.random.default_rng(1)
    try:
        with np.errstate(all="ignore"):
            matrix = _superposed(law, n, m, rng)
    except Exception:  # a table that ends, a root: such a law is not linear, and its trial is one of usual motions
        return None
    if matrix is None:
        return None
    names = (*DESIRED, *measured_names(law.channels), SENT)
    found = Block("feedforward", matrix[1:, :n], matrix[1:, n:], matrix[:1, :n], matrix[:1, n:], dt_s, names,
                  ("command_v",))  # fmt: skip
    with np.errstate(all="ignore"):
        follows = _follows(law, found, rng.standard_normal((IN_A_ROW, m)))
    return found if follows else None


def _superposed(law: Law, n: int, m: int, rng: np.random.Generator) -> Array | None:
    """Return the matrix (1 + n, n + m) of a law, None where superposition does not hold."""
    matrix = np.array([law.evaluated(unit[:n], unit[n:]) for unit in np.eye(n + m)]).T
    if not np.isfinite(matrix).all():
        return None
    for _ in range(TRIALS):
        given = rng.standard_normal(n + m) * 10.0 ** rng.uniform(SMALLEST, LARGEST, n + m)
        off = np.abs(law.evaluated(given[:n], given[n:]) - matrix @ given)
        if not np.all(off <= ROUNDING * np.abs(matrix) @ np.abs(given)):
            return None
    return matrix


def _follows(law: Law, block: Block, inputs: Array) -> bool:
    """Return whether a law gives the outputs of its block for inputs (k, m) one after another, from rest."""
    made, state = law.new(), np.zeros(len(block.A))
    size = np.abs(block.C) @ np.ones(len(state)) + np.abs(block.D) @ np.ones(inputs.shape[1])
    for given in inputs:
        wanted = float((block.C @ state + block.D @ given).item())
        code = float(made.command(given[:3].copy(), given[3:-1].copy(), float(given[-1])))
        state = block.A @ state + block.B @ given
        if not np.isfinite(state).all():
            return True  # so far it did: a block that is unstable
        if not abs(code - wanted) <= FOLLOWS * (float(size[0]) * (1.0 + np.abs(state).max(initial=0.0))):
            return False
    return True


def with_sent_before(block: Block) -> Block:
    """Return a derived block whose last input is its own command of the sample before."""
    n = len(block.A)
    by_sent, through = block.B[:, -1:], block.D[:, -1:]
    a = np.block([[block.A, by_sent], [block.C, through]])
    b = np.vstack([block.B[:, :-1], block.D[:, :-1]])
    c = np.hstack([block.C, through])
    assert a.shape == (n + 1, n + 1)
    return Block(block.name, a, b, c, block.D[:, :-1], block.dt_s, block.inputs[:-1], block.outputs)


def declared_block(
    linear: Callable[..., Any], law: Law, dt_s: float, adapted: Array | None = None, interface: str = "acceleration"
) -> Block:
    """Return the block that a law which is not linear declares, from desired motion and measured samples; `adapted`
    (k,): with these values of the parameters that move."""
    names = (*DESIRED, *measured_names(law.channels, interface))
    at = () if adapted is None else (adapted.copy(),)
    try:
        a, b, c, d = (np.asarray(one, dtype=float) for one in linear(law.parameters.copy(), dt_s, *at))
        n, m = len(a), d.shape[-1]
        if d.shape != (1, m) or not len(DESIRED) <= m <= len(names):
            raise ValueError(f"D of shape {d.shape}")
        matrices = (a.reshape(n, n), b.reshape(n, m), c.reshape(1, n), d)
        return Block("feedforward", *matrices, dt_s, names[:m], ("command_v",))
    except Exception as error:
        told = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(
            f"controller: {law.name}: linear must return A (n, n), B (n, m), C (1, n), D (1, m), m from 3 to "
            f"{len(names)} inputs ({', '.join(names)}); it gave: {told}"
        ) from error
