"""`RigInfo`, what a laboratory knows of its rig before any measurement: channels, converters, limits, data sheet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from rths_cli.case.plugin_interface import OLD_NAMES, RENAMED
from rths_cli.case.rig_capabilities import Capabilities, capabilities_of

CHANNEL_UNITS = {"acceleration": "m/s^2", "displacement": "m", "force": "N", "strain": "1"}
"""The unit of each kind of channel."""
BRAKE_SHARE = 0.45  # of the acceleration limit, with which the guard brakes


def adjective(kind: str) -> str:
    """Return the word before "rig" or "table" of a kind, with its space: that no table moved is always said."""
    return "" if capabilities_of(kind).moves_hardware else f"{kind} "


@dataclass(frozen=True)
class Channel:
    """One measured channel, as a laboratory knows it, in the unit of its kind; a corner of 0 Hz means there is none.

    `kind`: acceleration (m/s^2), displacement (m), force (N) or strain (1). `sign` is -1 for a sensor that is mounted
    against the positive direction; the level to warn of and the one to stop at are infinite where the rig file states
    none; `label` is the laboratory's own name, `terminal` the input's. `position`: table, floor_N or storey_N; `uses`:
    control, guard, shear, log. `uncertainty`: of the sensitivity, relative. `noise_rms`: white noise per sample of a
    virtual rig. `plate_mass_kg`: mass above a load cell that is no part of the building.
    """

    name: str
    sensitivity_v_per_unit: float
    range: float
    high_pass_hz: float
    low_pass_hz: float
    sign: float = 1.0
    warning: float = math.inf
    abort: float = math.inf
    label: str = ""
    terminal: str = ""
    kind: str = "acceleration"
    position: str = ""
    uses: tuple[str, ...] = ("control",)
    uncertainty: float = 0.01
    noise_rms: float = 0.0
    plate_mass_kg: float = 0.0
    height_m: float = 0.0

    if not TYPE_CHECKING:  # our own code uses the present names

        def __getattr__(self, name: str) -> Any:
            """Return a field by its name of interface 1 of rig packages."""
            if name not in RENAMED:
                raise AttributeError(f"a channel has no {name}", name=name, obj=self)
            OLD_NAMES.add(name)
            return getattr(self, RENAMED[name])

    @property
    def unit(self) -> str:
        """Return the unit of its values."""
        return CHANNEL_UNITS[self.kind]

    @property
    def range_v(self) -> float:
        """Return the range in V."""
        return self.range * self.sensitivity_v_per_unit


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
    """Bounds that the guard holds: table displacement, velocity, acceleration and actuator force.

    Further ones are infinite where the rig file states none; `lost_samples` is how many answers in a row may be lost.
    """

    stroke_m: float
    velocity_m_s: float
    acceleration_m_s2: float
    force_n: float
    command_rate_v_s: float = math.inf
    tracking_error_m_s2: float = math.inf
    energy_ratio: float = math.inf
    lost_samples: int = 5
    tracking_error_m: float = math.inf  # where displacements are commanded

    def fastest_m_s(self, gain_m_per_v: float) -> float:
        """Return the velocity in m/s that the limits of velocity and of the command's rate permit a table."""
        return min(self.velocity_m_s, gain_m_per_v * self.command_rate_v_s)

    def of_fastest(self, gain_m_per_v: float) -> str:
        """Return the key of the limit that `fastest_m_s` is."""
        by_rate = gain_m_per_v * self.command_rate_v_s < self.velocity_m_s
        return "limits.command_rate_v_s" if by_rate else "limits.velocity_m_s"


@dataclass(frozen=True)
class Uncertainty:
    """Standard uncertainties of what a laboratory declares beside sensitivities: AC corners and weighed masses relative
    to their values, the instants at which channels are sampled in s, the relative changes of a sensitivity and of
    the specimen's stiffness from the identification to the test, and that of the table's gain from the verification
    before a test to its end. 0: exactly as declared.

    `masses`: of each floor on the table, where a calibration states what scales showed; (): all as `mass`.
    """

    corner: float = 0.1
    skew_s: float = 25e-6
    mass: float = 0.003
    drift: float = 0.0005
    specimen: float = 0.005
    table_gain: float = 0.03
    masses: tuple[float, ...] = ()

    @property
    def any(self) -> bool:
        """Return whether an identification may find anything that differs from what is declared."""
        return max(self.corner, self.skew_s, self.mass, *self.masses) > 0.0

    def of_masses(self, floors: int) -> tuple[float, ...]:
        """Return the relative uncertainties of the masses of the floors on the table, upwards."""
        return self.masses or (self.mass,) * floors


@dataclass(frozen=True)
class RigInfo:
    """All that the runner may know of a rig before it has measured anything.

    `channels`: the table's accelerometer first, then one per experimental floor; `further`: the channels beside them.
    The samples of a rig are those of `all_channels`, (n_channels,). `latency_samples`: the command
    computed from the samples of t_k is held from t_(k + latency) on; hold and sensor lag are not in that number.
    `transport_s`: further delay between command and table or table and samples, as of a network link.
    `gain_m_per_v` and `moving_mass_kg` are nominal data-sheet values; `specimen_mass_kg` is weighed. `unattended`: its
    own file lets the rig move without a person's confirmation. `watchdog_s`: after so long without a command the rig
    leads its table to rest by itself (0: it has no watchdog). `overrun`: what a missed deadline does, hold, skip or
    stop. `driver_verified`: what is behind the driver, hardware, loopback or fake: an open rig's own info says it,
    before that it is empty or what the address of a target lets expect. Empty on a virtual rig. `actuators`: number of
    commands, all with the same gain and limits. `uncertainty`: of sensors and masses as declared. `interface`: what is
    commanded, the table's acceleration or an actuator's displacement; then `channels` are its displacement sensor and
    its load cell.
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
    unattended: bool = False
    watchdog_s: float = 0.1
    overrun: str = "skip"
    driver_verified: str = ""
    actuators: int = 1
    further: tuple[Channel, ...] = ()
    uncertainty: Uncertainty = Uncertainty()
    interface: Literal["acceleration", "displacement"] = "acceleration"

    @property
    def all_channels(self) -> tuple[Channel, ...]:
        """Return every channel, in the order of the samples: the accelerometers of table and floors first."""
        return (*self.channels, *self.further)

    @property
    def previews(self) -> bool:
        """Return whether the rig goes on by a preview of the commands when one is late; the step must be linear."""
        return self.can.takes_trajectories and self.overrun == "skip"

    @property
    def calibrates(self) -> bool:
        """Return whether sensors or masses may differ from what is declared, so that an identification looks for it."""
        return self.uncertainty.any or any(channel.uncertainty > 0.0 for channel in self.channels)

    @property
    def shear_cell(self) -> int | None:
        """Return which of `further` is the load cell of the base shear, None without one."""
        found = [i for i, channel in enumerate(self.further) if "shear" in channel.uses]
        return found[0] if found else None

    @property
    def can(self) -> Capabilities:
        """Return what the rig can do."""
        return capabilities_of(self.kind)

    @property
    def signs(self) -> tuple[float, ...]:
        """Return the factor on the raw samples of each of the accelerometers of table and floors, +1 or -1."""
        return tuple(channel.sign for channel in self.channels)
