"""Advance the virtual table over one sample interval, compiled: friction, clipping, laws of the specimen's storeys,
sensors.

The forces of laws are further inputs of the plant's linear part, a parabola over each inner step like friction and
clipping (`plant`). Their values at middle and end follow from drifts and rates there, and these from the forces: a
fixed-point iteration solves both. A law follows its storey's drift from node to node, so that a path in between is
taken for monotone. The order is four where a force is smooth; a step in which a law changes its branch errs in
proportion to the square of the step. Equations: docs/background/storey_laws.md. The loop's computed storeys and SIM
each have implementations of their own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.compiled import borrowed, entry, kept_part, part, part_class, shared_part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.numerics.tiled_products import ROWS, copied, product, product_of_squares, shifted
from rths_cli.rigs.virtual.further_outputs import FurtherOutputs
from rths_cli.structure import Specimen, storey_matrix, storey_values
from rths_cli.structure.storey_laws import (
    BILINEAR,
    BOUC_WEN,
    CUBIC,
    GAP,
    MAXWELL,
    SOFTENING,
    VISCOUS,
    Law,
    Laws,
    LawSpec,
    arranged,
    law_of,
)

SATURATED = 10.0  # tanh(10) is 1 within 5e-9
SOLVED = 1e-9  # of tanh(v / v_s) at a node

REMEMBERED = 12  # numbers of a law
PHASE = 1e-3  # rad in an inner step, of the specimen's fastest vibration
ROUNDS = 40  # of the fixed point
CONTRACTION = 0.25  # of an error in the forces by one round of the fixed point
FASTEST_M_S = 1.0  # rate of a storey up to which a damper's tangent is bounded
MOST_PIECES = 8
MOST_CORNERS = 8
ELASTIC, BACKBONE, UNLOADING, RELOADING = range(4)
END_STOP = 1
CLIPPED_LEVEL = 4
CROSSING_LEVEL = 9  # of an interval in which clipping may begin or end


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


@part_class
class NoLaws(NamedTuple):
    """A linear specimen: its plant is compiled without what laws need."""

    storeys: int = 0

    def accel_by_laws(self, state: Array, forces: int, channel: int) -> float:
        """Return what laws add to the absolute acceleration of table or floor at a step's end: nothing."""
        return 0.0

    def inner_level(self, level: int, refine: int, most: int) -> int:
        """Return the level of inner steps where friction and clipping need `level`: the same."""
        return level

    def tiles_used(self, used: int, all_of_them: int) -> int:
        """Return how many column tiles of the state act where friction and clipping use so many: these."""
        return used

    def find_forces(self, plant: Plant, s: PlantState, level: int, active: int) -> None:
        """Find the acting nonlinearities at start, middle and end of an inner step."""
        solve(plant, s, level, active)


@part_class
class SpecimenLaws(NamedTuple):
    """Constant arrays of l laws in q storeys of the specimen; `storeys` is q.

    `which` (l,) place of the storey among the q, `code` (l,), `numbers` (l, NUMBERS). `arguments` (levels, 2, 2 + 2 q,
    columns): v / v_s, F_ref, drifts, rates at middle and end of an inner step, from the columns of the plant's state.
    `accel` (c, q) absolute accelerations of table and floors per N. `level` of inner steps; `solved_n`, the change of a
    force at which the iteration ends.
    """

    storeys: int
    which: Integers
    code: Integers
    numbers: Array
    arguments: Array
    accel: Array
    level: int
    solved_n: float

    def accel_by_laws(self, state: Array, forces: int, channel: int) -> float:
        """Return what the laws add to the absolute acceleration of table or floor at a step's end."""
        value = 0.0
        for q in range(self.storeys):
            value += self.accel[channel, q] * state[forces + ROWS * (2 + q) + 2]
        return value

    def inner_level(self, level: int, refine: int, most: int) -> int:
        """Return the level of inner steps where friction and clipping need `level`."""
        return max(level, min(self.level + refine, most))

    def tiles_used(self, used: int, all_of_them: int) -> int:
        """Return how many column tiles of the state act where friction and clipping use so many: all."""
        return all_of_them

    def find_forces(self, plant: Plant, s: PlantState, level: int, active: int) -> None:
        """Find friction, clipping and the laws' forces at start, middle and end of an inner step (fixed point)."""
        solve_with_laws(self, plant, s, level, active == 2)


def specimen_with_laws(specimen: Specimen, stated: tuple[tuple[LawSpec, ...], ...], g: float) -> tuple[Specimen, Laws]:
    """Return a specimen with what its laws add at rest, and its laws; storeys count from 0 at the table.

    `stated` holds the laws storey by storey from the table, `g` in m/s^2 makes weights of masses. Raises InputError for
    another number of storeys.
    """
    if not any(stated):
        return specimen, arranged(())
    storeys = len(specimen.masses_kg)
    if len(stated) != storeys:
        raise InputError(
            f"table.physics.specimen_laws: {len(stated)} entries for {storeys} storeys on the table; state one for each"
        )
    weights = g * np.cumsum(specimen.masses_kg[::-1])[::-1]
    springs = zip(stated, storey_values(specimen.K).tolist(), weights.tolist(), strict=True)
    laws: list[tuple[Law, ...]] = [tuple(law_of(one, k, weight) for one in of) for of, k, weight in springs]
    at_rest = np.array([np.sum([law.at_rest for law in of], axis=0) if of else (0.0, 0.0) for of in laws])
    K, C = specimen.K + storey_matrix(at_rest[:, 0]), specimen.C + storey_matrix(at_rest[:, 1])
    return Specimen(specimen.masses_kg, K, C), arranged(tuple(laws))


def law_columns(masses_kg: Array, table_kg: float, storeys: Integers, states: int) -> Array:
    """Return the change (states, q) of the plant's mechanical rates per N in each of q storeys.

    The force pulls its floor back and the floor below, or the table, along.
    """
    floors, columns = len(masses_kg), np.zeros((states, len(storeys)))
    floor = 3 + floors  # first relative velocity
    for q, storey in enumerate(storeys):
        columns[floor + storey, q] -= 1.0 / masses_kg[storey]
        if storey > 0:
            columns[floor + storey - 1, q] += 1.0 / masses_kg[storey - 1]
        else:
            columns[1, q] = 1.0 / table_kg
            columns[floor:, q] -= 1.0 / table_kg
    return columns


def law_rows(floors: int, storeys: Integers, states: int) -> Array:
    """Return the rows (2 q, states) of drifts, then their rates, of the plant's mechanical states."""
    rows, count = np.zeros((2 * len(storeys), states)), len(storeys)
    for q, storey in enumerate(storeys):
        for row, first in ((q, 3), (count + q, 3 + floors)):
            rows[row, first + storey] = 1.0
            if storey > 0:
                rows[row, first + storey - 1] = -1.0
    return rows


def level_of(laws: Laws, which: Integers, specimen: Specimen, arguments: Array, forces: int, dt_s: float) -> int:
    """Return the level of inner steps that resolves the specimen and lets the fixed point converge.

    Raises InputError where even the smallest step is too long for the stiffest law.
    """
    squares = np.linalg.eigvals(specimen.K / specimen.masses_kg[:, None]).real
    level = max(1, math.ceil(math.log2(max(dt_s * math.sqrt(float(squares.max())) / PHASE, 1.0))))
    count = (arguments.shape[2] - 2) // 2
    steepest = np.zeros((2, count))
    stiffness, dashpot = np.abs(laws.stiffness).max(axis=1), np.abs(laws.dashpot).max(axis=1)
    for i, place in enumerate(which):
        numbers, damper = laws.numbers[i], dashpot[i]
        if not math.isfinite(damper):
            damper = numbers[1] * numbers[0] * FASTEST_M_S ** (numbers[1] - 1.0)
        steepest[:, place] += stiffness[i], damper
    while level < len(arguments):
        fed = np.abs(arguments[level][:, 2:, forces + 8 :]).sum(axis=2)  # of each argument, of all forces
        if (fed[:, :count] * steepest[0] + fed[:, count:] * steepest[1]).max() <= CONTRACTION:
            return level
        level += 1
    raise InputError(
        f"table.physics.specimen_laws: a law is too steep for the specimen's masses at dt = {1e3 * dt_s:.4g} ms; "
        "soften it, or raise sample_rate_hz"
    )


@shared_part
def solve_with_laws(laws: SpecimenLaws, plant: Plant, s: PlantState, level: int, clips: bool) -> None:
    """Find friction, clipping and the laws' forces at start, middle and end of an inner step (fixed point)."""
    laws, plant, s = borrowed((laws, plant, s))
    n, first = plant.mechanical, plant.forces
    arguments, storeys, state, memory = laws.arguments[level], laws.storeys, s.state, s.law_memory
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
            friction = tanh(value_of(laws, plant, s, level, node, 0))
            clip = clipped(value_of(laws, plant, s, level, node, 1), plant) if clips else 0.0
            solved &= abs(friction - state[first + 1 + node]) < 1e-10
            solved &= abs(clip - state[first + ROWS + 1 + node]) < 1e-10
            for i in range(laws.code.size):
                for m in range(memory.shape[2]):
                    memory[node + 1, i, m] = memory[node, i, m]
            for q in range(storeys):
                u, v = (
                    value_of(laws, plant, s, level, node, 2 + q),
                    value_of(laws, plant, s, level, node, 2 + storeys + q),
                )
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
def value_of(laws: SpecimenLaws, plant: Plant, s: PlantState, level: int, node: int, which: int) -> float:
    """Return an argument of the nonlinearities at middle (node = 0) or end (1) of an inner step, as solved so far."""
    value = s.law_free[node, which]
    for i in range(plant.forces, s.state.size):
        value += laws.arguments[level, node, which, i] * s.state[i]
    return value


@part
def law_force(code: int, numbers: Array, memory: Array, u: float, v: float, time_s: float) -> float:
    """Follow a law to drift u and rate v, `time_s` after its memory; return its force beyond the spring at rest."""
    if code == BILINEAR:
        memory[0] = min(max(memory[0], u - numbers[1]), u + numbers[1])  # the plastic drift
        return -numbers[0] * memory[0]
    if code == GAP:
        return numbers[0] * (max(u - numbers[1], 0.0) + min(u + numbers[1], 0.0))
    if code == CUBIC:
        return numbers[0] * u * u * u
    if code == SOFTENING:
        return -numbers[0] * u * abs(u) / (abs(u) + numbers[1])
    if code == VISCOUS:
        size = abs(v)
        if size <= numbers[2]:
            return numbers[0] * numbers[2] ** (numbers[1] - 1.0) * v
        return math.copysign(numbers[0] * size ** numbers[1], v)
    if code == MAXWELL:
        kept = math.exp(-time_s * numbers[0] / numbers[1])
        memory[0] = kept * memory[0] + numbers[1] * (1.0 - kept) * (u - memory[1]) / time_s
        memory[1] = u
        return memory[0]
    if code == BOUC_WEN:
        return bouc_wen(numbers, memory, u)
    return clough(numbers, memory, u)


@part
def bouc_wen(numbers: Array, memory: Array, u: float) -> float:
    """Follow Bouc and Wen's law to a drift by Runge and Kutta's method over the way; return the force.

    Memory: z over the yield drift, dissipated energy, drift.
    """
    limit = numbers[1]
    way = (u - memory[2]) / limit
    pieces = min(MOST_PIECES, 1 + int(4.0 * abs(way) * (1.0 + numbers[3])))
    step = way / pieces
    for _ in range(pieces):
        y, e = memory[0], memory[1]
        first, first_e = bouc_wen_slopes(numbers, y, e, way)
        second, second_e = bouc_wen_slopes(numbers, y + 0.5 * step * first, e + 0.5 * step * first_e, way)
        third, third_e = bouc_wen_slopes(numbers, y + 0.5 * step * second, e + 0.5 * step * second_e, way)
        last, last_e = bouc_wen_slopes(numbers, y + step * third, e + step * third_e, way)
        memory[0] += step / 6.0 * (first + 2.0 * second + 2.0 * third + last)
        memory[1] += step / 6.0 * (first_e + 2.0 * second_e + 2.0 * third_e + last_e)
    memory[2] = u
    return numbers[0] * (limit * memory[0] - u)


@part
def bouc_wen_slopes(numbers: Array, y: float, e: float, way: float) -> tuple[float, float]:
    """Return the derivatives of y and of the dissipated energy by the way, over the yield drift."""
    side = math.copysign(1.0, way)
    n, beta, gamma, nu = numbers[3], numbers[4], numbers[5], 1.0 + numbers[7] * e
    slope = 1.0 - numbers[6] * e - nu * abs(y) ** n * (gamma + beta * math.copysign(1.0, y * side))
    slope /= 1.0 + numbers[8] * e
    if numbers[9] > 0.0:
        zeta = numbers[9] * (1.0 - math.exp(-numbers[10] * e))
        width = (numbers[12] + numbers[13] * e) * (numbers[14] + zeta)
        beyond = y * side - numbers[11] * (nu * (beta + gamma)) ** (-1.0 / n)
        slope *= 1.0 - zeta * math.exp(-((beyond / width) ** 2))
    return slope, (1.0 - numbers[2]) * y


@part
def clough(numbers: Array, memory: Array, u: float) -> float:
    """Follow Clough's law to a drift along its straight lines; return the force beyond the spring.

    Memory: drift, force, branch, side; farthest drift and force of the positive, then of the negative side; the
    branch's slope; drift at which unloading began, the branch before it and its slope.
    """
    k, limit, hardening = numbers[0], numbers[1], numbers[2]
    if memory[2] == ELASTIC:
        if abs(u) <= limit:
            return 0.0
        side = math.copysign(1.0, u)
        memory[0], memory[1], memory[2], memory[3] = side * limit, side * k * limit, BACKBONE, side
        memory[4], memory[5], memory[6], memory[7], memory[8] = limit, k * limit, -limit, -k * limit, hardening * k
    if u == memory[0]:
        return memory[1] - k * u
    for _ in range(MOST_CORNERS):
        side, far = memory[3], 4 if memory[3] > 0.0 else 6
        if memory[2] != UNLOADING and (u - memory[0]) * side < 0.0:  # it turns back
            if memory[2] == BACKBONE:
                memory[far], memory[far + 1] = memory[0], memory[1]
            memory[9], memory[10], memory[11] = memory[0], memory[2], memory[8]
            softened = k * (limit / abs(memory[far])) ** numbers[3]
            memory[2], memory[8] = UNLOADING, max(softened, memory[far + 1] / memory[far])
        end = side * math.inf
        if memory[2] == RELOADING:
            end = memory[far]
        elif memory[2] == UNLOADING:
            end = memory[9] if (u - memory[0]) * side > 0.0 else memory[0] - memory[1] / memory[8]
        if (u - end) * math.copysign(1.0, u - memory[0]) <= 0.0:
            break
        memory[1] += memory[8] * (end - memory[0])
        memory[0] = end
        if memory[2] == RELOADING:
            memory[2], memory[8] = BACKBONE, hardening * k
        elif (u - end) * side > 0.0:  # back where unloading began
            memory[2], memory[8] = memory[10], memory[11]
        else:  # no force is left: towards the farthest point of the other side
            other = 6 if side > 0.0 else 4
            reach = memory[other] - end
            memory[1], memory[2], memory[3] = 0.0, RELOADING, -side
            memory[8] = memory[other + 1] / reach if reach * side < 0.0 else k
    memory[1] += memory[8] * (u - memory[0])
    memory[0] = u
    return memory[1] - k * u


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
