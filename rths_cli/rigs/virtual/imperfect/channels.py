"""Channels of the imperfect table, compiled: what each senses, and first-order filters that are answered exactly.

What a channel senses is a polynomial of degree four over an inner step, through its values at five equidistant
instants. A low pass of rate l behind which an AC coupling of rate h stands answers l / (l - h) (u_l - u_h), where
du = rate (sensed - u) for both: each of them is solved for the polynomial without a further approximation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.numerics.compiled import borrowed, part, shared_part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.rigs.virtual.imperfect.equations import (
    DPITCH,
    FLOORS,
    PITCH,
    Mechanics,
    X,
    deck_position,
    storey_value,
)

ACCELERATION, DISPLACEMENT, COIL_DISPLACEMENT, FORCE, DRIFT = range(5)
"""What a channel senses: absolute acceleration of table (place 0) or floors (1, 2, ..., between two: interpolated);
absolute displacement of table or floors, or of the coil; force on all that stands on a load cell, at the table (0)
with a plate, or in a storey (1, 2, ...); drift of a storey (1, 2, ...)."""
NODES = 5
BY_NODES = np.linalg.inv(np.vander(np.linspace(0.0, 1.0, NODES), NODES, increasing=True))
"""Coefficients of the powers of the share of a step, from the values at its five instants."""
SERIES = 16


class Sensing(NamedTuple):
    """Constants of c channels."""

    kind: Integers  # (c,)
    place: Array  # (c,)
    low_pass: Array  # (c,) rate in 1/s; 0: none
    high_pass: Array  # (c,)
    gain: Array  # (c,) true over declared sensitivity
    skew_s: Array  # (c,)
    offset_v: Array  # (c,)
    hum_v: Array  # (c,)
    hum_phase: Array  # (c,) rad
    hum_rate: float  # rad/s
    walk_v: Array  # (c,) standard deviation of the zero's step per reading
    vertical: Array  # (c,) transverse sensitivity times the arm, m
    lateral: Array  # (c,) transverse sensitivity times the lateral share
    noise: Array  # (c,) rms in the channel's unit
    range: Array  # (c,)
    v_per_unit: Array  # (c,) declared
    plate_kg: Array  # (c,) what stands on a load cell below the specimen


@part
def sensed(one: Sensing, m: Mechanics, c: int, y: Array, made: Array, accel: Array) -> float:
    """Return what a channel senses in its unit, from state, its rates and the accelerations of deck and floors."""
    kind, place = one.kind[c], one.place[c]
    if kind == ACCELERATION:
        floor = min(int(place), accel.size - 1)
        value = accel[floor]
        if floor + 1 < accel.size:
            value += (place - floor) * (accel[floor + 1] - accel[floor])
        return (1.0 + one.lateral[c]) * value - m.gravity_m_s2 * y[PITCH] + one.vertical[c] * made[DPITCH]
    at = int(place)
    if kind == COIL_DISPLACEMENT:
        return y[X]
    if kind == DISPLACEMENT:
        value = deck_position(m, y)
        if at > 0:
            value += y[FLOORS + at - 1] + m.heights_m[at - 1] * y[PITCH]
        return value
    if kind == FORCE:
        tilt = m.gravity_m_s2 * y[PITCH]
        value = one.plate_kg[c] * (accel[0] - tilt)
        for i in range(max(at - 1, 0), m.masses_kg.size):
            value += m.masses_kg[i] * (accel[1 + i] - tilt)
        return value
    return storey_value(y, FLOORS, at - 1)


@shared_part
def answered(rate: float, time_s: float, share: float, powers: Array, begun: float) -> float:
    """Return u after a time, du = rate (p - u), p a polynomial of the share of the step that has passed.

    `powers` are its coefficients, `share` how much of the step the time is.
    """
    powers = borrowed(powers)
    x = rate * time_s
    last, factor = 0.0, share * share * share * share
    if x < 1.0:  # integral of the highest power by its series, those of lower ones downwards from it
        term = x / NODES
        for k in range(SERIES):
            last += term
            term *= -x / (NODES + 1.0 + k)
        value = powers[4] * factor * last
        for j in range(NODES - 1, 0, -1):
            last = x / j * (1.0 - last)
            factor = 1.0
            for _ in range(j - 1):
                factor *= share
            value += powers[j - 1] * factor * last
        return math.exp(-x) * begun + value
    kept = math.exp(-x)
    last, factor = 1.0 - kept, 1.0
    value = powers[0] * last
    for j in range(1, NODES):
        last = 1.0 - j / x * last
        factor *= share
        value += powers[j] * factor * last
    return kept * begun + value


@part
def polynomial(powers: Array, share: float) -> float:
    """Return a polynomial of degree four."""
    return powers[0] + share * (powers[1] + share * (powers[2] + share * (powers[3] + share * powers[4])))


@part
def conditioned(low_rate: float, high_rate: float, fast: float, slow: float) -> float:
    """Return what low pass and AC coupling make of u_l (without a low pass: what is sensed) and u_h."""
    if high_rate == 0.0:
        return fast
    if low_rate == 0.0:
        return fast - slow
    return low_rate / (low_rate - high_rate) * (fast - slow)
