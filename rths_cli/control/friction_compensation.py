"""The feedforward that also counters the table's dry friction, from its identified shape over the desired velocity.

Friction acts on the table like the command -kappa (tanh(v / v_s) - c v) beside the identified model, which contains its
linear part c v (identification/friction.py). The same command with the other sign is added, so early that it acts when
the table has that velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.control.interface import Logged
from rths_cli.numerics.lti import Array, Block


@dataclass(frozen=True)
class FrictionFeedforward:
    """The design of a linear feedforward to which kappa (tanh(w / v_s) - c w) in V is added, w = v + lead_s a with
    velocity v and acceleration a desired at k + n_p.

    The table's friction and this part cancel: what is judged is the linear block alone.
    """

    block: Block
    command_v: float  # kappa
    scale_m_s: float  # v_s
    linear_s_per_m: float  # c
    lead_s: float
    left: float  # share of friction's disturbance that is expected to remain
    affine: bool = True
    linear: bool = False
    logs: tuple[Logged, ...] = ()

    @property
    def name(self) -> str:
        """Return the name of the linear feedforward."""
        return self.block.name

    @property
    def multiplications(self) -> int:
        """Return those of the linear block."""
        return self.block.multiplications

    def added_v(self, motion: Array) -> Array:
        """Return the command (n,) in V that it adds for the desired motion (3, n) at k + n_p."""
        velocity = motion[1] + self.lead_s * motion[0]
        return np.asarray(self.command_v * (np.tanh(velocity / self.scale_m_s) - self.linear_s_per_m * velocity))

    def linearised(self, at: Array | None = None) -> Block:
        """Return the linear feedforward: on the table with its friction the rest adds nothing."""
        return self.block


def compensation_lead_s(delay_s: float, lag_s: float, lead_samples: int, dt_s: float) -> float:
    """Return by how much the velocity desired at k + n_p must be advanced.

    A command of t_k acts `delay_s` later, and a force on the table acts like a command that is early by the actuator's
    `lag_s`.
    """
    return delay_s + lag_s - lead_samples * dt_s
