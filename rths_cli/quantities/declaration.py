"""The declaration of one quantity, and the words that several declarations share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from numpy.typing import ArrayLike

ACCEL = "m/s^2"
LESS, MORE, ZERO, ONE, NONE = "smaller", "larger", "near zero", "near one", "none"
BAND = "in the test band (12 Hz, 4th-order Butterworth forward and backward), above the lowest reliable frequency"
FULL = "above the lowest reliable frequency"
Values = Mapping[str, ArrayLike]
"""Values of metrics by their paths: a number each, or one per storey, channel, mode or frequency."""


@dataclass(frozen=True)
class Quantity:
    """Hold what a number is.

    `path` with dots between its groups; `over`: what it has one value for each of ("" for a single number); `better`:
    which way it improves; `text`: its meaning; `kinds`: the suffixes under which it stands too; `band`: where in
    frequency it is evaluated, "" where that says nothing; `reference`: the publication that defines it.
    """

    path: str
    units: str
    over: str
    better: str
    text: str
    kinds: tuple[str, ...] = ()
    band: str = ""
    reference: str = ""

    @property
    def group(self) -> str:
        """Return the first part of the path: the run, or what was evaluated (`check`, `latency`)."""
        return self.path.partition(".")[0]

    @property
    def definition(self) -> str:
        """Return the meaning with the band it is evaluated in."""
        return f"{self.text}, {self.band}" if self.band else self.text
