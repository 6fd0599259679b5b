"""Equations of motion of the imperfect table and its specimen, compiled.

State: x, v of the coil; force F of the drive; stretch q of the deck's spring and its rate; pitch th and its rate (rad,
positive: what is above the axis moves forward); deflection z of the friction's bristles; then drift from the deck of
each floor along the pitched table, and their rates.

    coil      m_c a_c = (1 - b x^2) F + k_q q + c_q dq + m_c g th
    deck      m_d a_d = -k_q q - c_q dq - c_t v_d - friction - k x_d - k_3 x_d^3 + f + m_d g th
    floors    m_i a_i = -(K u + C du)_i - laws + m_i g th,     a_i = a_d + h_i th'' + u_i''
    pitch     I th'' = -c th' - k th - sum h_i m_i a_i + g (m_c x_c + m_d x_d + sum m_i (x_d + u_i))
    drive     tau dF = clip(crossover(F_ref)) - F,     F_ref = m_l (w^2 (g u' - x_c) - 2 z w v_c)
    friction  F_c + (F_s - F_c) exp(-(v / v_st)^2) = G;   G tanh(v / v_s), or s_0 z + s_1 dz, dz = v - s_0 abs(v) z / G

f is the force of the specimen on the table. Without a spring of the deck, coil and deck are one mass. Every weight on
the pitched table pulls along it, so that an accelerometer on it senses a - g th.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array, Integers

X, V, F, Q, DQ, PITCH, DPITCH, BRISTLE, FLOORS = range(9)
"""Places in the state; the floors' drifts begin at FLOORS, their rates follow."""


class Mechanics(NamedTuple):
    """Constants of the equations, in SI units; 0 switches an effect off."""

    coil_kg: float  # 0: one mass with the deck
    deck_kg: float
    deck_n_per_m: float
    deck_n_s_per_m: float
    viscous_n_s_per_m: float
    coulomb_n: float
    per_friction_velocity: float  # 1 / v_s
    stribeck_n: float  # F_s - F_c
    per_stribeck_velocity: float
    bristle_n_per_m: float  # s_0; 0: tanh(v / v_s)
    bristle_n_s_per_m: float  # s_1
    suspension_n_per_m: float
    suspension_n_per_m3: float
    loop_n_per_m: float  # m_l w^2
    loop_n_s_per_m: float  # 2 z w m_l
    gain_m_per_v: float
    per_time_constant: float  # 1 / tau
    force_limit_n: float
    crossover_n: float
    distortion_per_v2: float
    gain_drift_per_s: float
    force_drop_per_m2: float
    pitch_kg_m2: float  # I; 0: no pitch
    pitch_n_m: float
    pitch_n_m_s: float
    gravity_m_s2: float
    heights_m: Array  # (n,)
    masses_kg: Array  # (n,)
    stiffness: Array  # (n, n) N/m
    damping: Array  # (n, n) N s/m
    law_storey: Integers  # (l,) storeys of the laws, from 0 at the table
    law_code: Integers  # (l,)
    law_numbers: Array  # (l, NUMBERS)


@part
def deck_position(m: Mechanics, y: Array) -> float:
    """Return the displacement of the deck in m."""
    return y[X] + y[Q]


@part
def deck_velocity(m: Mechanics, y: Array) -> float:
    """Return the velocity of the deck in m/s."""
    return y[V] + y[DQ]


@part
def storey_value(y: Array, first: int, storey: int) -> float:
    """Return drift or rate of a storey, of which those of the floors begin at `first`."""
    return y[first + storey] - y[first + storey - 1] if storey > 0 else y[first]


@part
def friction_limit(m: Mechanics, velocity: float) -> float:
    """Return the force G that friction has at a steady velocity."""
    if m.stribeck_n == 0.0:
        return m.coulomb_n
    ratio = velocity * m.per_stribeck_velocity
    return m.coulomb_n + m.stribeck_n * math.exp(-ratio * ratio)


@part
def wanted_force(m: Mechanics, y: Array, command_v: float, time_s: float) -> float:
    """Return what the drive's force follows: amplifier and displacement loop."""
    heard_v = command_v * (1.0 + m.distortion_per_v2 * command_v * command_v) * (1.0 + m.gain_drift_per_s * time_s)
    force = m.loop_n_per_m * (m.gain_m_per_v * heard_v - y[X]) - m.loop_n_s_per_m * y[V]
    if m.crossover_n > 0.0:
        force *= abs(force) / (abs(force) + m.crossover_n)
    return min(max(force, -m.force_limit_n), m.force_limit_n)


@part
def rates(
    m: Mechanics, command_v: float, time_s: float, law_n: Array, y: Array, made: Array, accel: Array
) -> None:  # fmt: skip
    """Write the rates of the state, and the absolute accelerations (1 + n,) of deck and floors along the table.

    `time_s` since the start of the run; `law_n` (n,) forces of the laws of each storey, that pull its floor back.
    """
    n = m.masses_kg.size
    position, velocity = deck_position(m, y), deck_velocity(m, y)
    tilt = m.gravity_m_s2 * y[PITCH]
    on_deck, moment = 0.0, 0.0
    for i in range(n):
        pull = -law_n[i]
        if i + 1 < n:
            pull += law_n[i + 1]
        for j in range(n):
            pull -= m.stiffness[i, j] * y[FLOORS + j] + m.damping[i, j] * y[FLOORS + n + j]
        on_deck -= pull
        accel[1 + i] = pull / m.masses_kg[i] + tilt
        moment += m.masses_kg[i] * (m.gravity_m_s2 * (position + y[FLOORS + i]) - m.heights_m[i] * accel[1 + i])
    limit = friction_limit(m, velocity)
    if m.bristle_n_per_m > 0.0:
        made[BRISTLE] = velocity - m.bristle_n_per_m * abs(velocity) * y[BRISTLE] / limit
        friction = m.bristle_n_per_m * y[BRISTLE] + m.bristle_n_s_per_m * made[BRISTLE]
    else:
        made[BRISTLE] = 0.0
        friction = limit * (1.0 - 2.0 / (math.exp(2.0 * velocity * m.per_friction_velocity) + 1.0))
    suspension = (m.suspension_n_per_m + m.suspension_n_per_m3 * position * position) * position
    resisting = m.viscous_n_s_per_m * velocity + friction + suspension
    drive = (1.0 - m.force_drop_per_m2 * y[X] * y[X]) * y[F]
    spring = m.deck_n_per_m * y[Q] + m.deck_n_s_per_m * y[DQ]
    made[X], made[Q], made[PITCH] = y[V], y[DQ], y[DPITCH]
    if m.coil_kg > 0.0:
        made[V] = (drive + spring) / m.coil_kg + tilt
        accel[0] = (on_deck - resisting - spring) / m.deck_kg + tilt
        made[DQ] = accel[0] - made[V]
    else:
        accel[0] = (drive + on_deck - resisting) / m.deck_kg + tilt
        made[V], made[DQ] = accel[0], 0.0
    made[F] = (wanted_force(m, y, command_v, time_s) - y[F]) * m.per_time_constant
    made[DPITCH] = 0.0
    if m.pitch_kg_m2 > 0.0:
        moment += m.gravity_m_s2 * (m.coil_kg * y[X] + m.deck_kg * position)
        made[DPITCH] = (moment - m.pitch_n_m * y[PITCH] - m.pitch_n_m_s * y[DPITCH]) / m.pitch_kg_m2
    for i in range(n):
        made[FLOORS + i] = y[FLOORS + n + i]
        made[FLOORS + n + i] = accel[1 + i] - accel[0] - m.heights_m[i] * made[DPITCH]
