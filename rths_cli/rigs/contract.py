"""What every rig has to keep, whatever it is made of: the contract, played on a rig that is no hardware.

Each clause opens rigs that a maker makes, plays a session and returns what was broken, "" where it is kept. The tests
of rths hold its own kinds of rig to it, `rths plugin test` those of a package. It moves its tables by up to half their
stroke and beyond the range of their sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rths_cli.errors import RthsError
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo, Uncertainty
from rths_cli.rigs.interface import STANDARD_GRAVITY_M_S2, Rig, as_commands
from rths_cli.rigs.plugin_rigs import DRIVERS

Make = Callable[[], Rig]
SINE_HZ, SINE_ACCEL = 6.4, 0.14  # of the motion that every accelerometer has to show; its share of the limit
SHOWN = 0.04  # of that motion, at least
STROKE = 0.5  # largest share of the stroke
AT_REST_V = 1e-3  # of a table that was just armed, off its mean at rest
PULSE_AT, SHORT, LONG = 10, 200, 300  # samples


@dataclass(frozen=True)
class Kept:
    """One clause of the contract, and what was broken ("" where it is kept)."""

    clause: str
    fault: str


def made_info(kind: str, name: str = "contract") -> RigInfo:
    """Return the description of a table with two floors, of 1000 mV/g and 16 bits, for a rig without a file."""
    g = STANDARD_GRAVITY_M_S2
    channels = tuple(
        Channel(one, 1.0 / g, 5.0 * g, 0.0, 0.0, uncertainty=0.0) for one in ("table", "floor_1", "floor_2")
    )
    limits, exact = Limits(0.079, 1.0, 45.0, 445.0), Uncertainty(0.0, 0.0, 0.0)
    return RigInfo(
        name, kind, 5e-4, channels, Converters(16, 10.0), 1, limits, 0.0079, 7.0, 13.86, uncertainty=exact
    )  # fmt: skip


def contract(make: Make) -> Iterator[Kept]:
    """Play every clause on rigs of a maker and yield whether it is kept; a fault of the rig is what was broken."""
    for clause, holds in CLAUSES.items():
        try:
            fault = holds(make)
        except RthsError as error:
            fault = str(error)
        yield Kept(clause, fault)


def played(rig: Rig, command_v: Array) -> Array:
    """Return the samples (n + 1, c) of a whole session: open, arm, exchange, rest, close, close again."""
    rig.open()
    samples = [rig.arm().copy()]
    samples += [rig.exchange(as_commands(np.full(rig.info.actuators, volts))).copy() for volts in command_v]
    rig.rest()
    rig.close()
    rig.close()
    return np.array(samples)


def _sine_v(info: RigInfo, count: int) -> Array:
    """Return a slow motion (count,) in V within the limits of a rig."""
    omega = 2.0 * np.pi * SINE_HZ
    moved_m = min(SINE_ACCEL * info.limits.acceleration_m_s2 / omega**2, STROKE * info.limits.stroke_m)
    return np.asarray(_volts(info, moved_m) * np.sin(omega * info.dt_s * np.arange(count)))


def _volts(info: RigInfo, moved_m: float) -> float:
    return min(moved_m / info.gain_m_per_v, 0.5 * info.converters.range_v)


def session(make: Make) -> str:
    """A session gives one row of finite samples for each command, in which every accelerometer moves."""
    rig = make()
    command_v = _sine_v(rig.info, LONG)
    samples = played(rig, command_v)
    if samples.shape != (LONG + 1, len(rig.info.all_channels)):
        return f"gave samples of shape {samples.shape}, not {(LONG + 1, len(rig.info.all_channels))}"
    if not np.isfinite(samples).all():
        return "gave samples that are no finite numbers"
    accel = float(np.max(command_v)) * rig.info.gain_m_per_v * (2.0 * np.pi * SINE_HZ) ** 2
    for channel, row in zip(rig.info.channels, samples.T, strict=False):
        least_v = SHOWN * accel * channel.sensitivity_v_per_unit
        if np.ptp(row) < least_v:
            return (
                f"channel {channel.name} shows {np.ptp(row):.3g} V of a motion that should show {least_v:.3g} V or more"
            )
    return ""


def latency(make: Make) -> str:
    """A command of step k changes the sample after k + latency_samples, and none before."""
    rig, still = make(), make()
    pulse = np.zeros(3 * PULSE_AT)
    pulse[PULSE_AT] = _volts(rig.info, STROKE * rig.info.limits.stroke_m)
    moved = np.flatnonzero((played(rig, pulse) != played(still, np.zeros(len(pulse))))[:, 0])
    stated = rig.info.latency_samples
    if not moved.size:
        return f"a command of {pulse.max():.3g} V moved nothing within {2 * PULSE_AT} samples"
    found = int(moved[0]) - PULSE_AT - 1
    return (
        "" if found == stated else f"the first sample that a command changes shows a latency of {found}, not {stated}"
    )


def arming(make: Make) -> str:
    """Arming puts the table at rest at zero, and the same commands give the same samples again."""
    rig = make()
    command_v = _sine_v(rig.info, SHORT)
    first, again = played(rig, command_v), played(rig, command_v)
    if not np.array_equal(first, again):
        return "the same commands after arm gave other samples than before"
    resting = played(rig, np.zeros(SHORT)).mean(axis=0)  # a sensor may have an offset
    off = float(np.abs(first[0] - resting).max())
    return "" if off < AT_REST_V else f"the first sample after arm is {off:.3g} V off the table at rest"


def codes(make: Make) -> str:
    """Samples are codes of the converter inside its range, whatever is asked."""
    rig = make()
    converters, count = rig.info.converters, 2 * SHORT
    span_v = converters.range_v
    command_v = np.where(np.arange(count) % 40 < 20, span_v, -span_v) * (np.arange(count) < SHORT)
    samples = played(rig, command_v)
    if samples.min() < -span_v or samples.max() > span_v - converters.step_v:
        worst = samples.flat[np.abs(samples).argmax()]
        return f"a sample of {worst:.6g} V is beyond the converter's range of +-{span_v:g} V less a bit"
    if not converters.bits:
        return ""
    steps = samples / converters.step_v
    return (
        ""
        if np.abs(steps - np.round(steps)).max() < 1e-9
        else f"samples are no multiples of a bit, {converters.step_v:.3g} V"
    )


def any_time(make: Make) -> str:
    """Rest and close are safe at any time, and the rig can be used afterwards as before."""
    rig = make()
    rig.rest()
    rig.close()
    rig.open()
    rig.rest()
    rig.arm()
    rig.exchange(as_commands(np.full(rig.info.actuators, 0.1 * rig.info.converters.range_v)))
    rig.rest()
    rig.rest()
    rig.close()
    rig.rest()
    rig.close()
    rig.open()
    again = np.array(rig.arm())
    rig.rest()
    rig.close()
    whole = again.shape == (len(rig.info.all_channels),) and bool(np.isfinite(again).all())
    return "" if whole else "after rest and close it could not be opened and armed again"


def driver(make: Make) -> str:
    """An open rig that is no hardware says what is behind its driver."""
    rig = make()
    rig.open()
    stated = rig.info.driver_verified
    rig.close()
    known = ("", *DRIVERS[1:])  # a virtual rig has no driver
    return "" if stated in known else f"states driver_verified {stated!r}, known are {', '.join(DRIVERS[1:])}"


CLAUSES: dict[str, Callable[[Make], str]] = {
    "a session gives a row of samples for each command": session,
    "the declared latency is true": latency,
    "arming puts the table at rest and repeats the run": arming,
    "samples are codes of the converter inside its range": codes,
    "rest and close are safe at any time": any_time,
    "the rig says what is behind its driver": driver,
}
"""The contract: what each clause is called, and what plays it."""
