"""What the design of an exchangeable part declares of itself, before the step is compiled: `PartDesign`.

A discrete `Block` is the design of a linear part. A nonlinear storey, an adaptive compensator or a model in another
program declares the same, so that check, predictions and result file need to know no kind of part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block


class Logged(NamedTuple):
    """A value that a part writes to the log in every step."""

    name: str
    units: str
    ahead: bool = False  # whether it belongs to k + n_p, as the desired motion does; the step sets it


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


OwnParts = Mapping[str, Callable[[Any], Any]]
"""Functions of the caller that make a part from the designed one, by its place: numerical, feedforward or feedback."""
PLACES = ("numerical", "feedforward", "feedback")


def not_judged(name: str) -> InputError:
    """Return the error of a part that has no linear block."""
    return InputError(f"{name} cannot be judged: it declares no linear block")
