"""The NI card as a rig: write, wait for the edge of the sample clock, read."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from rths_cli.errors import RigError
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import BRAKE_SHARE, RigInfo
from rths_cli.rigs.interface import MISSED_EDGES, Commands, one_actuator, only_command
from rths_cli.rigs.ni.daqmx import Card, Wiring

GENTLY_S = 0.2  # the shortest way to rest


class NiRig:
    """A table on an NI card; the card's sample clock is the clock of the loop.

    A command written after the samples of t_k is put out from t_k+1 on: `latency_samples` is 1. `missed` counts steps
    at whose end an edge of the clock had passed already; what that leads to is the loop's to decide. The card has no
    watchdog, it holds its last voltage.
    """

    offers = (MISSED_EDGES,)

    def __init__(self, info: RigInfo, wiring: Wiring) -> None:
        one_actuator(info)
        self.info = info
        self.missed = 0
        self.wiring = wiring
        self._card: Card | None = None
        self._armed = False
        self._command_v = self._rate_v_s = 0.0
        self._samples = np.zeros(len(info.all_channels))

    def open(self) -> None:
        """Reserve the card; raises RigError when package, driver, card or its single-point mode are missing."""
        if self.info.latency_samples != 1:
            declared = self.info.latency_samples
            raise RigError(f"{self._who}: a card's latency is 1 sample, not {declared}; correct latency_samples")
        self.close()
        self._card = Card(self.wiring, self._who)
        self.info = replace(self.info, driver_verified="hardware" if self._card.is_hardware else "fake")

    def arm(self) -> Array:
        """Put out 0 V, start the clock, enable motion, return the first samples in V, (n_channels,)."""
        card = self._opened()
        self.missed, self._command_v, self._rate_v_s = 0, 0.0, 0.0
        try:
            card.start()
        except RigError:
            with suppress(RigError):
                card.stop()
            raise
        self._armed = True
        card.wait()
        card.read(self._samples)
        return self._samples

    def exchange(self, command_v: Commands) -> Array:
        """Write a command, wait for the next edge, return its samples in V, (n_channels,); raises RigError."""
        card = self._opened()
        self._send(card, only_command(self.info, command_v))
        self.missed += card.wait()
        card.read(self._samples)
        return self._samples

    def rest(self) -> None:
        """Lead the command to 0 V within the rig's limits, disable motion; also after a fault, which it tells."""
        if self._card is None or not self._armed:
            return
        self._armed = False
        try:
            for command_v in way_to_rest(self._command_v, self._rate_v_s, self.info):
                self._send(self._card, float(command_v))
                self._card.wait()
        except RigError as fault:
            raise RigError(f"{fault}; the table could not be led to rest: use the emergency stop") from fault
        finally:
            self._card.stop()

    def close(self) -> None:
        """Let go of the card; safe to call twice."""
        card, self._card, self._armed = self._card, None, False
        if card is not None:
            card.close()

    @property
    def _who(self) -> str:
        return f"rig {self.info.name}"

    def _opened(self) -> Card:
        if self._card is None:
            raise RigError(f"{self._who}: is not open")
        return self._card

    def _send(self, card: Card, command_v: float) -> None:
        """Write a command that is one: finite and within the converter's range."""
        if not abs(command_v) <= self.info.converters.range_v:
            span = self.info.converters.range_v
            raise RigError(f"{self._who}: a command of {command_v:g} V is outside +-{span:g} V and was not sent")
        card.write(command_v)
        self._rate_v_s = (command_v - self._command_v) / self.info.dt_s
        self._command_v = command_v


def way_to_rest(from_v: float, rate_v_s: float, info: RigInfo) -> Array:
    """Return commands in V, (n,), from the one held, which changed at this rate, to 0.

    The commanded motion is braked at a constant deceleration, then led back along half a cosine, both within shares of
    the rig's limits.
    """
    braked_v = _braking(from_v, rate_v_s, info)
    return np.concatenate([braked_v, _returning(float(braked_v[-1]) if braked_v.size else from_v, info)])


def _braking(from_v: float, rate_v_s: float, info: RigInfo) -> Array:
    """Return commands that lose their rate at a constant deceleration, none where there is none to lose.

    A rate beyond the velocity limit was no motion but a step; what would pass the stroke or the range ends there.
    """
    limits, gain = info.limits, info.gain_m_per_v
    fastest, deceleration = limits.velocity_m_s / gain, BRAKE_SHARE * limits.acceleration_m_s2 / gain
    rate_v_s = min(max(rate_v_s, -fastest), fastest)
    steps = math.ceil(abs(rate_v_s) / (deceleration * info.dt_s))
    rates = rate_v_s * (1.0 - np.arange(1, steps + 1) / max(steps, 1))
    span = min(info.converters.range_v, limits.stroke_m / gain)
    return np.clip(from_v + np.cumsum(rates) * info.dt_s, -span, span)


def _returning(from_v: float, info: RigInfo) -> Array:
    """Return commands along half a cosine, slow enough for velocity, acceleration and rate."""
    away, limits = abs(from_v) * info.gain_m_per_v, info.limits
    seconds = max(
        GENTLY_S,
        0.5 * math.pi * away / (BRAKE_SHARE * limits.velocity_m_s),
        math.pi * math.sqrt(0.5 * away / (BRAKE_SHARE * limits.acceleration_m_s2)),
        0.5 * math.pi * abs(from_v) / limits.command_rate_v_s,
    )
    steps = math.ceil(seconds / info.dt_s)
    return 0.5 * from_v * (1.0 + np.cos(np.pi * np.arange(1, steps + 1) / steps))
