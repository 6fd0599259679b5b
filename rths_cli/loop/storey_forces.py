"""Computed storeys with laws, compiled: the linear storeys in modal coordinates, driven by the forces of their laws.

At each instant the laws follow the drift from sample to sample: work is bounded, nothing is solved by iteration but a
user's own law that depends on the rate, in at most ten rounds. Equations: docs/background/storey_laws.md. SIM computes
the same laws by itself (analysis/nonlinear_sim.py).
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
from rths_cli.numerics.power_curves import TERMS, on_curve, power_curve
from rths_cli.numerics.tiled_products import product, tiled
from rths_cli.numerics.user_functions import call_force
from rths_cli.structure.storey_laws import (
    BILINEAR,
    BOUC_WEN,
    CLOUGH,
    CUBIC,
    GAP,
    MAXWELL,
    NUMBERS,
    OWN,
    OWN_PARAMETERS,
    OWN_STATES,
    SOFTENING,
    VISCOUS,
    Laws,
)

REMEMBERED = 2 * OWN_STATES  # numbers of a law
ROUNDS = 10  # of secants for a user's own law whose force depends on the rate
MOST_PIECES = 8  # of a sample's drift, in each of which a hysteresis turns by at most half of its yield drift
CORNERS = 6  # of Clough's law that a drift of one sample may pass
SMALL = 1e-12  # share of the yield drift, below which abs(y)^n counts for nothing beside one
PER_LIMIT = NUMBERS - 1  # place of one over Bouc and Wen's yield drift, in 1/m
BACKBONE, UNLOADING, RELOADING = 1.0, 2.0, 3.0


@part
def hysteresis(numbers: Array, curve: Array, memory: Array, u: float) -> float:
    """Follow the drift to u with Bouc and Wen's law, in pieces, each a step of order four; return the force."""
    limit = numbers[1]
    way = (u - memory[2]) * numbers[PER_LIMIT]
    pieces = min(MOST_PIECES, 1 + int(2.0 * abs(way) * (1.0 + numbers[3])))
    h = way if pieces == 1 else way / pieces
    memory[2] = u
    if numbers[6] == 0.0 and numbers[7] == 0.0 and numbers[8] == 0.0 and numbers[9] == 0.0:  # e changes nothing
        side = math.copysign(1.0, way)
        y = side * memory[0]
        for _ in range(pieces):
            y = undegraded(numbers, curve, y, abs(h))
        memory[0] = side * y
        return numbers[0] * (memory[0] * limit - u)
    for _ in range(pieces):
        y1, e1 = bent(numbers, curve, memory[0], memory[1], h)
        y2, e2 = bent(numbers, curve, memory[0] + 0.5 * y1, memory[1] + 0.5 * e1, h)
        y3, e3 = bent(numbers, curve, memory[0] + 0.5 * y2, memory[1] + 0.5 * e2, h)
        y4, e4 = bent(numbers, curve, memory[0] + y3, memory[1] + e3, h)
        memory[0] += (y1 + 2.0 * y2 + 2.0 * y3 + y4) / 6.0
        memory[1] += (e1 + 2.0 * e2 + 2.0 * e3 + e4) / 6.0
    return numbers[0] * (memory[0] * limit - u)


@part
def undegraded(numbers: Array, curve: Array, y: float, way: float) -> float:
    """Return Bouc and Wen's variable after a piece of the way, of the yield drift, without degradation and pinching.

    y is positive where the drift goes. Taylor's series of order four takes one power: all derivatives follow from
    w = 1 - dy/dway, which is a power of y. Where they are large, near y = 0, a Runge-Kutta step takes four powers.
    """
    n, w = numbers[3], bends(numbers, curve, y)
    f = 1.0 - w
    if 3.0 * n * way * max(1.0, f) < abs(y):
        k = way / y
        first, more = n * w * f, (n - 1.0) * f - n * w  # dw/dway = first / y, d2w/dway2 = first more / y^2
        last = more * (more - f) - (2.0 * n - 1.0) * first
        return y + way * (f - first * k * (1.0 / 2.0 + k * (1.0 / 6.0 * more + 1.0 / 24.0 * k * last)))
    y1 = way * f
    y2 = way * (1.0 - bends(numbers, curve, y + 0.5 * y1))
    y3 = way * (1.0 - bends(numbers, curve, y + 0.5 * y2))
    y4 = way * (1.0 - bends(numbers, curve, y + y3))
    return y + (y1 + 2.0 * y2 + 2.0 * y3 + y4) * (1.0 / 6.0)


@part
def bends(numbers: Array, curve: Array, y: float) -> float:
    """Return what the slope of Bouc and Wen's variable lacks of one, without degradation and pinching."""
    n, size = numbers[3], abs(y)
    power = 1.0 if n == 1.0 else size if n == 2.0 else on_curve(curve, size)
    return (numbers[5] * size + numbers[4] * y) * power


@part
def bent(numbers: Array, curve: Array, y: float, e: float, way: float) -> tuple[float, float]:
    """Return the change of Bouc and Wen's variable and of the dissipated energy over a way, of the yield drift."""
    n, beta, gamma = numbers[3], numbers[4], numbers[5]
    nu = 1.0 + numbers[7] * e
    size = abs(y) if n == 1.0 else y * y if n == 2.0 else abs(y) * on_curve(curve, abs(y))
    turns = gamma + (beta if y * way > 0.0 else -beta)
    change = ((1.0 - numbers[6] * e) - nu * size * turns) * way / (1.0 + numbers[8] * e)
    if numbers[9] > 0.0:
        zeta = numbers[9] * (1.0 - math.exp(-numbers[10] * e))
        width = (numbers[12] + numbers[13] * e) * (numbers[14] + zeta)
        bound = nu * (beta + gamma)
        strength = 1.0 / bound if n == 1.0 else 1.0 / math.sqrt(bound) if n == 2.0 else bound ** (-1.0 / n)
        off = (math.copysign(1.0, way) * y - numbers[11] * strength) / width
        change *= 1.0 - zeta * math.exp(-off * off)
    return change, (1.0 - numbers[2]) * y * way


@part
def clough(numbers: Array, memory: Array, u: float) -> float:
    """Follow the drift to u with Clough's law; return the force.

    Memory: drift, force, branch, side; drift and force farthest to the positive, then to the negative side; foot and
    slope of the line of reloading; where unloading began, the branch before it, and the slope of unloading.
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
            softened = k * (limit / abs(memory[far])) ** numbers[3]
            memory[12] = max(softened, memory[far + 1] / memory[far])  # never past rest
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
        slope = memory[12]
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
    curve: Array,
    memory: Array,
    u: float,
    rate: float,
    gives: float,
    before: float,
) -> float:
    """Return the force of a law beyond the spring at rest, in N, at a drift in m.

    `rate` in m/s is that of the drift with the law's last force `before`; it falls by `gives` per N. `numbers` and
    `curve` as `of_the_step` makes them, `address` of a user's own law.
    """
    if code == BILINEAR:
        k, limit = numbers[0], numbers[1]
        memory[0] = min(max(memory[0], u - limit), u + limit)
        return -k * memory[0]
    if code == BOUC_WEN:
        return hysteresis(numbers, curve, memory, u)
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
        memory[0] = numbers[0] * memory[0] + numbers[1] * (u - memory[1])
        memory[1] = u
        return memory[0]
    return on_curve(curve, rate + gives * before)


def of_the_step(laws: Laws, gives: Array, dt_s: float) -> tuple[Array, Array]:
    """Return the laws' numbers (l, NUMBERS) and curves (l, pieces, 8) as `law_force` takes them: what is the same at
    each step is computed here, once. `gives` (l,) in m/s per N."""
    numbers, curves = laws.numbers.copy(), {}
    for i in np.flatnonzero(laws.code == MAXWELL):
        stiffness, dashpot = laws.numbers[i, :2]
        lost = -math.expm1(-dt_s * stiffness / dashpot)  # share of its force that a damper loses from step to step
        numbers[i, :2] = 1.0 - lost, lost * dashpot / dt_s
    for i in np.flatnonzero(laws.code == BOUC_WEN):
        limit, n = laws.numbers[i, 1], float(laws.numbers[i, 3])
        numbers[i, PER_LIMIT] = 1.0 / limit
        if n not in (1.0, 2.0):
            curves[i] = power_curve(1.0, n - 1.0, SMALL, 0.0)
    for i in np.flatnonzero(laws.code == VISCOUS):
        c, power, knee = map(float, laws.numbers[i, :3])
        curves[i] = power_curve(c, power, knee, float(gives[i]))
    together = np.zeros((len(numbers), max(map(len, curves.values()), default=0), TERMS + 1))
    for i, curve in curves.items():
        together[i, : len(curve)] = curve
    return numbers, together


@part_class
class StoreysAndForces(NamedTuple):
    """Linear storeys in m pairs of states, as modal_substructure.Modal, l laws in q storeys; one axis.

    States and inputs are columns of one matrix each, tiles as of tiled_products.tiled.
    """

    turn: Array  # (4, m)
    drive: Array  # (tiles, q + 2, 4) of ground acceleration, laws' forces, base shear into firsts, then seconds
    drifts: Array  # (tiles, 2 m + q + 2, 4) of states and these inputs to drifts (q,), then their rates (q,)
    interface: Array  # (1, 2 m + q + 2, 4) of them to the interface's motion (3,)
    direct: Array  # (1, 1) acceleration per force
    columns: Array  # (2 m + q + 2,) states and inputs
    pushed: Array  # (4 tiles,) what inputs add to the states
    made: Array  # (4 tiles,) drifts and rates
    motion: Array  # (4,) of the interface, without base shear
    which: Integers  # (l,) place of the law's storey in q
    code: Integers  # (l,)
    address: Integers  # (l,)
    numbers: Array  # (l, NUMBERS)
    curves: Array  # (l, pieces, 8) of dampers
    gives: Array  # (l,) fall of the drift's rate in m/s per N of the law
    memory: Array  # (l, REMEMBERED)
    forces: Array  # (l,) of each law at the last instant
    logged: Array  # (q,) of all laws of a storey, among the columns
    shear: Array  # (2,) base shear at the last instant, and before

    def free(self, ground: Array, accel: Array) -> None:
        """Write the acceleration (1,) without base shear, and follow the laws to this instant, as
        parts.NumericalSubstructure."""
        columns, made, logged, forces = self.columns, self.made, self.logged, self.forces
        q, last = logged.size, columns.size - 1
        columns[last - q - 1] = ground[0]
        columns[last] = 2.0 * self.shear[0] - self.shear[1]
        product(self.drifts, last + 1, columns, made)
        for j in range(q):
            logged[j] = 0.0
        for i in range(forces.size):
            at, code, address = self.which[i], self.code[i], self.address[i]
            numbers, curve, memory = self.numbers[i], self.curves[i], self.memory[i]
            u, rate, gives, before = made[at], made[q + at], self.gives[i], forces[i]
            forces[i] = law_force(code, address, numbers, curve, memory, u, rate, gives, before)
            logged[at] += forces[i]
        product(self.interface, last, self.columns, self.motion)
        accel[0] = self.motion[0]

    def advance(self, ground: Array, force: Array, motion: Array) -> None:
        """Write the interface's absolute motion (3, 1) and go on, as parts.NumericalSubstructure."""
        m, last = self.turn.shape[1], self.columns.size - 1
        for row in range(3):
            value = self.motion[row] + self.interface[0, last, row] * force[0]
            motion[row, 0] = value if row == 0 else value + ground[row]
        self.columns[last] = force[0]
        product(self.drive, last + 1 - 2 * m, self.columns[2 * m :], self.pushed)
        for i in range(m):
            first, second = self.columns[i], self.columns[m + i]
            self.columns[i] = self.turn[0, i] * first + self.turn[1, i] * second + self.pushed[i]
            self.columns[m + i] = self.turn[2, i] * first + self.turn[3, i] * second + self.pushed[m + i]
        self.shear[1] = self.shear[0]
        self.shear[0] = force[0]


def storeys_and_forces(design: StoreysWithLaws, interface: Interface, room: Room) -> StoreysAndForces:
    """Return computed storeys with laws at rest; raises InputError for an interface of several degrees of freedom, and
    as `modal`."""
    turn, drive, outputs = modal_arrays(design.block)
    laws, through, q = design.laws, design.block.D, len(design.storeys)
    states, order = 2 * turn.shape[1], [0, *range(2, 2 + q), 1]  # ground acceleration, laws' forces, base shear
    which = np.searchsorted(np.array(design.storeys), laws.storey)
    gives = -through[3 + q + which, 2 + which]
    numbers, curves = of_the_step(laws, gives, design.dt_s)
    whole = np.hstack([outputs.transpose(0, 2, 1).reshape(-1, states)[: 3 + 2 * q], through[:, order]])
    drifts, pushes = tiled(whole[3:]), tiled(drive.reshape(-1, states)[order].T)
    columns = room.take(states + q + 2)
    return StoreysAndForces(
        turn=turn,
        drive=pushes,
        drifts=drifts,
        interface=tiled(whole[:3]),
        direct=np.ascontiguousarray(through[:1, 1:2]),
        columns=columns,
        pushed=np.zeros(4 * len(pushes)),
        made=np.zeros(4 * len(drifts)),
        motion=np.zeros(4),
        which=which,
        code=laws.code,
        address=laws.address,
        numbers=numbers,
        curves=curves,
        gives=gives,
        memory=room.take(len(laws.code), REMEMBERED),
        forces=room.take(len(laws.code)),
        logged=columns[states + 1 : states + 1 + q],
        shear=room.take(2),
    )
