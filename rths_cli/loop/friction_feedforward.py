"""The compiled feedforward that counters dry friction beside its linear block (control/friction_compensation.py)."""

from __future__ import annotations

import math
from typing import NamedTuple

from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.interface import Interface
from rths_cli.loop.linear_parts import LinearFeedforward, linear_feedforward
from rths_cli.loop.parts import Room
from rths_cli.numerics.compiled import part_class
from rths_cli.numerics.lti import Array


@part_class
class CompensatedFeedforward(NamedTuple):
    """A linear feedforward of one command, and the command that counters friction at the velocity to come."""

    inverse: LinearFeedforward
    logged: Array  # nothing
    command_v: float  # kappa
    per_scale: float  # 1 / v_s
    linear_s_per_m: float  # c
    lead_s: float

    def feed_forward(self, motion: Array, corrected: Array, sent: Array, command: Array) -> None:
        """Write the command (1,) in V for the desired motion (3, 1), as parts.Feedforward."""
        self.inverse.feed_forward(motion, corrected, sent, command)
        velocity = motion[1, 0] + self.lead_s * motion[0, 0]
        sign = math.tanh(velocity * self.per_scale)
        command[0] += self.command_v * (sign - self.linear_s_per_m * velocity)


def compensated_feedforward(design: FrictionFeedforward, interface: Interface, room: Room) -> CompensatedFeedforward:
    """Return a feedforward that counters friction, at rest."""
    made = linear_feedforward(design.block, interface, room)
    return CompensatedFeedforward(
        made, made.logged, design.command_v, 1.0 / design.scale_m_s, design.linear_s_per_m, design.lead_s
    )
