"""Faults of sensors, cables, table, driver and operator, between a real step, guard and loop and a virtual table."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from bench import rig_info, specimen
from hybrid import best_like
from scipy.signal import butter, sosfilt

from rths_cli import compiled
from rths_cli.case.virtual_physics import VirtualPhysics
from rths_cli.control.blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.loop import guard as g
from rths_cli.loop import realtime
from rths_cli.loop.blocks import NUMERICAL
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.realtime import Performance
from rths_cli.lti import Array
from rths_cli.rig_info import Limits, RigInfo
from rths_cli.rigs.virtual import kernel
from rths_cli.rigs.virtual.plant import Plant
from rths_cli.rigs.virtual.rig import build_plant
from rths_cli.structure import Specimen

DT_S, RAMP_S, RECORD = 1e-3, 0.1, 1600
REST_S = 2.0
PLACE_AT_REST_M, VELOCITY_AT_REST_M_S = 2e-3, 0.02  # a specimen that still swings moves the table by less
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


BEYOND = {g.STROKE, g.VELOCITY, g.ACCELERATION, g.FORCE, g.COMMAND, g.RATE}
ODD = {g.ENERGY, g.TRACKING, g.SATURATED, g.STUCK} | BEYOND - {g.COMMAND}  # how a wrong motion may show first
Sensor = Callable[[Play, int, Array], Array]  # (play, k, samples in V) -> what the runner is given
Wire = Callable[[Play, int, float], float]  # (play, k, command in V) -> what the amplifier is given


class Table:
    """The virtual table with its compiled calls bound once: a step of a bound call takes 20 us, of a rig's own 400."""

    def __init__(self, plant: Plant) -> None:
        self.state = kernel.fresh_state(plant, 1)
        self.samples, self._noise = np.zeros(3), np.zeros(3)
        self._random = np.random.default_rng(3)
        self.wear(plant)

    def wear(self, plant: Plant) -> None:
        """Go on as another table."""
        self._flat: list[object] = []
        kind = ",".join(compiled._flatten(argument, self._flat) for argument in (plant, self.state, 0.0))
        kernel.hold_interval.bind(plant, self.state, 0.0)
        self._hold, self._plant = kernel.hold_interval._loaded[kind], plant
        self._read = kernel.read_samples.bind(plant, self.state, self._noise, self.samples)

    def read(self) -> Array:
        self._noise[:] = self._random.standard_normal(3)
        self._read()
        return self.samples.copy()

    def exchange(self, command_v: float) -> Array:
        self._flat[-1] = ctypes.c_double(command_v)
        self._hold(self._flat)
        if self.state.fault[0] == kernel.END_STOP:
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
    return replace(best_like(bench_info()), shaping_step_v=bench_info().converters.step_v)


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
        g.STUCK_BITS * bit, np.full(3, limits.acceleration_m_s2), limits.command_rate_v_s, limits.energy_ratio,
        0.5 * info.specimen_mass_kg * (0.02 * limits.velocity_m_s) ** 2,
    )  # fmt: skip


# --- faults of sensors


def every(change: Callable[[Play, Array], Array]) -> Sensor:
    """Return a fault that changes all samples from its beginning on."""
    return lambda play, k, samples: change(play, samples) if k >= play.at else samples


def one(channel: int, change: Callable[[Play, float], float], last: int | None = None) -> Sensor:
    """Return a fault of one channel that lasts for some samples, or for ever."""

    def spoil(play: Play, k: int, samples: Array) -> Array:
        if k >= play.at and (last is None or k < play.at + last):
            samples[channel] = change(play, samples[channel])
        return samples

    return spoil


def stuck(*channels: int) -> Sensor:
    def spoil(play: Play, k: int, samples: Array) -> Array:
        if k >= play.at:
            before = play.kept.setdefault("before", samples.copy())
            samples[list(channels)] = before[list(channels)]
        return samples

    return spoil


def late(count: int, first_lasts: int | None = None) -> Sensor:
    """Return a fault that gives the samples of `count` steps earlier, for ever or for some steps."""

    def spoil(play: Play, k: int, samples: Array) -> Array:
        play.kept[str(k)] = samples.copy()
        there = k >= play.at and (first_lasts is None or k < play.at + first_lasts)
        return play.kept.get(str(k - count), samples).copy() if there else samples

    return spoil


def held(count: int) -> Sensor:
    """Return a fault that gives the last samples again and again for some steps, as after lost answers."""

    def spoil(play: Play, k: int, samples: Array) -> Array:
        if not play.at <= k < play.at + count:
            play.kept["last"] = samples.copy()
        return play.kept["last"].copy()

    return spoil


def growing(play: Play, samples: Array, volts_per_step: float) -> Array:
    steps = play.kept.setdefault("steps", np.zeros(1))
    steps += 1
    samples[0] += volts_per_step * steps[0]
    return samples


SENSORS: dict[str, tuple[Sensor, set[int]]] = {
    "table sensor NaN": (one(0, lambda p, v: np.nan), {g.NOT_A_NUMBER}),
    "floor sensor NaN": (one(2, lambda p, v: np.nan), {g.NOT_A_NUMBER}),
    "one NaN sample": (one(1, lambda p, v: np.nan, 1), {g.NOT_A_NUMBER}),
    "sensor infinite": (one(0, lambda p, v: np.inf, 1), {g.NOT_A_NUMBER}),
    "table sensor stuck": (stuck(0), {g.STUCK, g.ENERGY, g.TRACKING}),
    "floor sensor stuck": (stuck(2), {g.STUCK, g.ENERGY, g.TRACKING}),
    "all sensors stuck": (stuck(0, 1, 2), {g.STUCK, g.ENERGY, g.TRACKING}),
    "table sensor saturated": (one(0, lambda p, v: RANGE_V), {g.SATURATED}),
    "floor sensor saturated": (one(1, lambda p, v: -RANGE_V), {g.SATURATED}),
    "table sensor sign flipped": (one(0, lambda p, v: -v), ODD),
    "first floor sign flipped": (one(1, lambda p, v: -v), ODD),
    "top floor sign flipped": (one(2, lambda p, v: -v), ODD | {g.END}),
    "spike beyond the limits": (one(0, lambda p, v: 4.8, 1), {g.ACCELERATION}),
    "spike within the limits": (one(0, lambda p, v: v + 0.2, 1), {g.END}),
    "table sensor unplugged": (one(0, lambda p, v: 0.0), {g.STUCK, g.ENERGY, g.TRACKING}),
    "floor sensor unplugged": (one(2, lambda p, v: 0.0), {g.STUCK, g.ENERGY, g.TRACKING}),
    "floating input, mains hum": (
        every(lambda p, s: s * 0 + 0.6 * np.sin(0.314 * p.rig.k)),
        ODD,
    ),
    "loose contact": (every(lambda p, s: s if p.random.random() > 0.1 else 0 * s), ODD),
    "sensitivity doubled": (one(0, lambda p, v: 2 * v), ODD),
    "sensitivity a tenth": (one(0, lambda p, v: 0.1 * v), ODD),
    "offset jumps": (one(0, lambda p, v: v + 1.0), ODD),
    "sensor drifts": (every(lambda p, s: growing(p, s, 2e-3)), ODD),
    "noise of 0.3 V": (every(lambda p, s: s + 0.3 * p.random.standard_normal(3)), ODD),
    "channels swapped": (every(lambda p, s: s[[1, 0, 2]]), ODD),
    "one answer lost": (held(1), {g.END}),
    "four answers lost": (held(4), {g.END}),
    "samples late by one": (late(1), {g.END}),
    "samples late by 30": (late(30), ODD),
}


# --- faults of table, amplifier and cable of the command


def from_then(change: Callable[[Play, float], float]) -> Wire:
    return lambda play, k, command: change(play, command) if k >= play.at else command


def delayed(count: int) -> Wire:
    def spoil(play: Play, k: int, command: float) -> float:
        sent = play.rig.commands
        return sent[-1 - count] if k >= play.at and len(sent) > count else command

    return spoil


WIRES: dict[str, tuple[Wire, set[int]]] = {
    "amplifier dead": (from_then(lambda p, u: 0.0), ODD),
    "amplifier holds": (from_then(lambda p, u: p.rig.commands[p.at - 1]), ODD),
    "polarity reversed": (from_then(lambda p, u: -u), ODD),
    "amplifier gain 1.5": (from_then(lambda p, u: 1.5 * u), ODD),
    "amplifier gain 0.5": (from_then(lambda p, u: 0.5 * u), ODD),
    "command delayed by one": (delayed(1), {g.END}),
    "command delayed by 30": (delayed(30), ODD),
    "offset of the amplifier": (from_then(lambda p, u: u + 0.5), ODD),
}

TABLES: dict[str, tuple[dict[str, float], set[int]]] = {
    "friction jump to 3 N": ({"coulomb_n": 3.0}, ODD | {g.END}),
    "friction jump to 30 N": ({"coulomb_n": 30.0}, ODD),
    "table jams": ({"coulomb_n": 400.0}, ODD),
    "specimen loses 30 % stiffness": ({"stiffness": 0.7}, ODD | {g.END}),
    "actuator weak": ({"force_limit_n": 20.0}, ODD),
    "actuator's loop goes soft": ({"loop_frequency_hz": 4.0}, ODD),
}


# --- faults of the source, the driver and the operator


def raising(play: Play, k: int) -> None:
    if k == play.at:
        raise RigError("rig bench: the amplifier tripped")


def end_stop(play: Play, k: int) -> None:
    if k == play.at:
        play.rig.inner.state.state[0] = 0.08


def order(what: int) -> Callable[[Play, int], None]:
    def give(play: Play, k: int) -> None:
        if k == play.at:
            play.orders[0] = what

    return give


def fails_later(play: Play, k: int) -> None:
    if k == play.at:
        play.orders[0] = 1
    if k == play.at + 100:
        raise RigError("rig bench: the amplifier tripped")


def ordered_twice(play: Play, k: int) -> None:
    if k in (play.at, play.at + 100):
        play.orders[0] = 2 if k == play.at else 3


EVENTS: dict[str, tuple[Callable[[Play, int], None], set[int]]] = {
    "driver fails": (raising, {g.NONE}),
    "table hits its end stop": (end_stop, {g.NONE}),
    "driver fails on the way to rest": (fails_later, {g.OPERATOR}),
    "stop key": (order(1), {g.OPERATOR}),
    "Ctrl-C": (order(2), {g.INTERRUPT}),
    "SIGTERM": (order(3), {g.TERMINATION}),
    "log lost": (order(4), {g.LOG_FAILED}),
    "live view fails": (order(5), {g.WATCHER_FAILED}),
    "Ctrl-C, then SIGTERM": (ordered_twice, {g.INTERRUPT}),
}


def _louder(factor: float) -> Callable[[Play], None]:
    def change(play: Play) -> None:
        play.drive[play.at :] *= factor

    return change


def _set(value: float) -> Callable[[Play], None]:
    def change(play: Play) -> None:
        play.drive[play.at, 0] = value

    return change


def _displaced(play: Play) -> None:
    play.drive[play.at :, 2] += 0.2


def _shaken(play: Play) -> None:
    n = np.arange(len(play.drive) - play.at)
    play.drive[play.at :, 0] += 200.0 * np.sin(2 * np.pi * 25.0 * DT_S * n)


DRIVES: dict[str, tuple[Callable[[Play], None], set[int]]] = {
    "motion ten times too large": (_louder(10.0), BEYOND),
    "motion a thousand times too large": (_louder(1e3), BEYOND),
    "command saturates": (_louder(30.0), BEYOND),
    "ground jumps by 0.2 m": (_displaced, BEYOND),
    "ground shakes at 25 Hz": (_shaken, BEYOND | {g.TRACKING}),
    "record NaN": (_set(np.nan), {g.NOT_A_NUMBER}),
    "record infinite": (_set(np.inf), {g.NOT_A_NUMBER, *BEYOND}),
}

KINDS: dict[str, set[int]] = {
    name: reasons for table in (SENSORS, WIRES, TABLES, EVENTS, DRIVES) for name, (_, reasons) in table.items()
}


@dataclass(frozen=True)
class Ended:
    """How a faulty run ended: guard's reason, the rig's fault, and what the table was given and did."""

    reason: int
    fault: str
    phase: int
    at: int
    rested: int
    commands_v: Array
    place_m: float
    velocity_m_s: float
    taken_over: int  # steps that passed the guard


def performed(name: str, seed: int) -> Ended:
    """Run with one kind of fault at a random instant."""
    info, random = bench_info(), np.random.default_rng((seed, *name.encode()))
    rig, orders = FaultyRig(info), np.zeros(1, dtype=np.int64)
    ramp = round(RAMP_S / DT_S)
    play = Play(int(random.integers(ramp + 200, ramp + RECORD - 900)), random, rig, orders, shaken().copy())
    _spoil(name, play)
    run = realtime.prepare(info, blocks(), NUMERICAL, play.drive, guard_of(info), None, orders, RAMP_S)
    fault = realtime.perform(rig, run)
    return ended(rig, run, fault, play.at)


def ended(rig: FaultyRig, run: Performance, fault: str, at: int) -> Ended:
    """Return how a run went."""
    flags, state = run.guard.flags, rig.inner.state.state
    return Ended(
        int(flags[1]), fault, int(flags[0]), at, rig.rested, np.array(rig.commands), float(state[0]), float(state[1]),
        int(flags[3]),
    )  # fmt: skip


def _spoil(name: str, play: Play) -> None:
    rig = play.rig
    if name in SENSORS:
        rig.sensors = lambda k, samples: SENSORS[name][0](play, k, samples)
    if name in WIRES:
        rig.wire = lambda k, command: WIRES[name][0](play, k, command)
    if name in EVENTS:
        rig.event = lambda k: EVENTS[name][0](play, k)
    if name in DRIVES:
        play.at -= round(RAMP_S / DT_S)
        DRIVES[name][0](play)
        play.at += round(RAMP_S / DT_S)
    if name in TABLES:
        worn = plant(**TABLES[name][0])

        def change(k: int) -> None:
            if k == play.at:
                rig.inner.wear(worn)

        rig.event = change


def beyond_limits(info: RigInfo, commands_v: Array) -> list[str]:
    """Return a sentence for each limit that a series of commands breaks, seen from the table at rest at 0 V."""
    series = np.concatenate([[0.0], commands_v])
    place = info.gain_m_per_v * series
    share = {
        "stroke": np.abs(place).max() / info.limits.stroke_m,
        "range": np.abs(series).max() / info.converters.range_v,
        "velocity": np.abs(np.diff(place)).max() / info.dt_s / info.limits.velocity_m_s,
        "rate": np.abs(np.diff(series)).max() / info.dt_s / info.limits.command_rate_v_s,
    }
    told = [] if np.isfinite(series).all() else ["a command is not a number"]
    return told + [f"{name} {used:.6f} of its limit" for name, used in share.items() if not used <= 1.0 + 1e-9]


def judged(name: str, ended: Ended) -> list[str]:
    """Return a sentence for everything that is wrong with how a run with this fault ended."""
    told = beyond_limits(bench_info(), ended.commands_v)
    if ended.reason not in KINDS[name]:
        told.append(f"the reason is {g.REASONS[ended.reason] or 'none'!r}")
    if ended.rested < 1:
        told.append("the rig was never asked to rest")
    return told + ([] if ended.fault else _unrest(name, ended))


def _unrest(name: str, ended: Ended) -> list[str]:
    """Return why a table that the loop led to rest is not at rest; one that does not obey is judged by its command."""
    told = []
    if ended.phase != g.STOPPED or ended.commands_v[-1] != 0.0:
        told.append(f"the last command is {ended.commands_v[-1]:g} V, not at zero")
    if (took := DT_S * (len(ended.commands_v) - ended.taken_over)) > REST_S:
        told.append(f"the way to zero took {took:.2f} s")
    obeys = name not in WIRES and name not in TABLES
    if obeys and abs(ended.place_m) > PLACE_AT_REST_M:
        told.append(f"the table is still at {1e3 * ended.place_m:.2f} mm")
    if abs(ended.velocity_m_s) > VELOCITY_AT_REST_M_S:
        told.append(f"the table still moves at {1e3 * ended.velocity_m_s:.1f} mm/s")
    return told
