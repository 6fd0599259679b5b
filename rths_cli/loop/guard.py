"""The guard, last block of every step: checks limits and sensors, and brakes to rest; nothing reaches a rig except
through it.

If a limit is violated, the guard takes over the command: it brakes the commanded motion with a bounded deceleration and
then returns it to zero without overshoot. Displacement and velocity are estimated from the command and the nominal
gain, the actuator force as the sum of mass times acceleration.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.findings.of_stop import TEXTS
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import kept_part, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import BRAKE_SHARE, RigInfo

RUNNING, BRAKING, RETURNING, STOPPED = 0, 1, 2, 3
NONE, STROKE, VELOCITY, ACCELERATION, FORCE, COMMAND, TRACKING, NOT_A_NUMBER, SATURATED, STUCK = range(10)
RATE, ENERGY, LOST, OVERRUN, RIG_FAULT, OPERATOR, INTERRUPT, TERMINATION, LOG_FAILED, WATCHER_FAILED, END = range(
    10, 21
)
MEASURED_STROKE, LEVEL, DISAGREES = range(21, 24)
PLANNED_REACH, DEVIATION = range(24, 26)
REASONS = ("", *TEXTS.values())
RETURN_RATE = 7.5  # rad/s, less if a limit is tight: the table is back at zero within 2 s
AT_REST_M = 1e-6  # less than half a bit of a 16-bit command
STUCK_S = 0.5  # a channel is stuck if it keeps its code for this time
STUCK_BITS = 10.0  # while it should have moved by this many bits
FORGET_HZ = 0.5  # an error of velocity below this frequency is attributed to sensor offsets
NO_CHANNEL = -1
UNWATCHED, WATCHED, STROKE_SENSOR, CELL = range(4)  # what the guard does with a further channel
REACTION_S = 20e-3  # time from a measured displacement until the table begins to brake
VELOCITY_S = 5e-3  # time constant of the velocity from a displacement sensor
COMPARED_S = 1.0  # memory of the comparison of a further channel with what it must show
COMPARED_HZ = 2.0  # corner up to which displacements are compared, where the table follows its command at once
SATURATED_SHARE = 0.999  # of a range, from which a sensor is saturated
TOLERATED = 0.005  # of a sensor's range, RMS difference from what it must show that is no fault
PLACE_TOLERATED = 0.02  # of the stroke limit, the same of a displacement sensor
DIFFERS = 0.5  # RMS difference over the RMS of what a channel must show, from which it disagrees
LOW_1, LOW_2, OWN_1, OWN_2, DIFFERENCE, SIZE, PLACE, SPEED = range(8)  # places in a row of GuardState.compared


class FurtherLimits(NamedTuple):
    """Constants of the guard for f further channels, each in its unit, beside c accelerometers."""

    duty: IntArray  # (f,) UNWATCHED, WATCHED, STROKE_SENSOR or CELL
    saturation_v: Array  # (f,)
    abort: Array  # (f,) value at which the channel stops the test
    tolerated: Array  # (f,) RMS difference from what it must show that is no fault
    reads: Array  # (f, c) what a load cell shows per m/s^2 of each accelerometer, in N


NOTHING_COMPARED = np.zeros((0, 8))
NO_FURTHER = FurtherLimits(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 0)))


class GuardLimits(NamedTuple):
    """Constants of the guard, the same for all actuators; c channels, each in its unit. An infinite limit is off."""

    stroke_m: float
    velocity_m_s: float
    acceleration_m_s2: float
    force_n: float
    command_v: float
    tracking_error: float  # in the unit of what is commanded, m/s^2 or m
    gain_m_per_v: float
    dt_s: float
    force_weights: Array  # (c,) actuator force in N per unit of each channel: moving mass and floor masses
    saturation_v: Array  # (c,)
    stuck: Array  # (c,) motion that a channel must have missed to be stuck
    abort: Array  # (c,) value at which each channel stops the test
    command_rate_v_s: float = math.inf
    energy_ratio: float = math.inf  # energy that the table's errors may add, over that exchanged at the interface
    energy_floor_j: float = 0.0  # added to the exchanged energy, because noise at rest exchanges almost none
    further: FurtherLimits = NO_FURTHER
    reach_m: float = math.inf  # displacement, with the room to brake, that the run at hand needs at most
    deviation_m: float = math.inf  # between displacement and desired displacement, in the run at hand


def without_zeros(limits: GuardLimits, zeros_v: Array) -> GuardLimits:
    """Return the limits for samples from which the zeros (c + f,) in V are subtracted.

    A sensor is clipped before its zero is subtracted, so that a clipped sample may be below its range by the zero.
    """
    own, beside = np.split(np.abs(zeros_v), [limits.saturation_v.size])
    further = limits.further._replace(saturation_v=limits.further.saturation_v - beside[: limits.further.duty.size])
    return limits._replace(saturation_v=limits.saturation_v - own, further=further)


def stopping_at_stuck(limits: GuardLimits) -> GuardLimits:
    """Return the limits by which every channel that keeps its code for 0.5 s is stuck, whatever it should show."""
    return limits._replace(stuck=np.full_like(limits.stuck, -1.0))


def without_limits(limits: GuardLimits) -> GuardLimits:
    """Return limits that stop a simulated test only where it is no number."""
    never = np.full(limits.stuck.shape, np.inf)
    return limits._replace(
        stroke_m=np.inf, velocity_m_s=np.inf, acceleration_m_s2=1e30, force_n=np.inf, command_v=np.inf,
        tracking_error=np.inf, saturation_v=never, stuck=never, abort=never, command_rate_v_s=np.inf,
        energy_ratio=np.inf, reach_m=np.inf, deviation_m=np.inf,
    )  # fmt: skip


class GuardState(NamedTuple):
    """State of the guard between steps."""

    flags: Array  # int (4,): phase, reason, channel that the reason concerns (or NO_CHANNEL), steps before it
    motion: Array  # (2 a,) commanded displacements in m of all actuators, then their velocities in m/s
    codes: Array  # (c,) last sample in V of each channel
    expected_at: Array  # (2, c) expected accelerations, as in Step.expected, when that sample last changed
    moved: Array  # (2, c) largest change of the expected accelerations since then
    same: Array  # int (c,) number of samples for which the channel has not changed
    slip: Array  # (2, i) error of the velocity in m/s at each degree of freedom, and its last tracking error
    energy: Array  # (2,) energy in J that these errors added, and exchanged energy
    seen: Array  # (1,) value that exceeded its limit, in the limit's unit; NaN if nothing was measured
    actuators: tuple[int, ...] = (0,)  # (a,) numbers of the commands; numba knows its length
    axes: tuple[int, ...] = (0,)  # (i,) numbers of the degrees of freedom, the same
    compared: Array = NOTHING_COMPARED  # (f, 8) comparison of each further channel with what it must show


def further_limits(rig: RigInfo, specimen_kg: Array) -> FurtherLimits:
    """Return the guard's constants for the channels beside the accelerometers; `specimen_kg` (c,): what stands on the
    table, the interface's part first, without the plate of a load cell.

    A channel of the base shear and one with `use: guard` is watched, others are not.
    """
    further, count = rig.further, len(rig.further)
    duty, tolerated, reads = np.zeros(count, np.int64), np.zeros(count), np.zeros((count, len(rig.channels)))
    for j, channel in enumerate(further):
        if "guard" not in channel.uses and "shear" not in channel.uses:
            continue
        duty[j], tolerated[j] = WATCHED, TOLERATED * channel.range
        if channel.kind == "displacement" and channel.position == "table":
            duty[j], tolerated[j] = STROKE_SENSOR, max(tolerated[j], PLACE_TOLERATED * rig.limits.stroke_m)
        elif channel.kind == "force" and channel.position == "table":
            duty[j], reads[j] = CELL, specimen_kg
            reads[j, 0] += channel.plate_mass_kg
    ranges = [SATURATED_SHARE * min(channel.range_v, rig.converters.range_v) for channel in further]
    aborts = [channel.abort for channel in further]
    return FurtherLimits(duty, np.array(ranges), np.array(aborts), tolerated, reads)


def fresh_guard(channels: int, actuators: int = 1, axes: int = 1, further: int = 0) -> GuardState:
    """Return the initial state of the guard; `axes`: degrees of freedom of the interface, `further`: channels beside
    the `channels` accelerometers."""
    return GuardState(
        np.zeros(4, dtype=np.int64), np.zeros(2 * actuators), np.full(channels, np.nan), np.zeros((2, channels)),
        np.zeros((2, channels)), np.zeros(channels, dtype=np.int64), np.zeros((2, axes)), np.zeros(2),
        np.full(1, np.nan), tuple(range(actuators)), tuple(range(axes)), np.zeros((further, 8)),
    )  # fmt: skip


@part
def beyond(g: GuardState, value: float, reason: int) -> int:
    """Store the value that exceeds its limit, and return the reason to stop."""
    g.seen[0] = value
    return reason


@part
def check_samples(lim: GuardLimits, g: GuardState, samples: Array, accel: Array, expected: Array) -> int:
    """Check the samples; return the reason to stop, or NONE. The channel concerned is stored.

    Whether all is well is found without a branch for each channel, which the processor would often guess wrongly.
    """
    force, well = 0.0, True
    for c in range(g.codes.size):
        note_code(g, c, samples[c], expected)
        well &= (abs(samples[c]) < lim.saturation_v[c]) & (not abs(accel[c]) > lim.abort[c]) & (not is_stuck(lim, g, c))
        force += lim.force_weights[c] * accel[c]
    reason = NONE if well else fault_of_samples(lim, g, samples, accel)
    if reason == NONE:
        reason = check_further(lim, g, samples, accel)
    if reason != NONE:
        return reason
    g.flags[2] = NO_CHANNEL
    return beyond(g, abs(force), FORCE) if abs(force) > lim.force_n else NONE


@part
def fault_of_samples(lim: GuardLimits, g: GuardState, samples: Array, accel: Array) -> int:
    """Return why the first faulty accelerometer stops the test, NONE without one; its channel is stored."""
    for c in range(g.codes.size):
        g.flags[2] = c
        if not math.isfinite(samples[c]):
            return NOT_A_NUMBER
        if abs(samples[c]) >= lim.saturation_v[c]:
            return beyond(g, abs(samples[c]), SATURATED)
        if abs(accel[c]) > lim.abort[c]:
            return beyond(g, abs(accel[c]), ACCELERATION)
        if is_stuck(lim, g, c):
            return beyond(g, must_have_moved(g, c), STUCK)
    return NONE


@part
def check_further(lim: GuardLimits, g: GuardState, samples: Array, values: Array) -> int:
    """Check the samples in V and the values of the further channels, behind those of the accelerometers; return the
    reason to stop, or NONE."""
    first, further = g.codes.size, lim.further
    for j in range(further.duty.size):
        if further.duty[j] == UNWATCHED:
            continue
        value = values[first + j]
        g.flags[2] = first + j
        if not math.isfinite(samples[first + j]):
            return NOT_A_NUMBER
        if abs(samples[first + j]) >= further.saturation_v[j]:
            return beyond(g, abs(samples[first + j]), SATURATED)
        if abs(value) > further.abort[j]:
            return beyond(g, abs(value), LEVEL)
        if further.duty[j] == STROKE_SENSOR:
            reached = measured_reach(lim, g.compared[j], value)
            if reached > lim.stroke_m:
                return beyond(g, reached, MEASURED_STROKE)
            if differs(g.compared[j], g.motion[0], value, COMPARED_HZ, lim.dt_s, further.tolerated[j]):
                return beyond(g, math.sqrt(g.compared[j, DIFFERENCE]), DISAGREES)
        elif further.duty[j] == CELL:
            shown = 0.0
            for c in range(first):
                shown += further.reads[j, c] * values[c]
            if differs(g.compared[j], shown, value, math.inf, lim.dt_s, further.tolerated[j]):
                return beyond(g, math.sqrt(g.compared[j, DIFFERENCE]), DISAGREES)
    return NONE


@part
def measured_reach(lim: GuardLimits, state: Array, place: float) -> float:
    """Return how far a table gets that is braked now, in m, from its measured displacement.

    Its velocity is the difference of the samples, at most the permitted one, behind a low pass: a sensor that jumps is
    no table that moves. Braking begins after REACTION_S.
    """
    changed = min(max((place - state[PLACE]) * (1.0 / lim.dt_s), -lim.velocity_m_s), lim.velocity_m_s)
    state[SPEED] += (changed - state[SPEED]) * lim.dt_s / (VELOCITY_S + lim.dt_s)
    state[PLACE] = place
    speed = state[SPEED]
    braked = place + speed * REACTION_S + braking_distance(lim, speed)
    return max(abs(place), abs(braked))


@part
def braking_distance(lim: GuardLimits, velocity: float) -> float:
    """Return the displacement in m, with its sign, that a velocity needs to be braked; what divides is a constant."""
    return velocity * abs(velocity) * (0.5 / (BRAKE_SHARE * lim.acceleration_m_s2))


@part
def differs(state: Array, must: float, shown: float, corner_hz: float, dt_s: float, tolerated: float) -> bool:
    """Return whether a channel has shown something else than it must for some time.

    D and E, the mean squares of the difference and of what it must show, forget within COMPARED_S; it differs where
    D > (DIFFERS^2) E + tolerated^2. Both pass the same two low passes, unless the corner is infinite.
    """
    keeps = 1.0 / (1.0 + 2.0 * math.pi * corner_hz * dt_s)
    state[LOW_1] = must + keeps * (state[LOW_1] - must)
    state[LOW_2] = state[LOW_1] + keeps * (state[LOW_2] - state[LOW_1])
    state[OWN_1] = shown + keeps * (state[OWN_1] - shown)
    state[OWN_2] = state[OWN_1] + keeps * (state[OWN_2] - state[OWN_1])
    share, off = dt_s / COMPARED_S, state[OWN_2] - state[LOW_2]
    state[DIFFERENCE] += share * (off * off - state[DIFFERENCE])
    state[SIZE] += share * (state[LOW_2] * state[LOW_2] - state[SIZE])
    return state[DIFFERENCE] > DIFFERS * DIFFERS * state[SIZE] + tolerated * tolerated


@part
def note_code(g: GuardState, c: int, sample: float, expected: Array) -> None:
    """Note for how long a channel has shown this sample, and how far it should have moved meanwhile.

    `expected` (2, c) are the accelerations expected from the desired and from the measured motion of the table.
    """
    changed = sample != g.codes[c]
    g.codes[c], g.same[c] = sample, 0 if changed else g.same[c] + 1
    for i in range(2):
        now, begun, moved = expected[i, c], g.expected_at[i, c], g.moved[i, c]
        begun, moved = now if changed else begun, 0.0 if changed else moved
        g.expected_at[i, c], g.moved[i, c] = begun, max(moved, abs(now - begun))


@part
def is_stuck(lim: GuardLimits, g: GuardState, c: int) -> bool:
    """Return whether a channel kept its code for 0.5 s while it should have moved by more than 10 of its bits.

    By the desired and by the measured motion of the table it should. In the quiet end of a record friction may hold a
    table that is commanded to move, and a drifting sensor of the table may show motion while everything rests.
    """
    return g.same[c] * lim.dt_s >= STUCK_S and must_have_moved(g, c) > lim.stuck[c]


@part
def must_have_moved(g: GuardState, c: int) -> float:
    """Return the motion, in its unit, that a channel should have shown since its code last changed."""
    return min(g.moved[0, c], g.moved[1, c])


@part
def farthest(lim: GuardLimits) -> float:
    """Return the largest displacement in m that stroke limit and command range permit."""
    return min(lim.stroke_m, lim.gain_m_per_v * lim.command_v)


@part
def check_command(lim: GuardLimits, g: GuardState, a: int, command: float, desired_m: float) -> int:
    """Check a command in V that is to make a desired displacement; return the reason to stop, or NONE.

    The displacement includes the room that is needed to brake.
    """
    if not math.isfinite(command):
        return NOT_A_NUMBER
    if abs(command) > lim.command_v:
        return beyond(g, abs(command), COMMAND)
    place = lim.gain_m_per_v * command
    velocity = (place - g.motion[a]) * (1.0 / lim.dt_s)
    if abs(velocity) > lim.velocity_m_s:
        return beyond(g, abs(velocity), VELOCITY)
    if abs(velocity) > lim.gain_m_per_v * lim.command_rate_v_s:
        return beyond(g, abs(velocity) / lim.gain_m_per_v, RATE)
    reached = max(abs(place), abs(place + braking_distance(lim, velocity)))
    if reached > farthest(lim):
        return beyond(g, reached, STROKE)
    if reached > lim.reach_m:
        return beyond(g, reached, PLANNED_REACH)
    if abs(place - desired_m) > lim.deviation_m:
        return beyond(g, abs(place - desired_m), DEVIATION)
    return NONE


@part
def check_errors(lim: GuardLimits, g: GuardState, error: Array) -> int:
    """Check the tracking errors (i,); return the reason to stop, or NONE."""
    for i in range(len(g.axes)):
        if not math.isfinite(error[i]):
            return NOT_A_NUMBER
        if abs(error[i]) > lim.tracking_error:
            return beyond(g, abs(error[i]), TRACKING)
    return NONE


@part
def note_slip(lim: GuardLimits, g: GuardState, i: int, error: float, of_accel: bool) -> None:
    """Advance the error of the velocity at a degree of freedom by a tracking error, `of_accel` or of displacement."""
    if of_accel:
        g.slip[0, i] += (error - 2.0 * math.pi * FORGET_HZ * g.slip[0, i]) * lim.dt_s
    else:
        g.slip[0, i] = (error - g.slip[1, i]) / lim.dt_s
        g.slip[1, i] = error


@part
def check_energy(lim: GuardLimits, g: GuardState, error: Array, motion: Array, force: Array, of_accel: bool) -> int:
    """Return ENERGY if the table's errors have added too much energy to the structure, else NONE.

    At each degree of freedom the numerical substructure receives the power f v, and the specimen delivers f v_table.
    The energy added by the interface is the integral of their sum of f (v - v_table), as in hybrid simulation error
    monitors (Mosqueda, Stojadinovic and Mahin 2007). A lagging table adds energy in every cycle, long before the motion
    grows.
    """
    if lim.energy_ratio == math.inf:
        return NONE
    for i in range(len(g.axes)):
        note_slip(lim, g, i, error[i], of_accel)
        g.energy[0] += force[i] * g.slip[0, i] * lim.dt_s
        g.energy[1] += abs(force[i] * motion[1, i]) * lim.dt_s
    exchanged = g.energy[1] + lim.energy_floor_j
    if g.energy[0] <= lim.energy_ratio * exchanged:
        return NONE
    return beyond(g, g.energy[0] / exchanged if exchanged > 0.0 else math.inf, ENERGY)


@part
def return_rate(lim: GuardLimits) -> float:
    """Return the rate r in rad/s of the critically damped return x0 (1 + r t) exp(-r t) within the limits.

    Its velocity stays below x0 r / e and its acceleration below x0 r^2.
    """
    fastest = min(lim.velocity_m_s, lim.gain_m_per_v * lim.command_rate_v_s)
    by_velocity = math.e * fastest / farthest(lim)
    by_acceleration = math.sqrt(BRAKE_SHARE * lim.acceleration_m_s2 / farthest(lim))
    return min(RETURN_RATE, by_velocity, by_acceleration)


@part
def ramp_down(lim: GuardLimits, g: GuardState) -> None:
    """Advance the commanded motions by one step on their way to rest: all actuators brake, then all return."""
    rate, phase, ready, count = return_rate(lim), g.flags[0], True, len(g.actuators)
    for a in range(count):
        place, velocity = g.motion[a], g.motion[count + a]
        if phase == BRAKING:
            less = BRAKE_SHARE * lim.acceleration_m_s2 * lim.dt_s
            velocity = math.copysign(max(abs(velocity) - less, 0.0), velocity)
            place += velocity * lim.dt_s
            ready = ready and velocity == 0.0
        elif phase == RETURNING:
            slope = (velocity + rate * place) * lim.dt_s
            decay = math.exp(-rate * lim.dt_s)
            place, velocity = (place + slope) * decay, (velocity - rate * slope) * decay
            if abs(place) < AT_REST_M and abs(velocity) < AT_REST_M * rate:
                place, velocity = 0.0, 0.0
            else:
                ready = False
        g.motion[a], g.motion[count + a] = place, velocity
    if ready and phase == BRAKING:
        g.flags[0] = RETURNING
    elif ready and phase == RETURNING:
        g.flags[0] = STOPPED


@part
def take_over(g: GuardState, reason: int, value: float) -> None:
    """Take over the command for a reason other than samples and command; the first reason is kept.

    `value` is the count that exceeded its limit, NaN if there is none.
    """
    if g.flags[0] == RUNNING:
        g.flags[0], g.flags[1], g.flags[2], g.seen[0] = BRAKING, reason, NO_CHANNEL, value


@kept_part
def guard(
    lim: GuardLimits,
    g: GuardState,
    command: Array,
    came: bool,
    samples: Array,
    accel: Array,
    expected: Array,
    error: Array,
    of_accel: bool,
    motion: Array,
    force: Array,
) -> None:
    """Leave the commands (a,) in V as they are, or write those that may be sent instead.

    `samples` in V and `accel`, both (c + f,), are the measured ones, accelerations in m/s^2 first, then the further
    channels in their units; unless samples `came` in this step they are not judged. `expected` (2, c) are the
    accelerations expected of the channels, as in Step. `error` (i,): tracking errors, `of_accel` in m/s^2 or of
    displacement in m; `motion` (3, i) and `force` (i,) of the interface, as in Step.
    """
    if g.flags[0] == RUNNING:
        reason = check_samples(lim, g, samples, accel, expected) if came else NONE
        for a in range(len(g.actuators)):
            if reason == NONE:
                desired_m = motion[2, a] if a < len(g.axes) else 0.0
                reason = check_command(lim, g, a, command[a], desired_m)
        if reason == NONE:
            reason = check_errors(lim, g, error)
        if reason == NONE:
            reason = check_energy(lim, g, error, motion, force, of_accel)
        if reason == NONE:
            for a in range(len(g.actuators)):
                place = lim.gain_m_per_v * command[a]
                g.motion[len(g.actuators) + a] = (place - g.motion[a]) * (1.0 / lim.dt_s)
                g.motion[a] = place
            g.flags[3] += 1
            return
        g.flags[0], g.flags[1] = BRAKING, reason
    ramp_down(lim, g)
    for a in range(len(g.actuators)):
        command[a] = g.motion[a] / lim.gain_m_per_v
