"""The interface of numerical and experimental substructure: what is commanded there, and how the force is made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from rths_cli.numerics.lti import Array

COMMANDED = {"acceleration": 0, "displacement": 2}
"""What an interface may command, and its row of the motion: acceleration, velocity, displacement."""

Commanded = Literal["acceleration", "displacement"]


@dataclass(frozen=True)
class InterfaceForce:
    """Weights of the interface force f at k + n_p, in N per unit of what they multiply.

    f = estimates z + recent d[k .. k+n_p-1] + samples c + desired d[k+n_p] with the estimates z of the observer, the
    desired accelerations d and the corrected samples c; i degrees of freedom. A load cell has its weight in `samples`.
    """

    estimates: Array  # (i, e)
    recent: Array  # (i, n_p, i)
    samples: Array  # (i, c)
    desired: Array  # (i, i)

    @property
    def lead_samples(self) -> int:
        """Return n_p, by how many samples the hybrid clock runs ahead of the table."""
        return self.recent.shape[1]

    def of_one(self) -> tuple[Array, Array, Array, float]:
        """Return the weights (e,), (n_p,), (c,) and one number of an interface with one degree of freedom.

        Raises ValueError for more.
        """
        if len(self.desired) != 1:
            raise ValueError(f"the interface has {len(self.desired)} degrees of freedom, this is for one")
        return self.estimates[0], self.recent[0, :, 0], self.samples[0], float(self.desired[0, 0])


def force_of_one(estimates: Array, recent: Array, samples: Array, desired: float) -> InterfaceForce:
    """Return the weights (e,), (n_p,), (c,) and one number of an interface with one degree of freedom."""
    return InterfaceForce(estimates[None, :], recent[None, :, None], samples[None, :], np.array([[desired]]))


@dataclass(frozen=True)
class Interface:
    """The interface of a test: its force and what it commands.

    `channels` (i,): the channel that measures the commanded motion of each degree of freedom, after its correction in
    m/s^2 or m. `actuators`: number of commands.
    """

    force: InterfaceForce
    channels: tuple[int, ...] = (0,)
    actuators: int = 1
    commanded: Commanded = "acceleration"

    @property
    def commands(self) -> tuple[int, ...]:
        """Return the numbers (a,) of the commands."""
        return tuple(range(self.actuators))


def no_force(channels: int, estimates: int = 1) -> Interface:
    """Return an interface whose force is zero, for runs without numerical substructure."""
    return Interface(force_of_one(np.zeros(estimates), np.zeros(0), np.zeros(channels), 0.0))
