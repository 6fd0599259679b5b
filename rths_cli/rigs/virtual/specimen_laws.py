"""Laws of the virtual specimen's storeys, compiled: forces at middle and end of an inner step of the plant.

The forces are further inputs of the plant's linear part, a parabola over each inner step like friction and clipping
(`plant`). Their values at middle and end follow from drifts and rates there, and these from the forces: a fixed-point
iteration solves both. A law follows its storey's drift from node to node, so that a path in between is taken for
monotone. The order is four where a force is smooth; a step in which a law changes its branch errs in proportion to the
square of the step. Equations: docs/background/storey_laws.md. The loop's computed storeys and SIM each have
implementations of their own.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.compiled import borrowed, part, part_class, shared_part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.numerics.tiled_products import ROWS
from rths_cli.rigs.virtual.friction_and_clipping import clipped, solve, tanh
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

if TYPE_CHECKING:
    from rths_cli.rigs.virtual.plant_kernel import Plant, PlantState

REMEMBERED = 12  # numbers of a law
PHASE = 1e-3  # rad in an inner step, of the specimen's fastest vibration
ROUNDS = 40  # of the fixed point
CONTRACTION = 0.25  # of an error in the forces by one round of the fixed point
FASTEST_M_S = 1.0  # rate of a storey up to which a damper's tangent is bounded
MOST_PIECES = 8
MOST_CORNERS = 8
ELASTIC, BACKBONE, UNLOADING, RELOADING = range(4)


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
