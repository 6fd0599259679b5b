"""Faults of sensors, cables, table, driver and operator, between a real step, guard and loop and a virtual table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from bench import rig_info, specimen
from hybrid import best_like
from scipy.signal import butter, sosfilt

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control.designed_blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.loop import guard as g
from rths_cli.loop.guard import GuardLimits
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import Limits, RigInfo
from rths_cli.rigs.virtual import plant_kernel
from rths_cli.rigs.virtual.plant_kernel import Plant
from rths_cli.rigs.virtual.virtual_rig import build_plant
from rths_cli.structure import Specimen

DT_S, RAMP_S, RECORD = 1e-3, 0.1, 1600
MASSES_KG = np.array([7.0, 6.91, 6.95])
SENSITIVITY_V = 0.102  # per m/s^2
RANGE_V = 5.0
HELD_STEPS = 250


@dataclass
class Play:
    """One faulty run: where the fault begins, and what it may draw on."""

    at: int
    random: np.random.Generator
    rig: FaultyRig
    orders: np.ndarray
    drive: Array
    kept: dict[str, Array] = field(default_factory=dict)  # what a fault remembers


Sensor = Callable[[Play, int, Array], Array]  # (play, k, samples in V) -> what the runner is given
Wire = Callable[[Play, int, float], float]  # (play, k, command in V) -> what the amplifier is given


class Table:
    """The virtual table with its compiled calls, which may become another one while it moves."""

    def __init__(self, plant: Plant) -> None:
        self.state = plant_kernel.fresh_state(plant, 1)
        self.samples, self._noise, self._command = np.zeros(3), np.zeros(3), np.zeros(1)
        self._random = np.random.default_rng(3)
        self.wear(plant)

    def wear(self, plant: Plant) -> None:
        """Go on as another table."""
        self._hold = plant_kernel.hold_interval.bind(plant, self.state, self._command)
        self._read = plant_kernel.read_samples.bind(plant, self.state, self._noise, self.samples)

    def read(self) -> Array:
        self._noise[:] = self._random.standard_normal(3)
        self._read()
        return self.samples.copy()

    def exchange(self, command_v: float) -> Array:
        self._command[0] = command_v
        self._hold()
        if self.state.fault[0] == plant_kernel.END_STOP:
            raise RigError("rig bench: the table ran into its end stop")
        return self.read()


class FaultyRig:
    """A virtual table behind the bare interface; `sensors`, `wire` and `event` spoil what passes, step by step.

    `commands` are those that came from the runner, `rested` counts its calls of `rest`.
    """

    def __init__(self, info: RigInfo) -> None:
        self.info = info
        self.inner = Table(plant())
        self.commands: list[float] = []
        self.k, self.rested = 0, 0
        self.sensors: Callable[[int, Array], Array] = lambda k, samples: samples
        self.wire: Callable[[int, float], float] = lambda k, command: command
        self.event: Callable[[int], None] = lambda k: None
        self.resting: Callable[[], None] = lambda: None

    def open(self) -> None: ...

    def arm(self) -> Array:
        return self.inner.read()

    def exchange(self, command_v: float) -> Array:
        self.k += 1
        self.commands.append(command_v)
        self.event(self.k)
        return self.sensors(self.k, self.inner.exchange(self.wire(self.k, command_v)))

    def rest(self) -> None:
        """Note it, and hold the last command for a while: that alone does not bring a table to zero."""
        self.rested += 1
        for _ in range(HELD_STEPS if self.inner.state.fault[0] == 0 else 0):
            self.inner.exchange(self.wire(self.k, self.commands[-1]))
        self.resting()

    def close(self) -> None: ...


@cache
def bench_info() -> RigInfo:
    """Return the virtual APS 400 at 1 kHz, with limits on the command's rate too."""
    limits = Limits(0.079, 1.0, 45.0, 445.0, 120.0, tracking_error_m_s2=3.0, energy_ratio=0.1)
    return rig_info(dt_s=DT_S, limits=limits)


@cache
def plant(stiffness: float = 1.0, **physics: float) -> Plant:
    """Return a table with other physics, its specimen's stiffness times a factor."""
    parts = specimen()
    worn = Specimen(parts.masses_kg, stiffness * parts.K, parts.C)
    return build_plant(bench_info(), VirtualPhysics(**physics), worn, 3e-4)


@cache
def blocks() -> Blocks:
    """Return the blocks of a whole hybrid test, with shaping."""
    return replace(best_like(bench_info()), shaping_step_v=bench_info().converters.step_v, specimen=specimen())


@cache
def shaken() -> Array:
    """Return a ground motion (n, 3) in 1-8 Hz that begins and ends at rest: the table then moves by about 10 mm."""
    white = np.random.default_rng(11).standard_normal(RECORD)
    window = np.tanh(np.arange(RECORD) / 200.0) * np.tanh(np.arange(RECORD)[::-1] / 200.0)
    place = 16e-3 * window * sosfilt(butter(2, (1.0, 8.0), "bandpass", fs=1.0 / DT_S, output="sos"), white)
    velocity = np.gradient(place, DT_S)
    return np.column_stack([np.gradient(velocity, DT_S), velocity, place])


def guard_of(info: RigInfo) -> GuardLimits:
    """Return the guard of a real rig with these limits."""
    limits = info.limits
    bit = info.converters.step_v / SENSITIVITY_V
    return GuardLimits(
        limits.stroke_m, limits.velocity_m_s, limits.acceleration_m_s2, limits.force_n, info.converters.range_v,
        limits.tracking_error_m_s2, info.gain_m_per_v, info.dt_s, MASSES_KG, np.full(3, 0.999 * RANGE_V),
        np.full(3, g.STUCK_BITS * bit), np.full(3, limits.acceleration_m_s2), limits.command_rate_v_s,
        limits.energy_ratio, 0.5 * info.specimen_mass_kg * (0.02 * limits.velocity_m_s) ** 2,
    )  # fmt: skip
