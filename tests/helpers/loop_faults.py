"""The kinds of faults within one process: what each does, and by which reasons the guard may stop the test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from faulty_rig import DT_S, RANGE_V, Play, Sensor, Wire

from rths_cli.errors import RigError
from rths_cli.loop import guard as g
from rths_cli.numerics.lti import Array

BEYOND = {g.STROKE, g.VELOCITY, g.ACCELERATION, g.FORCE, g.COMMAND, g.RATE}
ODD = {g.ENERGY, g.TRACKING, g.SATURATED, g.STUCK} | BEYOND - {g.COMMAND}  # how a wrong motion may show first


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


def growing(play: Play, samples: Array, volts_per_step: float, channel: int = 0) -> Array:
    steps = play.kept.setdefault("steps", np.zeros(1))
    steps += 1
    samples[channel] += volts_per_step * steps[0]
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
    "all signs flipped": (every(lambda p, s: -s), ODD),
    "floor sensitivity doubled": (one(1, lambda p, v: 2 * v), ODD | {g.END}),
    "floor offset jumps": (one(1, lambda p, v: v + 1.0), ODD | {g.END}),
    "floor sensor drifts": (every(lambda p, s: growing(p, s, 2e-3, 1)), ODD | {g.END}),
    "floor noise of 0.3 V": (one(2, lambda p, v: v + 0.3 * p.random.standard_normal()), ODD | {g.END}),
    "floors swapped": (every(lambda p, s: s[[0, 2, 1]]), ODD | {g.END}),
    "loose contact of one floor": (one(1, lambda p, v: v if p.random.random() > 0.1 else 0.0), ODD | {g.END}),
    "loose contact": (every(lambda p, s: s if p.random.random() > 0.1 else 0 * s), ODD),
    "sensitivity doubled": (one(0, lambda p, v: 2 * v), ODD),
    "sensitivity halved": (one(0, lambda p, v: 0.5 * v), ODD | {g.END}),
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
