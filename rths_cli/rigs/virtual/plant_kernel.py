"""Advance the virtual table in the loop, compiled: friction, clipping, laws, sensors, over one sample
interval."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.numerics.compiled import borrowed, entry, kept_part, part, shared_part
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import ROWS, copied, product, product_of_squares, shifted
from rths_cli.rigs.virtual.plant import Plant
from rths_cli.rigs.virtual.specimen_laws import REMEMBERED, law_force

END_STOP = 1
SATURATED = 10.0  # tanh(10) is 1 within 5e-9
CLIPPED_LEVEL = 4
CROSSING_LEVEL = 9  # of an interval in which clipping may begin or end
SOLVED = 1e-9  # of tanh(v / v_s) at a node
ROUNDS = 40  # of the fixed point beside laws


class PlantState(NamedTuple):
    """What the kernel changes: c = 1 + n_floors channels, n mechanical states, latency + 1 commands under way."""

    state: Array  # mechanical states, command held, both nonlinearities at start, middle, end, as Plant.push's columns
    state_tiles: Array  # the same memory, (column tiles, 4)
    low: Array  # (c,) the channels' low passes
    coupled: Array  # (c,) what their AC couplings take away
    made: Array  # what Plant.push gives
    made_tiles: Array  # the same memory, (row tiles, 4)
    begin: Array  # (8,) what Plant.start gives, the offsets included
    offsets: Array  # (4,) v / v_s at middle and end, F_ref at middle and end, nonlinearities left out
    queue: Array  # (latency + 1,) commands under way, the oldest first
    middle_velocity: Array  # (c,) true absolute velocities in the middle of the interval
    fault: Array  # (1,) 0 or END_STOP
    law_memory: Array  # (3, l, REMEMBERED) of the laws at start, middle and end of an inner step
    law_free: Array  # (2, 2 + 2 q) SpecimenLaws.arguments at middle and end, nonlinearities left out


def fresh_state(plant: Plant, latency_samples: int) -> PlantState:
    """Return a table at rest."""
    c, begin = plant.accel_rows.shape[0], np.zeros(8)
    state, made = np.zeros((plant.push.shape[2], ROWS)), np.zeros((plant.push.shape[1], ROWS))
    return PlantState(
        state.reshape(-1), state, np.zeros(c), np.zeros(c), made.reshape(-1), made,
        begin, begin[4:], np.zeros(latency_samples + 1), np.zeros(c), np.zeros(1, dtype=np.int64),
        np.zeros((3, plant.laws.code.size, REMEMBERED)), np.zeros((2, 2 + 2 * plant.laws.accel.shape[1])),
    )  # fmt: skip


@part
def convert(value: float, step: float, steps_per_unit: float, bound: float) -> float:
    """Return the value of a converter of that step (0: none) and range, in the same unit."""
    if step > 0.0:
        value = np.floor(value * steps_per_unit + 0.5) * step
    return min(max(value, -bound), bound - step)


@part
def tanh(value: float) -> float:
    """Return tanh to rounding of 1; inf gives 1."""
    return 1.0 - 2.0 / (math.exp(2.0 * value) + 1.0)


@part
def tanh_after(begun: float, ratio: float, moved: float) -> float:
    """Return tanh(ratio + moved), `begun` being tanh(ratio): for small moves by the addition theorem, within 2e-12.

    Not where tanh is saturated: 1 or -1 has forgotten its ratio and would stay the same through a reversal.
    """
    if abs(moved) > 1.0 or abs(ratio) > SATURATED:
        return tanh(ratio + moved)
    square = moved * moved
    over = moved * (135135.0 + square * (17325.0 + square * (378.0 + square)))
    under = 135135.0 + square * (62370.0 + square * (3150.0 + square * 28.0))
    return (begun * under + over) / (under + begun * over)


@part
def follow(begun: float, moved: float) -> float:
    """Return a guess of tanh(ratio + moved), `begun` being tanh(ratio): the second-order series, within -1 and 1."""
    guess = begun + (1.0 - begun * begun) * moved * (1.0 - begun * moved)
    return min(max(guess, -1.0), 1.0)


@part
def friction_sign(velocity: float, plant: Plant) -> float:
    """Return tanh(v / v_s), 1 or -1 where it is saturated."""
    ratio = velocity * plant.per_friction_velocity
    return math.copysign(1.0, ratio) if abs(ratio) > SATURATED else tanh(ratio)


@part
def clipped(reference: float, plant: Plant) -> float:
    """Return clip(F_ref) - F_ref."""
    return min(max(reference, -plant.force_limit_n), plant.force_limit_n) - reference


@part
def choose_level(plant: Plant, s: PlantState) -> tuple[int, int]:
    """Return the level of inner steps for the next interval, and how many nonlinearities act in it.

    None acts while the table moves fast enough for constant friction, two where F_ref may exceed the force limit.

    A parabola through tanh(v / v_s) at start, middle and end errs by 0.008 times its third derivative times the third
    power of the step. Beside exp(-2 r), r the smallest |v| / v_s, that is about q^3 + bend q, q being the change of
    v / v_s in the interval and bend what actuator and friction add to the bending of v.
    """
    n = plant.mechanical
    product(plant.start, n + 1, s.state, s.begin)
    velocity = s.state[1] * plant.per_friction_velocity
    friction_accel = plant.accel_friction[0] * s.state[plant.forces + 2]
    for q in range(plant.laws.accel.shape[1]):
        friction_accel += plant.laws.accel[0, q] * s.state[plant.forces + ROWS * (2 + q) + 2]
    change = (abs(s.begin[0] + friction_accel) + abs(s.begin[3])) * plant.dt_s * plant.per_friction_velocity
    nearest = max(abs(velocity) - 1.5 * change, 0.0)
    level, active = 0, 0 if nearest > SATURATED else 1
    cubed = plant.steps_cubed * change * (change * change + plant.bend)
    if cubed > 1.0:
        cubed *= math.exp(-2.0 * nearest)
        while cubed > 1.0:
            level += 1
            cubed *= 0.125
    wanted = abs(s.begin[1])
    swing = 1.5 * abs(s.begin[2] + plant.reference_per_velocity * friction_accel) * plant.dt_s
    if wanted + swing > plant.force_limit_n:
        level, active = max(level, CLIPPED_LEVEL if wanted - swing > plant.force_limit_n else CROSSING_LEVEL), 2
    return min(level + plant.refine, plant.push.shape[0] - 1), active


@part
def argument(plant: Plant, s: PlantState, level: int, node: int, which: int) -> float:
    """Return v / v_s (which = 0) or F_ref (1) at middle (node = 0) or end (1) of an inner step, as solved so far."""
    value = s.offsets[2 * which + node]
    for j in range(3):
        value += plant.feed[level, node, which, 0, j] * s.state[plant.forces + j]
        value += plant.feed[level, node, which, 1, j] * s.state[plant.forces + ROWS + j]
    return value


@part
def solve_friction(plant: Plant, s: PlantState, level: int) -> None:
    """Solve the collocation equations for tanh(v / v_s) at middle and end of an inner step (Newton's method).

    The first guess follows tanh to second order in the change of v / v_s; one step is then mostly enough: it leaves
    the square of the guess's error in v / v_s.
    """
    first, feed = plant.forces, plant.feed[level]
    begun, ratio = s.state[first + 2], s.state[1] * plant.per_friction_velocity
    s.state[first] = begun
    middle_free = s.offsets[0] + feed[0, 0, 0, 0] * begun - ratio
    end_free = s.offsets[1] + feed[1, 0, 0, 0] * begun - ratio
    middle = follow(begun, middle_free + (feed[0, 0, 0, 1] + feed[0, 0, 0, 2]) * begun)
    end = follow(begun, end_free + (feed[1, 0, 0, 1] + feed[1, 0, 0, 2]) * begun)
    for _ in range(20):
        middle_is = tanh_after(begun, ratio, middle_free + feed[0, 0, 0, 1] * middle + feed[0, 0, 0, 2] * end)
        end_is = tanh_after(begun, ratio, end_free + feed[1, 0, 0, 1] * middle + feed[1, 0, 0, 2] * end)
        middle_slope, end_slope = 1.0 - middle_is * middle_is, 1.0 - end_is * end_is
        a, b = 1.0 - middle_slope * feed[0, 0, 0, 1], -middle_slope * feed[0, 0, 0, 2]
        c, d = -end_slope * feed[1, 0, 0, 1], 1.0 - end_slope * feed[1, 0, 0, 2]
        scale = 1.0 / (a * d - b * c)
        by_middle = scale * (d * (middle_is - middle) - b * (end_is - end))
        by_end = scale * (a * (end_is - end) - c * (middle_is - middle))
        middle, end = middle + by_middle, end + by_end
        moved = abs(feed[0, 0, 0, 1] * by_middle + feed[0, 0, 0, 2] * by_end)
        moved = max(moved, abs(feed[1, 0, 0, 1] * by_middle + feed[1, 0, 0, 2] * by_end))
        if moved * moved < SOLVED:
            break
    s.state[first + 1], s.state[first + 2] = middle, end


@part
def solve_both(plant: Plant, s: PlantState, level: int) -> None:
    """Solve the collocation equations for friction and clipping at middle and end of an inner step (fixed point)."""
    n, first = plant.mechanical, plant.forces
    product(plant.start[:1], n + 1, s.state, s.begin)
    s.state[first] = s.state[first + 1] = s.state[first + 2]
    s.state[first + ROWS] = s.state[first + ROWS + 1] = s.state[first + ROWS + 2] = clipped(s.begin[1], plant)
    for _ in range(20):
        change = 0.0
        for node in range(2):
            friction = tanh(argument(plant, s, level, node, 0))
            clip = clipped(argument(plant, s, level, node, 1), plant)
            one, other = first + 1 + node, first + ROWS + 1 + node
            change = max(change, abs(friction - s.state[one]), abs(clip - s.state[other]))
            s.state[one], s.state[other] = friction, clip
        if change < 1e-10:
            return


@part
def solve(plant: Plant, s: PlantState, level: int, active: int) -> None:
    """Find the acting nonlinearities at start, middle and end of an inner step."""
    n, first = plant.mechanical, plant.forces
    if active == 0:
        sign = math.copysign(1.0, s.state[1])
        s.state[first], s.state[first + 1], s.state[first + 2] = sign, sign, sign
        return
    if level > 0:
        product(plant.nodes[level], n + 1, s.state, s.offsets)
    if active == 1:
        s.state[first] = s.state[first + 2]
        solve_friction(plant, s, level)
    else:
        solve_both(plant, s, level)


@shared_part
def solve_with_laws(plant: Plant, s: PlantState, level: int, clips: bool) -> None:
    """Find friction, clipping and the laws' forces at start, middle and end of an inner step (fixed point)."""
    plant, s = borrowed((plant, s))
    n, first, laws = plant.mechanical, plant.forces, plant.laws
    arguments, storeys, state, memory = laws.arguments[level], laws.accel.shape[1], s.state, s.law_memory
    half_s = 0.5 * plant.dt_s / (1 << level)
    reference = plant.start[0, n, 1] * state[n]
    for i in range(n):
        reference += plant.start[0, i, 1] * state[i]
    state[first + ROWS + 2] = clipped(reference, plant) if clips else 0.0
    for place in range(first, state.size, ROWS):
        state[place] = state[place + 1] = state[place + 2]
    for node in range(2):
        for which in range(s.law_free.shape[1]):
            value = 0.0
            for i in range(n + 1):
                value += arguments[node, which, i] * state[i]
            s.law_free[node, which] = value
    for _ in range(ROUNDS):
        solved = True
        for node in range(2):
            friction = tanh(value_of(plant, s, level, node, 0))
            clip = clipped(value_of(plant, s, level, node, 1), plant) if clips else 0.0
            solved &= abs(friction - state[first + 1 + node]) < 1e-10
            solved &= abs(clip - state[first + ROWS + 1 + node]) < 1e-10
            for i in range(laws.code.size):
                for m in range(memory.shape[2]):
                    memory[node + 1, i, m] = memory[node, i, m]
            for q in range(storeys):
                u, v = value_of(plant, s, level, node, 2 + q), value_of(plant, s, level, node, 2 + storeys + q)
                force = 0.0
                for i in range(laws.code.size):
                    if laws.which[i] == q:
                        force += law_force(laws.code[i], laws.numbers[i], memory[node + 1, i], u, v, half_s)
                place = first + ROWS * (2 + q) + 1 + node
                solved &= abs(force - state[place]) <= laws.solved_n + 1e-12 * abs(force)
                state[place] = force
            state[first + 1 + node], state[first + ROWS + 1 + node] = friction, clip
        if solved:
            break
    for i in range(laws.code.size):
        for m in range(memory.shape[2]):
            memory[0, i, m] = memory[2, i, m]


@part
def value_of(plant: Plant, s: PlantState, level: int, node: int, which: int) -> float:
    """Return an argument of the nonlinearities at middle (node = 0) or end (1) of an inner step, as solved so far."""
    value = s.law_free[node, which]
    for i in range(plant.forces, s.state.size):
        value += plant.laws.arguments[level, node, which, i] * s.state[i]
    return value


@part
def take(plant: Plant, s: PlantState, level: int, wide: int) -> None:
    """Advance mechanics and sensors by an inner step whose nonlinearities are found."""
    n, channels = plant.mechanical, s.low.size
    product_of_squares(plant.push[level], wide, s.state_tiles, s.made_tiles)
    copied(n, s.made, s.state)
    keeps, couples, takes = plant.filters[level, 0], plant.filters[level, 1], plant.filters[level, 2]
    for c in range(channels):
        s.coupled[c] = s.made[n + channels + c] + couples * s.coupled[c] + takes * s.low[c]
        s.low[c] = s.made[n + c] + keeps * s.low[c]
    if not plant.has_low_pass:
        sense_directly(plant, s)


@part
def sense_directly(plant: Plant, s: PlantState) -> None:
    """Put the accelerations into the places of the low passes, where the sensors have none."""
    friction = s.state[plant.forces + 2]
    for c in range(s.low.size):
        value = plant.accel_friction[c] * friction
        for q in range(plant.laws.accel.shape[1]):
            value += plant.laws.accel[c, q] * s.state[plant.forces + ROWS * (2 + q) + 2]
        for i in range(plant.mechanical):
            value += plant.accel_rows[c, i] * s.state[i]
        s.low[c] = value


@kept_part
def hold(plant: Plant, s: PlantState, command_v: float) -> None:
    """Queue a command, hold the one that is due for a sample interval and note the velocities at its middle."""
    shifted(s.queue)
    step_v, range_v = plant.command_step_v, plant.command_range_v
    s.queue[s.queue.size - 1] = convert(command_v, step_v, plant.command_steps_per_v, range_v)
    n = plant.mechanical
    s.state[n] = s.queue[0]
    level, active = choose_level(plant, s)
    wide, has_laws = plant.forces // ROWS + (2 if active == 2 else 1), plant.laws.code.size > 0
    if has_laws:
        level = max(level, min(plant.laws.level + plant.refine, plant.push.shape[0] - 1))
        wide = s.state_tiles.shape[0]
    half = (1 << level) >> 1
    for step in range(1 << level):
        if half > 0 and step == half:
            note_velocity(s, n)
        if has_laws:
            solve_with_laws(plant, s, level, active == 2)
        else:
            solve(plant, s, level, active)
        take(plant, s, level, wide)
    if half == 0:
        for c in range(s.middle_velocity.size):
            s.middle_velocity[c] = s.made[n + 2 * s.low.size + c]
    s.state[plant.forces + 2] = friction_sign(s.state[1], plant)
    if abs(s.state[0]) > plant.stroke_m:
        s.fault[0] = END_STOP


@part
def note_velocity(s: PlantState, mechanical: int) -> None:
    """Keep the true absolute velocities of table and floors."""
    floors = s.middle_velocity.size - 1
    s.middle_velocity[0] = s.state[1]
    for floor in range(floors):
        s.middle_velocity[1 + floor] = s.state[1] + s.state[mechanical - floors + floor]


@part
def read(plant: Plant, s: PlantState, noise: Array, samples: Array) -> None:
    """Write the converted samples in V, (c,), for one row of standard normal noise (c,)."""
    for c in range(samples.size):
        accel = s.low[c] - s.coupled[c] + plant.noise_rms_m_s2 * noise[c]
        accel = min(max(accel, -plant.sensor_range_m_s2), plant.sensor_range_m_s2)
        volts = accel * plant.sensor_v_per_m_s2
        samples[c] = convert(volts, plant.sensor_step_v, plant.sensor_steps_per_v, plant.sensor_range_v)


@entry
def hold_interval(plant: Plant, s: PlantState, command_v: Array) -> None:
    """Do what `hold` does with the command in an array (1,), called from Python."""
    plant, s, command_v = borrowed((plant, s, command_v))
    hold(plant, s, command_v[0])


@entry
def read_samples(plant: Plant, s: PlantState, noise: Array, samples: Array) -> None:
    """Do what `read` does, called from Python."""
    plant, s, noise, samples = borrowed((plant, s, noise, samples))
    read(plant, s, noise, samples)
