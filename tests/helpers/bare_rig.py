"""A rig behind the interface of any rig, so that the loop cannot know what it is; what it gave is written down."""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import Rig


class BareRig:
    """A rig, the names of the calls to it but `exchange`, and the samples (c,) in V that it gave at each instant."""

    def __init__(self, rig: Rig) -> None:
        self.info, self._rig = rig.info, rig
        self.calls: list[str] = []
        self.samples: list[Array] = []

    def open(self) -> None:
        self.calls.append("open")
        self._rig.open()

    def arm(self) -> Array:
        self.calls.append("arm")
        return self._noted(self._rig.arm())

    def exchange(self, command_v: float) -> Array:
        return self._noted(self._rig.exchange(command_v))

    def rest(self) -> None:
        self.calls.append("rest")
        self._rig.rest()

    def close(self) -> None:
        self.calls.append("close")
        self._rig.close()

    def shown(self, samples: Array) -> Array:
        """Return what the rig gives in place of the samples (c,) in V: here the samples."""
        return samples

    def _noted(self, samples: Array) -> Array:
        self.samples.append(self.shown(np.array(samples)))
        return self.samples[-1].copy()
