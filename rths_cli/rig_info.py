"""What a laboratory knows of its rig before it has measured anything: channels, converters, limits, data sheet."""

from __future__ import annotations

from dataclasses import dataclass

STANDARD_GRAVITY_M_S2 = 9.80665
BRAKE_SHARE = 0.45  # of the acceleration limit, with which the guard brakes


@dataclass(frozen=True)
class Channel:
    """One measured channel, as a laboratory knows it; a corner of 0 Hz means that there is none."""

    name: str
    sensitivity_v_per_m_s2: float
    range_m_s2: float
    high_pass_hz: float
    low_pass_hz: float


@dataclass(frozen=True)
class Converters:
    """Analogue converters of the rig: +-range_v, `bits` 0 means no quantisation."""

    bits: int
    range_v: float

    @property
    def step_v(self) -> float:
        """Return the size of one bit in V (0 without quantisation)."""
        return 2.0 * self.range_v / 2**self.bits if self.bits else 0.0


@dataclass(frozen=True)
class Limits:
    """Bounds that the guard holds: table displacement, velocity, acceleration and actuator force."""

    stroke_m: float
    velocity_m_s: float
    acceleration_m_s2: float
    force_n: float


@dataclass(frozen=True)
class RigInfo:
    """All that the runner may know of a rig before it has measured anything.

    `channels`: the table's accelerometer first, then one per experimental floor. `latency_samples`: the command
    computed from the samples of t_k is held from t_(k + latency) on; hold and sensor lag are not in that number.
    `transport_s`: further delay between command and table or table and samples, as of a network link.
    `gain_m_per_v` and `moving_mass_kg` are nominal data-sheet values; `specimen_mass_kg` is weighed.
    """

    name: str
    kind: str
    dt_s: float
    channels: tuple[Channel, ...]
    converters: Converters
    latency_samples: int
    limits: Limits
    gain_m_per_v: float
    moving_mass_kg: float
    specimen_mass_kg: float
    transport_s: float = 0.0
