"""Computed storeys with laws, compiled: the linear storeys in modal coordinates, driven by the forces of their laws.

At each instant the laws follow the drift from sample to sample: work is bounded, nothing is solved by iteration but the
power of a damper, in at most ten rounds. Equations: docs/background/storey_laws.md. SIM computes the same laws by
itself (analysis/nonlinear_sim.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.control.interface import Interface
from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.loop.modal_substructure import modal_arrays
from rths_cli.loop.parts import Room
from rths_cli.numerics.compiled import part, part_class
from rths_cli.numerics.lti import Array, Integers
from rths_cli.numerics.tiled_products import product
from rths_cli.numerics.user_functions import call_force
from rths_cli.structure.storey_laws import (
    BILINEAR,
    BOUC_WEN,
    CLOUGH,
    CUBIC,
    GAP,
    MAXWELL,
    OWN,
    OWN_PARAMETERS,
    OWN_STATES,
    SOFTENING,
)

REMEMBERED = 2 * OWN_STATES  # numbers of a law
ROUNDS = 10  # of Newton's method for a damper
NEAR = 0.1  # share of a damper's rate, less where it takes much of it, up to which series are taken: exact to 1e-7
ROOT = 1e-3  # the same at which Newton's method ends, where series are exact to 1e-12
FAR = 0.3  # the same up to which they lead nearer
MOST_PIECES = 8  # of a sample's drift, in each of which a hysteresis turns by at most half of its yield drift
CORNERS = 6  # of Clough's law that a drift of one sample may pass
BACKBONE, UNLOADING, RELOADING = 1.0, 2.0, 3.0


@part
def to_root(size: float, v: float, lost: float, power: float) -> float:
    """Return x, but for its fifth power, of the root v (1 + x) of w + lost (w / v)^power = size, by reversed series."""
    scale = 1.0 / (v + power * lost)
    first = (size - v - lost) * scale
    b = 0.5 * power * (power - 1.0) * lost * scale
    c = b * (power - 2.0) * (1.0 / 3.0)
    d = c * (power - 3.0) * 0.25
    return first * (1.0 - first * (b + first * (c - 2.0 * b * b + first * (d - 5.0 * b * c + 5.0 * b * b * b))))


@part
def power_near_one(x: float, power: float) -> float:
    """Return (1 + x)^power by its series up to the fifth power of x."""
    last = 1.0 + (power - 4.0) * (1.0 / 5.0) * x
    third = 1.0 + (power - 2.0) * (1.0 / 3.0) * x * (1.0 + (power - 3.0) * 0.25 * x * last)
    return 1.0 + power * x * (1.0 + (power - 1.0) * 0.5 * x * third)


@part
def begin_damper(numbers: Array, size: float, gives: float) -> tuple[float, float]:
    """Return a rate from which Newton's method does not overshoot, and the force there."""
    c, power, knee, slope = numbers[0], numbers[1], numbers[2], numbers[3]
    force = c * size**power
    r = gives * force / size
    if power < 1.0 and size * (1.0 + (power - 1.0) * r) < knee * (1.0 + power * r):
        return knee, slope * knee  # the tangent at the whole rate leads too far
    if power > 1.0 and r > 1.0:
        return size * r ** (-1.0 / power), size / gives  # still above the root
    return size, force


@part
def damper(numbers: Array, memory: Array, rate: float, gives: float) -> float:
    """Return the force of a damper at the rate `rate - gives * force`: `gives` in m/s per N, at least zero.

    The usual exponents 1/2 and 2 make a quadratic equation for the root of the rate, or for the rate. With others the
    force is a series about a rate whose force is known, because all derivatives of a power follow from its value; a
    power is taken only where the rate has left that one by a tenth. Far from it Newton's method leads near the root.
    Memory: that rate at the damper, zero if there is none, and its force; sizes.
    """
    c, power, knee, slope = numbers[0], numbers[1], numbers[2], numbers[3]
    size = abs(rate)
    if size <= knee * (1.0 + gives * slope):
        memory[0] = 0.0
        return slope * rate / (1.0 + gives * slope)
    if power == 0.5:
        half = 0.5 * gives * c
        return math.copysign(c * size / (half + math.sqrt(half * half + size)), rate)
    if power == 2.0:
        v = 2.0 * size / (1.0 + math.sqrt(1.0 + 4.0 * gives * c * size))
        return math.copysign(c * v * v, rate)
    v, force = memory[0], memory[1]
    x = to_root(size, v, gives * force, power) if v > 0.0 else math.inf
    if not abs(x) * (v + gives * force) <= NEAR * v:
        if abs(x) <= FAR:
            v += x * v
            force = c * v**power
        else:
            v, force = begin_damper(numbers, size, gives)
        for _ in range(ROUNDS):
            x = to_root(size, v, gives * force, power)
            if abs(x) <= ROOT:
                break
            v += (size - v - gives * force) / (1.0 + gives * power * force / v)
            force = c * v**power
        memory[0], memory[1] = v, force
    return math.copysign(force * power_near_one(x, power), rate)


@part
def hysteresis(numbers: Array, memory: Array, u: float) -> float:
    """Follow the drift to u with Bouc and Wen's law, one Runge-Kutta step per piece; return the force."""
    limit = numbers[1]
    way = (u - memory[2]) / limit
    pieces = min(MOST_PIECES, 1 + int(2.0 * abs(way) * (1.0 + numbers[3])))
    h = way / pieces
    memory[2] = u
    if numbers[6] == 0.0 and numbers[7] == 0.0 and numbers[8] == 0.0 and numbers[9] == 0.0:  # e changes nothing
        y, side, h = math.copysign(1.0, way) * memory[0], math.copysign(1.0, way), abs(h)
        for _ in range(pieces):
            y1 = h * undegraded(numbers, y)
            y2 = h * undegraded(numbers, y + 0.5 * y1)
            y3 = h * undegraded(numbers, y + 0.5 * y2)
            y += (y1 + 2.0 * y2 + 2.0 * y3 + h * undegraded(numbers, y + y3)) / 6.0
        memory[0] = side * y
        return numbers[0] * (memory[0] * limit - u)
    for _ in range(pieces):
        y1, e1 = bent(numbers, memory[0], memory[1], h)
        y2, e2 = bent(numbers, memory[0] + 0.5 * y1, memory[1] + 0.5 * e1, h)
        y3, e3 = bent(numbers, memory[0] + 0.5 * y2, memory[1] + 0.5 * e2, h)
        y4, e4 = bent(numbers, memory[0] + y3, memory[1] + e3, h)
        memory[0] += (y1 + 2.0 * y2 + 2.0 * y3 + y4) / 6.0
        memory[1] += (e1 + 2.0 * e2 + 2.0 * e3 + e4) / 6.0
    return numbers[0] * (memory[0] * limit - u)


@part
def undegraded(numbers: Array, y: float) -> float:
    """Return the slope of Bouc and Wen's variable, without degradation and pinching; y is positive where the drift
    goes."""
    n, size = numbers[3], abs(y)
    bends = numbers[5] * size + numbers[4] * y
    if n == 1.0:
        return 1.0 - bends
    return 1.0 - bends * (size if n == 2.0 else size ** (n - 1.0))


@part
def bent(numbers: Array, y: float, e: float, way: float) -> tuple[float, float]:
    """Return the change of Bouc and Wen's variable and of the dissipated energy over a way, of the yield drift."""
    n, beta, gamma = numbers[3], numbers[4], numbers[5]
    nu = 1.0 + numbers[7] * e
    size = abs(y) if n == 1.0 else y * y if n == 2.0 else abs(y) ** n
    turns = gamma + (beta if y * way > 0.0 else -beta)
    change = ((1.0 - numbers[6] * e) - nu * size * turns) * way / (1.0 + numbers[8] * e)
    if numbers[9] > 0.0:
        zeta = numbers[9] * (1.0 - math.exp(-numbers[10] * e))
        width = (numbers[12] + numbers[13] * e) * (numbers[14] + zeta)
        strength = (nu * (beta + gamma)) ** (-1.0 / n)
        off = (math.copysign(1.0, way) * y - numbers[11] * strength) / width
        change *= 1.0 - zeta * math.exp(-off * off)
    return change, (1.0 - numbers[2]) * y * way


@part
def clough(numbers: Array, memory: Array, u: float) -> float:
    """Follow the drift to u with Clough's law; return the force.

    Memory: drift, force, branch, side; drift and force farthest to the positive, then to the negative side; foot and
    slope of the line of reloading; where unloading began, and the branch before it.
    """
    k, limit, after = numbers[0], numbers[1], numbers[2]
    if memory[2] == 0.0:
        if abs(u) <= limit:
            memory[0], memory[1] = u, k * u
            return 0.0
        memory[2], memory[3] = BACKBONE, math.copysign(1.0, u)
        memory[4], memory[5], memory[6], memory[7] = limit, k * limit, -limit, -k * limit
    for _ in range(CORNERS):
        side = memory[3]
        if memory[2] != UNLOADING and (u - memory[0]) * side < 0.0:
            far = 4 if side > 0.0 else 6
            if memory[2] == BACKBONE:
                memory[far], memory[far + 1] = memory[0], memory[1]
            memory[10], memory[11], memory[2] = memory[0], memory[2], UNLOADING
        if memory[2] == BACKBONE:
            memory[0], memory[1] = u, side * k * limit + after * k * (u - side * limit)
            break
        if memory[2] == RELOADING:
            far = 4 if side > 0.0 else 6
            if (u - memory[far]) * side <= 0.0:
                memory[0], memory[1] = u, memory[9] * (u - memory[8])
                break
            memory[0], memory[1], memory[2] = memory[far], memory[far + 1], BACKBONE
            continue
        far = 4 if side > 0.0 else 6
        slope = max(k * (limit / abs(memory[far])) ** numbers[3], memory[far + 1] / memory[far])  # never past rest
        foot = memory[0] - memory[1] / slope
        if (u - memory[10]) * side > 0.0:  # beyond where unloading began
            memory[1] += slope * (memory[10] - memory[0])
            memory[0], memory[2] = memory[10], memory[11]
        elif (u - foot) * side >= 0.0:
            memory[1] += slope * (u - memory[0])
            memory[0] = u
            break
        else:
            other = 6 if side > 0.0 else 4
            reach = memory[other] - foot
            memory[8], memory[9] = foot, memory[other + 1] / reach if reach * side < 0.0 else k
            memory[0], memory[1], memory[2], memory[3] = foot, 0.0, RELOADING, -side
    return memory[1] - k * u


@part
def own_force(address: int, numbers: Array, memory: Array, u: float, rate: float, gives: float) -> float:
    """Follow the drift to u with a user's own law; return its force at the rate `rate - gives * force`.

    Memory: the law's state, then the next one. A force that depends on the rate is solved for by secants, whose slope
    is kept between those of no dashpot and of the law's greatest one.
    """
    steep = gives * numbers[OWN_PARAMETERS]
    force = call_force(address, numbers, memory, 0, OWN_STATES, u, rate)
    if steep > 0.0:
        left, change, slope = force, 0.0, 1.0 + steep
        force = 0.0
        for _ in range(ROUNDS):
            change = left / slope
            force += change
            if abs(change) <= 1e-12 * abs(force):
                break
            before, left = left, call_force(address, numbers, memory, 0, OWN_STATES, u, rate - gives * force) - force
            slope = min(max((before - left) / change, 1.0), 1.0 + steep)
    for i in range(OWN_STATES):
        memory[i] = memory[OWN_STATES + i]
    return force


@part
def law_force(
    code: int,
    address: int,
    numbers: Array,
    memory: Array,
    u: float,
    rate: float,
    gives: float,
    before: float,
    dt_s: float,
) -> float:
    """Return the force of a law beyond the spring at rest, in N, at a drift in m.

    `rate` in m/s is that of the drift with the law's last force `before`; it falls by `gives` per N. `address` of a
    user's own law.
    """
    if code == BILINEAR:
        k, limit = numbers[0], numbers[1]
        memory[0] = min(max(memory[0], u - limit), u + limit)
        return -k * memory[0]
    if code == BOUC_WEN:
        return hysteresis(numbers, memory, u)
    if code == CLOUGH:
        return clough(numbers, memory, u)
    if code == GAP:
        return numbers[0] * (u - min(max(u, -numbers[1]), numbers[1]))
    if code == CUBIC:
        return numbers[0] * u * u * u
    if code == SOFTENING:
        return -numbers[0] * u * abs(u) / (abs(u) + numbers[1])
    if code == OWN:
        return own_force(address, numbers, memory, u, rate + gives * before, gives)
    if code == MAXWELL:
        time_s = numbers[1] / numbers[0]
        kept = math.exp(-dt_s / time_s)
        memory[0] = kept * memory[0] + numbers[1] * (1.0 - kept) * (u - memory[1]) / dt_s
        memory[1] = u
        return memory[0]
    return damper(numbers, memory, rate + gives * before, gives)


@part_class
class StoreysAndForces(NamedTuple):
    """Linear storeys in m pairs of states, as modal_substructure.Modal, l laws in q storeys; one axis."""

    turn: Array  # (4, m)
    drive: Array  # (2 + q, 2, m) of ground acceleration, base shear, laws' forces
    outputs: Array  # (tiles, 2 m, 4)
    through: Array  # (3 + 2 q, 2 + q) outputs per input of the same instant
    direct: Array  # (1, 1) acceleration per force
    state: Array  # (2 m,)
    made: Array  # (4 tiles,)
    which: Integers  # (l,) place of the law's storey in q
    code: Integers  # (l,)
    address: Integers  # (l,)
    numbers: Array  # (l, NUMBERS)
    memory: Array  # (l, REMEMBERED)
    forces: Array  # (l,) of each law at the last instant
    logged: Array  # (q,) of all laws of a storey
    shear: Array  # (2,) base shear at the last instant, and before
    dt_s: float

    def free(self, ground: Array, accel: Array) -> None:
        """Write the acceleration (1,) without base shear, and follow the laws to this instant, as
        parts.NumericalSubstructure."""
        product(self.outputs, self.state.size, self.state, self.made)
        q = self.logged.size
        shear = 2.0 * self.shear[0] - self.shear[1]
        for i in range(self.code.size):
            at = self.which[i]
            u = self.made[3 + at] + self.through[3 + at, 0] * ground[0] + self.through[3 + at, 1] * shear
            rate = self.made[3 + q + at] + self.through[3 + q + at, 0] * ground[0]
            rate += self.through[3 + q + at, 1] * shear
            for j in range(q):
                u += self.through[3 + at, 2 + j] * self.logged[j]
                rate += self.through[3 + q + at, 2 + j] * self.logged[j]
            gives = -self.through[3 + q + at, 2 + at]
            before = self.forces[i]
            code, address, numbers, memory = self.code[i], self.address[i], self.numbers[i], self.memory[i]
            self.forces[i] = law_force(code, address, numbers, memory, u, rate, gives, before, self.dt_s)
        for j in range(q):
            self.logged[j] = 0.0
        for i in range(self.code.size):
            self.logged[self.which[i]] += self.forces[i]
        accel[0] = self.made[0] + self.through[0, 0] * ground[0]
        for j in range(q):
            accel[0] += self.through[0, 2 + j] * self.logged[j]

    def advance(self, ground: Array, force: Array, motion: Array) -> None:
        """Write the interface's absolute motion (3, 1) and go on, as parts.NumericalSubstructure."""
        m, q = self.turn.shape[1], self.logged.size
        for row in range(3):
            value = self.made[row] + self.through[row, 0] * ground[0] + self.through[row, 1] * force[0]
            for j in range(q):
                value += self.through[row, 2 + j] * self.logged[j]
            motion[row, 0] = value if row == 0 else value + ground[row]
        for i in range(m):
            first, second = self.state[i], self.state[m + i]
            inputs = self.drive[0, 0, i] * ground[0] + self.drive[1, 0, i] * force[0]
            for j in range(q):
                inputs += self.drive[2 + j, 0, i] * self.logged[j]
            self.state[i] = self.turn[0, i] * first + self.turn[1, i] * second + inputs
            inputs = self.drive[0, 1, i] * ground[0] + self.drive[1, 1, i] * force[0]
            for j in range(q):
                inputs += self.drive[2 + j, 1, i] * self.logged[j]
            self.state[m + i] = self.turn[2, i] * first + self.turn[3, i] * second + inputs
        self.shear[1] = self.shear[0]
        self.shear[0] = force[0]


def storeys_and_forces(design: StoreysWithLaws, interface: Interface, room: Room) -> StoreysAndForces:
    """Return computed storeys with laws at rest; raises InputError for an interface of several degrees of freedom, and
    as `modal`."""
    turn, drive, outputs = modal_arrays(design.block)
    laws, through = design.laws, np.ascontiguousarray(design.block.D)
    count = laws.code.size
    which = np.searchsorted(np.array(design.storeys), laws.storey)
    return StoreysAndForces(
        turn=turn,
        drive=drive,
        outputs=outputs,
        through=through,
        direct=np.ascontiguousarray(through[:1, 1:2]),
        state=room.take(2 * turn.shape[1]),
        made=np.zeros(4 * len(outputs)),
        which=which,
        code=laws.code,
        address=laws.address,
        numbers=laws.numbers,
        memory=room.take(count, REMEMBERED),
        forces=room.take(count),
        logged=room.take(len(design.storeys)),
        shear=room.take(2),
        dt_s=design.dt_s,
    )
