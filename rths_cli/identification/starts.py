"""Where the fit of a table starts: structured guesses over loops of every kind, so that no luck is needed."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from rths_cli.identification.factors import Layout, pack
from rths_cli.identification.fit_table import Fit, Problem, Timing, fit, problem_of, solve
from rths_cli.lti import Array, ComplexArray, Frf

LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING, LAG_S = (7.0, 14.0, 26.0), (0.35, 0.7), (1.0, 3.0), 2e-3
START_LINES = 200
STARTS_KEPT = 4


def first_fit(frf: Frf, modes: tuple[Array, Array], timing: Timing, band_hz: tuple[float, float]) -> Fit:
    """Fit 2 n + 3 poles, the declared delay and the ripple, from the best of many starts, with 2 n finite zeros held.

    `modes`: natural frequencies in Hz and damping ratios (n,) of the specimen on a fixed base. The table cannot move at
    them whatever drives it: they are its zeros.
    Raises InputError when the band holds too few lines.
    """
    floors = len(modes[0])
    layout = Layout(floors + 1, 1, floors, timing.delay_s)
    problem = problem_of(frf, layout, timing, band_hz, ripple=True)
    return fit(frf, layout, best_start(problem, modes), timing, band_hz, ripple=True, held_zeros=floors)


def best_start(problem: Problem, modes: tuple[Array, Array]) -> Array:
    """Return the best of several structured starts (loop frequency and damping), each improved on few lines."""
    few = thinned(problem)
    low = slice(0, 10)
    gain = float(np.median(np.abs(few.measured[low] / few.s[low] ** 2)))
    specimen = np.column_stack([2.0 * np.pi * modes[0], modes[1]])
    starts = []
    for loop in product(LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING):
        pair, corner = _loop_roots(*loop)
        starts.append(np.append(pack(gain, np.vstack([specimen * [0.99, 1.05], [pair]]), corner, specimen), 0.0))
    return best_of(few, starts, few.layout.zeros(few.layout.zero_pairs))


def best_of(few: Problem, starts: list[Array], held: slice | None = None) -> Array:
    """Return the start of least error after a few steps from each of the four that begin best."""
    starts = sorted(starts, key=lambda theta: float(np.sum(few.evaluated(theta)[0] ** 2)))
    improved = [solve(few, theta, 30, held)[0] for theta in starts[:STARTS_KEPT]]
    return min(improved, key=lambda theta: float(np.sum(few.evaluated(theta)[0] ** 2)))


def thinned(problem: Problem) -> Problem:
    """Return about 200 of the lines, evenly spaced in log frequency, for the search of a start."""
    wanted = np.geomspace(abs(problem.s[0]), abs(problem.s[-1]), START_LINES)
    lines = np.unique(np.searchsorted(np.abs(problem.s), wanted).clip(max=len(problem.s) - 1))
    alias = None if problem.alias is None else problem.alias[lines]
    return replace(
        problem,
        s=problem.s[lines],
        measured=problem.measured[lines],
        weight=problem.weight[lines],
        alias=alias,
        hold=problem.hold[lines],
    )


def _loop_roots(frequency_hz: float, ratio: float, stiffening: float) -> tuple[tuple[float, float], Array]:
    """Return pair (w, zeta) and corner (1,) in rad/s of a displacement loop closed around a lagging actuator.

    LAG_S s^3 + s^2 + r (2 zeta w s + w^2) = 0; r is above 1 when the loop was set for more mass than moves.
    """
    omega = 2.0 * np.pi * frequency_hz
    found: ComplexArray = np.roots([LAG_S, 1.0, stiffening * 2.0 * ratio * omega, stiffening * omega**2]).astype(
        complex
    )
    found = found[np.argsort(np.abs(found.imag))]  # a real root first
    two = found[1:]
    size = float(np.sqrt(abs(two[0] * two[1])))
    return (size, float(-np.real(two[0] + two[1]) / (2.0 * size))), np.abs(found[:1])
