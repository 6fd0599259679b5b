"""Data classes of linear systems with their frequency response: `StateSpace`, `Block` (discrete), `Frf`, `Model`
(poles, zeros).

Time or frequency is the last axis of every array. All quantities are SI.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Integers = NDArray[np.int64]

FEW_POINTS = 16  # up to which a frequency response is solved point by point
ROWS_AT_ONCE = 24  # of a triangular solution: the rest of the matrix acts on them in one product
MOST_CONDITION = 1e6  # of eigenvectors that stand for their states
POINTS_AT_ONCE = 65_536  # complex numbers of the states at once: they stay in the processor's cache


@dataclass(frozen=True)
class StateSpace:
    """Continuous linear system dx/dt = A x + B u, y = C x + D u.

    Shapes: A (n, n), B (n, m), C (p, n), D (p, m).
    """

    A: Array
    B: Array
    C: Array
    D: Array

    def response(self, frequency_hz: Array) -> ComplexArray:
        """Return the frequency response, shape (p, m, n_frequencies)."""
        return _response(self, 2j * np.pi * np.asarray(frequency_hz, dtype=float), 0.0)


@dataclass(frozen=True)
class Block:
    """Discrete linear block x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k] of the step.

    Shapes: A (n, n), B (n, m), C (p, n), D (p, m); `inputs` and `outputs` name the signals with their units.
    """

    name: str
    A: Array
    B: Array
    C: Array
    D: Array
    dt_s: float
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def response(self, frequency_hz: Array) -> ComplexArray:
        """Return the frequency response at z = exp(j w dt), shape (p, m, n_frequencies)."""
        z = np.exp(2j * np.pi * np.asarray(frequency_hz, dtype=float) * self.dt_s)
        return _response(self, z, 1.0)

    @property
    def affine(self) -> bool:
        """Return True, as control.part_designs.PartDesign."""
        return True

    @property
    def linear(self) -> bool:
        """Return True, as control.part_designs.PartDesign."""
        return True

    @property
    def logs(self) -> tuple[()]:
        """Return nothing: its outputs are in the log already."""
        return ()

    @property
    def multiplications(self) -> int:
        """Return the number of entries of A, B, C and D."""
        return self.A.size + self.B.size + self.C.size + self.D.size

    def linearised(self, at: Array | None = None) -> Block:
        """Return the block itself, whatever its state."""
        return self


@dataclass(frozen=True)
class Frf:
    """Estimated frequency response function of one output to one input.

    `response` (n,) complex, `coherence` (n,), `relative_error` (n,): standard error of |response| over |response|.
    `bandwidth_lines`: over how many lines the noise of one is spread (Hann window: 1.5), so that neighbours share it.
    """

    frequency_hz: Array
    response: ComplexArray
    coherence: Array
    relative_error: Array
    averages: int
    bandwidth_lines: float = 1.0


@dataclass(frozen=True)
class Model:
    """Identified table: command (V) to corrected table acceleration (m/s^2).

    G(s) = gain * prod(s - zeros) / prod(s - poles) * exp(-s delay_s), roots in rad/s. `delay_s` is the part of the
    loop's transport delay that the fit was told, half a sample of the hold included; the rest is in the poles and
    zeros. What a hold takes off the size, sin(x) / x with x = pi f dt_s, is in every response. A sample of the table
    also carries an alias of the hold's staircase, ripple * (u[k - l] - u[k - l - 1]), l = max(latency_samples, 1);
    samples corrected for an AC coupling of the sensor, corner `coupling_hz` (0: none), carry its integral too.
    """

    zeros: ComplexArray
    poles: ComplexArray
    gain: float
    delay_s: float
    band_hz: tuple[float, float]
    ripple_m_s2_per_v: float = 0.0
    latency_samples: int = 1
    dt_s: float = 0.0
    coupling_hz: float = 0.0

    def response(self, frequency_hz: Array) -> ComplexArray:
        """Return G(j w), shape (n_frequencies,), in m/s^2/V."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        value = np.full(s.shape, self.gain, dtype=complex)
        for k in range(max(len(self.zeros), len(self.poles))):
            if k < len(self.zeros):
                value = value * (s - self.zeros[k])
            if k < len(self.poles):
                value = value / (s - self.poles[k])
        return np.asarray(value * np.exp(-s * self.delay_s) * hold_size(frequency_hz, self.dt_s), dtype=complex)

    @property
    def low_frequency_gain_m_per_v(self) -> float:
        """Return the displacement per V of a slow command: the limit of G(s) / s^2 far below the roots in the band.

        Roots below the band count as they do at its lower end: of what they do further down the data say nothing.
        """
        low = 2.0 * np.pi * self.band_hz[0]
        finite = self.zeros[np.abs(self.zeros) > 1e-9]
        above = [roots[np.abs(roots) > low] for roots in (finite, self.poles)]
        below = [np.abs(1j * low - roots[np.abs(roots) <= low]) for roots in (finite, self.poles)]
        size = np.prod(below[0]) / np.prod(below[1])
        return float(np.real(self.gain * size * np.prod(-above[0]) / np.prod(-above[1])))

    def sampled_response(self, frequency_hz: Array) -> ComplexArray:
        """Return the response of the table's samples, staircase alias included, (n_frequencies,), in m/s^2/V."""
        return self.response(frequency_hz) + self.alias(frequency_hz)

    def alias(self, frequency_hz: Array) -> ComplexArray:
        """Return what the hold's staircase adds to the response of the table's samples, (n_frequencies,)."""
        return self.ripple_m_s2_per_v * staircase(frequency_hz, self.latency_samples, self.dt_s, self.coupling_hz)

    @property
    def ripple_sum_m_s2_per_v(self) -> float:
        """Return the alias's integral per V of the sum u[k - l] + u[k - l - 1]."""
        return self.ripple_m_s2_per_v * integral_share(self.coupling_hz, self.dt_s)


def hold_size(frequency_hz: Array, dt_s: float) -> Array:
    """Return by how much a hold of dt_s (0: none) makes a command smaller, sin(x) / x with x = pi f dt_s."""
    return np.asarray(np.sinc(np.asarray(frequency_hz, dtype=float) * dt_s))


def staircase(frequency_hz: Array, latency_samples: int, dt_s: float, coupling_hz: float = 0.0) -> ComplexArray:
    """Return the response of u[k - l] - u[k - l - 1] to u, l = max(latency_samples, 1), (n_frequencies,).

    With `coupling_hz` its integral is in it as well, share * (u[k - l] + u[k - l - 1]): an alias lies far above the
    corner of an AC coupling and passes it, but the correction 1 + w_h / s of the samples acts on it too.
    """
    late: ComplexArray = np.exp(-2j * np.pi * np.asarray(frequency_hz, dtype=complex) * dt_s)
    return late ** max(latency_samples, 1) * (1.0 - late + integral_share(coupling_hz, dt_s) * (1.0 + late))


def integral_share(coupling_hz: float, dt_s: float) -> float:
    """Return w_h dt / 2, by which the correction of an AC coupling integrates samples (trapezoidal rule)."""
    return np.pi * coupling_hz * dt_s


def _response(system: StateSpace | Block, points: ComplexArray, about: float) -> ComplexArray:
    """Evaluate C (p I - A)^-1 B + D at complex points, shape (p, m, n_points).

    By a similar triangular matrix, one decomposition and then a triangular solution for all points at once (Laub, IEEE
    Trans. Automatic Control 26, 1981, with T in place of a Hessenberg form). A - about I is decomposed: sampled fast,
    A is nearly I, and its rounding would hide what the slow motions are.
    """
    n, m = system.B.shape
    if n == 0:
        return np.repeat(system.D[:, :, None].astype(complex), points.size, axis=2)
    if points.size <= FEW_POINTS:
        resolvent = np.linalg.solve(points[:, None, None] * np.eye(n) - system.A, system.B.astype(complex)[None])
        return np.moveaxis((system.C @ resolvent + system.D).astype(complex), 0, -1)
    triangle, into, out = _by_modes(system, about) or _by_schur(system, about)
    found = np.empty((len(system.C), m, points.size), dtype=complex)
    at_once = max(POINTS_AT_ONCE // (n * m), 1)
    for start in range(0, points.size, at_once):
        part = points[start : start + at_once] - about
        states = _triangular(triangle, into, part)
        found[..., start : start + at_once] = (out @ states).reshape(-1, m, part.size)
    found += system.D[:, :, None]
    return found


def _by_modes(system: StateSpace | Block, about: float) -> tuple[ComplexArray, ComplexArray, ComplexArray] | None:
    """Return T (n, n) upper triangular, S^-1 B (n, m) and C S (p, n) for A - about I = S T S^-1.

    S holds the eigenvectors of each set of states that act on each other in a circle; what only acts on others stands
    behind them, so that a delay's registers, which have no eigenvectors, are triangular as they are. None where
    eigenvectors of states scaled to equal sizes hardly span them.
    """
    A = system.A - about * np.eye(len(system.A))
    circle, order = _circles(A != 0.0)
    values, basis, scale = A.diagonal().astype(complex), np.eye(len(A), dtype=complex), np.ones((len(A), 1))
    for first in np.flatnonzero(np.bincount(circle) > 1):
        inside = np.flatnonzero(circle == first)
        values[inside], vectors = np.linalg.eig(A[np.ix_(inside, inside)])
        basis[np.ix_(inside, inside)], scale[inside, 0] = vectors, np.abs(vectors).max(axis=1)
        if not np.linalg.cond(vectors / scale[inside]) < MOST_CONDITION:
            return None
    sides = np.hstack([A @ basis, system.B]) / scale
    similar = np.asarray(np.linalg.solve(basis / scale, sides), dtype=complex)
    between = np.where(circle[:, None] != circle, similar[:, : len(A)], 0.0) + np.diag(values)
    out = np.asarray(system.C @ basis, dtype=complex)
    return between[np.ix_(order, order)], similar[order, len(A) :], out[:, order]


def _circles(acts: NDArray[np.bool_]) -> tuple[Integers, Integers]:
    """Return the first state of each state's circle, (n,), and an order (n,) in which none acts on one behind it.

    `acts` (n, n): whether the second state acts on the first.
    """
    reached = (acts | np.eye(len(acts), dtype=bool)).astype(np.float32)
    for _ in range(len(acts).bit_length()):
        reached = (reached @ reached > 0.0).astype(np.float32)
    circle = np.argmax(reached * reached.T, axis=1)
    return circle, np.lexsort((circle, -reached.sum(axis=1)))


def _by_schur(system: StateSpace | Block, about: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return T (n, n) upper triangular, S' B (n, m) and C S (p, n) for A - about I = S T S', scaled to equal sizes."""
    from scipy.linalg import matrix_balance, schur

    balanced, (scale, _) = matrix_balance(system.A - about * np.eye(len(system.A)), permute=False, separate=True)
    triangle, basis = schur(balanced, output="complex")
    return triangle, basis.conj().T @ (system.B / scale[:, None]), (system.C * scale) @ basis


def _triangular(triangle: ComplexArray, into: ComplexArray, points: ComplexArray) -> ComplexArray:
    """Return (p I - T)^-1 B, shape (n, m n_points), for T upper triangular, from the last row up."""
    n, m = into.shape
    states = np.empty((n, m * points.size), dtype=complex)
    for end in range(n, 0, -ROWS_AT_ONCE):
        first = max(end - ROWS_AT_ONCE, 0)
        states[first:end] = triangle[first:end, end:] @ states[end:] + np.repeat(into[first:end], points.size, axis=1)
        for i in range(end - 1, first - 1, -1):
            if triangle[i, i + 1 : end].any():
                states[i] += triangle[i, i + 1 : end] @ states[i + 1 : end]
            states[i].reshape(m, -1)[...] /= points - triangle[i, i]
    return states


def driven_modes(poles: ArrayLike, now: ArrayLike, before: ArrayLike, series: ArrayLike) -> Array:
    """Return z[k] = p z[k-1] + a u[k] + b u[k-1], z[0] = 0, for each complex mode: (2, m, n), real and imaginary part.

    `poles` p, `now` a, `before` b are complex (m,), `series` u is (n,).
    """
    from scipy.signal import lfilter

    numbers = np.array([poles, now, before], dtype=complex).reshape(3, -1)
    drive = np.asarray(series, dtype=float)
    modes = np.empty((2, numbers.shape[1], len(drive)))
    for r, (p, a, b) in enumerate(numbers.T):
        mode, _ = lfilter([a, b], [1.0, -p], drive, zi=[-a * drive[0]])
        modes[0, r], modes[1, r] = mode.real, mode.imag
    return modes
