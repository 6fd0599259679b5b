"""The feedforward that calls a user's compiled command."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.control.compensator import CompiledLaw
from rths_cli.control.interface import Interface
from rths_cli.loop.parts import Room
from rths_cli.numerics.compiled import part_class
from rths_cli.numerics.lti import Array
from rths_cli.numerics.user_functions import call_command


@part_class
class CompiledCommand(NamedTuple):
    """A compensator's `command`, known by its address, with p parameters and n states, for one command."""

    address: int
    parameters: Array  # (p,)
    state: Array  # (n,)
    after: Array  # (n,) the next state
    desired: Array  # (3,) handed over
    measured: Array  # (c,) handed over
    logged: Array  # (k,) values of the parameters that move
    units_per_v: float  # of its command: 1 for V, of an actuator metres
    v_per_unit: float

    def feed_forward(self, motion: Array, corrected: Array, sent: Array, command: Array) -> None:
        """Write the command (1,) in V for the desired motion (3, 1), as parts.Feedforward."""
        for q in range(3):
            self.desired[q] = motion[q, 0]
        for c in range(self.measured.size):
            self.measured[c] = corrected[c]
        command[0] = call_command(
            self.address, self.parameters, self.state, self.after, self.desired, self.measured,
            sent[0, 0] * self.units_per_v,
        )  # fmt: skip
        command[0] *= self.v_per_unit
        for i in range(self.state.size):
            self.state[i] = self.after[i]


def compiled_command(design: CompiledLaw, interface: Interface, room: Room) -> CompiledCommand:
    """Return the part of a compiled law at rest."""
    channels = interface.force.samples.shape[1]
    return CompiledCommand(
        design.function.address, design.parameters.copy(), room.take(design.states), np.zeros(design.states),
        np.zeros(3), np.zeros(channels), np.zeros(len(design.logs)), design.units_per_v, 1.0 / design.units_per_v,
    )  # fmt: skip
