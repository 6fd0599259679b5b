"""What every rig does, real or virtual: open, arm, exchange, rest, close."""

from __future__ import annotations

from typing import Protocol

from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import STANDARD_GRAVITY_M_S2, Channel, Converters, Limits, RigInfo

__all__ = ["STANDARD_GRAVITY_M_S2", "Channel", "Converters", "Limits", "Rig", "RigInfo"]


class Rig(Protocol):
    """A rig in the hands of one process. Between `arm` and `rest` each `exchange` takes one sample interval."""

    info: RigInfo

    def open(self) -> None:
        """Take hold of the rig; raise RigError when it cannot be had."""

    def arm(self) -> Array:
        """Enable motion and return the first samples in V, shape (n_channels,)."""

    def exchange(self, command_v: float) -> Array:
        """Send one command, wait for the next sample instant, return its samples in V, shape (n_channels,).

        Samples are as the converter gives them: the loop takes zero offsets and signs out. The array belongs to the
        rig and is overwritten by the next call. Raises RigError on a fault of the rig.
        """

    def rest(self) -> None:
        """Bring the table to rest at zero and disable motion."""

    def close(self) -> None:
        """Let go of the rig; safe to call twice."""
