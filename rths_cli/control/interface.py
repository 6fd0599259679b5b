"""The interface between computed and experimental storeys, and what the design of an exchangeable part declares.

A discrete `Block` is the design of a linear part. A nonlinear storey, an adaptive compensator or a model in another
program declares the same (`PartDesign`), so that check, predictions and result file need to know no kind of part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block

COMMANDED = {"acceleration": 0, "displacement": 2}
"""What an interface may command, and its row of the motion: acceleration, velocity, displacement."""

Commanded = Literal["acceleration", "displacement"]

OwnParts = Mapping[str, Callable[[Any], Any]]
"""Functions of the caller that make a part from the designed one, by its place: numerical, feedforward or feedback."""
PLACES = ("numerical", "feedforward", "feedback")


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


LAW_FORCE = "law_force_"  # first part of the name of what is logged of laws, before the storey's number


class Logged(NamedTuple):
    """A value that a part writes to the log in every step."""

    name: str
    units: str
    ahead: bool = False  # whether it belongs to k + n_p, as the desired motion does; the step sets it


@dataclass(frozen=True, eq=False)
class Adapted:
    """The parameters of a law that move while the test runs: names, units, and (k,) start, least, most, and the largest
    change in a sample. The law's last k states are what they differ from `start`."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    start: Array
    least: Array
    most: Array
    rate: Array

    @property
    def limits(self) -> Array:
        """Return least, most and largest change in a sample (3, k) of the differences from the start."""
        return np.array([self.least - self.start, self.most - self.start, self.rate])


@runtime_checkable
class PartDesign(Protocol):
    """The design of a part of the step.

    That of a numerical substructure may have an attribute `building` as well: the whole building (structure.Building)
    that it and the specimen make. SIM and SIM-DELAY are then those of that building.
    """

    @property
    def name(self) -> str:
        """Return the part's name in result files and messages."""

    @property
    def affine(self) -> bool:
        """Return whether its outputs are affine in the inputs of the same instant; the interface force must be such an
        input of a numerical substructure."""

    @property
    def linear(self) -> bool:
        """Return whether it is a linear block at all times, so that its coming outputs can be foreseen."""

    @property
    def logs(self) -> tuple[Logged, ...]:
        """Return what it logs, in the order of its compiled part's `logged`."""

    @property
    def multiplications(self) -> int:
        """Return its work in a step, for information; 0 where it is not known."""

    def linearised(self, at: Array | None = None) -> Block:
        """Return the linear block at a state or at parameters, as the log holds them; None: those of the start.

        Raises InputError where there is none: such a part cannot be judged before it is used.
        """


def not_judged(name: str) -> InputError:
    """Return the error of a part that has no linear block."""
    return InputError(f"{name} cannot be judged: it declares no linear block")
