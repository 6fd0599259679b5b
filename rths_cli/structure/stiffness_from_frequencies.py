"""Storey stiffnesses of a shear building from its masses and natural frequencies: all positive solutions.

The coefficients of the characteristic polynomial det(K - w^2 M) are multilinear in the n storey stiffnesses,
the j-th one homogeneous of degree j. So there are n! complex solutions, none at infinity, and a total-degree
homotopy reaches all (Sommese and Wampler, The Numerical Solution of Systems of Polynomials, 2005).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.structure.shear_chain import storey_matrix

MAX_STOREYS = 5
SLOWEST_HZ = 1e-6
MOST_APART = {"frequencies": 1e4, "masses": 1e8}  # of a specimen whose stiffnesses can be found
_FIELD = "structure.experimental.natural_frequencies_hz"
_START_PHASES_RAD = (1.1, 2.3, 4.0)
"""Phases of the start system; almost every one works, the next is tried when paths meet."""
_MAX_STEPS = 3000


@dataclass(frozen=True)
class _Polynomials:
    """The n equations sum_S weight[j, S] prod_(i in S) x_i = 1 in scaled stiffnesses x = k / reference.

    `members` (2^n, n) says which storeys each subset S holds, `weight` is (n, 2^n), and `slope` (n, n, 2^n)
    holds the weights of the derivative of equation j with respect to x_i.
    """

    members: np.ndarray
    weight: Array
    slope: Array
    reference_n_per_m: float

    def evaluate(self, x: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return residuals (n_paths, n) and Jacobians (n_paths, n, n) at x (n_paths, n)."""
        monomials = np.where(self.members, x[:, None, :], 1.0).prod(axis=-1)
        return monomials @ self.weight.T - 1.0, np.einsum("ps,jis->pji", monomials, self.slope)


def stiffness_from_frequencies(masses_kg: Sequence[float], frequencies_hz: Sequence[float]) -> Array:
    """Return every set of positive storey stiffnesses in N/m (n_solutions, n) with these frequencies.

    The sets are sorted by their distance from equal stiffnesses; masses (n,) in kg, frequencies (n,) in Hz.
    Raises InputError when the frequencies do not ascend, for more than five storeys, for values too far apart, and for
    no solution.
    """
    masses, frequencies = np.asarray(masses_kg, dtype=float), np.asarray(frequencies_hz, dtype=float)
    if len(masses) > MAX_STOREYS:
        raise InputError(
            f"{_FIELD}: stiffnesses are found for up to {MAX_STOREYS} storeys, this specimen has "
            f"{len(masses)}; state experimental.stiffness_n_per_m instead"
        )
    if len(masses) != len(frequencies) or frequencies[0] <= 0.0 or np.any(np.diff(frequencies) <= 0.0):
        raise InputError(f"{_FIELD}: state {len(masses)} positive frequencies that ascend, not {_listed(frequencies)}")
    if not frequencies[0] >= SLOWEST_HZ:
        raise InputError(f"{_FIELD}: {frequencies[0]:g} Hz must be at least {SLOWEST_HZ:g} Hz; raise it")
    for what, values in (("frequencies", frequencies), ("masses", masses)):
        if not values.max() <= MOST_APART[what] * values.min():
            raise InputError(
                f"{_FIELD}: {what} of {values.min():g} and {values.max():g} are more than {MOST_APART[what]:g} times "
                "apart, too much to find stiffnesses; state experimental.stiffness_n_per_m instead"
            )
    solutions = _positive_solutions(masses, (2.0 * np.pi * frequencies) ** 2)
    if len(solutions) == 0:
        raise InputError(
            f"{_FIELD}: no positive storey stiffnesses give {_listed(frequencies)} Hz with masses "
            f"{_listed(masses)} kg; correct them, or state structure.experimental.stiffness_n_per_m instead"
        )
    distance = np.linalg.norm(solutions / solutions.mean(axis=1, keepdims=True) - 1.0, axis=1)
    return solutions[np.argsort(distance, kind="stable")]


def _positive_solutions(masses: Array, eigenvalues: Array) -> Array:
    """Return the real roots among all complex ones, in N/m, (n_solutions, n).

    They are positive: B^T diag(k) B has as many negative eigenvalues as k has negative entries (Sylvester).
    """
    equations = _polynomials(masses, eigenvalues)
    for phase in _START_PHASES_RAD:
        roots, complete = _follow_paths(equations, len(masses), phase)
        if complete:
            break
    real = np.abs(roots.imag).max(axis=1) < 1e-8 * np.abs(roots).max(axis=1)
    rounded = np.round(roots[real].real, 7)
    order = np.lexsort(rounded.T[::-1])
    another = np.abs(np.diff(rounded[order], axis=0, prepend=np.inf)).max(axis=1) > 0.0
    return roots[real][order[another]].real * equations.reference_n_per_m


def _polynomials(masses: Array, eigenvalues: Array) -> _Polynomials:
    """Write the symmetric functions of the eigenvalues in (rad/s)^2 as polynomials in the stiffnesses.

    A subset's coefficient is the product of the nonzero eigenvalues of the chain that has only its springs.
    """
    n = len(masses)
    members = (np.arange(2**n)[:, None] >> np.arange(n)) & 1 == 1
    reference = float(np.exp(np.mean(np.log(eigenvalues * masses))))
    target = np.abs(np.poly(eigenvalues))
    weight, slope = np.zeros((n, 2**n)), np.zeros((n, n, 2**n))
    for subset in range(1, 2**n):
        size = int(members[subset].sum())
        chain = storey_matrix(members[subset]) / np.sqrt(np.outer(masses, masses))
        coefficient = np.prod(np.linalg.eigvalsh(chain)[n - size :])
        weight[size - 1, subset] = coefficient * reference**size / target[size]
    for storey in range(n):
        without = np.flatnonzero(~members[:, storey])
        slope[:, storey, without] = weight[:, without | (1 << storey)]
    return _Polynomials(members, weight, slope, reference)


def _follow_paths(equations: _Polynomials, n: int, phase: float) -> tuple[ComplexArray, bool]:
    """Follow all n! roots of x_j^j = 1 to the equations; say whether n! distinct ones arrived."""
    circles = [np.exp(2j * np.pi * np.arange(degree) / degree) for degree in range(1, n + 1)]
    x = np.array(list(product(*circles)))
    t, step = np.zeros(len(x)), np.full(len(x), 0.02)
    for _ in range(_MAX_STEPS):
        active = np.flatnonzero(t < 1.0)
        if len(active) == 0:
            break
        end = np.minimum(t[active] + step[active], 1.0)
        moved, good = _advance(equations, phase, x[active], t[active], end)
        x[active[good]], t[active[good]] = moved[good], end[good]
        step[active] = np.where(good, np.minimum(1.5 * step[active], 0.1), 0.5 * step[active])
    x = x[t >= 1.0]
    distance = np.abs(x[:, None, :] - x[None, :, :]).max(axis=-1) + np.eye(len(x))
    return x, bool(np.all(t >= 1.0) and distance.min() > 1e-6)


def _advance(
    equations: _Polynomials, phase: float, x: ComplexArray, t: Array, end: Array
) -> tuple[ComplexArray, np.ndarray]:
    """Step each path from t to end by Euler prediction and three Newton corrections; say which converged."""
    _, jacobian, rate = _homotopy(equations, phase, x, t)
    moved = x - np.linalg.solve(jacobian, rate[..., None])[..., 0] * (end - t)[:, None]
    for _ in range(3):
        residual, jacobian, _ = _homotopy(equations, phase, moved, end)
        change = np.linalg.solve(jacobian, residual[..., None])[..., 0]
        moved = moved - change
    return moved, np.abs(change).max(axis=1) < 1e-8 * np.abs(moved).max(axis=1)


def _homotopy(
    equations: _Polynomials, phase: float, x: ComplexArray, t: Array
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return H = (1 - t) e^(i phase) (x_j^j - 1) + t F, its Jacobian and its derivative with respect to t."""
    degree = np.arange(1, x.shape[1] + 1)
    start = np.exp(1j * phase) * (x**degree - 1.0)
    start_slope = (np.exp(1j * phase) * degree * x ** (degree - 1))[:, :, None] * np.eye(len(degree))
    residual, slope = equations.evaluate(x)
    t = t[:, None]
    return (
        (1.0 - t) * start + t * residual,
        (1.0 - t[..., None]) * start_slope + t[..., None] * slope,
        residual - start,
    )


def _listed(values: Array) -> str:
    """Write numbers for a sentence, for example `3.2, 8.4`."""
    return ", ".join(f"{value:g}" for value in values)
