"""Find Coulomb friction and force clipping of the virtual table at start, middle and end of an inner step, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rths_cli.numerics.compiled import part
from rths_cli.numerics.tiled_products import ROWS, product

if TYPE_CHECKING:
    from rths_cli.rigs.virtual.plant_kernel import Plant, PlantState

SATURATED = 10.0  # tanh(10) is 1 within 5e-9
SOLVED = 1e-9  # of tanh(v / v_s) at a node


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
