"""What `rths plugin test` holds a compensator to: each clause of its contract, tried on a table that is made up."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rths_cli.control.block_files import placed_block
from rths_cli.control.compensator import (
    FIELD,
    Definition,
    Plant,
    compiled_function,
    designed_law,
    made_up_plant,
    part_of_law,
)
from rths_cli.control.interface import PartDesign
from rths_cli.control.law_block import STEP_SHARE, Law, derived_block, seconds_per_call
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block
from rths_cli.rigs.contract import Kept

SECONDS, RANGE_V = 5.0, 10.0
MOTION_HZ = (0.7, 2.3, 6.1)
WOUND_UP = 0.01  # of the range: command that is left long after a motion beyond the range
GROWS = 10.0  # times that a state may be larger in the last fifth of a motion than before
AGREES = 1e-9  # of the peak


@dataclass(frozen=True)
class Played:
    """A motion played to a law in a step of its own: commands (k,) in V and the largest state of each sample (k,)."""

    command_v: Array
    state: Array


def clauses(definition: Definition) -> Iterator[Kept]:
    """Yield each clause of the contract, and what was broken of it."""
    plant = made_up_plant()
    try:
        made = designed_law(definition, definition.values({}), plant)
        part = made if isinstance(made, Block) else part_of_law(definition, made, plant.dt_s)
    except InputError as error:
        clause = "at rest it commands nothing, it is finite, and the same state and inputs give the same"
        for one in error.faults:
            yield Kept(clause, one.removeprefix(f"{FIELD}: {definition.who}: "))
        return
    law = _BlockLaw(made) if isinstance(made, Block) else made
    yield Kept("at rest it commands nothing, it is finite, and the same state and inputs give the same", "")
    tried: tuple[tuple[str, Callable[[], str]], ...] = (
        ("its state stays bounded", lambda: _bounded(law, plant)),
        ("behind a motion beyond the range it does not stay wound up", lambda: _unwinds(law, plant)),
        (_judged_by(part), lambda: _agrees(law, part, plant)),
        (_runs_as(definition, made, part), lambda: ""),
        (f"a step takes at most {STEP_SHARE:g} of the interval", lambda: _in_time(made, part, plant)),
    )
    for clause, fault in tried:
        yield Kept(clause, fault())


class _BlockLaw:
    """A block as a law that plays a motion."""

    def __init__(self, block: Block) -> None:
        self.block = block

    def new(self) -> _BlockLaw:
        """Return the block at rest."""
        made = _BlockLaw(self.block)
        made.state = np.zeros(len(self.block.A))
        return made

    state: Array

    def command(self, desired: Array, measured: Array, sent: float) -> float:
        """Return the command in V, and make the next state the state."""
        given = np.concatenate([desired, measured])[: self.block.B.shape[1]]
        made = float((self.block.C @ self.state + self.block.D @ given)[0])
        self.state[:] = self.block.A @ self.state + self.block.B @ given
        return made


AnyLaw = Law | _BlockLaw


def motion(plant: Plant, peak_m: float, still_s: float = 0.0) -> Array:
    """Return a desired motion (3, k), acceleration, velocity and displacement, that begins and ends at rest, and is
    followed by `still_s` at rest."""
    time_s = np.arange(0.0, SECONDS, plant.dt_s)
    angle = 2.0 * np.pi * np.array(MOTION_HZ)
    waves = np.sin(angle[:, None] * time_s) / angle[:, None]
    place = waves.sum(axis=0) * np.sin(math.pi * time_s / SECONDS) ** 2
    place *= peak_m / np.abs(place).max()
    velocity = np.gradient(place, plant.dt_s)
    accel = np.gradient(velocity, plant.dt_s)
    return np.hstack([np.vstack([accel, velocity, place]), np.zeros((3, round(still_s / plant.dt_s)))])


def played(law: AnyLaw, plant: Plant, desired: Array) -> Played:
    """Play a motion: the table follows late by its lag, the floors as it does, commands are limited to the range."""
    made, late = law.new(), round(plant.lag_s / plant.dt_s)
    commands, sizes, sent = np.zeros(desired.shape[1]), np.zeros(desired.shape[1]), 0.0
    for k in range(desired.shape[1]):
        measured = np.full(plant.channels, desired[0, k - late] if k >= late else 0.0)
        commands[k] = made.command(desired[:, k].copy(), measured, sent)
        sent = min(max(commands[k], -RANGE_V), RANGE_V)
        sizes[k] = np.abs(made.state).max(initial=0.0)
        if not math.isfinite(commands[k]):
            return Played(commands[: k + 1], sizes[: k + 1])
    return Played(commands, sizes)


def _bounded(law: AnyLaw, plant: Plant) -> str:
    block = law.block if isinstance(law, _BlockLaw) else derived_block(law, plant.dt_s)
    radius = 0.0 if block is None or not block.A.size else float(np.abs(np.linalg.eigvals(block.A)).max())
    if radius > 1.0 + 1e-9:
        return f"its own spectral radius is {radius:.6g}, its state grows without end; it must be at most 1"
    found = played(law, plant, motion(plant, 0.01))
    if not np.isfinite(found.command_v[-1]):
        return f"the command is not finite after {found.command_v.size * plant.dt_s:.3g} s of a motion of 10 mm"
    last = found.state.size // 5
    before, after = found.state[:-last].max(initial=0.0), found.state[-last:].max(initial=0.0)
    grown = after > GROWS * before > 0.0
    return f"the largest state grows from {before:.3g} to {after:.3g} though the motion ends" if grown else ""


def _unwinds(law: AnyLaw, plant: Plant) -> str:
    peak_m = 3.0 * RANGE_V * plant.gain_m_per_v
    found = played(law, plant, motion(plant, peak_m, still_s=SECONDS))
    left = float(np.abs(found.command_v[-1]))
    if left <= WOUND_UP * RANGE_V:
        return ""
    return (
        f"{SECONDS:g} s after a motion of three times the range it still commands {left:.3g} V; correct the state by "
        "what was sent less what was commanded (sent, the command of the last sample behind all limits)"
    )


def _judged_by(part: PartDesign) -> str:
    if isinstance(part, Block):
        return "it is linear: the check judges its block, found by exciting it, and the block agrees with the code"
    try:
        part.linearised()
    except InputError:
        return "it is not linear and declares no block: the check cannot judge it, and refuses it unless overridden"
    return "it is not linear, or uses sent: the check judges its block, which agrees with the code for small motions"


def _agrees(law: AnyLaw, part: PartDesign, plant: Plant) -> str:
    """Return by how much block and code differ, for a motion of 1 um for what is not linear; "" where they agree."""
    try:
        block = placed_block(FIELD, part.linearised(), plant.dt_s, plant.channels)
    except InputError:
        return ""
    desired = motion(plant, 0.01 if part.linear else 1e-6)[:, :2000]
    code, linear = (played(one, plant, desired).command_v for one in (law, _BlockLaw(block)))
    peak = float(np.abs(linear).max(initial=0.0))
    off = float(np.abs(code - linear).max(initial=0.0))
    limit = AGREES if part.linear else 1e-3
    return "" if off <= limit * peak else f"they differ by {off:.3g} V, with a peak of {peak:.3g} V"


def _runs_as(definition: Definition, made: Law | Block, part: PartDesign) -> str:
    if isinstance(part, Block):
        return "it runs compiled, as a linear block"
    assert isinstance(made, Law)
    function = compiled_function(definition, made)
    if isinstance(function, str):
        return f"it runs in Python, on a rig only at a rate that it holds, because {function}"
    return "it runs compiled"


def _in_time(made: Law | Block, part: PartDesign, plant: Plant) -> str:
    if isinstance(made, Block) or isinstance(part, Block):
        return ""
    seconds = seconds_per_call(made.in_step().command, plant.channels)
    most = STEP_SHARE * plant.dt_s
    return "" if seconds <= most else f"it takes {1e6 * seconds:.3g} us in Python, at most {1e6 * most:.3g} us"
