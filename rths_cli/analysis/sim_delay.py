"""SIM-DELAY: the building whose numerical substructure gets the base shear a pure delay later.

Every derivative here is per substep (h d/dt).

Numerical part and specimen are advanced with their matrix exponentials. Over a substep the table
acceleration and the delayed base shear are cubic Hermite polynomials of their values and derivatives, which
both parts give exactly; the ground acceleration is linear. The substep is halved until the response no
longer changes. Vibrations have to be resolved by the first of them; what a dashpot lets die out within a sample need
not be, as its exponential is exact for any step. Nothing here is shared with the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm, matrix_balance

from rths_cli.analysis.sim import Response, base_shear_n, checked_record, hold_matrices, simulate, state_equation
from rths_cli.errors import InputError
from rths_cli.numerics.compiled import borrowed, entry, part
from rths_cli.numerics.lti import Array, ComplexArray, Integers
from rths_cli.structure import Building, Numerical, Specimen

_MOST_PASSES = 100
_SETTLED = 1e-14


class Part(NamedTuple):
    """A linear part and its state: over a substep y+ = E y + G inputs, output and its derivative are W y + V inputs.

    `band` (n, w) holds w neighbours of each row of E, from column `first` (n,) on: n in full, 2 in modal form. G is
    (n, .), W (2, n), V (2, .); state y (n,) and the next one `following` (n,).
    """

    band: Array
    first: Integers
    G: Array
    W: Array
    V: Array
    y: Array
    following: Array


class Scratch(NamedTuple):
    """Zeroed room of `integrate`: `ends` (6,) ground, its end, force and derivative, theirs at the end; `table` (4,)
    acceleration and derivative, theirs at the end; `now` (3,) ground, force, derivative; `force` (2,) of the specimen.
    """

    ends: Array
    table: Array
    now: Array
    force: Array


@part
def _advance(x: Part, inputs: Array) -> None:
    """Write the state a substep later to `following`."""
    for i in range(x.y.size):
        total = 0.0
        for j in range(x.band.shape[1]):
            total += x.band[i, j] * x.y[x.first[i] + j]
        for j in range(inputs.size):
            total += x.G[i, j] * inputs[j]
        x.following[i] = total


@part
def _read_out(x: Part, state: Array, inputs: Array, result: Array, place: int) -> None:
    """Write output and derivative at one instant to two places of `result`."""
    for i in range(2):
        total = 0.0
        for j in range(state.size):
            total += x.W[i, j] * state[j]
        for j in range(x.V.shape[1]):
            total += x.V[i, j] * inputs[j]
        result[place + i] = total


@part
def _past(history: Array, position: float) -> tuple[float, float]:
    """Return force and derivative at `position` (in substeps) by cubic Hermite, zero before the start."""
    if position <= 0.0:
        return 0.0, 0.0
    base = int(position)
    s = position - base
    start, end = base % history.shape[0], (base + 1) % history.shape[0]
    f0, d0, f1, d1 = history[start, 0], history[start, 1], history[end, 0], history[end, 1]
    c2 = 3.0 * (f1 - f0) - 2.0 * d0 - d1
    c3 = 2.0 * (f0 - f1) + d0 + d1
    return f0 + s * (d0 + s * (c2 + s * c3)), d0 + s * (2.0 * c2 + 3.0 * s * c3)


@part
def _keep(x: Part, result: Array, sample: int, place: int) -> None:
    """Write a state to its places in a row of `result`."""
    for i in range(x.y.size):
        result[sample, place + i] = x.y[i]


@part
def _pass(numerical: Part, specimen: Part, s: Scratch) -> None:
    """Carry both parts over a substep whose inputs at the end are assumed in `ends`: table and force there."""
    _advance(numerical, s.ends)
    s.now[0], s.now[1], s.now[2] = s.ends[1], s.ends[4], s.ends[5]
    _read_out(numerical, numerical.following, s.now, s.table, 2)
    _advance(specimen, s.table)
    _read_out(specimen, specimen.following, s.table[2:], s.force, 0)


@part
def _settle(x: Part) -> None:
    """Take the state a substep later as the state."""
    for i in range(x.y.size):
        x.y[i] = x.following[i]


@entry
def integrate(
    ground: Array,
    substeps: int,
    most: int,
    lag: float,
    force_limit: float,
    numerical: Part,
    specimen: Part,
    s: Scratch,
    history: Array,
    result: Array,
) -> int:
    """Advance both parts from rest; return the number of samples reached within the force limit and `most` substeps.

    `ground` (n,) in m/s^2, `lag` the delay in substeps. `numerical` takes [ground, ground+, f, f', f+,
    f'+], f in N being the delayed force, and gives the table's [a1, a1'] from [ground, f, f']; `specimen`
    takes [a1, a1', a1+, a1'+] and gives [f, f'] from [a1, a1']. `history` (lag + 3 or more, 2) is a zeroed
    ring; `result` (n, n_states + 1) takes the states of both and the delayed force at every sample. When
    lag < 1 the force is iterated until it agrees with its own history.
    """
    ground, numerical, specimen, s, history, result = borrowed((ground, numerical, specimen, s, history, result))
    states = numerical.y.size + specimen.y.size
    largest = 0.0
    s.now[0] = ground[0]
    _read_out(numerical, numerical.y, s.now, s.table, 2)
    _read_out(specimen, specimen.y, s.table[2:], s.force, 0)
    history[0, 0], history[0, 1] = s.force[0], s.force[1]
    for i in range(states + 1):
        result[0, i] = 0.0
    new, step = 0, 0
    for sample in range(ground.shape[0] - 1):
        if step + substeps > most:
            return sample + 1
        rise = (ground[sample + 1] - ground[sample]) / substeps
        for inner in range(substeps):
            step += 1
            new = 0 if new + 1 == history.shape[0] else new + 1
            s.ends[0], s.ends[1] = ground[sample] + rise * inner, ground[sample] + rise * (inner + 1)
            s.ends[2], s.ends[3] = s.ends[4], s.ends[5]
            s.table[0], s.table[1] = s.table[2], s.table[3]
            history[new, 0], history[new, 1] = s.force[0] + s.force[1], s.force[1]
            for _ in range(_MOST_PASSES):
                s.ends[4], s.ends[5] = _past(history, step - lag)
                _pass(numerical, specimen, s)
                change = abs(s.force[0] - history[new, 0]) + abs(s.force[1] - history[new, 1])
                largest = max(largest, abs(s.force[0]))
                history[new, 0], history[new, 1] = s.force[0], s.force[1]
                if lag >= 1.0 or change <= _SETTLED * largest or not math.isfinite(change):
                    break
            if not abs(s.force[0]) <= force_limit:
                return sample + 1
            _settle(numerical)
            _settle(specimen)
        _keep(numerical, result, sample + 1, 0)
        _keep(specimen, result, sample + 1, numerical.y.size)
        result[sample + 1, states] = s.ends[4]
    return ground.shape[0]


DIVERGENCE_FACTOR = 1000.0
_LARGEST_PHASE_PER_SUBSTEP = 0.5  # rad, of the fastest vibration of either part, in the coarsest solution
_DIED_OUT = 20.0  # decay exponent within a sample, from which a motion is not resolved: e^-20 is 2e-9
MOST_WORK = 4e8  # substeps of the whole record times numbers that each handles: 5 to 10 s
_OWN_WORK = 30  # of a substep, in the same unit
_MOST_STOREYS = 300  # in all: the eigenvalues of its critical delay take 10 s
_MOST_SUBSTEPS_PER_SAMPLE = 10_000
LARGEST_CONDITION = 1e6  # of modal coordinates: beyond it they lose six digits
_BLOCK = 1 << 20  # numbers that are turned into responses at a time
_MOST_COMPARED = 1e9  # numbers in the comparison of two solutions; of larger ones every second, third, ... sample


@dataclass(frozen=True)
class DelayedResponse(Response):
    """Response with a delayed base shear; every series is NaN from `diverged_at_s` on.

    `error_estimate` is the change, relative to the peak of each quantity, when `substep_s` was last halved.
    """

    substep_s: float
    diverged_at_s: float | None


@dataclass(frozen=True)
class _Basis:
    """Coordinates y of a part, states = T y: modal ones, of pairs and single `eigenvalues`, or the states (None).

    `A` is that of the states, `rates` its eigenvalues.
    """

    A: Array
    T: Array
    eigenvalues: ComplexArray | None
    rates: ComplexArray

    @property
    def numbers(self) -> int:
        """Return how many numbers a substep takes of the transition."""
        return self.T.size if self.eigenvalues is None else 2 * len(self.T)

    def derivative(self, rows: Array) -> Array:
        """Return what gives the time derivative of `rows` y, (r, n), without inputs.

        The eigenvalues multiply the modes: the product with A would lose the digits of slow modes beside fast ones.
        """
        if self.eigenvalues is None:
            return rows @ self.A
        result, column = np.empty_like(rows), 0
        for value in self.eigenvalues:
            real, imag = rows[:, column], rows[:, column + 1] if value.imag else 0.0
            result[:, column] = value.real * real - value.imag * imag
            if value.imag:
                result[:, column + 1] = value.imag * real + value.real * imag
            column += 2 if value.imag else 1
        return result


@dataclass(frozen=True)
class _Solution:
    """Coordinates of both parts and the delayed force in N, (n, n_states + 1), NaN where it was cut."""

    numbers: Array
    substep_s: float


def simulate_delayed(
    building: Building,
    dt_s: float,
    ground_accel_m_s2: ArrayLike,
    delay_s: float,
    tolerance: float = 1e-6,
    sim: Response | None = None,
) -> DelayedResponse:
    """Solve Eq. 2.3 with f(t - delay_s), 2.5 and 2.6 from rest for a record (n,) linear between samples.

    The substep is halved until no quantity changes by more than `tolerance` of its peak. An absolute acceleration
    beyond 1000 times SIM's peak cuts the response; `sim` is SIM where that is known already. Raises InputError for a
    negative delay, a bad step, record or tolerance, and where that takes more work than is allowed.
    """
    record = checked_record(dt_s, ground_accel_m_s2)
    check_delay(delay_s, tolerance)
    if len(building.M) > _MOST_STOREYS:
        raise InputError(
            f"SIM-DELAY: {len(building.M)} storeys, at most {_MOST_STOREYS} in all can be solved with a delay; use "
            "fewer, or take sim_delay out of runs"
        )
    sim = sim or simulate(building, dt_s, record)
    if delay_s == 0:
        series = {field.name: getattr(sim, field.name) for field in fields(sim)}
        return DelayedResponse(**series, substep_s=dt_s, diverged_at_s=None)
    limit = DIVERGENCE_FACTOR * float(np.abs(sim.abs_accel_m_s2).max())
    bases = _basis(building.numerical), _basis(building.specimen)
    substeps, fastest = _first_substeps(building, bases, dt_s, delay_s)
    most = int(MOST_WORK / (_OWN_WORK + sum(basis.numbers for basis in bases)))
    if 2 * fastest.substeps * len(record) > most:
        raise InputError(fastest.refusal(len(record), most, by_modes=all(b.eigenvalues is not None for b in bases)))
    coarse = _solve(building, bases, dt_s, record, delay_s, substeps, most, limit)
    while True:
        substeps *= 2
        fine = _solve(building, bases, dt_s, record, delay_s, substeps, most, limit)
        change = _relative_change(building, bases, limit, coarse, fine)
        if change <= tolerance or 2 * substeps * len(record) > most:
            del coarse
            return _response(building, bases, dt_s, fine, limit, change)
        coarse = fine


def check_delay(delay_s: float, tolerance: float) -> None:
    """Raise InputError unless the delay is zero or more and the tolerance positive."""
    faults = []
    if not (math.isfinite(delay_s) and delay_s >= 0):
        faults.append(f"delay_s is {delay_s:g} s, but must be finite and 0 s or more: give 0.005, say")
    if not tolerance > 0:
        faults.append(f"tolerance is {tolerance:g}, but it must be positive: give 1e-6, say")
    if faults:
        raise InputError(*faults)


@dataclass(frozen=True)
class _Fastest:
    """The fastest vibration that has to be resolved: its rate in rad/s, its part, and the substeps per sample."""

    rate_rad_s: float
    part: str
    substeps: int

    def refusal(self, samples: int, most: int, by_modes: bool) -> str:
        """Return the sentence that refuses a record of so many samples, `most` substeps being allowed."""
        if not by_modes:
            return (
                f"SIM-DELAY: {2 * self.substeps * samples:.2g} steps over the record, the limit is {most:.2g} for this "
                "building, which has no modes that double precision can tell apart: its masses differ too much, or two "
                "modes coincide; change masses_kg, stiffnesses or dashpots of structure, shorten the record, or take "
                "sim_delay out of runs"
            )
        return (
            f"SIM-DELAY: a vibration of {self.rate_rad_s / (2.0 * math.pi):.3g} Hz in the {self.part} part takes "
            f"{2 * self.substeps * samples:.2g} steps over the record, the limit for this building is {most:.2g}; "
            f"lower the stiffness or raise the masses of structure.{self.part}, shorten the record, or take sim_delay "
            "out of runs"
        )


def _first_substeps(
    building: Building, bases: tuple[_Basis, _Basis], dt_s: float, delay_s: float
) -> tuple[int, _Fastest]:
    """Return the substeps per sample of the coarsest solution, and what asks for most of them.

    They resolve the fastest vibration of either part. With half the interface floor or more on the table the
    force grows at every return, at any frequency: only substeps below the delay show that (such a response
    diverges, and ends, early).
    """
    parts = zip(("numerical", "experimental"), bases, strict=True)
    rates = [(max(map(_rate(dt_s), basis.rates), default=0.0), name) for name, basis in parts]
    rate, name = max(rates)
    needed = max(1, math.ceil(dt_s * rate / _LARGEST_PHASE_PER_SUBSTEP))
    fastest = _Fastest(rate, name, needed)
    if building.interface_experimental_mass_kg >= building.numerical.interface_mass_kg:
        needed = max(needed, math.ceil(min(dt_s / delay_s, _MOST_SUBSTEPS_PER_SAMPLE)))
    return needed, fastest


def _rate(dt_s: float) -> Callable[[complex], float]:
    """Return the function that tells how fast a motion of an eigenvalue is, zero where it dies out within a sample."""
    return lambda value: 0.0 if -value.real * dt_s > _DIED_OUT else abs(value)


def _state_matrices(part: Numerical | Specimen) -> tuple[Array, Array]:
    """Return A, B of a substructure for the acceleration of its base."""
    influence = part.influence if isinstance(part, Numerical) else None
    return state_equation(part.mass_matrix, part.C, part.K, influence)


def _basis(part: Numerical | Specimen) -> _Basis:
    """Return modal coordinates, in which a step costs as much as there are storeys; none where they lose digits."""
    A, _ = _state_matrices(part)
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    eigenvalues, vectors = np.linalg.eig(balanced)
    kept = np.flatnonzero(eigenvalues.imag >= 0.0)
    columns = [
        column for i in kept for column in (vectors[:, i].real, vectors[:, i].imag)[: 2 if eigenvalues[i].imag else 1]
    ]
    T = np.array(columns).T
    rates = eigenvalues.astype(complex)
    if not np.linalg.cond(T) < LARGEST_CONDITION:
        return _Basis(A, np.eye(len(A)), None, rates)
    return _Basis(A, scale[:, None] * T, rates[kept], rates)


def _numerical_part(building: Building, basis: _Basis, h_s: float) -> Part:
    """Prepare Eq. 2.3: inputs ground acceleration (linear) and delayed force (cubic), output a1."""
    A, B = _state_matrices(building.numerical)
    force_in = np.zeros((len(A), 1))
    force_in[len(A) // 2 :, 0] = building.numerical.per_force
    start, slope, _, _ = _moments(basis, B, h_s)
    G = np.hstack([start - slope, slope, *_hermite(_moments(basis, force_in, h_s))])
    a1 = basis.derivative(basis.T)[-1:]
    W = np.vstack([a1, h_s * basis.derivative(a1)])
    inverse_mass = force_in[-1, 0]
    V = np.array([[0.0, inverse_mass, 0.0], [*(h_s * A[-1:] @ np.hstack([B, force_in]))[0], inverse_mass]])
    return _part(basis, h_s, G, W, V)


def _specimen_part(building: Building, basis: _Basis, h_s: float) -> Part:
    """Prepare Eq. 2.5: input a1 (cubic); output the base shear of Eq. 2.6."""
    A, B = _state_matrices(building.specimen)
    masses = building.specimen.masses_kg[None, :]
    shear = -masses @ basis.derivative(basis.T)[len(A) // 2 :]
    W = np.vstack([shear, h_s * basis.derivative(shear)])
    mass = building.interface_experimental_mass_kg
    V = np.array([[-mass, 0.0], [(-h_s * masses @ A[len(A) // 2 :] @ B).item(), -mass]])
    return _part(basis, h_s, np.hstack(_hermite(_moments(basis, B, h_s))), W, V)


def _part(basis: _Basis, h_s: float, G: Array, W: Array, V: Array) -> Part:
    """Return a part in its coordinates, in the memory order the compiled recursion takes."""
    n = len(basis.T)
    if basis.eigenvalues is None:
        band, first = expm(basis.A * h_s), np.zeros(n, dtype=np.int64)
    else:
        band, first = _bands(basis.eigenvalues, h_s)
    band, G, W, V = (np.ascontiguousarray(m, dtype=float) for m in (band, G, W, V))
    return Part(band, first, G, W, V, np.zeros(n), np.zeros(n))


def _moments(basis: _Basis, B: Array, h_s: float) -> list[Array]:
    """Return G_i (n, m), i = 0 to 3: what inputs (t / h)^i through B (n, m) leave in the coordinates after a step."""
    if basis.eigenvalues is None:
        return hold_matrices(basis.A, B, h_s, 3)[1]
    drive, weights = np.linalg.solve(basis.T, B), h_s * _weights(basis.eigenvalues * h_s)
    moments, row = np.zeros((4, *drive.shape)), 0
    for value, weight in zip(basis.eigenvalues, weights.T, strict=True):
        if value.imag:
            made = weight[:, None] * (drive[row] - 1j * drive[row + 1])
            moments[:, row], moments[:, row + 1] = made.real, -made.imag
        else:
            moments[:, row] = weight.real[:, None] * drive[row]
        row += 2 if value.imag else 1
    return list(moments)


def _weights(z: ComplexArray) -> ComplexArray:
    """Return the integrals of exp(z (1 - s)) s^k over s from 0 to 1, (4, m), k = 0 to 3: by parts, or by their series
    where z is small."""
    large = np.abs(z) > 4.0
    far = np.where(large, z, 1.0)
    weights = np.empty((4, len(z)), dtype=complex)
    weights[0] = (np.exp(np.where(large, z, 0.0)) - 1.0) / far
    for k in range(1, 4):
        weights[k] = (k * weights[k - 1] - 1.0) / far
    near = np.where(large, 0.0, z)
    for k in range(4):
        term = total = np.full(len(z), 1.0 / (k + 1), dtype=complex)
        for j in range(40):  # 4^40 over 40! is 1e-24
            term = term * near / (k + 2 + j)
            total = total + term
        weights[k] = np.where(large, weights[k], total)
    return weights


def _bands(eigenvalues: ComplexArray, h_s: float) -> tuple[Array, Integers]:
    """Return exp(A h) in real modal form as two neighbours of each row, (n, 2), and the column of the left one (n,)."""
    n = sum(2 if value.imag else 1 for value in eigenvalues)
    full, row = np.zeros((n, n + 1)), 0
    first = np.minimum(np.arange(n), n - 2)
    for value, step in zip(eigenvalues, np.exp(eigenvalues * h_s), strict=True):
        full[row, row] = step.real
        if value.imag:
            full[row, row + 1], full[row + 1, row], full[row + 1, row + 1] = step.imag, -step.imag, step.real
            first[row + 1] = row
        row += 2 if value.imag else 1
    return np.array([full[i, first[i] : first[i] + 2] for i in range(n)]), first


def _hermite(inputs: list[Array]) -> list[Array]:
    """Turn matrices for 1, s, s^2, s^3 into those for the cubic's value and slope at s = 0, then at s = 1."""
    g0, g1, g2, g3 = inputs
    return [g0 - 3 * g2 + 2 * g3, g1 - 2 * g2 + g3, 3 * g2 - 2 * g3, g3 - g2]


def _solve(
    building: Building, bases: tuple[_Basis, _Basis], dt_s: float, record: Array, delay_s: float, substeps: int,
    most: int, limit_m_s2: float,
) -> _Solution:  # fmt: skip
    """Integrate with `substeps` per sample, `most` in all, until an absolute acceleration passes the limit.

    Raises InputError where so many substeps do not reach that, nor the end of the record.
    """
    h_s = dt_s / substeps
    lag = delay_s / h_s
    numerical, specimen = _numerical_part(building, bases[0], h_s), _specimen_part(building, bases[1], h_s)
    allowed = min(substeps * len(record), most)
    history = np.zeros((math.ceil(min(lag, allowed)) + 3, 2))
    numbers = np.full((len(record), numerical.y.size + specimen.y.size + 1), np.nan)
    moving_mass = building.specimen.masses_kg.sum() + building.interface_experimental_mass_kg
    scratch = Scratch(np.zeros(6), np.zeros(4), np.zeros(3), np.zeros(2))
    limit_n = float(limit_m_s2 * moving_mass)
    reached = integrate(record, substeps, most, lag, limit_n, numerical, specimen, scratch, history, numbers)
    if reached < len(record) and substeps * reached > most:
        raise InputError(
            f"SIM-DELAY: a delay of {delay_s:g} s takes {substeps} steps a sample, {substeps * len(record):.2g} over "
            f"the record, the limit for this building is {most:.2g}; raise delay_s, shorten the record, or take "
            "sim_delay out of runs"
        )
    return _Solution(numbers, h_s)


def _motions(building: Building, bases: tuple[_Basis, _Basis]) -> Callable[[Array], tuple[Array, Array, Array]]:
    """Return the function that turns numbers (k, n_states + 1) into relative displacement, relative velocity and
    absolute acceleration, each (n_storeys, k)."""
    p, n, split = len(building.numerical.masses_kg), len(building.specimen.masses_kg), len(bases[0].T)
    own, top = (np.vstack([basis.T, basis.derivative(basis.T)[len(basis.T) // 2 :]]) for basis in bases)

    def motions(numbers: Array) -> tuple[Array, Array, Array]:
        y, z = own @ numbers[:, :split].T, top @ numbers[:, split:-1].T
        if building.numerical.M is None:
            y[-1] += numbers[:, -1] / building.numerical.masses_kg[-1]
        else:
            y[2 * p :] += np.outer(building.numerical.per_force, numbers[:, -1])
        z[:n] += y[p - 1]
        z[n : 2 * n] += y[2 * p - 1]
        disp, vel, accel = (np.concatenate([y[i * p : (i + 1) * p], z[i * n : (i + 1) * n]]) for i in range(3))
        return disp, vel, accel

    return motions


def _response(
    building: Building, bases: tuple[_Basis, _Basis], dt_s: float, solution: _Solution, limit_m_s2: float, change: float
) -> DelayedResponse:
    """Assemble the series of a solution, NaN from where an absolute acceleration passes the limit."""
    motions, count, samples = _motions(building, bases), len(building.M), len(solution.numbers)
    series = np.empty((3, count, samples))
    within, block = np.empty(samples, dtype=bool), _samples_at_once(solution)
    for first in range(0, samples, block):
        some = slice(first, first + block)
        series[:, :, some] = motions(solution.numbers[some])
        within[some] = np.abs(series[2][:, some]).max(axis=0) <= limit_m_s2
    end = samples if within.all() else int(np.argmin(within))
    series[:, :, end:] = np.nan
    diverged_at_s = None if within.all() else end * dt_s
    disp, vel, accel = series
    return DelayedResponse(disp, vel, accel, base_shear_n(building, accel), change, solution.substep_s, diverged_at_s)


def _samples_at_once(solution: _Solution) -> int:
    """Return how many samples are turned into responses at a time."""
    return max(1, _BLOCK // solution.numbers.shape[1])


def _relative_change(
    building: Building, bases: tuple[_Basis, _Basis], limit_m_s2: float, coarse: _Solution, fine: _Solution
) -> float:
    """Return the largest difference of any quantity over its peak, where neither solution has been cut."""
    motions, samples = _motions(building, bases), len(fine.numbers)
    stride = math.ceil(2.0 * fine.numbers.size * len(building.M) / _MOST_COMPARED)
    changes, peaks = np.zeros(4), np.zeros(4)
    block = stride * _samples_at_once(fine)
    for first in range(0, samples, block):
        some = slice(first, first + block, stride)
        before, after = ([*motions(solution.numbers[some])] for solution in (coarse, fine))
        for quantities in (before, after):
            quantities.append(base_shear_n(building, quantities[2])[None])
        within = np.all([np.abs(one[2]).max(axis=0) <= limit_m_s2 for one in (before, after)], axis=0)
        end = len(within) if within.all() else int(np.argmin(within))
        for i in range(4 if end else 0):
            changes[i] = max(changes[i], np.abs(after[i][:, :end] - before[i][:, :end]).max())
            peaks[i] = max(peaks[i], np.abs(after[i][:, :end]).max())
        if end < len(within):
            break
    return float((changes / np.where(peaks > 0.0, peaks, 1.0)).max())
