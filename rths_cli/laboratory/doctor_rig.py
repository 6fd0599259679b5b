"""`rths doctor` with a rig: its exchange at rest; zeros, noise and signs of channels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.designed_blocks import cell_reads
from rths_cli.errors import RigError
from rths_cli.experiment.identify_on_rig import play_excitation
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, PROBE, AtRest, channel_faults, heard, open_rig
from rths_cli.experiment.setup import make_setup
from rths_cli.files.rig_lock import locked_rig
from rths_cli.numerics.lti import staircase
from rths_cli.rigs.interface import LinkedRig, as_commands, linked, name_session
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp.fault_sentences import fault_names
from rths_cli.rigs.udp.packets import COMMAND

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.experiment.setup import Setup
    from rths_cli.laboratory.doctor import ExchangeDelays
    from rths_cli.loop.run_log import Signals
    from rths_cli.numerics.clock import IntArray
    from rths_cli.numerics.lti import Array
    from rths_cli.rigs.description import Channel, RigInfo
    from rths_cli.rigs.interface import Rig

HURRY = 0.5  # time that exchanges take over that of their sample instants, below which they wait for none

SHARE = 0.05  # of stroke, velocity and acceleration limit that the motion takes
SLOWEST_HZ, OF_FIRST_MODE = 1.0, 0.3  # the motion's frequency: the lower of it and this part of the first mode
PERIODS, RAMP_PERIODS = 6, 2  # of the motion, of which the first and the last ones are its ramps
AGREES = 3.0  # standard uncertainties within which channels agree
LEAST = 0.02  # relative difference that is always permitted
LOUD = 8.0  # times its noise, from which a channel was pushed


def exchange_delays(case: Case) -> ExchangeDelays:
    """Return a function that measures when the samples of each step arrive, for a rate in Hz and a duration in s.

    Its result (n,) is in ns after the step's deadline; for a rig with its own clock, relative to the earliest step.
    Raises InputError, RigError.
    """

    def measure(rate_hz: float, seconds: float) -> IntArray:
        rig = open_rig(make_setup(case.model_copy(update={"sample_rate_hz": rate_hz})), (EXP_RTHS,), 0)
        steps = max(round(seconds * rate_hz), 1)
        name_session(rig, "doctor")
        with locked_rig(rig.info.name):
            rig.open()
            try:
                rig.arm()
                there = linked(rig)
                if there is None or there.link.plain[links.OF_TARGET] == 1:
                    return paced_delays(rig, steps)
                return udp_delays(there, steps)
            finally:
                rig.rest()
                rig.close()

    return measure


def udp_delays(rig: LinkedRig, steps: int) -> IntArray:
    """Return the arrival (n,) of each step's answer in ns after its deadline; a lost one counts as an interval."""
    link, interval_ns = rig.link, round(1e9 * rig.info.dt_s)
    number = int(link.status[links.LAST] - link.status[links.BASE]) + 1
    late_ns = np.zeros(steps, dtype=np.int64)
    deadline = time.monotonic_ns() + interval_ns
    for k in range(steps):
        outcome = links.converse_at(link, COMMAND, number, 0.0, deadline, interval_ns)
        if outcome == links.FAULT:
            why = fault_names(int(link.status[links.FAULTS])) or "it obeys no commands"
            raise RigError(f"rig {rig.info.name}: the target {rig.peer} stopped: {why}")
        late_ns[k] = link.status[links.RECEIVED_NS] - deadline if outcome == links.OK else interval_ns
        passed = 1 + int(late_ns[k]) // interval_ns
        number, deadline = number + passed, deadline + interval_ns * passed
    return late_ns


def paced_delays(rig: Rig, steps: int) -> IntArray:
    """Return the delay (n,) of each exchange in ns against an even pace, relative to the earliest one.

    Raises RigError for a rig whose exchanges do not wait for their sample instants.
    """
    returned, resting = np.zeros(steps, dtype=np.int64), as_commands(np.zeros(rig.info.actuators))
    for k in range(steps):
        rig.exchange(resting)
        returned[k] = time.monotonic_ns()
    took_s, wanted_s = 1e-9 * float(returned[-1] - returned[0]), (steps - 1) * rig.info.dt_s
    if took_s < HURRY * wanted_s:
        raise RigError(
            f"rig {rig.info.name}: {steps - 1} exchanges took {took_s:.3g} s, not the {wanted_s:.3g} s of their sample "
            "instants: exchange does not wait for the next one. Have it wait for the rig's clock; the class of a "
            "simulated rig, which counts its steps, says so by COUNTED_CLOCK among its offers"
        )
    late = returned - np.round(np.arange(steps) * (1e9 * rig.info.dt_s)).astype(np.int64)
    return np.asarray(late - late.min())


@dataclass(frozen=True)
class Row:
    """One channel at rest; values in its unit."""

    name: str
    label: str
    kind: str
    unit: str
    uses: str
    zero_v: float
    zero: float
    noise: float
    range: float
    pushed: int | None  # sign of its first excursion by a push, 0: none; None: nobody pushed


@dataclass(frozen=True)
class Comparison:
    """What a channel showed in a slow motion over what it must show.

    Where `has_phase` is False, the alias of the held command was taken off such that the phase, in degrees, is 0 or 180
    whatever the channel does: it tells the sign and no delay.
    """

    channel: str
    against: str
    ratio: float
    phase_deg: float
    permitted: float
    has_phase: bool = True

    @property
    def agrees(self) -> bool:
        """Return whether size, sign and phase agree within what is permitted."""
        angle = math.radians(self.phase_deg)
        return abs(self.ratio * complex(math.cos(angle), math.sin(angle)) - 1.0) <= self.permitted

    @property
    def told(self) -> str:
        """Return the verdict in words."""
        if self.agrees:
            return "agrees"
        return "its sign is reversed" if math.cos(math.radians(self.phase_deg)) < -0.5 else "does not agree"


@dataclass(frozen=True)
class ChannelsExamined:
    """The result of `rths doctor --channels`."""

    rig: str
    seconds: float
    rows: tuple[Row, ...]
    comparisons: tuple[Comparison, ...]
    faults: tuple[str, ...]

    @property
    def exit_code(self) -> int:
        """Return 1 if a channel is not at rest, or two that must agree do not."""
        return 1 if self.faults or not all(one.agrees for one in self.comparisons) else 0


def examine_channels(
    setup: Setup, seconds: float, moves: bool, push: Callable[[], object] | None, say: Callable[[str], object]
) -> ChannelsExamined:
    """Listen to the channels of a rig at rest for a time; `moves`: then compare them in a slow motion of the table.

    `push`: asks a person to push the specimen in the positive direction while the channels are heard; None: nobody.
    Raises InputError or RigError if the rig is not available or the guard stopped the motion.
    """
    info = setup.rig
    shown = _heard(setup, seconds, say)
    found = AtRest(shown.mean(axis=0), shown.std(axis=0))
    pushed: list[int] | None = None
    if push is not None:
        push()
        pushed = first_signs(_heard(setup, seconds, say), found, info)
    rows = [
        Row(
            channel.name, channel.label, channel.kind, channel.unit, ", ".join(channel.uses), float(zero),
            float(channel.sign * zero / channel.sensitivity_v_per_unit), float(noise / channel.sensitivity_v_per_unit),
            channel.range, None if pushed is None else pushed[i],
        )
        for i, (channel, zero, noise) in enumerate(zip(info.all_channels, found.zeros_v, found.noise_v, strict=True))
    ]  # fmt: skip
    faults = tuple(channel_faults(info, found))
    compared = tuple(_compared(setup, say)) if moves and not faults else ()
    return ChannelsExamined(info.name, seconds, tuple(rows), compared, faults)


def _heard(setup: Setup, seconds: float, say: Callable[[str], object]) -> Array:
    """Return the samples (n, c + f) in V of a rig at rest; `say` hears of live values."""
    channels = setup.rig.all_channels
    rig = open_rig(setup, (PROBE,), 0)

    def look(samples: Array) -> None:
        values = zip(channels, samples, strict=True)
        told = (f"{c.name} {c.sign * v / c.sensitivity_v_per_unit:.3g} {c.unit}" for c, v in values)
        say(", ".join(told))

    return heard(setup, rig, seconds, look, "doctor")


def first_signs(shown: Array, found: AtRest, info: RigInfo) -> list[int]:
    """Return the sign of the first excursion of each channel from rest in samples (n, c + f) in V, 0 where none is."""
    off = shown - found.zeros_v
    least = LOUD * np.maximum(found.noise_v, info.converters.step_v)
    signs = []
    for column, level, channel in zip(off.T, least, info.all_channels, strict=True):
        loud = np.flatnonzero(np.abs(column) > level)
        signs.append(int(channel.sign * np.sign(column[loud[0]])) if loud.size else 0)
    return signs


def motion(setup: Setup) -> tuple[Array, float]:
    """Return a slow sine for a rig as commands (n,) in V, ramped at its ends, and its frequency in Hz."""
    specimen, limits = setup.building.specimen, setup.rig.limits
    squares = np.linalg.eigvals(np.linalg.solve(np.diag(specimen.masses_kg), specimen.K)).real
    frequency = min(SLOWEST_HZ, OF_FIRST_MODE * math.sqrt(max(squares.min(), 0.0)) / (2.0 * math.pi))
    rate = 2.0 * math.pi * frequency
    fastest = limits.fastest_m_s(setup.rig.gain_m_per_v)
    place_m = SHARE * min(limits.stroke_m, fastest / rate, limits.acceleration_m_s2 / rate**2)
    count = round((PERIODS + 2 * RAMP_PERIODS) / frequency / setup.rig.dt_s)
    time_s = setup.rig.dt_s * np.arange(count)
    ramp = np.clip(np.minimum(time_s, time_s[-1] - time_s) * frequency / RAMP_PERIODS, 0.0, 1.0)
    smooth = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    return place_m / setup.rig.gain_m_per_v * smooth * np.sin(rate * time_s), frequency


def _compared(setup: Setup, say: Callable[[str], object]) -> list[Comparison]:
    """Move the table slowly and return the comparisons of its channels."""
    command_v, frequency = motion(setup)
    say("a slow motion of the table")
    drive = np.column_stack([command_v, np.zeros((command_v.size, 2))])
    outcome = play_excitation(setup, drive, (PROBE,), lambda now: None)
    if outcome.stopped_by_limit or outcome.rig_fault:
        raise RigError(f"rig {setup.rig.name}: {outcome.stopped_by_limit or outcome.rig_fault}")
    return comparisons(setup, outcome.log, frequency)


def comparisons(setup: Setup, log: Signals, frequency_hz: float) -> list[Comparison]:
    """Return what each channel showed over what others demand, from the signals of a slow sine."""
    info, rate = setup.rig, 2.0 * math.pi * frequency_hz
    lines = _lines(np.vstack([log.corrected, log.further, np.atleast_2d(log.command_v)]), frequency_hz, info.dt_s)
    own = len(info.channels)
    shown, further, command = lines[:own], lines[own:-1], lines[-1]
    coupling_hz = info.channels[0].high_pass_hz if setup.removes_sensors else 0.0
    change = command * complex(staircase(np.array([frequency_hz]), info.latency_samples, info.dt_s, coupling_hz)[0])
    place = info.gain_m_per_v * command
    accel = np.array([_without_alias(shown[0], place, change), *shown[1:]])
    names = [channel.name for channel in info.channels]
    mass = setup.building.interface_experimental_mass_kg
    found = [_comparison(info.channels[0], "command, nominal gain", -accel[0] / rate**2, place, 0.1, has_phase=False)]
    found += [
        _comparison(channel, "table, same sense", accel[1 + i], accel[0], 1.0)
        for i, channel in enumerate(info.channels[1:])
    ]
    for channel, line in zip(info.further, further, strict=True):
        at = names.index(channel.position) if channel.position in names else -1
        if channel.kind == "displacement" and at >= 0:
            other = info.channels[at].uncertainty
            must = _without_alias(shown[at], line, change) if at == 0 else shown[at]
            against = f"{names[at]}, twice integrated"
            found.append(_comparison(channel, against, line, -must / rate**2, other, has_phase=at != 0))
        elif channel.kind == "acceleration" and at >= 0:
            found.append(_comparison(channel, names[at], line, shown[at], info.channels[at].uncertainty))
        elif channel.kind == "force" and channel.position == "table":
            reads = cell_reads(setup.floor_masses_kg, mass, channel.plate_mass_kg)
            other = max(one.uncertainty for one in info.channels)
            found.append(_comparison(channel, "masses times accelerations", line, complex(reads @ shown), other))
    return found


def _without_alias(accel: complex, place: complex, change: complex) -> complex:
    """Return the amplitude of the table's acceleration without what the steps of the held command add to its samples.

    The vibration that each step of the command excites dies within an interval and is sampled at the same phase of it
    every time: it adds a real multiple of the last change of the command, and removing an AC coupling adds to that. The
    multiple is the one that leaves the acceleration in phase, or in antiphase, with the displacement. At 500 Hz it may
    be half of a slow motion. What stands on the table hardly feels it, and a load cell feels the same.
    """
    across = (change * np.conj(place)).imag
    return accel - change * (accel * np.conj(place)).imag / across if across != 0.0 else accel


def _comparison(
    channel: Channel, against: str, shown: complex, must: complex, other: float, has_phase: bool = True
) -> Comparison:
    ratio = shown / must if must != 0.0 else complex(math.nan)
    permitted = max(AGREES * math.hypot(channel.uncertainty, other), LEAST) if other < 1.0 else other
    return Comparison(
        channel.name, against, abs(ratio), math.degrees(math.atan2(ratio.imag, ratio.real)), permitted, has_phase
    )


def _lines(rows: Array, frequency_hz: float, dt_s: float) -> Array:
    """Return the complex amplitudes (m,) of rows (m, n) at a frequency, over the whole periods between the ramps."""
    first = round(RAMP_PERIODS / frequency_hz / dt_s)
    count = round(PERIODS / frequency_hz / dt_s)
    wave = np.exp(-2j * math.pi * frequency_hz * dt_s * np.arange(count))
    return np.asarray(2.0 / count * (rows[:, first : first + count] @ wave))
