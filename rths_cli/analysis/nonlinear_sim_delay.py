"""SIM-DELAY of a building whose storeys have laws: its numerical storeys get the base shear a pure delay later.

Both parts are one linear system with a matrix exponential, the specimen driven by the interface floor, and the laws'
force is solved as in SIM (`nonlinear_sim`), events included. Over a substep, of the delay at most, the delayed base
shear is known: a cubic Hermite polynomial of its values and one-sided derivatives in the history. The substep is halved
until the response no longer changes. With mass of the interface floor on the table a jump of the shear's derivative
comes back after each delay (a neutral equation) and is met at the ends of substeps only; then accelerations converge
in proportion to the substep. Nothing here is shared with the loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from rths_cli.analysis.nonlinear_sim import (
    LawState,
    Moving,
    Tables,
    advance,
    at_rest,
    begin,
    copy,
    drift_rows,
    laws_at_rest,
    push_matrix,
    read_forces,
    simulate_with_laws,
    step_tables,
    too_steep,
)
from rths_cli.analysis.sim import LawHistory, Response, base_shear_n, checked_record, state_equation
from rths_cli.analysis.sim_delay import DIVERGENCE_FACTOR, DelayedResponse, check_delay, simulate_delayed
from rths_cli.errors import InputError
from rths_cli.numerics.compiled import borrowed, entry, shared_part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.structure import Building

LARGEST_PHASE = 0.5  # rad in the coarsest substep, of the fastest vibration
DIED_OUT = 20.0  # decay exponent within a sample, from which a motion is not resolved: e^-20 is 2e-9
MOST_WORK = 2e9  # substeps of the whole record times numbers that each handles: 5 to 10 s
LAWS_WORK = 500  # of each storey with laws in a substep, in the same unit
ON_GRID = 1e-9  # of a substep, by which a delay may miss a whole number of them


class Shear(NamedTuple):
    """Base shear f and its derivative per substep h: `state` (2, 2n) of the states, `late` (2, 2) of the delayed shear
    and its derivative, `ground` that of the derivative, `laws` (2, q) of the forces and their derivatives.

    f = state[0] x + late[0, 0] f_d + laws[0] g; f' = state[1] x + ground a_g + late[1] [f_d, f_d'] + laws[1] g
    + laws[0] g'.
    """

    state: Array
    late: Array
    ground: float
    laws: Array


@dataclass(frozen=True)
class _System:
    """Both parts as one: states [x, dx] of the numerical storeys to the ground and of the specimen to the table.

    dx = A x + B a_g + E f_d + push g. f = `shear` A x + ... of the same, for `shear` (1, 2n): Eq. 2.6.
    """

    A: Array
    B: Array
    E: Array
    push: Array
    rows: Array
    shear: Array


@dataclass(frozen=True)
class _Solution:
    """States (2n, k), delayed shear in N (k,), forces and work of laws (q, k) of the samples before the cut."""

    states: Array
    late_n: Array
    force_n: Array
    work_j: Array
    substep_s: float


def simulate_delayed_with_laws(
    building: Building,
    dt_s: float,
    ground_accel_m_s2: ArrayLike,
    delay_s: float,
    tolerance: float = 1e-6,
    sim: Response | None = None,
) -> DelayedResponse:
    """Solve Eq. 2.3 with laws and with f(t - delay_s), 2.5 and 2.6 from rest for a record (n,) linear between samples.

    The substep is halved until no quantity changes by more than `tolerance` of its peak, or until that takes more work
    than is allowed: `error_estimate` tells. An absolute acceleration beyond 1000 times SIM's peak cuts the response;
    `sim` is SIM where that is known already. Raises InputError for a negative delay, a bad step, record or tolerance,
    for laws that cannot be solved, and where the coarsest substep takes more work than is allowed.
    """
    record = checked_record(dt_s, ground_accel_m_s2)
    check_delay(delay_s, tolerance)
    sim = sim or simulate_with_laws(building, dt_s, record)
    if delay_s == 0:
        series = {field.name: getattr(sim, field.name) for field in fields(sim)}
        return DelayedResponse(**series, substep_s=dt_s, diverged_at_s=None)
    if building.linear:
        return simulate_delayed(building, dt_s, record, delay_s, tolerance, sim)
    limit = DIVERGENCE_FACTOR * float(np.abs(sim.abs_accel_m_s2).max())
    storeys = np.unique(building.laws.storey)
    system = _system(building, storeys)
    most = MOST_WORK / (2 * len(system.A) ** 2 + LAWS_WORK * len(storeys))
    substeps = _first_substeps(system, dt_s, delay_s)
    if 2 * substeps * len(record) > most:
        raise InputError(
            f"SIM-DELAY: a delay of {delay_s:g} s and the fastest vibration of this building take "
            f"{2 * substeps * len(record):.2g} steps over the record, the limit beside laws is {most:.2g}; raise "
            "delay_s, lower the largest stiffness of structure, shorten the record, or take sim_delay out of runs"
        )
    coarse = _solve(building, system, dt_s, record, delay_s, substeps, limit)
    while True:
        substeps *= 2
        fine = _solve(building, system, dt_s, record, delay_s, substeps, limit)
        before, after = _response(building, system, coarse, dt_s, limit), _response(building, system, fine, dt_s, limit)
        change = _relative_change(before, after)
        if change <= tolerance or 2 * substeps * len(record) > most:
            return _whole(after, len(record), change)
        coarse = fine


def _system(building: Building, storeys: Integers) -> _System:
    """Return both parts of a building as one system, with laws in these storeys."""
    own, top = building.numerical, building.specimen
    p, n = len(own.masses_kg), len(top.masses_kg)
    A_own, B_own = state_equation(np.diag(own.masses_kg), own.C, own.K)
    A_top, B_top = state_equation(np.diag(top.masses_kg), top.C, top.K)
    E_own = np.zeros((2 * p, 1))
    E_own[-1] = 1.0 / own.masses_kg[-1]
    below, above = storeys[storeys < p], storeys[storeys >= p] - p
    push_own = np.hstack([push_matrix(np.diag(own.masses_kg), below), np.zeros((2 * p, len(above)))])
    push_top = np.hstack([np.zeros((2 * n, len(below))), push_matrix(np.diag(top.masses_kg), above)])
    to_top = np.vstack([np.zeros((p, 2 * p)), A_own[p:]])[-1:]  # the interface floor's absolute acceleration
    A = np.block([[A_own, np.zeros((2 * p, 2 * n))], [B_top @ to_top, A_top]])
    E, push = np.vstack([E_own, B_top @ E_own[-1:]]), np.vstack([push_own, push_top + B_top @ push_own[-1:]])
    rows = _drift_rows(p, n, below, above)
    shear = np.zeros((1, 2 * (p + n)))  # of the rates: absolute accelerations of interface and specimen, which drop a1
    shear[0, 2 * p - 1] = -building.interface_experimental_mass_kg - top.masses_kg.sum()
    shear[0, 2 * p + n :] = -top.masses_kg
    return _System(A, np.vstack([B_own, np.zeros((2 * n, 1))]), E, push, rows, shear)


def _drift_rows(p: int, n: int, below: Integers, above: Integers) -> Array:
    """Return the rows (2q, 2p + 2n) of the drifts of all storeys with laws, then of their rates.

    The specimen's displacements are relative to the table, and so its lowest storey's drift is one of them.
    """
    own, top = drift_rows(p, below), drift_rows(n, above)
    halves = zip(np.split(own, 2), np.split(top, 2), strict=True)
    return np.vstack([block_diag(first, second) for first, second in halves])


def _shear(building: Building, system: _System, h_s: float) -> Shear:
    """Return what makes the base shear and its derivative per substep."""
    A, late, laws = system.A, system.shear @ system.E, system.shear @ system.push
    state = system.shear @ A
    return Shear(
        np.ascontiguousarray(np.vstack([state, h_s * state @ A])),
        np.array([[late.item(), 0.0], [(h_s * state @ system.E).item(), late.item()]]),
        float((h_s * state @ system.B).item()),
        np.ascontiguousarray(np.vstack([laws, h_s * state @ system.push])),
    )


def _first_substeps(system: _System, dt_s: float, delay_s: float) -> int:
    """Return the substeps per sample of the coarsest solution: below the delay, and what vibrates is resolved."""
    rates = [abs(value) for value in np.linalg.eigvals(system.A) if -value.real * dt_s <= DIED_OUT]
    return max(1, math.ceil(dt_s * max(rates) / LARGEST_PHASE), math.ceil(dt_s / delay_s * (1.0 - ON_GRID)))


def _solve(
    building: Building, system: _System, dt_s: float, record: Array, delay_s: float, substeps: int, limit_m_s2: float
) -> _Solution:
    """Integrate with `substeps` per sample until the base shear tells that an acceleration passes the limit."""
    h_s = dt_s / substeps
    lag = delay_s / h_s
    lag = float(round(lag)) if abs(lag - round(lag)) < ON_GRID * lag else lag
    storeys, which = np.unique(building.laws.storey, return_inverse=True)
    tables = step_tables(system.A, ((system.B, 1), (system.E, 3)), system.push, system.rows, h_s)
    samples, states = len(record), len(system.A)
    numbers = np.zeros((samples, states + 1 + 2 * len(storeys)))
    history = np.zeros((math.ceil(min(lag, substeps * samples)) + 3, 4))
    moving_mass = building.specimen.masses_kg.sum() + building.interface_experimental_mass_kg
    reached = _march_delayed(
        tables, laws_at_rest(building.laws, which, tables), at_rest(states, 6), _shear(building, system, h_s), record,
        substeps, h_s, lag, float(limit_m_s2 * moving_mass), history, np.zeros((3, len(storeys))), numbers,
    )  # fmt: skip
    if reached < 0:
        raise InputError(f"SIM-DELAY: {too_steep(-reached * dt_s)}")
    parts = np.split(numbers[:reached].T, [states, states + 1, states + 1 + len(storeys)])
    return _Solution(parts[0], parts[1][0], parts[2], parts[3], h_s)


@shared_part
def _past(history: Array, position: float, after: bool) -> tuple[float, float]:
    """Return shear and derivative at `position` (in substeps), its right-hand one if `after`; zero before the start."""
    if position < 0.0 or (position == 0.0 and not after):
        return 0.0, 0.0
    base = int(position)
    s = position - base
    if s == 0.0 and not after:
        base, s = base - 1, 1.0
    piece = (base + 1) % history.shape[0]
    f0, d0, f1, d1 = history[piece, 0], history[piece, 1], history[piece, 2], history[piece, 3]
    c2, c3 = 3.0 * (f1 - f0) - 2.0 * d0 - d1, 2.0 * (f0 - f1) + d0 + d1
    return f0 + s * (d0 + s * (c2 + s * c3)), d0 + s * (2.0 * c2 + 3.0 * s * c3)


@shared_part
def _read_shear(shear: Shear, lin: Array, late: float, slope: float, force: Array, rate: Array) -> tuple[float, float]:
    """Return shear and derivative for a state, the delayed shear and its derivative, and the laws' likewise."""
    states = shear.state.shape[1]
    f, d = shear.late[0, 0] * late, shear.late[1, 0] * late + shear.late[1, 1] * slope + shear.ground * lin[states]
    for s in range(states):
        f += shear.state[0, s] * lin[s]
        d += shear.state[1, s] * lin[s]
    for q in range(len(force)):
        f += shear.laws[0, q] * force[q]
        d += shear.laws[1, q] * force[q] + shear.laws[0, q] * rate[q]
    return f, d


@entry
def _march_delayed(
    tables: Tables,
    laws: LawState,
    moving: Moving,
    shear: Shear,
    record: Array,
    substeps: int,
    h_s: float,
    lag: float,
    limit_n: float,
    history: Array,
    storeys: Array,
    numbers: Array,
) -> int:
    """Advance both parts from rest; return the number of samples within the limit of the shear, the negative number of
    the sample where the laws cannot be solved.

    `lag` is the delay in substeps, at least one. `history` (lag + 3 or more, 4) is a zeroed ring of the substeps: shear
    and right-hand derivative at the start, shear and left-hand derivative at the end. `storeys` (3, q) zeros.
    `numbers` (n, 2n + 1 + 2q) takes states, delayed shear, forces and work of laws.
    """
    tables, laws, moving, shear = borrowed((tables, laws, moving, shear))
    record, history, storeys, numbers = borrowed((record, history, storeys, numbers))
    lin, now = moving.lin, moving.now
    work, force, none = storeys[0], storeys[1], storeys[2]
    states, q_all = shear.state.shape[1], len(work)
    begin(laws)
    step = 0
    for k in range(1, len(record)):
        rise = (record[k] - record[k - 1]) / substeps
        for part in range(substeps):
            f0, d0 = _past(history, step - lag, True)
            step += 1
            f1, d1 = _past(history, step - lag, False)
            c2, c3 = 3.0 * (f1 - f0) - 2.0 * d0 - d1, 2.0 * (f0 - f1) + d0 + d1
            lin[states], lin[states + 1] = record[k - 1] + rise * part, rise
            lin[states + 2], lin[states + 3], lin[states + 4], lin[states + 5] = f0, d0, 2.0 * c2, 6.0 * c3
            piece = history[step % history.shape[0]]
            piece[0], piece[1] = _read_shear(shear, lin, f0, d0, force, none)
            if not advance(tables, laws, h_s, moving, work):
                return -k
            for s in range(states):
                lin[s] += now[s]
                now[s] = 0.0
            read_forces(laws, force)
            piece[2], piece[3] = _read_shear(shear, lin, f1, d1, force, laws.slope[1])
            for q in range(q_all):
                piece[1] += shear.laws[0, q] * laws.slope[0, q]
            if not abs(piece[2]) <= limit_n:
                return k
        row = numbers[k]
        copy(lin, row, states)
        row[states] = f1
        for q in range(q_all):
            row[states + 1 + q], row[states + 1 + q_all + q] = force[q], work[q]
    return len(record)


def _response(
    building: Building, system: _System, solution: _Solution, dt_s: float, limit_m_s2: float
) -> DelayedResponse:
    """Assemble the series of a solution up to where an absolute acceleration passes the limit; no change is known."""
    p, n = len(building.numerical.masses_kg), len(building.specimen.masses_kg)
    x, storeys = solution.states, np.unique(building.laws.storey)
    rates = system.A @ x + system.E * solution.late_n + system.push @ solution.force_n
    disp = np.vstack([x[:p], x[2 * p : 2 * p + n] + x[p - 1]])
    vel = np.vstack([x[p : 2 * p], x[2 * p + n :] + x[2 * p - 1]])
    accel = np.vstack([rates[p : 2 * p], rates[2 * p + n :] + rates[2 * p - 1]])
    within = np.abs(accel).max(axis=0) <= limit_m_s2
    end = len(within) if within.all() else int(np.argmin(within))
    history = LawHistory(np.zeros((p + n, end)), np.zeros((p + n, end)))
    history.force_n[storeys], history.work_j[storeys] = solution.force_n[:, :end], solution.work_j[:, :end]
    disp, vel, accel = disp[:, :end], vel[:, :end], accel[:, :end]
    return DelayedResponse(
        disp, vel, accel, base_shear_n(building, accel), math.nan, solution.substep_s, end * dt_s, laws=history
    )


def _relative_change(coarse: DelayedResponse, fine: DelayedResponse) -> float:
    """Return the largest difference of any quantity over its peak, where neither solution has been cut."""
    changes = []
    for name in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2", "base_shear_n"):
        before, after = getattr(coarse, name), getattr(fine, name)
        end = min(before.shape[-1], after.shape[-1])
        peak = float(np.abs(after[..., :end]).max(initial=0.0)) or 1.0
        changes.append(float(np.abs(after[..., :end] - before[..., :end]).max(initial=0.0)) / peak)
    return max(changes)


def _whole(found: DelayedResponse, samples: int, change: float) -> DelayedResponse:
    """Return the response over all samples, NaN after its end."""
    end = len(found.base_shear_n)

    def filled(series: Array) -> Array:
        result = np.full((*series.shape[:-1], samples), np.nan)
        result[..., :end] = series
        return result

    assert found.laws is not None  # _response
    return DelayedResponse(
        filled(found.rel_disp_m),
        filled(found.rel_vel_m_s),
        filled(found.abs_accel_m_s2),
        filled(found.base_shear_n),
        change,
        found.substep_s,
        None if end == samples else found.diverged_at_s,
        laws=LawHistory(filled(found.laws.force_n), filled(found.laws.work_j)),
    )
