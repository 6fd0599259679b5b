"""Computed storeys with laws, compiled: the linear storeys in modal coordinates, driven by the forces of their
laws.

At each instant the laws follow the drift from sample to sample: work is bounded, nothing is solved by iteration but a
user's own law that depends on the rate, in at most ten rounds. Equations: docs/background/storey_laws.md. SIM computes
the same laws by itself (analysis/nonlinear_sim.py).

A discrete block x+ = A x + B u is transformed into uncoupled pairs of states, each for a complex pair of eigenvalues or
for two real ones. The transformation is exact to rounding; `modal` checks this before it returns.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.control.interface import Interface
from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.errors import InputError
from rths_cli.loop.parts import Room
from rths_cli.numerics.compiled import borrowed, fused_part, part, part_class, shared_part
from rths_cli.numerics.lti import Array, Block, Integers
from rths_cli.numerics.power_curves import TERMS, on_curve, power_curve
from rths_cli.numerics.tabulated_functions import (
    COLUMNS,
    FROM,
    FUNCTIONS,
    SCALE,
    TO,
    bell,
    piece_of,
    read_four,
    table_of,
)
from rths_cli.numerics.tiled_products import padded, product, tiled
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

EXACT = 1e-7  # tolerated error of the change of coordinates, relative to the largest entry

REMEMBERED = 32  # numbers of a law: at least 2 OWN_STATES
ROUNDS = 10  # of secants for a user's own law whose force depends on the rate
MOST_PIECES = 8  # of a sample's drift, in each of which a hysteresis turns by at most half of its yield drift
CORNERS = 6  # of Clough's law that a drift of one sample may pass
SMALL = 1e-12  # share of the yield drift, below which abs(y)^n counts for nothing beside one
NOTHING = 1e-7  # what a power may come to, times the fourth power of its relative change, to leave no error
SHORT = 0.05  # of a width of pinching that y may go in one step; of 1 + rate e that e may change `rate` times
MOST_ENERGY = 1e3  # dissipated, over k u_y^2, up to which degradation is tabulated; equations are evaluated beyond
PINCHES, REACH = COLUMNS, COLUMNS + 1  # places in the first row of a table of degradation: zeta_s, and `begins`
SIDE, SLOPE, BEND, NARROW, MOST, WAY, AHEAD, E_AHEAD, POWER, OFF, BESIDE = range(
    3, 14
)  # of the memory of a law that degrades
STRENGTH, PINCHING = 16, 24  # the same: what its table says, values and slopes of four functions each
PER_LIMIT = NUMBERS - 1  # place of one over Bouc and Wen's yield drift, in 1/m
BACKBONE, UNLOADING, RELOADING = 1.0, 2.0, 3.0
DEPENDING_ON_RATES = (VISCOUS, OWN)


@part_class
class Modal(NamedTuple):
    """A block of m pairs of states; inputs are ground acceleration and i forces, outputs an interface motion (3 i,)."""

    turn: Array  # (4, m) of each pair: first from first, first from second, second from first, second from second
    drive: Array  # (1 + i, 2, m) of each input: into the firsts, into the seconds
    outputs: Array  # (tiles, 2 m, 4), tiled_products.tiled
    through: Array  # (3 i, 1 + i) outputs per input of the same instant
    direct: Array  # (i, i) its accelerations per force
    state: Array  # (2 m,) all firsts, then all seconds
    made: Array  # (4 tiles,) outputs without the direct part of the inputs
    logged: Array  # nothing
    axes: tuple[int, ...]  # (i,) degrees of freedom of the interface

    def free(self, ground: Array, accel: Array) -> None:
        """Write the accelerations (i,) without interface force, as parts.NumericalSubstructure."""
        product(self.outputs, self.state.size, self.state, self.made)
        for i in range(len(self.axes)):
            accel[i] = self.made[i] + self.through[i, 0] * ground[0]

    def advance(self, ground: Array, force: Array, motion: Array) -> None:
        """Write the interface's absolute motion (3, i) and go on, as parts.NumericalSubstructure."""
        m, axes = self.turn.shape[1], len(self.axes)
        for q in range(3):
            for i in range(axes):
                value = self.made[q * axes + i] + self.through[q * axes + i, 0] * ground[0]
                for j in range(axes):
                    value += self.through[q * axes + i, 1 + j] * force[j]
                motion[q, i] = value if q == 0 else value + ground[q]
        for i in range(m):
            first, second = self.state[i], self.state[m + i]
            inputs = self.drive[0, 0, i] * ground[0] + self.drive[1, 0, i] * force[0]
            self.state[i] = self.turn[0, i] * first + self.turn[1, i] * second + inputs
            inputs = self.drive[0, 1, i] * ground[0] + self.drive[1, 1, i] * force[0]
            self.state[m + i] = self.turn[2, i] * first + self.turn[3, i] * second + inputs
        for j in range(1, axes):
            for i in range(m):
                self.state[i] += self.drive[1 + j, 0, i] * force[j]
                self.state[m + i] += self.drive[1 + j, 1, i] * force[j]


def modal(block: Block, interface: Interface, room: Room) -> Modal:
    """Return a block at rest in modal coordinates: ground acceleration and i forces to the interface's motion relative
    to the ground (3 i,), accelerations absolute.

    Raises InputError if the change of coordinates would lose accuracy (modes that coincide).
    """
    turn, drives, arranged = modal_arrays(block)
    forces, through = len(interface.channels), np.ascontiguousarray(block.D)
    direct = np.ascontiguousarray(through[:forces, 1:])
    state, made = room.take(2 * turn.shape[1]), np.zeros(4 * len(arranged))
    return Modal(turn, drives, arranged, through, direct, state, made, np.zeros(0), interface.channels)


def modal_arrays(block: Block) -> tuple[Array, Array, Array]:
    """Return `turn` (4, m), `drive` (inputs, 2, m) and `outputs` (tiles, 2 m, 4) of a block, as in `Modal`.

    Raises InputError if the change of coordinates would lose accuracy (modes that coincide).
    """
    basis = real_basis(block.A)
    try:
        turned, drive = (np.asarray(np.linalg.solve(basis, right)) for right in (block.A @ basis, block.B))
        back = np.linalg.multi_dot([basis, pairs_only(turned), np.linalg.inv(basis)])
        lost = float(np.abs(back - block.A).max(initial=0.0))
    except np.linalg.LinAlgError:
        lost = np.inf
    if not lost <= EXACT * np.abs(block.A).max(initial=1.0):
        raise InputError(
            f"{block.name}: modes of the computed storeys coincide, the step would lose {lost:.1e} of them; change a"
            " storey's stiffness or damping by a thousandth"
        )
    m, outputs = len(block.A) // 2, block.C @ basis
    first, second = slice(0, 2 * m, 2), slice(1, 2 * m, 2)
    turn = np.array([np.diag(turned[i, j]) for i in (first, second) for j in (first, second)])
    drives = np.ascontiguousarray(np.stack([drive[first].T, drive[second].T], axis=1))
    return turn, drives, tiled(np.hstack([outputs[:, first], outputs[:, second]]))


def real_basis(a: Array) -> Array:
    """Return a real basis (n, n) of A, n even, whose columns 2 i and 2 i + 1 span a pair of A's modes.

    Two neighbouring real eigenvalues form a pair; their columns are orthogonalised, so that they may be close.
    """
    values, vectors = np.linalg.eig(a)
    upper = np.flatnonzero(values.imag > 0.0)
    columns = [part for i in upper for part in (vectors[:, i].real, vectors[:, i].imag)]
    real = np.flatnonzero(values.imag == 0.0)
    real = real[np.argsort(values.real[real])]
    for one, two in zip(real[::2], real[1::2], strict=True):
        pair = np.linalg.svd(np.column_stack([vectors[:, one].real, vectors[:, two].real]), full_matrices=False)[0]
        columns += list(pair.T)
    return np.column_stack(columns) if columns else np.zeros((0, 0))


def pairs_only(turned: Array) -> Array:
    """Return the 2 x 2 blocks on the diagonal of a matrix (n, n), zeros elsewhere."""
    keep = np.kron(np.eye(len(turned) // 2), np.ones((2, 2)))
    return np.asarray(turned * keep, dtype=float)


@part
def hysteresis(numbers: Array, curve: Array, table: Array, memory: Array, u: float) -> float:
    """Follow the drift to u with Bouc and Wen's law, in pieces, each a step of order four; return the force.

    Memory: y, e, the drift; of a law that degrades also what `begins` states.
    """
    if table[0, SCALE] > 0.0:
        begins(numbers, curve, table, memory, u)
        looks_up(numbers, curve, table, memory)
        return ends(numbers, table, memory)
    way = (u - memory[2]) * numbers[PER_LIMIT]
    pieces = min(MOST_PIECES, 1 + int(2.0 * abs(way) * (1.0 + numbers[3])))
    h = abs(way) if pieces == 1 else abs(way) / pieces
    memory[2] = u
    side = math.copysign(1.0, way)
    y = side * memory[0]
    for _ in range(pieces):
        y = undegraded(numbers, curve, y, h)
    memory[0] = side * y
    return numbers[0] * (memory[0] * numbers[1] - u)


@part
def undegraded(numbers: Array, curve: Array, y: float, way: float) -> float:
    """Return Bouc and Wen's variable after a piece of the way, of the yield drift, without degradation and pinching.

    y is positive where the drift goes. Taylor's series of order four takes one power: all derivatives follow from
    w = 1 - dy/dway, which is a power of y. Where they are large, near y = 0, a Runge-Kutta step takes four powers.
    """
    n, size = numbers[3], abs(y)
    power = size * (1.0 if n == 1.0 else size if n == 2.0 else on_curve(curve, size))
    w = (numbers[5] + math.copysign(numbers[4], y)) * power
    f = 1.0 - w
    if expands(n * way * max(1.0, f), size, (abs(numbers[5]) + numbers[4]) * power):
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
def expands(far: float, size: float, most: float) -> bool:
    """Return whether a power c abs(y)^n, at most `most` at abs(y) = `size`, has a short series where y goes far / n.

    With m = far / size, its fifth term is below most exp(m) m^4 / 120 of the way. The series is short for m < 1/3, as
    it ever was; and for m < 4 where this is below 5e-8: with a large n far below yielding, where the power is nothing.
    """
    ratio, fourth = far * far, size * size
    return 3.0 * far < size or (far < 4.0 * size and most * ratio * ratio < NOTHING * fourth * fourth)


@fused_part
def begins(numbers: Array, curve: Array, table: Array, memory: Array, u: float) -> None:
    """Follow the drift to u with a law that degrades: predict y and e there, where no kink is on the way.

    With f = dy/ds, s the way over the yield drift, and y positive where the drift goes, a Hermite step of order four is
    y_1 = y_0 + h/2 (f_0 + f_1) + h^2/12 (df/ds_0 - df/ds_1). It is solved by one step of Newton's method (`ends`) from
    the prediction y_0 + h f_0 + h^2/2 df/ds_0, so that the equations are evaluated once, where Runge and Kutta's step
    takes four evaluations. Its error is h^5/720 times the fourth derivative of f. That of a bell is at most 12 over the
    fourth power of its width; with h below SHORT widths the error is below 1e-7 h. At kinks, where the way is longer
    than that, and beyond the table the step is Runge and Kutta's.
    Memory: side for which f holds, f and df/ds at this point; one over the width of pinching; what `expands` takes; h
    (negative where nothing is left to do), y and e predicted, and what is looked up there.
    """
    way = (u - memory[2]) * numbers[PER_LIMIT]
    h, side, e, c = abs(way), math.copysign(1.0, way), memory[1], 1.0 - numbers[2]
    y, f, bend = side * memory[0], memory[SLOPE], memory[BEND]
    memory[2] = u
    far = h * max(1.0, f)
    ahead = y + h * (f + 0.5 * h * bend)
    e_ahead = e + c * h * (y + h * (0.5 * f + (1.0 / 6.0) * h * bend))
    short = (far * memory[NARROW] < SHORT) & (2.0 * h * (1.0 + numbers[3]) < 1.0)
    inside = (table[0, FROM] <= e_ahead) & (e_ahead <= table[0, TO])
    slow = table[0, SCALE] * abs(e_ahead - e) < SHORT * (1.0 + table[0, SCALE] * e)
    smooth = table[0, REACH] * far < abs(y) or expands(numbers[3] * far, abs(y), memory[MOST])
    if memory[SIDE] == side and short and inside and slow and smooth:
        memory[WAY], memory[AHEAD], memory[E_AHEAD] = h, ahead, e_ahead
    else:
        memory[WAY] = -1.0
        with_kinks(numbers, curve, table, memory, way)


@fused_part
def looks_up(numbers: Array, curve: Array, table: Array, memory: Array) -> None:
    """Look up the power of the predicted y, what the predicted e makes of the law, and the bell of pinching."""
    y, e = memory[AHEAD], memory[E_AHEAD]
    n, size = numbers[3], abs(y)
    memory[POWER] = 1.0 if n == 1.0 else size if n == 2.0 else on_curve(curve, size)
    piece = piece_of(table, e)
    read_four(table, piece, e, 0, memory, STRENGTH)
    if table[0, PINCHES] > 0.0:
        read_four(table, piece, e, 4, memory, PINCHING)
        memory[OFF] = y * memory[PINCHING + 1] - memory[PINCHING + 2]
        memory[BESIDE] = bell(memory[OFF])


@fused_part
def ends(numbers: Array, table: Array, memory: Array) -> float:
    """Correct the prediction and return the force; a parabola from start to end has a quarter of its end's change."""
    h = memory[WAY]
    if h >= 0.0:
        f, bend = memory[SLOPE], memory[BEND]
        f_ahead, bend_ahead, f_y = slope_of(numbers, table, memory)
        x = 0.5 * h * f_y
        lacks = h * (0.5 * (f_ahead - f) - (1.0 / 12.0) * h * (5.0 * bend + bend_ahead)) * (1.0 + x * (1.0 + x))
        memory[0] = memory[SIDE] * (memory[AHEAD] + lacks)
        memory[1] = memory[E_AHEAD] + 0.25 * h * (1.0 - numbers[2]) * lacks
        memory[SLOPE] = f_ahead + f_y * lacks
        memory[BEND] = bend_ahead
    return numbers[0] * (memory[0] * numbers[1] - memory[2])


@shared_part
def with_kinks(numbers: Array, curve: Array, table: Array, memory: Array, whole: float) -> None:
    """Go a whole way, over the yield drift, with a law that degrades, by Runge and Kutta's method."""
    numbers, curve, table, memory = borrowed((numbers, curve, table, memory))
    pieces = min(MOST_PIECES, 1 + int(2.0 * abs(whole) * (1.0 + numbers[3])))
    way = whole / pieces
    for _ in range(pieces):
        y, e = memory[0], memory[1]
        y1, e1 = bent(numbers, curve, y, e, way)
        y2, e2 = bent(numbers, curve, y + 0.5 * y1, e + 0.5 * e1, way)
        y3, e3 = bent(numbers, curve, y + 0.5 * y2, e + 0.5 * e2, way)
        y4, e4 = bent(numbers, curve, y + y3, e + e3, way)
        memory[0] = y + (y1 + 2.0 * y2 + 2.0 * y3 + y4) / 6.0
        memory[1] = e + (e1 + 2.0 * e2 + 2.0 * e3 + e4) / 6.0
    memory[SIDE] = 0.0
    if table[0, FROM] <= memory[1] and memory[1] <= table[0, TO]:
        side = math.copysign(1.0, way)
        memory[AHEAD], memory[E_AHEAD] = side * memory[0], memory[1]
        looks_up(numbers, curve, table, memory)
        memory[SLOPE], memory[BEND], _ = slope_of(numbers, table, memory)
        memory[SIDE] = side


@fused_part
def slope_of(numbers: Array, table: Array, memory: Array) -> tuple[float, float, float]:
    """Return f = dy/ds, df/ds and the derivative of f over y at the prediction, from what was looked up: A / eta and
    nu / eta; zeta1, 1 / zeta2 and q y_u / zeta2; each with its slope."""
    y, n, power = memory[AHEAD], numbers[3], memory[POWER]
    size = abs(y)
    turns = (numbers[5] + math.copysign(numbers[4], y)) * power
    w, per_eta = turns * size, memory[STRENGTH + 1]
    memory[MOST] = per_eta * (abs(numbers[5]) + numbers[4]) * power * size
    f = memory[STRENGTH] - per_eta * w
    f_e = memory[STRENGTH + 4] - memory[STRENGTH + 5] * w
    f_y = -(per_eta * n) * math.copysign(turns, turns * y)
    if numbers[9] > 0.0:
        narrow, beside = memory[PINCHING + 1], memory[BESIDE]
        lost = memory[PINCHING] * beside
        steep = 2.0 * memory[OFF] * lost
        lost_e = memory[PINCHING + 4] * beside - steep * (y * memory[PINCHING + 5] - memory[PINCHING + 6])
        f_y = f_y * (1.0 - lost) + f * (steep * narrow)
        f_e = f_e * (1.0 - lost) - f * lost_e
        f = f * (1.0 - lost)
        memory[NARROW] = abs(narrow)
    return f, f_y * f + f_e * (table[0, SCALE] * (1.0 - numbers[2]) * y), f_y


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
        if zeta != 0.0:  # with lambda = 0 there is no width either
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
    table: Array,
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
        return hysteresis(numbers, curve, table, memory, u)
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


def of_the_step(laws: Laws, gives: Array, dt_s: float) -> tuple[Array, Array, Array]:
    """Return the laws' numbers (l, NUMBERS), curves (l, pieces, 8) and tables (l, pieces, columns) as `law_force` takes
    them: what is the same at each step is computed here, once. `gives` (l,) in m/s per N."""
    numbers = laws.numbers.copy()
    curves: dict[int, Array] = {}
    tables: dict[int, Array] = {}
    for i in np.flatnonzero(laws.code == MAXWELL).tolist():
        stiffness, dashpot = laws.numbers[i, :2]
        lost = -math.expm1(-dt_s * stiffness / dashpot)  # share of its force that a damper loses from step to step
        numbers[i, :2] = 1.0 - lost, lost * dashpot / dt_s
    for i in np.flatnonzero(laws.code == BOUC_WEN).tolist():
        limit, n = laws.numbers[i, 1], float(laws.numbers[i, 3])
        numbers[i, PER_LIMIT] = 1.0 / limit
        if n not in (1.0, 2.0):
            curves[i] = power_curve(1.0, n - 1.0, SMALL, 0.0)
        if laws.numbers[i, 6:10].any():
            tables[i] = degradation(laws.numbers[i])
    for i in np.flatnonzero(laws.code == VISCOUS).tolist():
        c, power, knee = map(float, laws.numbers[i, :3])
        curves[i] = power_curve(c, power, knee, float(gives[i]))
    return numbers, _together(len(numbers), curves, TERMS + 1), _together(len(numbers), tables, TERMS * COLUMNS)


def _together(count: int, of_laws: dict[int, Array], columns: int) -> Array:
    """Return arrays of some of the laws as one, zero where a law has none."""
    together = np.zeros((count, max(map(len, of_laws.values()), default=1), columns))
    for i, one in of_laws.items():
        together[i, : len(one)] = one
    return together


def degradation(numbers: Array) -> Array:
    """Return the table over e of what `slope_of` looks up, for Bouc and Wen's law of these numbers.

    Pieces grow with 1 + rate e, where `rate` is that of the fastest change: each function is a rational one or a power
    of 1 + delta e, or exp(-p e), or one over lambda + zeta1, whose change at rest is p zeta_s / lambda.
    """
    n, strength = numbers[3], numbers[4] + numbers[5]
    delta_a, delta_nu, delta_eta, zeta_s, p, q, psi, delta_psi, lambda_ = numbers[6:15]

    def of_energy(e: Array) -> Array:
        found = np.zeros((FUNCTIONS, len(e)))
        nu, eta = 1.0 + delta_nu * e, 1.0 + delta_eta * e
        found[0], found[1] = (1.0 - delta_a * e) / eta, nu / eta
        if zeta_s > 0.0:
            zeta = -zeta_s * np.expm1(-p * e)
            found[4], found[5] = zeta, 1.0 / ((psi + delta_psi * e) * (lambda_ + zeta))
            found[6] = q * (nu * strength) ** (-1.0 / n) * found[5]
        return found

    rates = [1e-6, delta_a, delta_nu, delta_eta]
    if zeta_s > 0.0:
        rates += [p * (1.0 + zeta_s / max(lambda_, 1e-3)), delta_psi / psi]
    table = table_of(of_energy, max(rates), MOST_ENERGY)
    table[0, PINCHES], table[0, REACH] = zeta_s, 1.5 if n in (1.0, 2.0) else 3.0 * n
    return table


@part_class
class StoreysAndForces(NamedTuple):
    """Linear storeys in m pairs of states, as modal_substructure.Modal, l laws in q storeys; one axis.

    States and inputs are columns of one matrix each, tiles as of tiled_products.tiled.
    """

    turn: Array  # (4, m)
    drive: Array  # (tiles, q + 2, 4) of ground acceleration, laws' forces, base shear into firsts, then seconds
    drifts: (
        Array  # (tiles, 2 m + q + 2, 4) of states and these inputs to drifts (q,), then rates (q,) if a law needs any
    )
    interface: Array  # (1, 2 m + q + 2, 4) of them to the interface's motion (3,)
    direct: Array  # (1, 1) acceleration per force
    columns: Array  # (2 m + q + 2,) states and inputs
    pushed: Array  # (4 tiles,) what inputs add to the states
    made: Array  # (>= 2 q,) drifts and rates, 0 where no law needs them
    motion: Array  # (4,) of the interface, without base shear
    which: Integers  # (l,) place of the law's storey in q
    code: Integers  # (l,)
    address: Integers  # (l,)
    numbers: Array  # (l, NUMBERS)
    curves: Array  # (l, pieces, 8) of dampers
    tables: Array  # (l, pieces, columns) of degradation, zero where a law has none
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
        waiting = False
        for i in range(forces.size):
            at, code, address = self.which[i], self.code[i], self.address[i]
            numbers, curve, table, memory = self.numbers[i], self.curves[i], self.tables[i], self.memory[i]
            u, rate, gives, before = made[at], made[q + at], self.gives[i], forces[i]
            if code == BOUC_WEN and table[0, SCALE] > 0.0:
                waiting = True
                begins(numbers, curve, table, memory, u)
            else:
                forces[i] = law_force(code, address, numbers, curve, table, memory, u, rate, gives, before)
                logged[at] += forces[i]
        if waiting:  # all laws together: the numbers of one wait for each other, those of several do not
            for i in range(forces.size):
                if self.code[i] == BOUC_WEN and self.tables[i, 0, SCALE] > 0.0:
                    looks_up(self.numbers[i], self.curves[i], self.tables[i], self.memory[i])
            for i in range(forces.size):
                if self.code[i] == BOUC_WEN and self.tables[i, 0, SCALE] > 0.0:
                    forces[i] = ends(self.numbers[i], self.tables[i], self.memory[i])
                    logged[self.which[i]] += forces[i]
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
    numbers, curves, tables = of_the_step(laws, gives, design.dt_s)
    whole = np.hstack([outputs.transpose(0, 2, 1).reshape(-1, states)[: 3 + 2 * q], through[:, order]])
    rows = 2 * q if np.isin(laws.code, DEPENDING_ON_RATES).any() else q
    drifts, pushes = tiled(whole[3 : 3 + rows]), tiled(drive.reshape(-1, states)[order].T)
    columns = room.take(states + q + 2)
    return StoreysAndForces(
        turn=turn,
        drive=pushes,
        drifts=drifts,
        interface=tiled(whole[:3]),
        direct=np.ascontiguousarray(through[:1, 1:2]),
        columns=columns,
        pushed=np.zeros(4 * len(pushes)),
        made=np.zeros(padded(2 * q)),
        motion=np.zeros(4),
        which=which,
        code=laws.code,
        address=laws.address,
        numbers=numbers,
        curves=curves,
        tables=tables,
        gives=gives,
        memory=room.take(len(laws.code), REMEMBERED),
        forces=room.take(len(laws.code)),
        logged=columns[states + 1 : states + 1 + q],
        shear=room.take(2),
    )
