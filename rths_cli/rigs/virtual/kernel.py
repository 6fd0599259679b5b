"""The compiled virtual table: hold a command over one sample interval, return the next samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.compiled import entry, part
from rths_cli.lti import Array
from rths_cli.rigs.virtual.plant import Plant

END_STOP = 1
SATURATED = 20.0  # tanh(20) is 1 in double precision
CLIPPED_LEVEL = 3
CROSSING_LEVEL = 8  # of an interval in which clipping may begin or end


class PlantState(NamedTuple):
    """What the kernel changes: c = 1 + n_floors channels, n states, latency + 1 commands under way."""

    state: Array  # (n,) mechanical states, then the channels' low passes, then their AC couplings
    pushed: Array  # (n,) scratch for the next state
    values: Array  # (2, 3) the nonlinearities at start, middle, end of an inner step
    offsets: Array  # (2, 2) scratch: the arguments at middle and end without the nonlinearities
    accel: Array  # (c,) absolute accelerations, wanted where the sensors have no low pass
    queue: Array  # (latency + 1,) commands under way, the oldest first
    middle_velocity: Array  # (c,) true absolute velocities in the middle of the interval
    fault: Array  # (1,) 0 or END_STOP


def fresh_state(plant: Plant, latency_samples: int) -> PlantState:
    """Return a table at rest."""
    n, c = plant.transition.shape[1], plant.accel_rows.shape[0]
    return PlantState(
        np.zeros(n), np.zeros(n), np.zeros((2, 3)), np.zeros((2, 2)), np.zeros(c),
        np.zeros(latency_samples + 1), np.zeros(c), np.zeros(1, dtype=np.int64),
    )  # fmt: skip


@part
def convert(value: float, step: float, bound: float) -> float:
    """Return the value of a converter of that step (0: none) and range, in the same unit."""
    if step > 0.0:
        value = math.floor(value / step + 0.5) * step
    return min(max(value, -bound), bound - step)


@part
def friction_sign(velocity: float, plant: Plant) -> float:
    """Return tanh(v / v_s)."""
    ratio = velocity / plant.friction_velocity_m_s
    if abs(ratio) > SATURATED:
        return math.copysign(1.0, ratio)
    return math.tanh(ratio)


@part
def nonlinearity(which: int, argument: float, plant: Plant) -> float:
    """Return tanh(v / v_s) (which = 0) or clip(F_ref) - F_ref (which = 1)."""
    if which == 0:
        return friction_sign(argument, plant)
    return min(max(argument, -plant.force_limit_n), plant.force_limit_n) - argument


@part
def start_argument(plant: Plant, s: PlantState, which: int, command: float) -> float:
    """Return v (which = 0) or F_ref (which = 1) at the present state."""
    argument = plant.start_hold[which] * command
    for i in range(plant.mechanical):
        argument += plant.start_rows[which, i] * s.state[i]
    return argument


@part
def choose_level(plant: Plant, s: PlantState, command: float) -> tuple[int, int]:
    """Return the level of inner steps for the next interval, and how many nonlinearities act in it.

    None acts while the table moves fast enough for constant friction, two where F_ref may exceed the force limit.

    The parabola through tanh(v / v_s) errs by about 0.03 exp(-2 r) (q / steps)^3, with r the smallest |v| / v_s
    and q the change of v / v_s in the interval; the steps keep this below 5e-6.
    """
    velocity = s.state[1] / plant.friction_velocity_m_s
    accel = plant.accel_friction[0] * friction_sign(s.state[1], plant)
    for i in range(plant.mechanical):
        accel += plant.accel_rows[0, i] * s.state[i]
    change = abs(accel) * plant.dt_s / plant.friction_velocity_m_s
    nearest = max(abs(velocity) - 1.5 * change, 0.0)
    steps = 18.0 * change * math.exp(-0.667 * nearest)
    level = 0
    while 2.0 * 2**level < steps:
        level += 1
    active = 0 if nearest > SATURATED else 1
    wanted = abs(start_argument(plant, s, 1, command))
    swing = 1.5 * abs(plant.start_rows[1, 0] * s.state[1] + plant.start_rows[1, 1] * accel) * plant.dt_s
    if wanted + swing > plant.force_limit_n:
        level, active = max(level, CLIPPED_LEVEL if wanted - swing > plant.force_limit_n else CROSSING_LEVEL), 2
    s.values[0, :] = math.copysign(1.0, velocity)
    s.values[1, :] = 0.0
    return min(level + plant.refine, plant.transition.shape[0] - 1), active


@part
def solve_nodes(plant: Plant, s: PlantState, level: int, active: int, command: float) -> None:
    """Solve the collocation equations for the acting nonlinearities at middle and end of an inner step."""
    values = s.values
    for which in range(active):
        argument = start_argument(plant, s, which, command)
        value = nonlinearity(which, argument, plant)
        for node in range(2):
            offset = plant.node_hold[level, node, which] * command
            for i in range(plant.mechanical):
                offset += plant.node_rows[level, node, which, i] * s.state[i]
            s.offsets[node, which] = offset
            values[which, node + 1] = value
        values[which, 0] = value
    for _ in range(20):
        change = 0.0
        for node in range(2):
            for which in range(active):
                argument = s.offsets[node, which]
                for source in range(active):
                    for j in range(3):
                        argument += plant.node_drive[level, node, which, source, j] * values[source, j]
                value = nonlinearity(which, argument, plant)
                change = max(change, abs(value - values[which, node + 1]))
                values[which, node + 1] = value
        if change < 1e-10:
            return


@part
def inner_step(plant: Plant, s: PlantState, level: int, active: int, command: float) -> None:
    """Advance mechanics and sensors by one inner step under a held command."""
    if active > 0:
        solve_nodes(plant, s, level, active, command)
    mechanical, channels = plant.mechanical, s.accel.size
    for i in range(s.state.size):
        value = plant.hold[level, i] * command
        for j in range(mechanical):
            value += plant.transition[level, i, j] * s.state[j]
        if i >= mechanical:
            value += plant.transition[level, i, i] * s.state[i]
        if i >= mechanical + channels:
            value += plant.transition[level, i, i - channels] * s.state[i - channels]
        for source in range(max(active, 1)):
            for j in range(3):
                value += plant.drive[level, i, source, j] * s.values[source, j]
        s.pushed[i] = value


@part
def sense_directly(plant: Plant, s: PlantState) -> None:
    """Put the accelerations into the places of the low passes, where the sensors have none."""
    friction = friction_sign(s.pushed[1], plant)
    for c in range(s.accel.size):
        value = plant.accel_friction[c] * friction
        for i in range(plant.mechanical):
            value += plant.accel_rows[c, i] * s.pushed[i]
        s.pushed[plant.mechanical + c] = value


@entry
def hold_interval(plant: Plant, s: PlantState, command_v: float) -> None:
    """Queue a command, hold the one that is due for a sample interval and note the velocities at its middle."""
    last = s.queue.size - 1
    for i in range(last):
        s.queue[i] = s.queue[i + 1]
    s.queue[last] = convert(command_v, plant.command_step_v, plant.command_range_v)
    held = s.queue[0]
    level, active = choose_level(plant, s, held)
    half = 2**level
    for step in range(2 * half):
        inner_step(plant, s, level, active, held)
        if not plant.has_low_pass:
            sense_directly(plant, s)
        for i in range(s.state.size):
            s.state[i] = s.pushed[i]
        if step == half - 1:
            note_velocity(s)
    if abs(s.state[0]) > plant.stroke_m:
        s.fault[0] = END_STOP


@part
def note_velocity(s: PlantState) -> None:
    """Keep the true absolute velocities of table and floors."""
    floors = s.middle_velocity.size - 1
    s.middle_velocity[0] = s.state[1]
    for floor in range(floors):
        s.middle_velocity[1 + floor] = s.state[1] + s.state[3 + floors + floor]


@entry
def read_samples(plant: Plant, s: PlantState, noise: Array, samples: Array) -> None:
    """Write the converted samples in V, (c,), for one row of standard normal noise (c,)."""
    for c in range(samples.size):
        place = plant.mechanical + c
        accel = s.state[place] - s.state[place + samples.size] + plant.noise_rms_m_s2 * noise[c]
        accel = min(max(accel, -plant.sensor_range_m_s2), plant.sensor_range_m_s2)
        samples[c] = convert(accel * plant.sensor_v_per_m_s2, plant.sensor_step_v, plant.sensor_range_v)
