"""Computed floors whose forces a program gives at a lower rate than that of the step: the rate transition.

The step owns the state: an exact block of the linear part, M, C and the tangent at rest K, whose further inputs are
forces g on the floors, M d2x + C dx + K x + g = -M 1 a_g + e_p f. Every N samples the program is asked for the forces
r at the displacements that the linear part predicts for the end of the next interval, H = D + N samples ahead, where D
samples are what an answer takes. The residual r - K x is then reached on a straight line from its present value, so
that it has no jump whenever an answer comes: linear interpolation, whose error falls with the square of the interval.
A late answer lets the line go on for an interval, then the residual is held; what it has missed it makes up for no
faster than it has changed before, over more than an interval where need be.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from rths_cli.control.interface import LAW_FORCE, Logged
from rths_cli.control.numerical_substructure import INPUTS, interface, state_space
from rths_cli.control.python_parts import PythonSubstructure
from rths_cli.control.state_space import discretise
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, StateSpace
from rths_cli.programs import Program, ProgramFault
from rths_cli.structure import Building, Numerical
from rths_cli.structure.programs import storey_forces
from rths_cli.structure.storey_laws import Laws

WHOLE = 1e-6  # by which the sample rate may miss a whole multiple of the program's rate
LONGEST_HOLD = 4  # intervals without an answer beyond which the test is stopped
EXTRAPOLATED, LATE, SLOWED = "program_extrapolated", "program_late_s", "program_slowed"  # what is logged


Logger = Callable[[Array, Array], Array]
"""Displacements (p,) in m and residual (p,) in N to what is logged (p,)."""


class Asked(Protocol):
    """What is asked for forces: a program, or a linear stand-in by which the transition is judged."""

    def request(self, displacement_m: Array) -> None:
        """Ask for the forces at displacements (p,) in m."""

    def forces(self) -> Array:
        """Return the forces (p,) in N that were asked for."""


@dataclass(frozen=True)
class Transition:
    """How a program is asked: every `every` samples, with answers after `answer` samples; `stalls` (at, further) in
    samples. `block` is that of the linear part with `stiffness` (p, p), `ground` (n,) the record in m/s^2 as far as it
    is known ahead."""

    block: Block
    stiffness: Array
    every: int
    answer: int
    stalls: tuple[tuple[int, int], ...] = ()
    ground: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def floors(self) -> int:
        """Return p."""
        return len(self.stiffness)


class RateTransition:
    """The floors of a run, as control.python_parts.Substructure. All that it remembers stands in `memory`: state of the
    block, last interface force, residual with its slope, the last two residuals, the displacements asked for."""

    def __init__(self, plan: Transition, ask: Asked, name: str = "program", logged: Logger | None = None) -> None:
        self.plan, self.ask, self.name = plan, ask, name
        p, states = plan.floors, len(plan.block.A)
        self.memory = np.zeros(states + 1 + 5 * p)
        self.state, self.force_before = self.memory[:states], self.memory[states : states + 1]
        self.residual, self.slope, self.older, self.newer, self.asked_at = self.memory[states + 1 :].reshape(5, p)
        self.older_at, self.newer_at = -plan.every, 0  # samples
        self.step, self.due, self.due_at_best, self.target = 0, -1, -1, 0  # due: -1 for no answer to come
        self.left = 2 * plan.every  # samples for which the line goes on
        self.fastest, self.behind = np.zeros(p), False  # slopes of answers in time; whether some are made up for
        self.stalls = list(plan.stalls)
        self.direct = plan.block.D[-1:, 1:2].copy()
        self.inputs = np.zeros(2 + p)
        ahead = plan.answer + plan.every
        self._ahead, self._inputs_ahead = np.arange(1, ahead + 1), np.zeros((ahead, 2 + p))
        self._prediction = _prediction(plan.block, p, ahead)
        self.logs = logged
        self.logged = np.zeros(p + 3)

    def free(self, ground: Array) -> Array:
        """Return the absolute acceleration (1,) of the interface without interface force; take an answer due."""
        self.logged[-2:] = 0.0
        if self.step == self.due:
            self.logged[-2] = (self.due - self.due_at_best) * self.plan.block.dt_s
            self._take()
        elif self.due >= 0 and self.step - self.due_at_best > LONGEST_HOLD * self.plan.every:
            raise ProgramFault(
                f"{self.name} has not answered for {self.step - self.due_at_best} samples beyond what an answer takes, "
                f"the limit is {LONGEST_HOLD} of its intervals, {LONGEST_HOLD * self.plan.every} samples"
            )
        self.inputs[0], self.inputs[1], self.inputs[2:] = ground[0], 0.0, self.residual
        self.made = self.plan.block.C @ self.state + self.plan.block.D @ self.inputs
        return self.made[-1:].copy()

    def advance(self, ground: Array, force: Array) -> Array:
        """Return the interface's absolute motion (3, 1) at this instant, and go to the next one."""
        block, p = self.plan.block, self.plan.floors
        self.inputs[1] = force[0]
        made = self.made + block.D[:, 1] * force[0]
        motion = np.array([[made[3 * p - 1]], [made[2 * p - 1] + ground[1]], [made[p - 1] + ground[2]]])
        self._log(made[:p])
        self.state[:] = block.A @ self.state + block.B @ self.inputs
        if self.step % self.plan.every == 0:
            if self.due < 0:
                self._request(ground[0], float(force[0]))
            else:
                self.logged[-1] = 1.0
        self._go_on()
        self.force_before[0] = force[0]
        self.step += 1
        return motion

    def resume(self, memory: Array) -> None:
        """Go on at an instant of request, as every interval of a run without late answers does, from a memory."""
        every, answer = self.plan.every, self.plan.answer
        self.memory[:] = memory
        self.step = 0
        if answer == every:  # the answer of the interval before comes now
            self.due = self.due_at_best = 0
            self.target, self.newer_at, self.left = every, 0, every
            self.ask.request(self.asked_at)
        else:
            self.newer_at, self.left = answer, every + answer
        self.older_at = self.newer_at - every

    def _log(self, displacement_m: Array) -> None:
        p = self.plan.floors
        self.logged[:p] = self.residual if self.logs is None else self.logs(displacement_m, self.residual)
        self.logged[p] = 1.0 if self.left < self.plan.every else 0.0

    def _go_on(self) -> None:
        """Move the residual along its line by one sample."""
        if self.left > 0:
            self.residual += self.slope
        self.left -= 1

    def _take(self) -> None:
        """Take the answer that is due, and aim at its residual, or beyond it where it is late, an interval ahead."""
        plan = self.plan
        found = self.ask.forces() - plan.stiffness @ self.asked_at
        self.older[:], self.older_at = self.newer, self.newer_at
        self.newer[:], self.newer_at = found, self.target
        ahead = min(self.step + plan.every - self.newer_at, plan.every)
        there = self.newer + (self.newer - self.older) * (ahead / max(self.newer_at - self.older_at, 1))
        self.slope[:] = (there - self.residual) / plan.every
        late = self.due > self.due_at_best  # the next answer then makes up for the requests that were left out
        if self.behind or late:
            usual = np.abs(self.newer - self.older) / max(self.newer_at - self.older_at, 1)
            most = np.maximum(self.fastest, usual)
            self.behind = late or bool((np.abs(self.slope) > most).any())
            np.clip(self.slope, -most, most, out=self.slope)
        else:
            np.maximum(self.fastest, np.abs(self.slope), out=self.fastest)
        self.left, self.due = 2 * plan.every, -1

    def _request(self, ground: float, force: float) -> None:
        """Ask for the forces at the displacements that are predicted for the end of the interval after the answer."""
        plan = self.plan
        self.due_at_best = self.step + plan.answer
        self.due, self.target = self.due_at_best, self.due_at_best + plan.every
        if self.stalls and self.step >= self.stalls[0][0]:
            self.due += self.stalls.pop(0)[1]
        self.asked_at[:] = self._predicted(ground, force)
        self.ask.request(self.asked_at)

    def _predicted(self, ground: float, force: float) -> Array:
        """Return the displacements (p,) in m at the end of the interval after the answer; the state is a sample on.

        The record is known, the interface force goes on as a straight line, the residual along its own.
        """
        i, known, inputs = self._ahead, self._known(ground), self._inputs_ahead
        inputs[:, 0] = known[np.minimum(self.step + i, known.size - 1)] if known.size else ground
        inputs[:, 1] = force + i * (force - self.force_before[0])
        inputs[:, 2:] = self.residual + np.minimum(i, max(self.left, 0))[:, None] * self.slope
        of_state, of_inputs = self._prediction
        return np.asarray(of_state @ self.state + of_inputs @ inputs.reshape(-1))

    def _known(self, ground: float) -> Array:
        """Return the record, nothing where the ground does not follow it."""
        record = self.plan.ground
        return record if self.step < record.size and record[self.step] == ground else record[:0]

    def close(self) -> None:
        """End what is asked."""
        end = getattr(self.ask, "close", None)
        if end is not None:
            end()


def _prediction(block: Block, p: int, ahead: int) -> tuple[Array, Array]:
    """Return what the displacements (p,) of a block some samples ahead are, of its state (., s) a sample from now and
    of the inputs (., ahead * i) of those samples."""
    of_inputs, row = [block.D[:p]], block.C[:p]
    for _ in range(ahead - 1):
        of_inputs.append(row @ block.B)
        row = row @ block.A
    return row, np.hstack(of_inputs[::-1])


class Started:
    """A program whose process starts when it is first asked."""

    def __init__(self, building: Building) -> None:
        assert building.program is not None
        self._description = building.program.description
        self._program: Program | None = None

    def request(self, displacement_m: Array) -> None:
        """Ask for the forces at displacements (p,) in m."""
        if self._program is None:
            self._program = Program(self._description)
        self._program.request(displacement_m)

    def forces(self) -> Array:
        """Return the forces (p,) in N that were asked for."""
        assert self._program is not None
        return self._program.forces()

    def close(self) -> None:
        """End the process."""
        if self._program is not None:
            self._program.close()


@dataclass(frozen=True)
class ProgramStoreys(PythonSubstructure):
    """The design of computed floors that are a program; `numerical` has the tangent at rest."""

    numerical: Numerical | None = field(default=None, compare=False)
    laws: Laws | None = field(default=None, compare=False)
    plan: Transition | None = field(default=None, compare=False)
    running: list[RateTransition] = field(default_factory=list, compare=False)

    def knowing(self, ground_m_s2: Array) -> ProgramStoreys:
        """Return the design for a run whose record (n,) in m/s^2 is known ahead."""
        assert self.plan is not None and self.building is not None
        return _design(self.building, replace(self.plan, ground=ground_m_s2), self.judged)

    def close(self) -> None:
        """End the programs of all runs."""
        while self.running:
            self.running.pop().close()


def program_storeys(building: Building, dt_s: float) -> ProgramStoreys:
    """Return the design of a building's floors that are a program.

    Raises InputError where the sample rate is no whole multiple of the program's rate, or an answer takes longer than
    the interval between two of them.
    """
    program = building.program
    assert program is not None
    every = round(1.0 / (program.rate_hz * dt_s))
    if every < 1 or abs(every * program.rate_hz * dt_s - 1.0) > WHOLE:
        raise InputError(
            f"structure.numerical.rate_hz: {program.rate_hz:g} Hz, the sample rate {1.0 / dt_s:g} Hz must be a whole "
            f"multiple of it; take {1.0 / (dt_s * max(every, 1)):.6g} Hz"
        )
    answer = max(1, math.ceil(program.answer_s / dt_s * (1.0 - WHOLE)))
    if answer > every:
        raise InputError(
            f"structure.numerical.rate_hz: at {program.rate_hz:g} Hz there are {1e3 / program.rate_hz:.4g} ms between "
            f"two answers, and one takes {1e3 * program.answer_s:.4g} ms (compute_time_s); lower rate_hz to at most "
            f"{1.0 / program.answer_s:.4g} Hz"
        )
    numerical = building.numerical
    linear = replace(numerical, K=program.stiffness_factor * numerical.K)
    stalls = tuple((math.ceil(at / dt_s), math.ceil(lasts / dt_s)) for at, lasts in sorted(program.stalls))
    plan = Transition(_block(linear, dt_s), linear.K, every, answer, stalls)
    return _design(building, plan, interface(numerical, dt_s))


def _design(building: Building, plan: Transition, judged: Block | None) -> ProgramStoreys:
    assert building.program is not None
    p, running = plan.floors, list[RateTransition]()
    beyond = plan.stiffness - building.numerical.K

    def logged(displacement_m: Array, residual_n: Array) -> Array:
        return storey_forces((beyond @ displacement_m + residual_n)[:, None])[:, 0]

    def make() -> RateTransition:
        made = RateTransition(plan, Started(building), building.program.description.name, logged)  # type: ignore[union-attr]
        running.append(made)
        return made

    forces = (Logged(f"{LAW_FORCE}{i + 1}_n", "N") for i in range(p))
    logs = (*forces, Logged(EXTRAPOLATED, "1"), Logged(LATE, "s"), Logged(SLOWED, "1"))
    return ProgramStoreys(
        "numerical", make, judged, logs, building=building, numerical=building.numerical, laws=building.laws, plan=plan,
        running=running,
    )  # fmt: skip


def _block(numerical: Numerical, dt_s: float) -> Block:
    """Return the block from ground acceleration, interface force and forces on the floors (p,) to every floor's
    displacement, velocity and absolute acceleration (3 p,)."""
    p, linear = len(numerical.masses_kg), state_space(numerical)
    accel, none = -np.diag(1.0 / numerical.masses_kg), np.zeros((p, p))
    b = np.hstack([linear.B, np.vstack([none, accel])])
    d = np.hstack([linear.D, np.vstack([none, none, accel])])
    inputs = (*INPUTS, *(f"floor_force_{i + 1}_n" for i in range(p)))
    names = tuple(f"{q}_{i + 1}" for q in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2") for i in range(p))
    return discretise(StateSpace(linear.A, b, linear.C, d), dt_s, "foh", "numerical", inputs, names)
