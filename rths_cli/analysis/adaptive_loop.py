"""Whether a loop stays stable while parameters of its law move within stated bounds and no faster than stated.

Four statements, each for what it is: the spectral radius with the parameters at their start; the largest one found at
the corners of the bounds, at `POINTS` points of a Sobol sequence and by a local search from the worst of them (a point
that is not found may exist); whether free motions decay while the parameters move to and fro at their largest rate
(simulated, no proof); and a proof for any change within the bounds, where the loop's matrix A(p) is affine in the
parameters and one P > 0 has A' P A < P at every corner: A' P A is convex in A, so it holds inside, and x' P x falls
whatever the parameters do (Boyd, El Ghaoui, Feron, Balakrishnan, Linear Matrix Inequalities in System and Control
Theory, 1994, section 5.1).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import cholesky, matrix_balance, solve_triangular
from scipy.optimize import minimize
from scipy.stats import qmc

from rths_cli.numerics.lti import Array

POINTS, SEED = 1000, 0  # of the Sobol sequence
SAFE = 1.0 - 1e-9  # the largest spectral radius of a stable loop
AFFINE = 1e-9  # of the matrix: how near it is to the affine one
MARGIN = 1e-8  # by which the largest eigenvalue of a proof is below 1
SWITCHED_S, MOST_STEPS = 5.0, 20_000  # length of the simulated switching
DOUBLINGS = 30  # of a sum over samples
ROUNDS, STEP, HOPELESS = 100, 0.5, 1.0  # of the search for a common Lyapunov function
BLOCK = 50  # samples for which a matrix that is not affine stays in the simulated switching

MatrixAt = Callable[[Array], Array]


class Bounds(Protocol):
    """Start, least, most and largest change in a sample of k parameters, (k,) each."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def start(self) -> Array: ...
    @property
    def least(self) -> Array: ...
    @property
    def most(self) -> Array: ...
    @property
    def rate(self) -> Array: ...


@dataclass(frozen=True)
class AdaptiveVerdict:
    """What is known of a loop whose parameters move."""

    names: tuple[str, ...]
    start_radius: float
    tried: int  # points: corners, Sobol points, search
    worst_radius: float  # the largest of them
    worst: Array  # (k,) the parameters there
    growth: float  # of a free motion by the simulated switching, its size in the last fifth over that in the first
    proved: bool  # one quadratic Lyapunov function is common to all corners, and the matrix is affine

    @property
    def found_unstable(self) -> bool:
        """Return whether a point within the bounds is not stable."""
        return self.worst_radius > SAFE

    @property
    def switching_stable(self) -> bool:
        """Return whether free motions decayed in the simulated switching."""
        return self.growth < 1.0

    @property
    def point(self) -> str:
        """Return the parameters of the worst point in words."""
        return ", ".join(f"{name} = {value:.4g}" for name, value in zip(self.names, self.worst, strict=True))

    @property
    def told(self) -> str:
        """Return in words what is known, no more."""
        at_start = "safe at its start" if self.start_radius <= SAFE else "unstable at its start"
        points = f"unstable at {self.point}" if self.found_unstable else f"no unstable point found in {self.tried}"
        switching = "stable" if self.switching_stable else "unstable"
        proof = "; safe for any change within the bounds" if self.proved else ""
        return f"{at_start}; {points}; {switching} in the simulated switching{proof}"


def judged(matrix_at: MatrixAt, bounds: Bounds, dt_s: float) -> AdaptiveVerdict:
    """Return the verdict on the loop x[k+1] = A(p) x[k], `matrix_at` the parameters (k,), with bounds on these."""
    least, most, start = bounds.least, bounds.most, bounds.start
    k, spread = len(start), most - least
    corners = np.array(list(itertools.product(*zip(least, most, strict=True))))
    sobol = least + qmc.Sobol(k, seed=SEED).random(1024)[:POINTS] * spread
    affine = _affine(matrix_at, least, most)
    at = matrix_at if affine is None else affine
    points = np.vstack([corners, sobol])
    radii = np.array([spectral_radius(at(point)) for point in points])
    first = int(np.argmax(radii))
    found = minimize(
        lambda unit: -spectral_radius(at(least + np.clip(unit, 0.0, 1.0) * spread)),
        (points[first] - least) / np.where(spread > 0.0, spread, 1.0),
        method="Nelder-Mead", bounds=[(0.0, 1.0)] * k, options={"maxfev": 60 * k, "xatol": 1e-4, "fatol": 1e-12},
    )  # fmt: skip
    worst, radius = points[first], float(radii[first])
    if -found.fun > radius:
        worst, radius = least + np.clip(found.x, 0.0, 1.0) * spread, float(-found.fun)
    at_start = spectral_radius(matrix_at(start))
    stable = max(radius, at_start) <= SAFE
    proved = stable and affine is not None and common_lyapunov([at(one) for one in corners], at(start)) is not None
    growth = _switched(at, bounds, dt_s, affine is not None)
    return AdaptiveVerdict(
        bounds.names, at_start, len(points) + int(found.nfev), max(radius, at_start), worst, growth, proved
    )


def spectral_radius(matrix: Array) -> float:
    """Return the largest size of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def _affine(matrix_at: MatrixAt, least: Array, most: Array) -> MatrixAt | None:
    """Return the matrix as constant and slopes, None where a few points show that it is not affine."""
    constant = matrix_at(least)
    ends = [np.where(np.arange(len(least)) == i, most, least) for i in range(len(least))]
    slopes = np.array([matrix_at(end) - constant for end in ends])

    def at(point: Array) -> Array:
        share = (point - least) / np.where(most > least, most - least, 1.0)
        return np.asarray(constant + np.tensordot(share, slopes, 1))

    size = np.abs(constant) + np.abs(slopes).sum(axis=0)
    rng = np.random.default_rng(SEED)
    for _ in range(3):
        point = least + rng.random(len(least)) * (most - least)
        if not np.all(np.abs(matrix_at(point) - at(point)) <= AFFINE * np.maximum(size, size.max() * 1e-6)):
            return None
    return at


def common_lyapunov(matrices: list[Array], nominal: Array) -> Array | None:
    """Return P > 0 (n, n) with A' P A < P for each matrix A, None where none is found.

    Candidates are the solution of the nominal Lyapunov equation and the mean of those of the matrices, each improved
    by projected subgradient steps. What is returned has been verified by eigenvalues, with `MARGIN`.
    """
    scale = matrix_balance(nominal, permute=False, separate=True)[1][0]  # powers of two
    own = [one * scale / scale[:, None] for one in matrices]
    alone = [_lyapunov(each) for each in (nominal * scale / scale[:, None], *own)]
    if any(one is None for one in alone):
        return None
    for candidate in (alone[0], sum(one / np.trace(one) for one in alone[1:] if one is not None)):
        assert candidate is not None
        found = _improved(own, candidate)
        if found is not None:
            return found / np.outer(scale, scale)
    return None


def _lyapunov(matrix: Array) -> Array | None:
    """Return the P of A' P A - r^2 P = -r^2 by doubling, r half way from A's spectral radius to 1, so that x' P x falls
    evenly in all directions; None where A is not stable."""
    radius = spectral_radius(matrix)
    if radius >= 1.0:
        return None
    P, power = np.eye(len(matrix)), matrix / (0.5 + 0.5 * radius)
    for _ in range(DOUBLINGS):
        more = power.T @ P @ power
        P, power = P + more, power @ power
        if not np.isfinite(P).all():
            return None
        if np.linalg.norm(more) <= 1e-12 * np.linalg.norm(P):
            return 0.5 * (P + P.T)
    return None


def _improved(matrices: list[Array], start: Array) -> Array | None:
    """Return a common P by subgradient steps from a candidate, in whose own coordinates it is the unit matrix."""
    try:
        root = cholesky(start, lower=True)
    except np.linalg.LinAlgError:
        return None
    own = [solve_triangular(root, (root.T @ one).T, lower=True).T for one in matrices]  # L' A L'^-1
    P = np.eye(len(start))
    for _ in range(ROUNDS):
        largest, direction, reached = -np.inf, P[0], P[0]
        for one in own:
            values, vectors = np.linalg.eigh(one.T @ P @ one - P)
            if values[-1] > largest:
                largest, direction, reached = values[-1], vectors[:, -1], one @ vectors[:, -1]
        if largest < 0.0 or largest > HOPELESS:
            break
        gradient = np.outer(reached, reached) - np.outer(direction, direction)
        P = P - (largest + MARGIN) * (1.0 + STEP) / max(float(np.sum(gradient**2)), 1e-300) * gradient
        values, vectors = np.linalg.eigh(0.5 * (P + P.T))
        P = (vectors * np.maximum(values, 1e-6 * values[-1])) @ vectors.T
    found = root @ P @ root.T
    found = 0.5 * (found + found.T)
    return found if all(_falls(one, found) for one in matrices) else None


def _falls(matrix: Array, P: Array) -> bool:
    """Return whether the largest eigenvalue of L^-1 A' P A L^-T, P = L L', is below 1 by `MARGIN` and by its rounding,
    which grows with the condition of L."""
    unit = 2.0 ** np.round(0.5 * np.log2(np.maximum(np.diag(P), np.finfo(float).tiny)))
    P, matrix = P / np.outer(unit, unit), matrix * unit[:, None] / unit
    try:
        root = cholesky(P, lower=True)
    except np.linalg.LinAlgError:
        return False
    own = solve_triangular(root, (root.T @ matrix).T, lower=True).T
    values = np.linalg.eigvalsh(P)
    condition = math.sqrt(values[-1] / max(values[0], np.finfo(float).tiny))
    rounding = 10.0 * len(P) * np.finfo(float).eps * condition
    largest = float(np.linalg.norm(own, 2)) ** 2
    return bool(largest < 1.0 - MARGIN - rounding)


def _switched(at: MatrixAt, bounds: Bounds, dt_s: float, affine: bool) -> float:
    """Return by how much free motions grow while each parameter moves to and fro at its largest rate, over its whole
    range, and over a half, a quarter, ... of it somewhere within, with random phases: 24 ways at once, 4 where the
    matrix is not affine."""
    rng = np.random.default_rng(SEED)
    n, k = len(at(bounds.start)), len(bounds.start)
    steps = int(min(MOST_STEPS, SWITCHED_S / dt_s))
    ways = 24 if affine else 4
    spread = bounds.most - bounds.least
    halvings = 2.0 ** -(np.arange(ways) % 8)  # of the share of the range that a way covers
    middle = bounds.least + spread * (0.5 * halvings[:, None] + (1.0 - halvings[:, None]) * rng.random((ways, k)))
    half = 0.5 * spread * halvings[:, None]
    period = 4.0 * half / np.where(bounds.rate > 0.0, bounds.rate, np.inf)
    moves = (half > 0.0) & (bounds.rate > 0.0)
    phase = rng.random((ways, k))
    states = rng.standard_normal((n, ways))
    if affine:
        zero = at(bounds.least)
        slopes = [at(np.where(np.arange(k) == i, bounds.most, bounds.least)) - zero for i in range(k)]
    sizes = np.zeros((2, ways))
    fifth = steps // 5
    for step in range(steps):
        turn = np.where(moves, phase + step / np.where(moves, period, 1.0), 0.25)
        triangle = 4.0 * np.abs(turn - np.floor(turn + 0.5)) - 1.0
        point = middle + half * triangle
        if affine:
            share = (point - bounds.least) / np.where(spread > 0.0, spread, 1.0)
            with np.errstate(all="ignore"):  # what grows may become infinite
                states = zero @ states + sum(slope @ (states * share[:, i]) for i, slope in enumerate(slopes))
        else:
            if step % BLOCK == 0:
                frozen = [at(one) for one in point]
            states = np.stack([one @ state for one, state in zip(frozen, states.T, strict=True)], axis=1)
        size = np.abs(states).max(axis=0)
        if not np.isfinite(size).all():
            return np.inf
        if step < fifth:
            sizes[0] = np.maximum(sizes[0], size)
        elif step >= steps - fifth:
            sizes[1] = np.maximum(sizes[1], size)
    return float(np.max(sizes[1] / np.maximum(sizes[0], np.finfo(float).tiny)))
