"""A virtual rig whose samples carry offset, drift and jumps behind the AC coupling, and whose true motion is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig


class DriftingRig:
    """Add to the samples of a virtual rig, in V and channel by channel: `offset_v` (c,), `drift_v_per_s` (c,) from the
    first sample on, and `jumps`, each a channel, the sample at which it begins, and its size in V.

    It is added before the converter, which rounds both together. `true_velocity_m_s` grows by a row (c,)
    per exchange: true absolute velocities in the middle of each interval.
    """

    def __init__(
        self,
        rig: VirtualRig,
        offset_v: Sequence[float],
        drift_v_per_s: Sequence[float],
        jumps: Sequence[tuple[int, int, float]] = (),
    ) -> None:
        rig.plant = rig.plant._replace(sensor_step_v=0.0, sensor_steps_per_v=0.0)  # rounded here instead
        self._rig, self._offset, self._drift = rig, np.array(offset_v), np.array(drift_v_per_s)
        self._jumps = jumps
        self._sample = 0
        self.true_velocity_m_s: list[Array] = []

    @property
    def info(self) -> RigInfo:
        """Return what is known of the rig."""
        return self._rig.info

    def open(self) -> None:
        """Take hold of the rig."""
        self._rig.open()

    def arm(self) -> Array:
        """Put the table at rest, return its first samples in V."""
        self._sample, self.true_velocity_m_s = 0, []
        return self._shown(self._rig.arm())

    def exchange(self, command_v: float) -> Array:
        """Hold the command for one interval and return the next samples in V."""
        samples = self._rig.exchange(command_v)
        self.true_velocity_m_s.append(self._rig.state.middle_velocity.copy())
        self._sample += 1
        return self._shown(samples)

    def rest(self) -> None:
        """Bring the table to rest."""
        self._rig.rest()

    def close(self) -> None:
        """Let go of the rig."""
        self._rig.close()

    def _shown(self, samples: Array) -> Array:
        added = self._offset + self._drift * (self._sample * self.info.dt_s)
        for channel, at, size in self._jumps:
            added[channel] += size if self._sample >= at else 0.0
        bit, shown = self.info.converters.step_v, samples + added
        return np.asarray(np.floor(shown / bit + 0.5) * bit if bit else shown)
