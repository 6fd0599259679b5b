"""A rig for rths that needs no hardware: every channel shows a table whose displacement lags behind its command.

Copy this package and put your driver's calls in place of the lines marked HERE.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rths_cli.errors import InputError, RigError
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import COUNTED_CLOCK, Rig, RigInfo

RTHS_INTERFACE = 2  # the version of the interface of rigs that this package is written for


def make(info: RigInfo, options: Mapping[str, object]) -> Rig:
    """Return the rig of a rig file; raises InputError for options that are not ours.

    `info` is what the rig file states, `options` what stands there under that key. Nothing may move here.
    """
    lag_s = options.get("lag_s", 0.02)
    unknown = sorted(set(options) - {"lag_s"})
    if unknown:
        raise InputError(f"options.{unknown[0]}: unknown key; known: lag_s")
    if not isinstance(lag_s, int | float) or not 1e-3 <= lag_s <= 1.0:
        raise InputError(f"options.lag_s: must be >= 0.001 and <= 1, got {lag_s!r}")
    if info.further:
        raise InputError(f"channels: this rig has accelerometers only, not {info.further[0].name}; leave it out")
    return SlowTable(info, float(lag_s))


class SlowTable:
    """A table of second order with two equal lags; `exchange` returns at once, it has a counted clock.

    A command is held from the sample after the one it was computed from: latency_samples is 1.
    """

    offers = (COUNTED_CLOCK,)  # HERE: leave it out, the exchange of your hardware waits for its sample instant

    def __init__(self, info: RigInfo, lag_s: float) -> None:
        self.info = replace(info, driver_verified="fake")  # a rig that drives hardware leaves info as it is
        self._lag_s = lag_s
        self._armed = False
        self._place_m = self._velocity_m_s = self._next_v = 0.0
        self._samples = np.zeros(len(info.channels))

    def open(self) -> None:
        """Take hold of the hardware. HERE: connect, refuse what is not there by RigError with one sentence."""

    def arm(self) -> Array:
        """Enable motion, return the first samples in V, (n_channels,). HERE: enable, wait for the first sample."""
        self._place_m = self._velocity_m_s = self._next_v = 0.0
        self._samples[:] = 0.0
        self._armed = True
        return self._samples

    def exchange(self, command_v: float) -> Array:
        """Send a command in V, return the next samples in V, (n_channels,).

        HERE: send the command, wait for the next sample instant of your hardware's clock, read.
        """
        if not self._armed:
            raise RigError(f"rig {self.info.name}: is not armed")
        held, self._next_v = self._next_v, command_v
        self._advance(self.info.gain_m_per_v * held)
        return self._samples

    def rest(self) -> None:
        """Bring the table to rest at zero and disable motion. HERE: along a bounded path, also after a fault."""
        self._armed = False

    def close(self) -> None:
        """Let go of the hardware; called twice now and then."""

    def _advance(self, wanted_m: float) -> None:
        """Advance the table one interval, half a step at a time, and sample its acceleration."""
        rate, dt_s = 1.0 / self._lag_s, self.info.dt_s / 16.0
        accel = 0.0
        for _ in range(16):
            accel = rate * rate * (wanted_m - self._place_m) - 2.0 * rate * self._velocity_m_s
            self._velocity_m_s += dt_s * accel
            self._place_m += dt_s * self._velocity_m_s
        span, step = self.info.converters.range_v, self.info.converters.step_v
        for i, channel in enumerate(self.info.channels):
            volts = min(max(accel * channel.sensitivity_v_per_unit * channel.sign, -span), span - step)
            self._samples[i] = step * round(volts / step) if step else volts
