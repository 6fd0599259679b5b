"""Advance the virtual table in the loop, compiled: friction, clipping, laws, sensors, over one sample
interval."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.numerics.compiled import borrowed, entry, kept_part, part, part_class
from rths_cli.numerics.lti import Array, Integers
from rths_cli.numerics.tiled_products import ROWS, copied, product, product_of_squares, shifted
from rths_cli.rigs.virtual.friction_and_clipping import SATURATED, friction_sign
from rths_cli.rigs.virtual.further_outputs import FurtherOutputs
from rths_cli.rigs.virtual.specimen_laws import REMEMBERED, NoLaws, SpecimenLaws

END_STOP = 1
CLIPPED_LEVEL = 4
CROSSING_LEVEL = 9  # of an interval in which clipping may begin or end


@part_class
class Plant(NamedTuple):
    """Constant arrays of the kernel for n states and c = 1 + n_floors channels.

    Arrays with a leading axis of levels hold one entry per inner step: level L divides the sample interval
    into 2^L inner steps. The columns of the matrices are the mechanical states and the command; those of `push` go
    on, after zeros up to `forces`, with tanh(v / v_s) at start, middle and end of the inner step and a zero, then
    clip(F_ref) - F_ref at the same and a zero, then the force of each storey with laws likewise.
    """

    push: Array  # (levels, ...) tiles.squares: state at the end of an inner step, what the sensors keep of themselves
    #              left out, then the absolute velocities of table and floors in its middle
    filters: Array  # (levels, 3) what a low pass keeps of itself, an AC coupling of itself, and takes of its low pass
    nodes: Array  # (levels, 1, columns, 4) v / v_s at middle and end, F_ref at middle and end, nonlinearities left out
    feed: Array  # (levels, 2, 2, 2, 3) node, argument: what each nonlinearity at start, middle, end adds to it
    start: Array  # (2, columns, 4) table acceleration, F_ref, its rate, surge, nonlinearities left out; then nodes[0]
    accel_rows: Array  # (c, n) absolute accelerations from the state
    accel_friction: Array  # (c,) the same from tanh(v / v_s)
    steps_cubed: float  # cube of the inner steps per q^3 + bend q, q the change of v / v_s in an interval
    bend: float  # square of the interval times the rates of actuator and friction
    reference_per_velocity: float  # what F_ref changes by with v
    mechanical: int  # number of mechanical states
    forces: int  # first column of the nonlinearities
    has_low_pass: bool
    dt_s: float
    per_friction_velocity: float  # 1 / v_s
    force_limit_n: float
    stroke_m: float
    command_range_v: float
    command_step_v: float
    command_steps_per_v: float
    sensor_range_m_s2: float
    sensor_v_per_m_s2: float
    sensor_range_v: float
    sensor_step_v: float
    sensor_steps_per_v: float
    noise_rms_m_s2: float
    refine: int  # levels added to the one chosen (0; more to check the integration)
    laws: NoLaws | SpecimenLaws
    further: FurtherOutputs

    def hold_command(self, s: PlantState, command_v: float) -> None:
        """Queue a command and hold the one that is due for a sample interval."""
        hold(self, s, command_v)

    def read_channels(self, s: PlantState, noise: Array, samples: Array) -> None:
        """Write the converted samples in V, (c + f,), for one row of standard normal noise (c + f,)."""
        read(self, s, noise, samples)


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
    fault: Integers  # (1,) 0 or END_STOP
    law_memory: Array  # (3, l, REMEMBERED) of the laws at start, middle and end of an inner step
    law_free: Array  # (2, 2 + 2 q) SpecimenLaws.arguments at middle and end, nonlinearities left out
    further: Array  # (4 tiles,) what FurtherOutputs.states gives


def fresh_state(plant: Plant, latency_samples: int) -> PlantState:
    """Return a table at rest."""
    c, begin = plant.accel_rows.shape[0], np.zeros(8)
    laws = 0 if isinstance(plant.laws, NoLaws) else plant.laws.code.size
    state, made = np.zeros((plant.push.shape[2], ROWS)), np.zeros((plant.push.shape[1], ROWS))
    return PlantState(
        state.reshape(-1), state, np.zeros(c), np.zeros(c), made.reshape(-1), made,
        begin, begin[4:], np.zeros(latency_samples + 1), np.zeros(c), np.zeros(1, dtype=np.int64),
        np.zeros((3, laws, REMEMBERED)), np.zeros((2, 2 + 2 * plant.laws.storeys)),
        np.zeros(ROWS * len(plant.further.states)),
    )  # fmt: skip


@part
def convert(value: float, step: float, steps_per_unit: float, bound: float) -> float:
    """Return the value of a converter of that step (0: none) and range, in the same unit."""
    if step > 0.0:
        value = np.floor(value * steps_per_unit + 0.5) * step
    return min(max(value, -bound), bound - step)


@part
def less_than_exp(x: float) -> float:
    """Return (1 + x / 8)^8, at most e^x, for x >= 0: it mostly spares a call of exp."""
    root = 1.0 + 0.125 * x
    square = root * root
    return square * square * square * square


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
    friction_accel += plant.laws.accel_by_laws(s.state, plant.forces, 0)
    change = (abs(s.begin[0] + friction_accel) + abs(s.begin[3])) * plant.dt_s * plant.per_friction_velocity
    nearest = max(abs(velocity) - 1.5 * change, 0.0)
    level, active = 0, 0 if nearest > SATURATED else 1
    cubed = plant.steps_cubed * change * (change * change + plant.bend)
    if cubed > less_than_exp(2.0 * nearest):
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
def acceleration(plant: Plant, s: PlantState, c: int) -> float:
    """Return the true absolute acceleration of table (0) or floor at this instant."""
    value = plant.accel_friction[c] * s.state[plant.forces + 2] + plant.laws.accel_by_laws(s.state, plant.forces, c)
    for i in range(plant.mechanical):
        value += plant.accel_rows[c, i] * s.state[i]
    return value


@part
def sense_directly(plant: Plant, s: PlantState) -> None:
    """Put the accelerations into the places of the low passes, where the sensors have none."""
    for c in range(s.low.size):
        s.low[c] = acceleration(plant, s, c)


@kept_part
def hold(plant: Plant, s: PlantState, command_v: float) -> None:
    """Queue a command, hold the one that is due for a sample interval and note the velocities at its middle."""
    shifted(s.queue)
    step_v, range_v = plant.command_step_v, plant.command_range_v
    s.queue[s.queue.size - 1] = convert(command_v, step_v, plant.command_steps_per_v, range_v)
    n = plant.mechanical
    s.state[n] = s.queue[0]
    level, active = choose_level(plant, s)
    level = plant.laws.inner_level(level, plant.refine, plant.push.shape[0] - 1)
    wide = plant.laws.tiles_used(plant.forces // ROWS + (2 if active == 2 else 1), s.state_tiles.shape[0])
    half = (1 << level) >> 1
    for step in range(1 << level):
        if half > 0 and step == half:
            note_velocity(s, n)
        plant.laws.find_forces(plant, s, level, active)
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
    """Write the converted samples in V, (c + f,), for one row of standard normal noise (c + f,)."""
    for c in range(s.low.size):
        accel = s.low[c] - s.coupled[c] + plant.noise_rms_m_s2 * noise[c]
        accel = min(max(accel, -plant.sensor_range_m_s2), plant.sensor_range_m_s2)
        volts = accel * plant.sensor_v_per_m_s2
        samples[c] = convert(volts, plant.sensor_step_v, plant.sensor_steps_per_v, plant.sensor_range_v)
    if plant.further.range.size > 0:
        read_further(plant, s, noise, samples)


@kept_part
def read_further(plant: Plant, s: PlantState, noise: Array, samples: Array) -> None:
    """Write the converted samples in V of the further channels, behind the c others."""
    further, own = plant.further, s.low.size
    product(further.states, plant.mechanical, s.state, s.further)
    if plant.laws.storeys > 0:
        for c in range(own):
            accel = plant.laws.accel_by_laws(s.state, plant.forces, c)
            for f in range(further.range.size):
                s.further[f] += further.accelerations[f, c] * accel
    for f in range(further.range.size):
        value = s.further[f] + further.friction[f] * s.state[plant.forces + 2]
        value += further.noise_rms[f] * noise[own + f]
        volts = min(max(value, -further.range[f]), further.range[f]) * further.v_per_unit[f]
        samples[own + f] = convert(volts, plant.sensor_step_v, plant.sensor_steps_per_v, plant.sensor_range_v)


@entry
def hold_interval(plant: Plant, s: PlantState, command_v: Array) -> None:
    """Do what `hold` does with the command in an array (1,), called from Python."""
    plant, s, command_v = borrowed((plant, s, command_v))
    plant.hold_command(s, command_v[0])


@entry
def read_samples(plant: Plant, s: PlantState, noise: Array, samples: Array) -> None:
    """Do what `read` does, called from Python."""
    plant, s, noise, samples = borrowed((plant, s, noise, samples))
    plant.read_channels(s, noise, samples)
