"""Oracle: scipy.linalg, closed forms, and the equations themselves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are

from rths_cli.numerics.lti import Array
from rths_cli.numerics.matrix_equations import (
    continuous_riccati,
    doubled,
    symmetric_eigenvectors,
)


def test_eigenvectors_come_from_another_method_where_the_first_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """LAPACK's divide and conquer, which numpy uses, does not converge on a few well-formed matrices."""
    A = np.cov(np.random.default_rng(4).normal(size=(6, 40)))
    usual = symmetric_eigenvectors(A)

    def gives_up(_: Array) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(np.linalg, "eigh", gives_up)
    values, vectors = symmetric_eigenvectors(A)
    assert values == pytest.approx(usual[0], rel=1e-12)
    assert vectors @ np.diag(values) @ vectors.T == pytest.approx(A, abs=1e-14)
    assert vectors.T @ vectors == pytest.approx(np.eye(6), abs=1e-14)


def specimen(n: int, damping: float) -> tuple[Array, Array]:
    """Return A and C of a chain driven at its base, outputs accelerations, as the estimator sees it."""
    k = 3000.0 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    lower = -np.hstack([k, damping * k]) / 7.0
    return np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]), lower


@pytest.mark.parametrize("noise", [(1000.0, 1.0), (0.04, 0.25), (1e-4, 1.0), (3.0, 1e-5)])
@pytest.mark.parametrize("storeys", [1, 2, 5])
def test_the_kalman_filters_equation_is_solved_as_well_as_scipy_does(storeys: int, noise: tuple[float, float]) -> None:
    A, C = specimen(storeys, 1e-3)
    B = np.concatenate([np.zeros(storeys), -np.ones(storeys)])[:, None]
    arguments = (A.T, C.T, noise[0] * B @ B.T, noise[1] * np.eye(storeys))
    found, expected = continuous_riccati(*arguments), solve_continuous_are(*arguments)
    assert found == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())
    assert np.array_equal(found, found.T)
    assert max(np.linalg.eigvals(A - found @ C.T @ C / noise[1]).real) < 0.0


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (4, 2), (10, 3), (30, 4)])
def test_any_continuous_riccati_equation_is_solved(n: int, m: int) -> None:
    random = np.random.default_rng(n)
    A, B = random.normal(size=(n, n)), random.normal(size=(n, m))
    Q, R = np.diag(random.uniform(0.1, 3.0, n)), np.diag(random.uniform(0.1, 3.0, m))
    X = continuous_riccati(A, B, Q, R)
    terms = [A.T @ X, X @ A, -X @ B @ np.linalg.solve(R, B.T @ X), Q]
    assert np.abs(sum(terms)).max() < 1e-12 * max(np.abs(term).max() for term in terms)
    assert solve_continuous_are(A, B, Q, R) == pytest.approx(X, rel=0, abs=1e-10 * np.abs(X).max())


def test_what_no_feedback_can_hold_is_refused() -> None:
    with pytest.raises(ValueError, match="no stabilising solution"):
        continuous_riccati(np.diag([1.0, 2.0]), np.array([[1.0], [0.0]]), np.eye(2), np.eye(1))


def test_doubling_solves_the_discrete_equation() -> None:
    random = np.random.default_rng(1)
    A, B = np.diag([0.9999, 0.5, 1.1]) + 0.01 * random.normal(size=(3, 3)), random.normal(size=(3, 1))
    found = doubled(A, B @ B.T / 2.0, np.eye(3))
    assert found is not None
    assert found == pytest.approx(solve_discrete_are(A, B, np.eye(3), [[2.0]]), rel=1e-9)
    assert doubled(np.array([[1.5]]), np.array([[0.0]]), np.array([[1.0]])) is None
    assert doubled(np.array([[0.5]]), np.array([[1.0]]), np.array([[-1.0]])) is None  # 1 + reach cost is singular
