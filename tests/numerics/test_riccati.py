"""Riccati solutions by their equation, by scipy, and where scipy gives up: slow modes sampled fast."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from rths_cli.control import feedback
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Model
from rths_cli.numerics.matrix_equations import doubled, riccati_cost, riccati_gain


def problem(seed: int, slowest: float) -> tuple[Array, Array, Array, Array, Array]:
    """Return A, B, Q, R, S of a random stable plant whose slowest mode decays to `slowest` in a sample."""
    random = np.random.default_rng(seed)
    turned = np.linalg.qr(random.standard_normal((5, 5)))[0]
    a = turned @ np.diag([slowest, 0.9, 0.5, -0.3, 0.1]) @ turned.T
    b, c, d = random.standard_normal((5, 1)), random.standard_normal((1, 5)), random.standard_normal((1, 1))
    return a, b, c.T @ c, d.T @ d + 0.1, c.T @ d


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("slowest", [0.9, 0.999, 0.99999])
def test_doubling_finds_what_scipy_finds(seed: int, slowest: float) -> None:
    a, b, q, r, s = problem(seed, slowest)
    found, wanted = riccati_cost(a, b, q, r, s), solve_discrete_are(a, b, q, r, s=s)
    assert np.abs(found - wanted).max() < 1e-8 * np.abs(wanted).max()
    assert residual(a, b, q, r, s, found) < 1e-9


def test_the_gain_makes_the_plant_decay() -> None:
    a, b, q, r, s = problem(1, 1.02)
    gain = riccati_gain(a, b, q, r, s)
    assert np.abs(np.linalg.eigvals(a - b @ gain)).max() < 1.0 < np.abs(np.linalg.eigvals(a)).max()


def test_what_cannot_be_stabilised_is_said() -> None:
    a, b, q, r, s = np.diag([1.2, 0.5]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1), np.zeros((2, 1))
    with pytest.raises(InputError, match="cannot be solved"):
        riccati_gain(a, b, q, r, s)


def test_a_singular_step_is_no_solution_and_no_crash() -> None:
    """1 + reach X is zero at once: this happens with models whose roots lie far outside the band."""
    assert doubled(np.eye(1), -np.eye(1), np.eye(1)) is None
    a, b, q, r, s = np.eye(1), np.eye(1), np.eye(1), -np.eye(1), np.zeros((1, 1))
    with pytest.raises(InputError, match="cannot be solved"):
        riccati_gain(a, b, q, r, s)


def light_specimen(turn: float = 1.0, rate_hz: float = 4000.0) -> Model:
    """Return a table whose specimen, 3 Hz times `turn` with 2.7 % damping, leaves a pole and a zero 0.4 % apart."""
    pair, near = -0.5427039 + 20.41223357j, -0.54440891 + 20.48843851j
    fast = -101.71345059 + 221.31636117j
    poles = np.array([pair, pair.conjugate(), fast, fast.conjugate(), -466.1286622])
    zeros = np.array([0.0, 0.0, near, near.conjugate()])
    return Model(turn * zeros, turn * poles, turn * 216855.6, 2.5 / rate_hz, (0.5, 60.0), 0.0, 2, 1.0 / rate_hz)


def residual(a: Array, b: Array, q: Array, r: Array, s: Array, cost: Array) -> float:
    """Return by how much a cost (n, n) misses the discrete equation, over its largest entry."""
    left = a.T @ cost @ a - cost + q
    left -= (a.T @ cost @ b + s) @ np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a + s.T)
    return float(np.abs(left).max() / np.abs(cost).max())


def regulator(model: Model) -> tuple[Array, Array, Array, Array, Array]:
    """Return A, B, Q, R, S of the regulator for a table."""
    a, b, c, d, _, _ = feedback.lqg_plant(feedback.sampled_table(model, model.dt_s), model.dt_s, feedback.DEFAULT)
    weight = feedback.DEFAULT.command_weight * abs(model.response(np.array([12.0]))[0])
    return a, b, c.T @ c, d.T @ d + weight**2, c.T @ d


def scipys_residual(problem: tuple[Array, Array, Array, Array, Array], balanced: bool) -> float:
    try:
        return residual(*problem, solve_discrete_are(*problem[:4], s=problem[4], balanced=balanced))
    except ValueError:
        return np.inf


def test_scipy_fails_on_regulators_of_light_specimens() -> None:
    """Why the equation is solved by doubling: scipy refuses one in ten, or unbalanced loses half the digits."""
    rates = (1000.0, 2000.0, 4000.0, 8000.0)
    problems = [regulator(light_specimen(turn, rate)) for turn in np.linspace(0.8, 1.2, 21) for rate in rates]
    assert max(residual(*problem, riccati_cost(*problem)) for problem in problems) < 1e-11
    assert max(scipys_residual(problem, balanced=True) for problem in problems) == np.inf
    assert min(scipys_residual(problem, balanced=False) for problem in problems) > 1e-9


def test_a_light_specimen_at_4_khz_has_its_feedback() -> None:
    found = feedback.design(light_specimen(), None, 2.5e-4, None, 1.5)
    assert found.sensitivity_peak <= 1.5
    assert found.bandwidth_hz > 30.0
