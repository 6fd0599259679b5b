"""The exchangeable parts of the step: what each has to offer, and the flat array in which all of them keep their state.

A part is a NamedTuple of arrays and numbers, marked `part_class`; the step calls its methods, which numba compiles into
it. Parts draw no random numbers and hold no state outside `Room`, so that runs can advance side by side. Shapes: c
channels, e estimates, i degrees of freedom of the interface, a commands, l logged values. To add a part: its design in
`control`, its class here in `loop`, and one line in `loop/step_arrays.py` that makes the second from the first.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from rths_cli.numerics.lti import Array


class Observer(Protocol):
    """Estimates the specimen's motion from the corrected samples."""

    @property
    def corrected(self) -> Array:
        """Return where the corrected samples (c,) belong."""

    @property
    def estimated(self) -> Array:
        """Return where the estimates (e,) of the present instant stand."""

    def observe(self, corrected: Array, force: Array) -> None:
        """Estimate from accelerations (c,) in m/s^2 at t_k; write the part of the interface force (i,) in N at k + n_p
        that follows from samples and estimates alone."""

    def can_substitute(self, channels: int) -> bool:
        """Return whether `substitute` knows the accelerations of every floor."""

    def substitute(self, corrected: Array) -> None:
        """Write the floors' accelerations that are expected where samples are lost; the table's, first in `corrected`
        (c,) in m/s^2, is given."""


class NumericalSubstructure(Protocol):
    """The computed storeys. The step is affine in the interface force: laws use no motion that the present force makes.

    At each instant `free` is called once, then `advance` once.
    """

    @property
    def direct(self) -> Array:
        """Return the acceleration in m/s^2 of each degree of freedom (i, i) per N of force at the same instant."""

    @property
    def logged(self) -> Array:
        """Return where the values (l,) that the log holds of it stand."""

    def free(self, ground: Array, accel: Array) -> None:
        """Write the absolute accelerations (i,) of the interface at this instant without interface force."""

    def advance(self, ground: Array, force: Array, motion: Array) -> None:
        """Write the interface's absolute motion (3, i) at this instant, acceleration, velocity and displacement, and go
        to the next one. `ground` (3,): the same of the ground; `force` (i,) in N on the interface."""


class Feedforward(Protocol):
    """Computes commands from the desired motion."""

    @property
    def logged(self) -> Array:
        """Return where the values (l,) that the log holds of it stand, as the parameters of an adaptive one."""

    def feed_forward(self, motion: Array, corrected: Array, sent: Array, command: Array) -> None:
        """Write the commands (a,) in V for the desired motion (3, i) at k + n_p.

        An adaptive one learns from the measured accelerations (c,) at t_k and from the commands (., a) that were sent,
        the latest first.
        """


class Feedback(Protocol):
    """Computes the part of the commands that corrects the tracking error."""

    @property
    def logged(self) -> Array:
        """Return where the values (l,) that the log holds of it stand."""

    def feed_back(self, error: Array, lowest: Array, highest: Array, command: Array) -> None:
        """Write the feedback's part (a,) of the commands in V, within its limits (a,), for tracking errors (i,)."""


class Room:
    """A flat array from which the parts of one step take the places of their states."""

    def __init__(self, size: int = 0) -> None:
        self.all = np.zeros(size)
        self.taken = 0

    def take(self, *shape: int) -> Array:
        """Return zeros of a shape: a view of the flat array, or an array of its own where that is too short."""
        count = int(np.prod(shape))
        first, self.taken = self.taken, self.taken + count
        if self.taken > self.all.size:
            return np.zeros(shape)
        return self.all[first : self.taken].reshape(shape)
