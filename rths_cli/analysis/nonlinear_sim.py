"""SIM of a building whose storeys have laws: the exact response of the linear building, and what the laws change of it.

Both are moved by the matrix exponential. The laws' force is a cubic through four Lobatto nodes of each step, solved by
fixed-point iteration (collocation, order six). Where a law changes its branch, or its force is no smooth cubic, the
step is halved, down to 2^-20 of the interval of the record: events are located to half a nanosecond at 2 kHz.
Nothing here is shared with the loop, whose reference this is. Without a force of the laws the response is that of
`simulate`, bit by bit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rths_cli.analysis.sim import (
    LawHistory,
    Response,
    base_shear_n,
    checked_record,
    hold_matrices,
    simulate,
    state_equation,
)
from rths_cli.errors import InputError
from rths_cli.numerics.compiled import borrowed, entry, shared_part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.numerics.user_functions import call_force
from rths_cli.structure import Building, storey_values
from rths_cli.structure.storey_laws import (
    BILINEAR,
    BOUC_WEN,
    CLOUGH,
    CUBIC,
    GAP,
    MAXWELL,
    OWN,
    OWN_STATES,
    SOFTENING,
    VISCOUS,
    Laws,
)

FINEST = 20  # halvings of the record's interval
FINEST_SMOOTH = 10  # halvings for the sake of smoothness alone
NODES = np.array([0.0, 0.5 - np.sqrt(5.0) / 10.0, 0.5 + np.sqrt(5.0) / 10.0, 1.0])
ROUNDS = 60  # of the fixed point before a step is halved
CONVERGED = 1e-14  # of the largest force so far
SMOOTH = 1e-6  # third difference of a force within a step, of its largest value so far
MOST_STORED = 4e7  # numbers of the matrices of all step sizes: 320 MB
DONE, EVENT, ROUGH, FAILED = range(4)
FORCE, SLOPE, ANCHOR, LOW, HIGH, RULE, BRANCH, SIDE = range(8)  # of a branch: f + slope (u - anchor), where it holds
TOP = 8  # farthest points so far: drift and force to the positive, then to the negative side
RELOADS = 12  # anchor and slope of the reloading line that was left, and whether it was one
MEMORY = 15
ELASTIC, BACKBONE, UNLOADS, RELOADING = range(4)


class Tables(NamedTuple):
    """What moves a state by each step size, the interval over 2^level, level = 0 .. FINEST (`step_tables`).

    Of the state with its inputs (N,): `whole` (levels, N, N) and `whole_force` (levels, 2n, q, 4) to the step's end,
    `at` (levels, 3, 2q, N) and `at_force` (levels, 3, 2q, q, 4) drifts and rates at the last three nodes; of forces
    (q,) at the four nodes. `weights` (4, 4) integrate over the step up to each node, `slopes` (2, 4) give the
    derivative at its start and at its end, per step.
    """

    whole: Array
    whole_force: Array
    at: Array
    at_force: Array
    weights: Array
    slopes: Array


class LawState(NamedTuple):
    """The state of l laws in q storeys, and room to solve their forces (`laws_at_rest`).

    `which` (l,) storey, `memory` and `signs` of the branch, `inner` variables, forces `made` and `rates` at the nodes
    of a step; `address` and `own` (l, 4 OWN_STATES), the states at the nodes, of users' own laws; `moved` (4, 2q)
    drifts and rates there, `nodes` (q, 4) the storeys' forces; `slope` (2, q) of these at start and end of an interval,
    per interval; `level` (1,) of the last step.
    """

    which: Integers
    code: Integers
    address: Integers
    numbers: Array
    own: Array
    memory: Array
    signs: Array
    inner: Array
    made: Array
    rates: Array
    scale: Array
    base: Array
    moved: Array
    nodes: Array
    full: Array
    slope: Array
    level: Integers


class Moving(NamedTuple):
    """A state on its way: `lin` (N,), with the inputs, moves without the laws, `now` (2n,) is what the laws change;
    `after` (N,) is room."""

    lin: Array
    now: Array
    after: Array


def at_rest(states: int, inputs: int) -> Moving:
    """Return a state of rest."""
    return Moving(np.zeros(states + inputs), np.zeros(states), np.zeros(states + inputs))


def simulate_with_laws(building: Building, dt_s: float, ground_accel_m_s2: Array) -> Response:
    """Solve M d2x + C dx + K x + laws = -M 1 a_g from rest for a record (n,) linear between samples.

    `building.laws` act on the drifts. Raises InputError as `simulate`, and where steps of 2^-20 of the interval do not
    converge.
    """
    record = checked_record(dt_s, ground_accel_m_s2)
    start = simulate(building, dt_s, record)
    laws, n = building.laws, len(building.M)
    history = LawHistory(np.zeros((n, len(record))), np.zeros((n, len(record))))
    if laws.code.size == 0:
        return replace(start, laws=history)
    storeys, which = np.unique(laws.storey, return_inverse=True)
    A, B = state_equation(building.M, building.C, building.K)
    push = push_matrix(building.M, storeys)
    tables = step_tables(A, ((B, 1),), push, drift_rows(n, storeys), dt_s)
    linear = np.ascontiguousarray(np.vstack([start.rel_disp_m, start.rel_vel_m_s]).T)
    change, force = np.zeros_like(linear), np.zeros((len(record), len(storeys)))
    work = np.zeros_like(force)
    failed = _march(
        tables, laws_at_rest(laws, which, tables), at_rest(2 * n, 2), linear, record, dt_s, change, force, work
    )
    if failed >= 0:
        drifts = np.diff(linear[failed - 1, :n] + change[failed - 1, :n], prepend=0.0)  # the last that is known
        raise InputError(f"SIM: {_collapse(building, drifts, failed * dt_s) or too_steep(failed * dt_s)}")
    history.force_n[storeys], history.work_j[storeys] = force.T, work.T
    states = linear.T + change.T
    abs_accel = start.abs_accel_m_s2 + A[n:] @ change.T + push[n:] @ force.T
    return replace(
        start,
        rel_disp_m=states[:n],
        rel_vel_m_s=states[n:],
        abs_accel_m_s2=abs_accel,
        base_shear_n=base_shear_n(building, abs_accel),
        laws=history,
    )


def _collapse(building: Building, drifts_m: Array, time_s: float) -> str:
    """Return the sentence on a storey that has drifted (n_storeys,) to where its cubic laws leave it no stiffness, ""
    if none has; a storey with other laws beside them is left out."""
    springs, laws = (
        np.concatenate([storey_values(building.numerical.K), storey_values(building.specimen.K)]),
        building.laws,
    )
    for storey in np.unique(laws.storey):
        here = laws.storey == storey
        softer = -float(laws.numbers[here, 0].sum())
        if (laws.code[here] != CUBIC).any() or softer <= 0.0:
            continue
        most = math.sqrt(springs[storey] / (3.0 * softer))
        if abs(drifts_m[storey]) > most:
            return (
                f"storey {storey + 1} collapses at {time_s:.4g} s: its cubic law leaves no stiffness beyond a drift of "
                f"{most:.4g} m; lower the scaling, or abs(cubic_n_per_m3)"
            )
    return ""


def too_steep(time_s: float) -> str:
    """Return the sentence on laws for which the smallest step is too long."""
    return (
        f"the laws of the storeys cannot be solved at {time_s:.4g} s; their forces are too steep for the floors' "
        "masses; lower them, or raise sample_rate_hz"
    )


def push_matrix(M: Array, storeys: Integers) -> Array:
    """Return the change (2n, q) of the state's rate per N in each of q storeys: it pulls its floor back, and the floor
    below along."""
    n = len(M)
    acts = np.zeros((n, len(storeys)))
    for q, storey in enumerate(storeys):
        acts[storey, q] = -1.0
        if storey > 0:
            acts[storey - 1, q] = 1.0
    return np.asarray(np.vstack([np.zeros_like(acts), np.linalg.solve(M, acts)]), dtype=float)


def drift_rows(n: int, storeys: Integers) -> Array:
    """Return the rows (2q, 2n) that make drifts, then their rates, from a state."""
    drift = np.zeros((len(storeys), n))
    for q, storey in enumerate(storeys):
        drift[q, storey] = 1.0
        if storey > 0:
            drift[q, storey - 1] = -1.0
    return np.asarray(np.kron(np.eye(2), drift), dtype=float)


def _lagrange() -> Array:
    """Return the coefficients (4 nodes, 4 powers) of the cubics that are one at a node and zero at the others."""
    return np.asarray(np.linalg.inv(np.vander(NODES, increasing=True)).T, dtype=float)


def _weights() -> Array:
    """Return the integrals (4, 4) of each cubic from the step's start to each node, over the step."""
    powers = np.arange(4)
    return np.array([_lagrange() @ (node ** (powers + 1) / (powers + 1)) for node in NODES])


def step_tables(A: Array, inputs: tuple[tuple[Array, int], ...], push: Array, rows: Array, interval_s: float) -> Tables:
    """Return what moves a state (2n,) of dx = A x + inputs + `push` (2n, q) forces by the step sizes of an interval.

    An input is a column (2n, 1) and the degree of a polynomial. It is part of the state, by its derivatives per
    interval: value, slope, ... up to its degree. `rows` (2q, 2n) make drifts, then their rates, from a state.
    """
    states, q = len(A), push.shape[1]
    size = states + sum(degree + 1 for _, degree in inputs)
    if (FINEST + 1) * states * (size + 4 * q) > MOST_STORED:
        raise InputError(f"SIM: {states // 2} storeys are too many beside laws; state fewer storeys")
    wide = np.zeros((size, size))
    wide[:states, :states] = A
    first = states
    for column, degree in inputs:
        wide[:states, first : first + 1] = column
        for i in range(degree):
            wide[first + i, first + i + 1] = 1.0 / interval_s
        first += degree + 1
    wide_push = np.vstack([push, np.zeros((size - states, q))])
    wide_rows, cubics = np.hstack([rows, np.zeros((2 * q, size - states))]), _lagrange()
    whole, whole_force = np.zeros((FINEST + 1, size, size)), np.zeros((FINEST + 1, states, q, 4))
    at, at_force = np.zeros((FINEST + 1, 3, 2 * q, size)), np.zeros((FINEST + 1, 3, 2 * q, q, 4))
    for level in range(FINEST + 1):
        for i, node in enumerate(NODES[1:]):
            moved, held = hold_matrices(wide, wide_push, node * interval_s / 2**level, 3)
            forces = np.einsum("psq,mp->sqm", [node**p * one for p, one in enumerate(held)], cubics)
            at[level, i], at_force[level, i] = wide_rows @ moved, np.einsum("rs,sqm->rqm", wide_rows, forces)
            if i == 2:
                whole[level], whole_force[level] = moved, forces[:states]
    slopes = np.ascontiguousarray([cubics[:, 1], cubics @ np.arange(4.0)])
    return Tables(whole, whole_force, at, at_force, _weights(), slopes)


def laws_at_rest(laws: Laws, which: Integers, tables: Tables) -> LawState:
    """Return laws at rest; `which` (l,) tells the place of each one's storey among those with laws."""
    count, storeys, size = len(laws.code), tables.whole_force.shape[2], tables.whole.shape[1]
    return LawState(
        which=which.astype(np.int64),
        code=laws.code,
        address=laws.address,
        numbers=laws.numbers,
        own=np.zeros((count, 4 * OWN_STATES)),
        memory=np.zeros((count, MEMORY)),
        signs=np.zeros((count, 2)),
        inner=np.zeros((count, 4, 2)),
        made=np.zeros((count, 4)),
        rates=np.zeros((count, 4, 2)),
        scale=np.zeros(count),
        base=np.zeros((3, 2 * storeys)),
        moved=np.zeros((4, 2 * storeys)),
        nodes=np.zeros((storeys, 4)),
        full=np.zeros(size),
        slope=np.zeros((2, storeys)),
        level=np.zeros(1, dtype=np.int64),
    )


@shared_part
def _begin(code: int, numbers: Array, memory: Array, signs: Array) -> None:
    """Write the branch of a law at rest."""
    memory[:] = 0.0
    memory[LOW], memory[HIGH] = -np.inf, np.inf
    signs[:] = 0.0 if code == VISCOUS else 1.0
    if code in (BILINEAR, CLOUGH):
        memory[SLOPE], memory[LOW], memory[HIGH] = numbers[0], -numbers[1], numbers[1]
        memory[TOP], memory[TOP + 1] = numbers[1], numbers[0] * numbers[1]
        memory[TOP + 2], memory[TOP + 3] = -numbers[1], -numbers[0] * numbers[1]
    elif code == GAP:
        memory[LOW], memory[HIGH] = -numbers[1], numbers[1]
    elif code == SOFTENING:
        memory[LOW] = 0.0


@shared_part
def _force(code: int, numbers: Array, memory: Array, signs: Array, u: float, v: float, inner: Array) -> float:
    """Return the force of a law beyond the spring at rest, on the branch that holds."""
    numbers, memory, signs, inner = borrowed((numbers, memory, signs, inner))
    if code in (BILINEAR, CLOUGH):
        return memory[FORCE] - memory[SLOPE] * memory[ANCHOR] + (memory[SLOPE] - numbers[0]) * u
    if code == GAP:
        return memory[FORCE] + memory[SLOPE] * (u - memory[ANCHOR])
    if code == CUBIC:
        return numbers[0] * u * u * u
    if code == SOFTENING:
        return -numbers[0] * u * u / (u + signs[0] * numbers[1])
    if code == VISCOUS:
        if signs[0] == 0.0:
            return numbers[0] * numbers[2] ** (numbers[1] - 1.0) * v
        return numbers[0] * signs[0] * max(signs[0] * v, 0.0) ** numbers[1]
    if code == MAXWELL:
        return inner[0]
    return numbers[0] * (inner[0] * numbers[1] - u)


@shared_part
def _rates(code: int, numbers: Array, signs: Array, v: float, inner: Array, rate: Array) -> None:
    """Write the rates (2,) of a law's inner variables."""
    numbers, signs, inner, rate = borrowed((numbers, signs, inner, rate))
    rate[0] = rate[1] = 0.0
    if code == BOUC_WEN:
        y, e, w = inner[0], inner[1], v / numbers[1]
        n, beta, gamma = numbers[3], numbers[4], numbers[5]
        nu, eta = 1.0 + numbers[7] * e, 1.0 + numbers[8] * e
        size = max(signs[1] * y, 0.0) ** n
        bent = (1.0 - numbers[6] * e) * w - nu * size * (beta * signs[0] * signs[1] + gamma) * w
        pinched = 1.0
        if numbers[9] > 0.0:
            zeta = numbers[9] * (1.0 - np.exp(-numbers[10] * e))
            width = (numbers[12] + numbers[13] * e) * (numbers[14] + zeta)
            top = (nu * (beta + gamma)) ** (-1.0 / n)
            pinched = 1.0 - zeta * np.exp(-(((y * signs[0] - numbers[11] * top) / width) ** 2))
        rate[0], rate[1] = pinched * bent / eta, (1.0 - numbers[2]) * y * w


@shared_part
def _left(code: int, numbers: Array, memory: Array, signs: Array, u: float, v: float, inner: Array) -> bool:
    """Return whether the branch does not hold at a point."""
    numbers, memory, signs, inner = borrowed((numbers, memory, signs, inner))
    if code == OWN:
        return False
    if code == VISCOUS:
        return abs(v) > numbers[2] if signs[0] == 0.0 else signs[0] * v < numbers[2]
    if code == BOUC_WEN:
        return signs[0] * v < 0.0 or signs[1] * inner[0] < 0.0
    return u < memory[LOW] or u > memory[HIGH] or memory[RULE] * v < 0.0


@shared_part
def _set(memory: Array, force: float, slope: float, anchor: float, low: float, high: float, rule: float) -> None:
    memory[FORCE], memory[SLOPE], memory[ANCHOR] = force, slope, anchor
    memory[LOW], memory[HIGH], memory[RULE] = low, high, rule


@shared_part
def _to_backbone(numbers: Array, memory: Array, side: float) -> None:
    k, limit = numbers[0], numbers[1]
    _set(memory, side * k * limit, numbers[2] * k, side * limit, -np.inf, np.inf, side)
    memory[BRANCH], memory[SIDE] = BACKBONE, side


@shared_part
def _to_reloading(memory: Array, side: float, anchor: float, slope: float) -> None:
    far = memory[TOP] if side > 0.0 else memory[TOP + 2]
    _set(memory, 0.0, slope, anchor, far if side < 0.0 else -np.inf, far if side > 0.0 else np.inf, side)
    memory[BRANCH], memory[SIDE] = RELOADING, side
    memory[RELOADS], memory[RELOADS + 1] = anchor, slope


@shared_part
def _switch_clough(numbers: Array, memory: Array, u: float, v: float) -> None:
    """Go from one branch of Clough's law to the next."""
    numbers, memory = borrowed((numbers, memory))
    k, limit, side = numbers[0], numbers[1], memory[SIDE]
    force = memory[FORCE] + memory[SLOPE] * (u - memory[ANCHOR])
    if memory[BRANCH] == ELASTIC:
        _to_backbone(numbers, memory, 1.0 if u > 0.0 else -1.0)
    elif memory[BRANCH] == BACKBONE or (memory[BRANCH] == RELOADING and side * v < 0.0):
        top = TOP if side > 0.0 else TOP + 2
        memory[RELOADS + 2] = 1.0 if memory[BRANCH] == RELOADING else 0.0
        if memory[BRANCH] == BACKBONE:
            memory[top], memory[top + 1] = u, force
        softened = k * (limit / abs(memory[top])) ** numbers[3]
        slope = max(softened, memory[top + 1] / memory[top])  # it does not unload past rest
        empty = u - force / slope
        _set(memory, force, slope, u, min(u, empty), max(u, empty), 0.0)
        memory[BRANCH] = UNLOADS
    elif memory[BRANCH] == RELOADING:
        _to_backbone(numbers, memory, side)
    elif (u > memory[HIGH]) == (side > 0.0):  # back where it was left
        if memory[RELOADS + 2] > 0.0:
            _to_reloading(memory, side, memory[RELOADS], memory[RELOADS + 1])
        else:
            _to_backbone(numbers, memory, side)
    else:
        empty = memory[LOW] if side > 0.0 else memory[HIGH]
        top = TOP + 2 if side > 0.0 else TOP
        reach = memory[top] - empty
        slope = memory[top + 1] / reach if reach * side < 0.0 else k
        _to_reloading(memory, -side, empty, slope)


@shared_part
def _switch(code: int, numbers: Array, memory: Array, signs: Array, u: float, v: float, inner: Array) -> None:
    """Go to the branch that holds from a point on at which the last one does not."""
    numbers, memory, signs, inner = borrowed((numbers, memory, signs, inner))
    if code == VISCOUS:
        signs[0] = 0.0 if signs[0] != 0.0 else 1.0 if v > 0.0 else -1.0
    elif code == BOUC_WEN:
        signs[0] = -signs[0] if signs[0] * v < 0.0 else signs[0]
        signs[1] = -signs[1] if signs[1] * inner[0] < 0.0 else signs[1]
    elif code == CLOUGH:
        _switch_clough(numbers, memory, u, v)
    elif code == BILINEAR:
        k, limit = numbers[0], numbers[1]
        if memory[RULE] == 0.0:
            side = 1.0 if u > memory[HIGH] else -1.0
            _set(memory, side * k * limit, 0.0, u, -np.inf, np.inf, side)
        else:
            rest = u - memory[RULE] * limit
            _set(memory, 0.0, k, rest, rest - limit, rest + limit, 0.0)
    elif code == SOFTENING:
        signs[0] = -signs[0]
        _set(memory, 0.0, 0.0, 0.0, 0.0 if signs[0] > 0.0 else -np.inf, 0.0 if signs[0] < 0.0 else np.inf, 0.0)
    elif code == GAP:
        k, gap = numbers[0], numbers[1]
        if u > memory[HIGH] and memory[SLOPE] == 0.0:
            _set(memory, 0.0, k, gap, gap, np.inf, 0.0)
        elif u < memory[LOW] and memory[SLOPE] == 0.0:
            _set(memory, 0.0, k, -gap, -np.inf, -gap, 0.0)
        else:
            _set(memory, 0.0, 0.0, 0.0, -gap, gap, 0.0)


@entry
def _march(
    tables: Tables,
    laws: LawState,
    moving: Moving,
    linear: Array,
    record: Array,
    dt_s: float,
    change: Array,
    force: Array,
    work: Array,
) -> int:
    """Write what laws change of the state (n, 2n), their force and work (n, q) sample by sample.

    Returns the number of the sample where no step was small enough, -1 if there is none.
    """
    tables, laws, moving = borrowed((tables, laws, moving))
    linear, record, change, force, work = borrowed((linear, record, change, force, work))
    states, lin, now = linear.shape[1], moving.lin, moving.now
    begin(laws)
    for k in range(1, len(record)):
        copy(linear[k - 1], lin, states)
        lin[states], lin[states + 1] = record[k - 1], record[k] - record[k - 1]
        copy(work[k - 1], work[k], work.shape[1])
        if not advance(tables, laws, dt_s, moving, work[k]):
            return k
        copy(now, change[k], states)
        read_forces(laws, force[k])
    return -1


@shared_part
def copy(source: Array, target: Array, count: int) -> None:
    """Copy the first values; a slice would be checked for its length by code that allocates."""
    for i in range(count):
        target[i] = source[i]


@shared_part
def begin(laws: LawState) -> None:
    """Write the branches of laws at rest."""
    for i in range(len(laws.code)):
        _begin(laws.code[i], laws.numbers[i], laws.memory[i], laws.signs[i])


@shared_part
def read_forces(laws: LawState, force: Array) -> None:
    """Write the storeys' forces (q,) of this instant."""
    force[:] = 0.0
    for i in range(len(laws.code)):
        force[laws.which[i]] += laws.made[i, 0]


@shared_part
def advance(tables: Tables, laws: LawState, interval_s: float, moving: Moving, work: Array) -> bool:
    """Move a state by one interval, and add what the laws do to `work` (q,); tell whether a step was small enough."""
    tables, laws, moving, work = borrowed((tables, laws, moving, work))
    lin, now, after = moving.lin, moving.now, moving.after
    states, size, storeys, ticks, position = len(now), len(lin), laws.nodes.shape[0], 1 << FINEST, 0
    while position < ticks:
        level = max(laws.level[0] - 1, 0)
        while position % (ticks >> level) != 0:
            level += 1
        copy(lin, laws.full, size)
        for s in range(states):
            laws.full[s] += now[s]
        while True:
            outcome = _try(tables, laws, level, interval_s / (1 << level))
            if outcome == DONE or (outcome == EVENT and level == FINEST):
                break
            if outcome == ROUGH and level >= FINEST_SMOOTH:
                break
            if level == FINEST:
                return False
            level += 1
        laws.level[0] = level
        step_s = interval_s / (1 << level)
        for q in range(storeys):
            first = last = 0.0
            for m in range(4):
                work[q] += step_s * tables.weights[3, m] * laws.nodes[q, m] * laws.moved[m, storeys + q]
                first += tables.slopes[0, m] * laws.nodes[q, m]
                last += tables.slopes[1, m] * laws.nodes[q, m]
            if position == 0:
                laws.slope[0, q] = first * (1 << level)
            laws.slope[1, q] = last * (1 << level)
        for s in range(states):
            total = 0.0
            for c in range(states):
                total += tables.whole[level, s, c] * now[c]
            for q in range(storeys):
                for m in range(4):
                    total += tables.whole_force[level, s, q, m] * laws.nodes[q, m]
            after[s] = total
        copy(after, now, states)
        for s in range(size):
            total = 0.0
            for c in range(size):
                total += tables.whole[level, s, c] * lin[c]
            after[s] = total
        copy(after, lin, size)
        _take_branches(laws)
        position += ticks >> level
    return True


@shared_part
def _take_branches(laws: LawState) -> None:
    """Take the end of a step as the start of the next one, on the branches that hold there."""
    laws = borrowed(laws)
    storeys = laws.nodes.shape[0]
    for i in range(len(laws.code)):
        code, numbers, memory, signs, inner = (
            laws.code[i], laws.numbers[i], laws.memory[i], laws.signs[i], laws.inner[i, 0],
        )  # fmt: skip
        u, v = laws.moved[3, laws.which[i]], laws.moved[3, storeys + laws.which[i]]
        copy(laws.inner[i, 3], inner, inner.size)
        laws.scale[i] = max(laws.scale[i], abs(laws.made[i, 3]))
        if code == OWN:
            for s in range(OWN_STATES):
                laws.own[i, s] = laws.own[i, 3 * OWN_STATES + s]
            laws.made[i, 0] = laws.made[i, 3]
            continue
        if _left(code, numbers, memory, signs, u, v, inner):
            _switch(code, numbers, memory, signs, u, v, inner)
        laws.made[i, 0] = _force(code, numbers, memory, signs, u, v, inner)
    copy(laws.moved[3], laws.moved[0], 2 * storeys)


@shared_part
def _relax(numbers: Array, rate_m_s: Array, inner: Array, weights: Array, step_s: float) -> None:
    """Solve the force of a Maxwell damper at the last three nodes, `inner` (4, 2), for the drift's rates at all four.

    Its own equation is linear. Solved at once it needs no step as short as the damper's relaxation.
    """
    rate_m_s, inner, weights = borrowed((rate_m_s, inner, weights))
    reach = step_s * numbers[0]
    decay = reach / numbers[1]
    a, b, c = 1.0 + decay * weights[1, 1], decay * weights[1, 2], decay * weights[1, 3]
    d, e, f = decay * weights[2, 1], 1.0 + decay * weights[2, 2], decay * weights[2, 3]
    g, h, i = decay * weights[3, 1], decay * weights[3, 2], 1.0 + decay * weights[3, 3]
    x, y, z = inner[0, 0], inner[0, 0], inner[0, 0]
    for j in range(4):
        supplied = reach * rate_m_s[j]
        if j == 0:
            supplied -= decay * inner[0, 0]
        x += weights[1, j] * supplied
        y += weights[2, j] * supplied
        z += weights[3, j] * supplied
    whole = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    inner[1, 0] = (x * (e * i - f * h) - b * (y * i - f * z) + c * (y * h - e * z)) / whole
    inner[2, 0] = (a * (y * i - f * z) - x * (d * i - f * g) + c * (d * z - y * g)) / whole
    inner[3, 0] = (a * (e * z - y * h) - b * (d * z - y * g) + x * (d * h - e * g)) / whole


@shared_part
def _try(tables: Tables, state: LawState, level: int, step_s: float) -> int:
    """Solve the laws' forces at the nodes of one step; tell whether it holds, or why it must be halved.

    Reads drifts and forces at the step's start in `moved[0]`, `made[:, 0]` and `inner[:, 0]`, the state in `full`. A
    user's own law goes from node to node.
    """
    tables, state = borrowed((tables, state))
    at, at_force, weights, full = tables.at[level], tables.at_force[level], tables.weights, state.full
    which, code, numbers, memory, signs = state.which, state.code, state.numbers, state.memory, state.signs
    inner, made, rates, scale = state.inner, state.made, state.rates, state.scale
    base, moved, nodes = state.base, state.moved, state.nodes
    laws, storeys = len(code), nodes.shape[0]
    for m in range(3):
        for r in range(2 * storeys):
            total = 0.0
            for s in range(full.size):
                total += at[m, r, s] * full[s]
            base[m, r] = total
    for i in range(laws):
        _rates(code[i], numbers[i], signs[i], moved[0, storeys + which[i]], inner[i, 0], rates[i, 0])
        for m in range(1, 4):
            made[i, m] = made[i, 0]
            copy(inner[i, 0], inner[i, m], 2)
            copy(rates[i, 0], rates[i, m], 2)
    solved = False
    for _ in range(ROUNDS):
        nodes[:] = 0.0
        for i in range(laws):
            for m in range(4):
                nodes[which[i], m] += made[i, m]
        for m in range(3):
            for r in range(2 * storeys):
                total = base[m, r]
                for q in range(storeys):
                    for j in range(4):
                        total += at_force[m, r, q, j] * nodes[q, j]
                moved[m + 1, r] = total
        if solved:
            break
        solved = True
        for i in range(laws):
            if code[i] == MAXWELL:
                _relax(numbers[i], moved[:, storeys + which[i]], inner[i], weights, step_s)
            else:
                for m in range(1, 4):  # first of all: a law at rest has neither force nor rates, but is moved
                    _rates(code[i], numbers[i], signs[i], moved[m, storeys + which[i]], inner[i, m], rates[i, m])
                for m in range(1, 4):
                    for x in range(2):
                        total = inner[i, 0, x]
                        for j in range(4):
                            total += step_s * weights[m, j] * rates[i, j, x]
                        inner[i, m, x] = total
            for m in range(1, 4):
                u, v = moved[m, which[i]], moved[m, storeys + which[i]]
                if code[i] == OWN:
                    first, after = (m - 1) * OWN_STATES, m * OWN_STATES
                    wanted = call_force(state.address[i], numbers[i], state.own[i], first, after, u, v)
                else:
                    wanted = _force(code[i], numbers[i], memory[i], signs[i], u, v, inner[i, m])
                if not abs(wanted - made[i, m]) <= CONVERGED * max(scale[i], abs(wanted)):
                    solved = False
                made[i, m] = wanted
    if not solved:
        return FAILED
    for i in range(laws):
        for m in range(1, 4):
            if _left(
                code[i], numbers[i], memory[i], signs[i], moved[m, which[i]], moved[m, storeys + which[i]], inner[i, m]
            ):
                return EVENT
        if code[i] in (BILINEAR, CLOUGH, GAP):
            for m in range(3):
                before, after = moved[m, storeys + which[i]], moved[m + 1, storeys + which[i]]
                if before * after < 0.0:  # it turns between these nodes
                    ahead_s = (NODES[m + 1] - NODES[m]) * step_s * before / (before - after)
                    farthest = moved[m, which[i]] + 0.5 * before * ahead_s
                    if farthest < memory[i, LOW] or farthest > memory[i, HIGH]:
                        return EVENT
    for i in range(laws):
        if code[i] == OWN and moved[0, storeys + which[i]] * moved[3, storeys + which[i]] < 0.0:
            return ROUGH  # the farthest drift lies between nodes
        third = made[i, 3] - made[i, 0] + 5.0**0.5 * (made[i, 1] - made[i, 2])
        if abs(third) > SMOOTH * max(scale[i], abs(made[i, 3])):
            return ROUGH
    return DONE
