"""SIM of a building whose storeys have laws: the exact response of the linear building, and what the laws change of it.

Both are moved by the matrix exponential. The laws' force is a cubic through four Lobatto nodes of each step, solved by
fixed-point iteration (collocation, order six). Where a law changes its branch, or its force is no smooth cubic, the
step is halved, down to 2^-20 of the interval of the record: events are located to half a nanosecond at 2 kHz.
Nothing here is shared with the loop, whose reference this is. Without a force of the laws the response is that of
`simulate`, bit by bit.
"""

from __future__ import annotations

from dataclasses import replace

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
from rths_cli.numerics.compiled import entry, shared_part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.structure import Building
from rths_cli.structure.storey_laws import BILINEAR, BOUC_WEN, CLOUGH, CUBIC, GAP, MAXWELL, VISCOUS

FINEST = 20  # halvings of the record's interval
FINEST_SMOOTH = 10  # halvings for the sake of smoothness alone
NODES = np.array([0.0, 0.5 - np.sqrt(5.0) / 10.0, 0.5 + np.sqrt(5.0) / 10.0, 1.0])
ROUNDS = 60  # of the fixed point before a step is halved
CONVERGED = 1e-14  # of the largest force so far
SMOOTH = 1e-3  # third difference of a force within a step, of its largest value so far
MOST_STORED = 4e7  # numbers of the matrices of all step sizes: 320 MB
DONE, EVENT, ROUGH, FAILED = range(4)
FORCE, SLOPE, ANCHOR, LOW, HIGH, RULE, BRANCH, SIDE = range(8)  # of a branch: f + slope (u - anchor), where it holds
TOP = 8  # farthest points so far: drift and force to the positive, then to the negative side
RELOADS = 12  # anchor and slope of the reloading line that was left, and whether it was one
MEMORY = 15
ELASTIC, BACKBONE, UNLOADS, RELOADING = range(4)


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
    push = _push(building.M, storeys)
    tables = _step_tables(A, B, push, storeys, dt_s)
    linear = np.ascontiguousarray(np.vstack([start.rel_disp_m, start.rel_vel_m_s]).T)
    change, force = np.zeros_like(linear), np.zeros((len(record), len(storeys)))
    work = np.zeros_like(force)
    failed = _march(
        *tables, _weights(), which.astype(np.int64), laws.code, laws.numbers, linear, record, dt_s, change, force, work
    )
    if failed >= 0:
        raise InputError(
            f"SIM: the laws of the storeys cannot be solved at {failed * dt_s:.4g} s; their forces are too steep for "
            "the floors' masses; lower them, or raise sample_rate_hz"
        )
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


def _push(M: Array, storeys: Integers) -> Array:
    """Return the change (2n, q) of the state's rate per N in each of q storeys: it pulls its floor back, and the floor
    below along."""
    n = len(M)
    acts = np.zeros((n, len(storeys)))
    for q, storey in enumerate(storeys):
        acts[storey, q] = -1.0
        if storey > 0:
            acts[storey - 1, q] = 1.0
    return np.asarray(np.vstack([np.zeros_like(acts), np.linalg.solve(M, acts)]), dtype=float)


def _drifts(n: int, storeys: Integers) -> Array:
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


def _step_tables(A: Array, B: Array, push: Array, storeys: Integers, dt_s: float) -> tuple[Array, Array, Array, Array]:
    """Return what moves a state by each step size, the record's interval over 2^level, level = 0 .. FINEST.

    Of the state with ground acceleration and its slope as further states (N = 2n + 2): `whole` (levels, 2n, N) and
    `whole_force` (levels, 2n, q, 4) to the step's end, `at` (levels, 3, 2q, N) and `at_force` (levels, 3, 2q, q, 4)
    drifts and rates at the last three nodes; of forces (q,) at the four nodes.
    """
    states, q = len(A), len(storeys)
    size = states + 2
    if (FINEST + 1) * states * (size + 4 * q) > MOST_STORED:
        raise InputError(f"SIM: {states // 2} storeys are too many beside laws; state fewer storeys")
    wide = np.zeros((size, size))
    wide[:states, :states], wide[:states, states : states + 1], wide[states, states + 1] = A, B, 1.0
    wide_push = np.vstack([push, np.zeros((2, q))])
    rows, cubics = np.hstack([_drifts(states // 2, storeys), np.zeros((2 * q, 2))]), _lagrange()
    whole, whole_force = np.zeros((FINEST + 1, states, size)), np.zeros((FINEST + 1, states, q, 4))
    at, at_force = np.zeros((FINEST + 1, 3, 2 * q, size)), np.zeros((FINEST + 1, 3, 2 * q, q, 4))
    for level in range(FINEST + 1):
        for i, node in enumerate(NODES[1:]):
            moved, inputs = hold_matrices(wide, wide_push, node * dt_s / 2**level, 3)
            forces = np.einsum("psq,mp->sqm", [node**p * one for p, one in enumerate(inputs)], cubics)
            at[level, i], at_force[level, i] = rows @ moved, np.einsum("rs,sqm->rqm", rows, forces)
            if i == 2:
                whole[level], whole_force[level] = moved[:states], forces[:states]
    return whole, whole_force, at, at_force


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


@shared_part
def _force(code: int, numbers: Array, memory: Array, signs: Array, u: float, v: float, inner: Array) -> float:
    """Return the force of a law beyond the spring at rest, on the branch that holds."""
    if code in (BILINEAR, CLOUGH):
        return memory[FORCE] - memory[SLOPE] * memory[ANCHOR] + (memory[SLOPE] - numbers[0]) * u
    if code == GAP:
        return memory[FORCE] + memory[SLOPE] * (u - memory[ANCHOR])
    if code == CUBIC:
        return numbers[0] * u * u * u
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
    rate[0] = rate[1] = 0.0
    if code == MAXWELL:
        rate[0] = numbers[0] * (v - inner[0] / numbers[1])
    elif code == BOUC_WEN:
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
    k, limit, side = numbers[0], numbers[1], memory[SIDE]
    force = memory[FORCE] + memory[SLOPE] * (u - memory[ANCHOR])
    if memory[BRANCH] == ELASTIC:
        _to_backbone(numbers, memory, 1.0 if u > 0.0 else -1.0)
    elif memory[BRANCH] == BACKBONE or (memory[BRANCH] == RELOADING and side * v < 0.0):
        top = TOP if side > 0.0 else TOP + 2
        memory[RELOADS + 2] = 1.0 if memory[BRANCH] == RELOADING else 0.0
        if memory[BRANCH] == BACKBONE:
            memory[top], memory[top + 1] = u, force
        slope = k * (limit / abs(memory[top])) ** numbers[3]
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
    whole: Array,
    whole_force: Array,
    at: Array,
    at_force: Array,
    weights: Array,
    which: Array,
    code: Array,
    numbers: Array,
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
    laws, states, storeys = len(code), linear.shape[1], force.shape[1]
    memory, signs = np.zeros((laws, MEMORY)), np.zeros((laws, 2))
    inner, made, rates = np.zeros((laws, 4, 2)), np.zeros((laws, 4)), np.zeros((laws, 4, 2))
    base, moved, full = np.zeros((3, 2 * storeys)), np.zeros((4, 2 * storeys)), np.zeros(states + 2)
    nodes = np.zeros((storeys, 4))
    lin, now, after = np.zeros(states + 2), np.zeros(states), np.zeros(states)
    scale = np.zeros(laws)
    for i in range(laws):
        _begin(code[i], numbers[i], memory[i], signs[i])
    ticks, last_level = 1 << FINEST, 0
    for k in range(1, len(record)):
        lin[:states] = linear[k - 1]
        lin[states], lin[states + 1] = record[k - 1], (record[k] - record[k - 1]) / dt_s
        work[k] = work[k - 1]
        position = 0
        while position < ticks:
            level = max(last_level - 1, 0)
            while position % (ticks >> level) != 0:
                level += 1
            for s in range(states + 2):
                full[s] = lin[s] + (now[s] if s < states else 0.0)
            while True:
                outcome = _try(
                    at[level],
                    at_force[level],
                    weights,
                    which,
                    code,
                    numbers,
                    memory,
                    signs,
                    inner,
                    made,
                    rates,
                    base,
                    moved,
                    full,
                    nodes,
                    scale,
                    dt_s / (1 << level),
                )
                if outcome == DONE or (outcome == EVENT and level == FINEST):
                    break
                if outcome == ROUGH and level >= FINEST_SMOOTH:
                    break
                if level == FINEST:
                    return k
                level += 1
            last_level = level
            step_s = dt_s / (1 << level)
            for q in range(storeys):
                for m in range(4):
                    work[k, q] += step_s * weights[3, m] * nodes[q, m] * moved[m, storeys + q]
            for s in range(states):
                total = 0.0
                for c in range(states):
                    total += whole[level, s, c] * now[c]
                for q in range(storeys):
                    for m in range(4):
                        total += whole_force[level, s, q, m] * nodes[q, m]
                after[s] = total
            now[:] = after
            for s in range(states):
                total = 0.0
                for c in range(states + 2):
                    total += whole[level, s, c] * lin[c]
                after[s] = total
            lin[:states] = after
            lin[states] += step_s * lin[states + 1]
            for i in range(laws):
                u, v = moved[3, which[i]], moved[3, storeys + which[i]]
                inner[i, 0] = inner[i, 3]
                scale[i] = max(scale[i], abs(made[i, 3]))
                if _left(code[i], numbers[i], memory[i], signs[i], u, v, inner[i, 0]):
                    _switch(code[i], numbers[i], memory[i], signs[i], u, v, inner[i, 0])
                made[i, 0] = _force(code[i], numbers[i], memory[i], signs[i], u, v, inner[i, 0])
            moved[0] = moved[3]
            position += ticks >> level
        change[k] = now
        for i in range(laws):
            force[k, which[i]] += made[i, 0]
    return -1


@shared_part
def _try(
    at: Array,
    at_force: Array,
    weights: Array,
    which: Array,
    code: Array,
    numbers: Array,
    memory: Array,
    signs: Array,
    inner: Array,
    made: Array,
    rates: Array,
    base: Array,
    moved: Array,
    full: Array,
    nodes: Array,
    scale: Array,
    step_s: float,
) -> int:
    """Solve the laws' forces at the nodes of one step; tell whether it holds, or why it must be halved.

    Reads drifts and forces at the step's start in `moved[0]`, `made[:, 0]` and `inner[:, 0]`.
    """
    laws, storeys = len(code), nodes.shape[0]
    for m in range(3):
        for r in range(2 * storeys):
            total = 0.0
            for s in range(full.size):
                total += at[m, r, s] * full[s]
            base[m, r] = total
    for i in range(laws):
        for m in range(1, 4):
            made[i, m], inner[i, m] = made[i, 0], inner[i, 0]
        _rates(code[i], numbers[i], signs[i], moved[0, storeys + which[i]], inner[i, 0], rates[i, 0])
        rates[i, 1:] = rates[i, 0]
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
            for m in range(1, 4):
                for x in range(2):
                    total = inner[i, 0, x]
                    for j in range(4):
                        total += step_s * weights[m, j] * rates[i, j, x]
                    inner[i, m, x] = total
            for m in range(1, 4):
                u, v = moved[m, which[i]], moved[m, storeys + which[i]]
                _rates(code[i], numbers[i], signs[i], v, inner[i, m], rates[i, m])
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
    for i in range(laws):
        third = made[i, 3] - made[i, 0] + 5.0**0.5 * (made[i, 1] - made[i, 2])
        if abs(third) > SMOOTH * max(scale[i], abs(made[i, 3])):
            return ROUGH
    return DONE
