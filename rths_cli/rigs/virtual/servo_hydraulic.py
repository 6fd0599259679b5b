"""A servo-hydraulic actuator that tracks displacement, with the specimen that it moves: valve, oil column, natural
velocity feedback, limit of force.

    g'' + beta_1 g' + beta_2 g = a_1 beta_0 (gain u - x)        valve g, driven by the error of displacement
    F' + a_3 F = g - a_2 x'                                     oil column, with the natural velocity feedback
    m x'' + c x' + k x = clip(F, +-limit)                       specimen

with command u and displacement x in m, force F in N. While F is within the limit the plant is linear, and sampled
exactly for a command that is held. Otherwise the sample is integrated in steps of `FINE`.

Source: C. E. Silva, D. Gomez, A. Maghareh, S. J. Dyke, B. F. Spencer: Benchmark control problem for real-time hybrid
simulation. Mechanical Systems and Signal Processing 135 (2020) 106381.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array, ComplexArray, StateSpace

FINE = 4  # steps (Runge-Kutta, fourth order) of a sample in which the force reaches its limit
VALVE, VALVE_RATE, FORCE, DISPLACEMENT, VELOCITY = range(5)  # the states


@dataclass(frozen=True)
class ServoHydraulic:
    """Numbers of the actuator and of the specimen, one degree of freedom."""

    valve_gain: float  # a_1 beta_0
    velocity_feedback: float  # a_2
    oil_column_rad_s: float  # a_3; it may be negative: the velocity feedback and the loop of displacement stabilise
    valve_damping_rad_s: float  # beta_1
    valve_stiffness_rad2_s2: float  # beta_2
    command_gain: float
    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    force_limit_n: float

    @property
    def linear(self) -> StateSpace:
        """Return the plant within the limit: command to displacement and force, 5 states in the module's order."""
        m, c, k = self.mass_kg, self.damping_n_s_per_m, self.stiffness_n_per_m
        a = np.zeros((5, 5))
        a[VALVE, VALVE_RATE] = 1.0
        a[VALVE_RATE, :2] = -self.valve_stiffness_rad2_s2, -self.valve_damping_rad_s
        a[VALVE_RATE, DISPLACEMENT] = -self.valve_gain
        a[FORCE, VALVE], a[FORCE, FORCE], a[FORCE, VELOCITY] = 1.0, -self.oil_column_rad_s, -self.velocity_feedback
        a[DISPLACEMENT, VELOCITY] = 1.0
        a[VELOCITY, FORCE:] = 1.0 / m, -k / m, -c / m
        b = np.zeros((5, 1))
        b[VALVE_RATE, 0] = self.command_gain * self.valve_gain
        outputs = np.zeros((2, 5))
        outputs[0, DISPLACEMENT] = outputs[1, FORCE] = 1.0
        return StateSpace(a, b, outputs, np.zeros((2, 1)))

    @property
    def poles(self) -> ComplexArray:
        """Return the poles (5,) from command to displacement, in rad/s; there is no zero."""
        return np.asarray(np.linalg.eigvals(self.linear.A), dtype=complex)

    @property
    def high_frequency_gain(self) -> float:
        """Return the gain g of displacement over command, g / prod(s - poles)."""
        return self.command_gain * self.valve_gain / self.mass_kg


class SampledActuator(NamedTuple):
    """The plant for the compiled loop; its state (5,) is the caller's."""

    sampled: Array  # (5, 5) exact for one sample
    driven: Array  # (5,) by a held command
    rates: Array  # (5, 5) of the continuous plant
    into: Array  # (5,)
    fine_s: float  # step where the force reaches its limit
    limit_n: float
    work: Array  # (6, 5)


def sampled_actuator(plant: ServoHydraulic, dt_s: float) -> SampledActuator:
    """Return the plant with exact matrices for samples of `dt_s`."""
    system = plant.linear
    whole = expm(dt_s * np.block([[system.A, system.B], [np.zeros((1, 6))]]))
    return SampledActuator(
        whole[:5, :5].copy(), whole[:5, 5].copy(), system.A.copy(), system.B[:, 0].copy(), dt_s / FINE,
        plant.force_limit_n, np.zeros((6, 5)),
    )  # fmt: skip


@part
def advance(plant: SampledActuator, state: Array, command: float) -> None:
    """Advance the state (5,) by one sample with a held command."""
    after = plant.work[0]
    for i in range(5):
        after[i] = plant.driven[i] * command
        for j in range(5):
            after[i] += plant.sampled[i, j] * state[j]
    if abs(state[FORCE]) <= plant.limit_n and abs(after[FORCE]) <= plant.limit_n:
        for i in range(5):
            state[i] = after[i]
        return
    for _ in range(FINE):
        _runge_kutta(plant, state, command)


@part
def _runge_kutta(plant: SampledActuator, state: Array, command: float) -> None:
    h, there = plant.fine_s, plant.work[5]
    for stage in range(4):
        share = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
        for i in range(5):
            there[i] = state[i] + (share * plant.work[stage, i] if stage > 0 else 0.0)
        _slope(plant, there, command, plant.work[stage + 1])
    for i in range(5):
        slopes = plant.work[1, i] + 2.0 * plant.work[2, i] + 2.0 * plant.work[3, i] + plant.work[4, i]
        state[i] += h / 6.0 * slopes


@part
def _slope(plant: SampledActuator, state: Array, command: float, slope: Array) -> None:
    for i in range(5):
        slope[i] = plant.into[i] * command
        for j in range(5):
            slope[i] += plant.rates[i, j] * state[j]
    over = state[FORCE] - limited(state[FORCE], plant.limit_n)
    slope[VELOCITY] -= plant.rates[VELOCITY, FORCE] * over


@part
def limited(value: float, limit: float) -> float:
    """Return a value within +-limit."""
    return min(max(value, -limit), limit)
