"""SIM: the exact response of the whole building to a piecewise-linear ground acceleration.

The state equation is solved with the matrix exponential and a first-order hold of the record, mode by mode:
each complex mode is one recursive filter of order one, so that the recursion grows linearly with the storeys.
Nothing here is shared with the loop, whose reference this is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm, matrix_balance

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, ComplexArray, Integers, driven_modes
from rths_cli.structure import Building

_LARGEST_EIGENVECTOR_CONDITION = 1e6  # beyond it the modal sum loses six digits: use the matrix recursion
_CHECKED_STEPS = 4000
_ROUNDED = 1e-14  # of the peak of a state: fifty rounding errors
_LARGEST_ERROR = 1e-2  # relative to the peak, by an estimate that is far above the error beside stiff storeys
MOST_VALUES = 1.1e7  # storeys times samples, in each of some ten arrays: 100 storeys and 55 s at 2 kHz
_MOST_RECURSION = 1e10  # samples times numbers of the matrix recursion: 10 s


@dataclass(frozen=True)
class LawHistory:
    """What is known of laws: `force_n` (n_storeys, n) the sum of the laws' forces in addition to the storeys' springs,
    `work_j` (n_storeys, n) the work that it has done so far, positive where the storey has taken it up."""

    force_n: Array
    work_j: Array


@dataclass(frozen=True)
class Response:
    """Response of a building to a record.

    `rel_disp_m`, `rel_vel_m_s` (n_storeys, n) relative to the ground, `abs_accel_m_s2` (n_storeys, n)
    absolute, `base_shear_n` (n,) the force f of Eq. 2.6; `error_estimate` is relative to the peak of each
    quantity. `laws` is that of storeys with laws.
    """

    rel_disp_m: Array
    rel_vel_m_s: Array
    abs_accel_m_s2: Array
    base_shear_n: Array
    error_estimate: float
    laws: LawHistory | None = field(default=None, kw_only=True)


def simulate(building: Building, dt_s: float, ground_accel_m_s2: ArrayLike) -> Response:
    """Solve M d2x + C dx + K x = -M 1 a_g (Eq. 2.1) from rest for a record (n,) linear between samples.

    Exact but for rounding: `error_estimate` is the largest one-step residual against the matrix
    exponential, accumulated over the memory of the least damped mode. Raises InputError for a step that is
    not positive, a record that is not finite, more work than is allowed, and a building whose storeys differ so much
    that double precision cannot solve it.
    """
    record = checked_record(dt_s, ground_accel_m_s2)
    check_size(len(building.M), len(record), dt_s)
    A, B = state_equation(building.M, building.C, building.K, building.influence)
    n = len(building.M)
    solved = modal_states(A, B, dt_s, record)
    if solved is None:
        states = _recursive_states(A, B, dt_s, record)
        solved = states, A[n:] @ states
    states, abs_accel = solved
    peaks = np.repeat([_peak(states[:n]), _peak(states[n:]), _peak(abs_accel)], n)
    error = accumulated_residual(A, B, dt_s, record, states, peaks)
    if not error <= _LARGEST_ERROR:
        raise InputError(
            f"SIM: this building can only be solved to {error:.1g} of its peak (at most {_LARGEST_ERROR:g}): its "
            "storeys are too unlike; bring the masses, stiffnesses and dashpots of structure closer together"
        )
    return Response(states[:n], states[n:], abs_accel, base_shear_n(building, abs_accel, states), error)


def check_size(storeys: int, samples: int, dt_s: float) -> None:
    """Raise InputError where the series of a response would be too large."""
    if storeys * samples > MOST_VALUES:
        rate_hz = MOST_VALUES / (storeys * samples * dt_s)
        raise InputError(
            f"sample_rate_hz: {1.0 / dt_s:g} Hz makes {samples} samples of {storeys} storeys, {storeys * samples:.2g} "
            f"values in each series, the limit is {MOST_VALUES:.2g}; lower it to {rate_hz:.3g} Hz, shorten the record, "
            "or use fewer storeys"
        )


def base_shear_n(building: Building, abs_accel_m_s2: Array, states: Array | None = None) -> Array:
    """Return f = -m1E a1 - sum m_j a_j (n,) in N (Eq. 2.6) from absolute accelerations (n_storeys, n).

    With an attached specimen f = -m a - c v - k x of the interface, whose displacement and velocity `states`
    (2 n_storeys, n) hold.
    """
    p = len(building.numerical.masses_kg)
    interface = building.interface_experimental_mass_kg * abs_accel_m_s2[p - 1]
    specimen = building.specimen
    if specimen.attached:
        assert states is not None
        place, velocity = states[p - 1], states[len(states) // 2 + p - 1]
        return np.asarray(-interface - specimen.C[0, 0] * velocity - specimen.K[0, 0] * place)
    return -interface - specimen.masses_kg @ abs_accel_m_s2[p:]


def checked_record(dt_s: float, ground_accel_m_s2: ArrayLike) -> Array:
    """Return the record as floats (n,), or raise InputError with one sentence per fault."""
    record = np.asarray(ground_accel_m_s2, dtype=float)
    faults = []
    if not (math.isfinite(dt_s) and dt_s > 0):
        faults.append(f"dt_s is {dt_s:g} s, but the sampling step must be positive: give 1 / sample_rate_hz")
    if record.ndim != 1 or record.size == 0:
        faults.append(f"ground_accel_m_s2 has shape {record.shape}, but must be a series (n,): pass one record")
    elif not np.all(np.isfinite(record)):
        first = int(np.argmin(np.isfinite(record)))
        faults.append(f"ground_accel_m_s2[{first}] is {record[first]}, but must be finite: repair the record")
    if faults:
        raise InputError(*faults)
    return record


def state_equation(M: Array, C: Array, K: Array, influence: Array | None = None) -> tuple[Array, Array]:
    """Return A (2n, 2n), B (2n, 1) of M d2x + C dx + K x = -M r a, state [x, dx]; A[n:] gives d2x + r a.

    `influence` r (n,): None stands for ones.
    """
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    return A, np.concatenate([np.zeros((n, 1)), -(np.ones((n, 1)) if influence is None else influence[:, None])])


def hold_matrices(A: Array, B: Array, h_s: float, degree: int) -> tuple[Array, list[Array]]:
    """Return exp(A h) and G_i of x(h) = exp(A h) x(0) + sum G_i c_i for the input sum c_i (t/h)^i.

    Source: Van Loan, IEEE Trans. Automatic Control 23 (1978), the exponential of a block matrix.
    """
    n, m = B.shape
    chain = np.zeros((n + m * (degree + 1),) * 2, dtype=np.result_type(A, B))
    chain[:n, :n] = A * h_s
    chain[:n, n : n + m] = B * h_s
    chain[n : n + m * degree, n + m :] = np.eye(m * degree)
    moved = expm(chain)[:n]
    inputs = [math.factorial(i) * moved[:, n + m * i : n + m * (i + 1)] for i in range(degree + 1)]
    return moved[:, :n], inputs


def modal_states(A: Array, B: Array, dt_s: float, record: Array) -> tuple[Array, Array] | None:
    """Sum the modes to states (2n, n_samples), in m and m/s, and absolute accelerations (n, n_samples), in m/s^2; None
    when the eigenvectors are too ill-conditioned. In balanced units they are not, only because some storeys are stiff.

    A (2n, 2n) and B (2n, 1) as of `state_equation`, record (n_samples,) in m/s^2.
    """
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    eigenvalues, vectors = np.linalg.eig(balanced)
    if not np.linalg.cond(vectors) < _LARGEST_EIGENVECTOR_CONDITION:
        return None
    participation = np.linalg.solve(vectors, (B / scale[:, None]).astype(vectors.dtype))[:, 0]
    kept = np.flatnonzero(eigenvalues.imag >= 0)
    weights = scale[:, None] * vectors[:, kept] * np.where(eigenvalues[kept].imag > 0, 2.0, 1.0)
    modal = held_modes(eigenvalues[kept], participation[kept].astype(complex), dt_s, record).reshape(2 * len(kept), -1)
    rates = (weights * eigenvalues[kept])[len(A) // 2 :]  # slow modes keep their digits beside fast ones
    states, accel = (np.hstack([rows.real, -rows.imag]) @ modal for rows in (weights, rates))
    return states, accel


def held_modes(eigenvalues: ComplexArray, participation: ComplexArray, dt_s: float, record: Array) -> Array:
    """Solve dz/dt = eigenvalue z + participation a_g from rest for modes (m,): real and imaginary part (2, m, n)."""
    poles, starts, slopes = np.zeros((3, len(eigenvalues)), dtype=complex)
    for i, (eigenvalue, drive) in enumerate(zip(eigenvalues, participation, strict=True)):
        pole, (start, slope) = hold_matrices(np.array([[eigenvalue]]), np.array([[drive]]), dt_s, 1)
        poles[i], starts[i], slopes[i] = pole.item(), start.item(), slope.item()
    return driven_modes(poles, slopes, starts - slopes, record)


def _recursive_states(A: Array, B: Array, dt_s: float, record: Array) -> Array:
    """Step the matrix recursion sample by sample: states (2n, n_samples); raises InputError where that takes long."""
    if len(record) * (1000.0 + A.size) > _MOST_RECURSION:
        raise InputError(
            f"SIM: two modes of this building coincide; {len(record)} samples of {len(A) // 2} storeys take too long "
            "without modes; change a mass, a stiffness or a dashpot of structure by 1 %, or shorten the record"
        )
    transition, (start, slope) = hold_matrices(A, B, dt_s, 1)
    drive = record[:-1, None] * start[:, 0] + np.diff(record)[:, None] * slope[:, 0]
    states = np.zeros((len(record), len(A)))
    for k, push in enumerate(drive):
        states[k + 1] = transition @ states[k] + push
    return states.T.copy()


def accumulated_residual(A: Array, B: Array, dt_s: float, record: Array, states: Array, peaks: Array) -> float:
    """Return the largest residual of a step over `peaks` (3n,), times the steps the building remembers.

    `states` (2n, n_samples) in m and m/s, `peaks` those of displacements, velocities and absolute accelerations.
    What rounds the states is no residual of the accelerations, which stiff storeys would make large: those come from
    the modes.
    """
    if len(record) < 2:
        return 0.0
    k = sampled_steps(len(record))
    return residual_of_steps(A, B, dt_s, record, (k, states[:, k], states[:, k + 1]), peaks)


def sampled_steps(samples: int) -> Integers:
    """Return the steps (c,) of a record whose residuals are computed."""
    return np.unique(np.floor(np.linspace(0, samples - 2, _CHECKED_STEPS))).astype(int)


def residual_of_steps(
    A: Array, B: Array, dt_s: float, record: Array, steps: tuple[Integers, Array, Array], peaks: Array
) -> float:
    """Return what `accumulated_residual` does, for steps (c,) with the states (2n, c) before and after each."""
    transition, (start, slope) = hold_matrices(A, B, dt_s, 1)
    k, before, after = steps
    step = transition @ before + start * record[k] + slope * (record[k + 1] - record[k])
    residual = after - step
    beyond = np.where(np.abs(residual) > _ROUNDED * peaks[: len(A), None], residual, 0.0)
    outputs = np.abs(np.concatenate([residual, A[len(A) // 2 :] @ beyond])).max(axis=1)
    decay = 1.0 - np.abs(np.linalg.eigvals(transition)).max()
    remembered = min(len(record), 1.0 / decay) if decay > 0 else len(record)
    return float((outputs / peaks).max() * remembered)


def _peak(series: Array) -> float:
    """Return the largest absolute value, or 1 for a response that is zero throughout."""
    return float(np.abs(series).max()) or 1.0
