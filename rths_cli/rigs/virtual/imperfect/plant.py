"""The imperfect table, compiled: equations of motion, what its channels sense, and the integration between the
command's edges.

The integration is that of Dormand and Prince (1980), of order five, with an embedded error estimate and the continuous
extension of order four. A window of the plant reaches from half an interval after one nominal instant to half an
interval after the next: command and samples of that instant may then come early and late. Without latency it reaches
from one instant to the next: samples cannot come late, nor the command early.

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

What a channel senses is a polynomial of degree four over an inner step, through its values at five equidistant
instants. A low pass of rate l behind which an AC coupling of rate h stands answers l / (l - h) (u_l - u_h), where
du = rate (sensed - u) for both: each of them is solved for the polynomial without a further approximation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.numerics.compiled import borrowed, kept_part, part, part_class, shared_part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.rigs.virtual.plant_kernel import END_STOP, REMEMBERED, convert, law_force
from rths_cli.structure.storey_laws import SOFTENING

X, V, F, Q, DQ, PITCH, DPITCH, BRISTLE, FLOORS = range(9)
"""Places in the state; the floors' drifts begin at FLOORS, their rates follow."""

ACCELERATION, DISPLACEMENT, COIL_DISPLACEMENT, FORCE, DRIFT = range(5)
"""What a channel senses: absolute acceleration of table (place 0) or floors (1, 2, ..., between two: interpolated);
absolute displacement of table or floors, or of the coil; force on all that stands on a load cell, at the table (0)
with a plate, or in a storey (1, 2, ...); drift of a storey (1, 2, ...)."""
NODES = 5
BY_NODES = np.linalg.inv(np.vander(np.linspace(0.0, 1.0, NODES), NODES, increasing=True))
"""Coefficients of the powers of the share of a step, from the values at its five instants."""
SERIES = 16
STAGES = 7
FRACTIONS = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
STAGE = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0],
        [44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
ERROR = np.array([-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40])
WITHIN = np.array(  # Shampine (1986): weights of the stages, by the powers 1 to 4 of the share of the step
    [
        [1.0, -8048581381 / 2820520608, 8663915743 / 2820520608, -12715105075 / 11282082432],
        [0.0, 0.0, 0.0, 0.0],
        [0.0, 131558114200 / 32700410799, -68118460800 / 10900136933, 87487479700 / 32700410799],
        [0.0, -1754552775 / 470086768, 14199869525 / 1410260304, -10690763975 / 1880347072],
        [0.0, 127303824393 / 49829197408, -318862633887 / 49829197408, 701980252875 / 199316789632],
        [0.0, -282668133 / 205662961, 2019193451 / 616988883, -1453857185 / 822651844],
        [0.0, 40617522 / 29380423, -110615467 / 29380423, 69997945 / 29380423],
    ]
)
SHORTEST = 1.0 / 4096.0  # of an interval
FARTHEST = 0.45  # of an interval, by which an instant may miss its clock
GROWTH, SHRINKAGE, MARGIN = 5.0, 0.2, 0.9


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


class ImperfectState(NamedTuple):
    """What the table changes: c channels, k numbers of its equations' state, l laws."""

    state: Array  # (1,) displacement of the deck at the last nominal instant
    y: Array  # (k,)
    stages: Array  # (STAGES + 1, k) rates, the last at an instant within a step
    end: Array  # (k,) state at the end of a step
    trial: Array  # (k,) state within it
    accel: Array  # (1 + n,)
    law_n: Array  # (n,) forces of the laws by storey
    law_begun_n: Array  # (n,) the same at the start of the step
    law_memory: Array  # (l, REMEMBERED)
    law_trial: Array  # (l, REMEMBERED)
    accels: Array  # (1 + n, NODES) accelerations over a step
    nodes: Array  # (c, NODES) what the channels sense over a step
    powers: Array  # (NODES,) coefficients of the polynomial through it
    fast: Array  # (c,) filters with the rate of the low pass
    slow: Array  # (c,) filters with the rate of the AC coupling
    due_s: Array  # (c,) next sampling instants, within the window
    taken: Array  # (c,) what the channels show at their last sampling instant, in their unit
    taken_s: Array  # (c,) that instant since the start of the run
    walk: Array  # (c,) random walk of their zeros, V
    jitter: Array  # (2,) standard normal numbers of command and samples
    queue: Array  # commands under way, the oldest first
    held: Array  # (1,) command that is held
    step_s: Array  # (1,) length of the next step
    windows: Integers  # (1,) that have passed
    middle_velocity: Array  # (1 + n,) true absolute velocities in the middle of the interval
    fault: Integers  # (1,) 0 or END_STOP


@part_class
class ImperfectPlant(NamedTuple):
    """Constants of the table, its channels and its converters.

    `lead_s` is how far a window reaches beyond its nominal instant. `tolerance` (k,) is the error of the state that a
    step may make, `tolerance_m_s2` that of an acceleration in its middle.
    """

    mechanics: Mechanics
    sensing: Sensing
    tolerance: Array
    tolerance_m_s2: float
    longest_s: float  # of a step
    dt_s: float
    lead_s: float
    stroke_m: float
    command_range_v: float
    command_step_v: float
    command_steps_per_v: float
    command_skew_s: float
    command_jitter_s: float
    sample_jitter_s: float
    sensor_range_v: float
    sensor_step_v: float
    sensor_steps_per_v: float

    def hold_command(self, s: ImperfectState, command_v: float) -> None:
        """Queue a command and advance the table by a window, in which the next due one takes over."""
        advance_window(self, s, command_v)

    def read_channels(self, s: ImperfectState, noise: Array, samples: Array) -> None:
        """Write the converted samples in V, (c,), for one row of standard normal noise, (normals,)."""
        read_window(self, s, noise, samples)


def normals(channels: int) -> int:
    """Return how many normal numbers a reading takes: noise and walk of each channel, jitter of both converters."""
    return 2 * channels + 2


def fresh_state(plant: ImperfectPlant, latency_samples: int) -> ImperfectState:
    """Return a table at rest."""
    m, c, k = plant.mechanics, plant.sensing.kind.size, plant.tolerance.size
    n, laws = m.masses_kg.size, m.law_code.size
    return ImperfectState(
        np.zeros(1), np.zeros(k), np.zeros((STAGES + 1, k)), np.zeros(k), np.zeros(k), np.zeros(1 + n),
        np.zeros(n), np.zeros(n), np.zeros((laws, REMEMBERED)), np.zeros((laws, REMEMBERED)), np.zeros((1 + n, NODES)),
        np.zeros((c, NODES)), np.zeros(NODES), np.zeros(c), np.zeros(c), np.zeros(c), np.zeros(c), np.zeros(c),
        np.zeros(c), np.zeros(2), np.zeros(max(latency_samples, 1)), np.zeros(1), np.full(1, plant.longest_s),
        np.zeros(1, dtype=np.int64), np.zeros(1 + n), np.zeros(1, dtype=np.int64),
    )  # fmt: skip


@part
def within(value: float, limit: float) -> float:
    """Return a value within +-limit."""
    return min(max(value, -limit), limit)


@kept_part
def advance_window(p: ImperfectPlant, s: ImperfectState, command_v: float) -> None:
    """Queue a command and advance the table by a window, in which the next due one takes over."""
    last = s.queue.size - 1
    for i in range(last):
        s.queue[i] = s.queue[i + 1]
    s.queue[last] = convert(command_v, p.command_step_v, p.command_steps_per_v, p.command_range_v)
    start_s = s.windows[0] * p.dt_s + p.lead_s
    if p.lead_s > 0.0:
        note_velocities(p, s, s.y)
    edge_s = p.command_skew_s + p.command_jitter_s * s.jitter[0]
    edge_s = within(edge_s, FARTHEST * p.dt_s) + (p.dt_s - p.lead_s if p.lead_s > 0.0 else 0.0)
    edge_s = max(edge_s, 0.0)
    clock_s = p.dt_s - p.lead_s
    for c in range(s.due_s.size):
        late_s = p.sensing.skew_s[c] + p.sample_jitter_s * s.jitter[1]
        s.due_s[c] = min(clock_s + within(late_s, FARTHEST * p.dt_s), p.dt_s)
    for after in range(2):
        if after > 0:
            s.held[0] = s.queue[0]
        begin_s, end_s = (edge_s, p.dt_s) if after > 0 else (0.0, edge_s)
        integrate(p, s, start_s, begin_s, end_s, s.held[0])
    s.windows[0] += 1
    if abs(s.y[X]) > p.stroke_m:
        s.fault[0] = END_STOP


@part
def note_velocities(p: ImperfectPlant, s: ImperfectState, y: Array) -> None:
    """Keep the true absolute velocities of deck and floors along the table."""
    m, velocity = p.mechanics, deck_velocity(p.mechanics, y)
    n = m.masses_kg.size
    s.middle_velocity[0] = velocity
    for i in range(n):
        s.middle_velocity[1 + i] = velocity + y[FLOORS + n + i] + m.heights_m[i] * y[DPITCH]


@part
def find_laws(p: ImperfectPlant, s: ImperfectState, y: Array, time_s: float) -> None:
    """Find the forces of the laws by storey, `time_s` after the start of the step."""
    m = p.mechanics
    n = m.masses_kg.size
    if time_s == 0.0:
        for i in range(n):
            s.law_n[i] = s.law_begun_n[i]
        return
    for i in range(n):
        s.law_n[i] = 0.0
    for law in range(m.law_code.size):
        storey = m.law_storey[law]
        drift, rate = storey_value(y, FLOORS, storey), storey_value(y, FLOORS + n, storey)
        for k in range(s.law_memory.shape[1]):
            s.law_trial[law, k] = s.law_memory[law, k]
        s.law_n[storey] += law_force(m.law_code[law], m.law_numbers[law], s.law_trial[law], drift, rate, time_s)


@part
def interpolate(s: ImperfectState, step_s: float, share: float) -> None:
    """Write the state within a step."""
    for k in range(s.y.size):
        s.trial[k] = s.y[k]
    for stage in range(STAGES):
        weight = WITHIN[stage, 3]
        for power in range(2, -1, -1):
            weight = WITHIN[stage, power] + share * weight
        weight *= share * step_s
        for k in range(s.y.size):
            s.trial[k] += weight * s.stages[stage, k]


@part
def combine(s: ImperfectState, stage: int, step_s: float) -> None:
    """Write the state at which a stage is evaluated."""
    for k in range(s.y.size):
        change = 0.0
        for j in range(stage):
            change += STAGE[stage, j] * s.stages[j, k]
        s.trial[k] = s.y[k] + step_s * change


@part
def embedded_error(p: ImperfectPlant, s: ImperfectState, step_s: float) -> float:
    """Return the largest difference to the method of order four over what is tolerated."""
    error = 0.0
    for k in range(s.y.size):
        missed = 0.0
        for stage in range(STAGES):
            missed += ERROR[stage] * s.stages[stage, k]
        error = max(error, abs(step_s * missed) / p.tolerance[k])
    return error


@part
def turning_error(p: ImperfectPlant, s: ImperfectState, step_s: float) -> float:
    """Return how far a drift goes and comes back within a step, over what is tolerated: laws follow its ends only."""
    m, error = p.mechanics, 0.0
    first = FLOORS + m.masses_kg.size
    for law in range(m.law_code.size):
        begin, end = storey_value(s.y, first, m.law_storey[law]), storey_value(s.end, first, m.law_storey[law])
        if begin * end < 0.0 and m.law_code[law] != SOFTENING:
            least = min(abs(begin), abs(end))
            error = max(error, 0.5 * step_s * least * least / abs(end - begin) / p.tolerance[FLOORS])
    return error


@part
def try_step(
    p: ImperfectPlant, s: ImperfectState, begun_s: float, step_s: float, command_v: float, first: int
) -> float:
    """Compute a step from stage `first` on, and what the channels sense in it; return its error over the tolerated."""
    error, shortest_s = 0.0, SHORTEST * p.dt_s
    for at in range(first, STAGES + NODES - 2):  # the stages, then three instants within
        node = -1
        if at < STAGES:
            combine(s, at, step_s)
            passed_s = step_s * FRACTIONS[at]
            if at == 0:
                node = 0
            if at == STAGES - 1:
                node = NODES - 1
        else:
            if at == STAGES:
                error = max(embedded_error(p, s, step_s), turning_error(p, s, step_s))
                if error > 1.0 and step_s > shortest_s:
                    return error
            node = at - STAGES + 1
            passed_s = step_s * node / (NODES - 1.0)
            interpolate(s, step_s, node / (NODES - 1.0))
        made = s.stages[min(at, STAGES)]
        find_laws(p, s, s.trial, passed_s)
        rates(p.mechanics, command_v, begun_s + passed_s, s.law_n, s.trial, made, s.accel)
        if at == STAGES - 1:
            for k in range(s.y.size):
                s.end[k] = s.trial[k]
        if node >= 0:
            for i in range(s.accel.size):
                s.accels[i, node] = s.accel[i]
            for c in range(s.fast.size):
                s.nodes[c, node] = sensed(p.sensing, p.mechanics, c, s.trial, made, s.accel)
    for i in range(s.accel.size):
        a = s.accels[i]
        bent = a[2] - (4.0 * (a[1] + a[3]) - a[0] - a[4]) / 6.0  # fourth difference
        error = max(error, abs(bent) / p.tolerance_m_s2)
    return error


@part
def finish_step(p: ImperfectPlant, s: ImperfectState, start_s: float, now_s: float, step_s: float) -> None:
    """Advance the channels over a step, keep what falls due in it, and make its end the start of the next one."""
    one, after_s = p.sensing, now_s + step_s
    for c in range(s.fast.size):
        for j in range(NODES):
            s.powers[j] = 0.0
            for node in range(NODES):
                s.powers[j] += BY_NODES[j, node] * s.nodes[c, node]
        low, high = one.low_pass[c], one.high_pass[c]
        if now_s < s.due_s[c] <= after_s:
            passed_s = s.due_s[c] - now_s
            share = passed_s / step_s
            fast = answered(low, passed_s, share, s.powers, s.fast[c]) if low > 0.0 else polynomial(s.powers, share)
            slow = answered(high, passed_s, share, s.powers, s.slow[c]) if high > 0.0 else 0.0
            s.taken[c] = conditioned(low, high, fast, slow)
            s.taken_s[c] = start_s + s.due_s[c]
        if low > 0.0:
            s.fast[c] = answered(low, step_s, 1.0, s.powers, s.fast[c])
        if high > 0.0:
            s.slow[c] = answered(high, step_s, 1.0, s.powers, s.slow[c])
        s.nodes[c, 0] = s.nodes[c, NODES - 1]
    clock_s, middle_s = p.dt_s - p.lead_s, 0.5 * p.dt_s - p.lead_s
    if now_s < clock_s <= after_s:
        interpolate(s, step_s, (clock_s - now_s) / step_s)
        s.state[0] = deck_position(p.mechanics, s.trial)
    if now_s < middle_s <= after_s:
        interpolate(s, step_s, (middle_s - now_s) / step_s)
        note_velocities(p, s, s.trial)
    find_laws(p, s, s.end, step_s)
    for law in range(s.law_memory.shape[0]):
        for k in range(s.law_memory.shape[1]):
            s.law_memory[law, k] = s.law_trial[law, k]
    for i in range(s.law_n.size):
        s.law_begun_n[i] = s.law_n[i]
    for k in range(s.y.size):
        s.y[k], s.stages[0, k] = s.end[k], s.stages[STAGES - 1, k]
    for i in range(s.accel.size):
        s.accels[i, 0] = s.accels[i, NODES - 1]


@part
def integrate(
    p: ImperfectPlant, s: ImperfectState, start_s: float, begin_s: float, end_s: float, command_v: float
) -> None:
    """Advance table and channels within a window that starts at `start_s` of the run, the command held."""
    now_s, shortest_s, first = begin_s, SHORTEST * p.dt_s, 0
    while now_s < end_s:
        whole_s = min(s.step_s[0], p.longest_s)
        step_s = whole_s if end_s - now_s > 1.01 * whole_s else end_s - now_s
        while True:
            error = try_step(p, s, start_s + now_s, step_s, command_v, first)
            first = 1  # the last stage of a step is the first of the next one
            if error <= 1.0 or step_s <= shortest_s:
                break
            whole_s = step_s = max(step_s * max(SHRINKAGE, MARGIN * error**-0.2), shortest_s)
        finish_step(p, s, start_s, now_s, step_s)
        growth = GROWTH if error < (MARGIN / GROWTH) ** 5 else MARGIN * error**-0.2
        s.step_s[0] = max(whole_s, min(step_s * growth, p.longest_s)) if growth >= 1.0 else step_s * growth
        now_s = end_s if end_s - now_s - step_s < 1e-9 * p.dt_s else now_s + step_s


@part
def read_window(p: ImperfectPlant, s: ImperfectState, noise: Array, samples: Array) -> None:
    """Write the converted samples in V, (c,), for one row of standard normal noise, (normals,)."""
    one, channels = p.sensing, samples.size
    s.jitter[0], s.jitter[1] = noise[2 * channels], noise[2 * channels + 1]
    for c in range(channels):
        value = one.gain[c] * s.taken[c] + one.noise[c] * noise[c]
        value = min(max(value, -one.range[c]), one.range[c])
        s.walk[c] += one.walk_v[c] * noise[channels + c]
        volts = value * one.v_per_unit[c] + one.offset_v[c] + s.walk[c]
        if one.hum_v[c] != 0.0:
            volts += one.hum_v[c] * math.sin(one.hum_rate * s.taken_s[c] + one.hum_phase[c])
        samples[c] = convert(volts, p.sensor_step_v, p.sensor_steps_per_v, p.sensor_range_v)
