"""A motion played to a law of a compensator and to the block by which it is judged: both must command the same."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rths_cli.control.law_block import Law
from rths_cli.numerics.lti import Array, Block

SECONDS, RANGE_V = 5.0, 10.0
MOTION_HZ = (0.7, 2.3, 6.1)
COMPARED = 2000  # samples of the motion
LARGE_M, SMALL_M = 0.01, 1e-6  # peaks of the motion for a linear law, and for another one
AGREES, NEAR = 1e-9, 1e-3  # of the peak of the command, for the same


@dataclass(frozen=True)
class Played:
    """A motion played to a law in a step of its own: commands (k,) in V and the largest state of each sample (k,)."""

    command_v: Array
    state: Array


class BlockLaw:
    """A block as a law that plays a motion."""

    def __init__(self, block: Block) -> None:
        self.block = block

    def new(self) -> BlockLaw:
        """Return the block at rest."""
        made = BlockLaw(self.block)
        made.state = np.zeros(len(self.block.A))
        return made

    state: Array

    def command(self, desired: Array, measured: Array, sent: float) -> float:
        """Return the command in V, and make the next state the state."""
        given = np.concatenate([desired, measured])[: self.block.B.shape[1]]
        made = float((self.block.C @ self.state + self.block.D @ given)[0])
        self.state[:] = self.block.A @ self.state + self.block.B @ given
        return made


def motion(dt_s: float, peak_m: float, still_s: float = 0.0) -> Array:
    """Return a desired motion (3, k), acceleration, velocity and displacement, that begins and ends at rest, and is
    followed by `still_s` at rest."""
    time_s = np.arange(0.0, SECONDS, dt_s)
    angle = 2.0 * np.pi * np.array(MOTION_HZ)
    waves = np.sin(angle[:, None] * time_s) / angle[:, None]
    place = waves.sum(axis=0) * np.sin(math.pi * time_s / SECONDS) ** 2
    place *= peak_m / np.abs(place).max()
    velocity = np.gradient(place, dt_s)
    accel = np.gradient(velocity, dt_s)
    return np.hstack([np.vstack([accel, velocity, place]), np.zeros((3, round(still_s / dt_s)))])


def played(law: Law | BlockLaw, desired: Array, channels: int, lag: float, of_displacement: bool = False) -> Played:
    """Play a motion: the table follows late by `lag` samples, the floors as it does, commands are limited to the
    range.

    `of_displacement`: channel 0 shows the displacement of an actuator, and its load cell no force.
    """
    made, late = law.new(), max(0, round(lag))
    commands, sizes, sent = np.zeros(desired.shape[1]), np.zeros(desired.shape[1]), 0.0
    for k in range(desired.shape[1]):
        measured = np.full(channels, desired[2 if of_displacement else 0, k - late] if k >= late else 0.0)
        measured[1:] *= not of_displacement
        commands[k] = made.command(desired[:, k].copy(), measured, sent)
        sent = min(max(commands[k], -RANGE_V), RANGE_V)
        sizes[k] = np.abs(made.state).max(initial=0.0)
        if not math.isfinite(commands[k]):
            return Played(commands[: k + 1], sizes[: k + 1])
    return Played(commands, sizes)


def code_and_block(
    law: Law | BlockLaw, block: Block, channels: int, lag: float, exact: bool, of_displacement: bool = False
) -> str:
    """Return by how much the code of a law and its block differ, for a motion of 1 um unless they are to be the same;
    "" where they agree."""
    desired = motion(block.dt_s, LARGE_M if exact else SMALL_M)[:, :COMPARED]
    code, linear = (played(one, desired, channels, lag, of_displacement).command_v for one in (law, BlockLaw(block)))
    if code.size != linear.size:
        return f"the command is not finite after {min(code.size, linear.size)} samples"
    peak = float(np.abs(linear).max(initial=0.0))
    off = float(np.abs(code - linear).max(initial=0.0))
    limit = AGREES if exact else NEAR
    unit = "m" if of_displacement else "V"
    return "" if off <= limit * peak else f"they differ by {off:.3g} {unit}, with a peak of {peak:.3g} {unit}"
