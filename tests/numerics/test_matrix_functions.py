"""Oracle: scipy.linalg, closed forms, and the equations themselves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from rths_cli.numerics.lti import Array
from rths_cli.numerics.matrix_equations import (
    balancing,
    continuous_riccati,
    doubled,
    exponential,
    symmetric_eigenvectors,
)


@pytest.mark.parametrize(("n", "size"), [(1, 1e-3), (2, 40.0), (3, 1.0), (8, 0.01), (20, 0.3), (40, 1.0), (120, 0.2)])
def test_the_exponential_is_scipys(n: int, size: float) -> None:
    A = size * np.random.default_rng(n).normal(size=(n, n))
    expected = expm(A)
    assert exponential(A) == pytest.approx(expected, rel=0, abs=1e-13 * np.abs(expected).max() * max(1.0, size * n))


def test_closed_forms_of_the_exponential() -> None:
    assert exponential(np.zeros((3, 3))) == pytest.approx(np.eye(3), rel=0, abs=1e-15)
    assert exponential(np.zeros((0, 0))).shape == (0, 0)
    assert exponential(np.array([[0.0, 1e6], [0.0, 0.0]])) == pytest.approx(
        np.array([[1.0, 1e6], [0.0, 1.0]]), rel=1e-15
    )
    assert exponential(np.array([[-1e200]]))[0, 0] == 0.0
    turn = exponential(np.array([[0.0, -30.0], [30.0, 0.0]]))
    assert turn == pytest.approx(np.array([[np.cos(30), -np.sin(30)], [np.sin(30), np.cos(30)]]), abs=1e-13)
    assert exponential(np.array([[2j]]))[0, 0] == pytest.approx(np.exp(2j), rel=1e-15)


def test_the_exponential_of_a_stiff_hold_keeps_its_small_entries() -> None:
    """A 100 Hz oscillator with its input's staircase, as a plant's step is discretised: entries from 1e-9 to 1."""
    w, h = 2 * np.pi * 100.0, 1e-4
    A = np.array([[0.0, 1.0, 0.0], [-(w**2), -0.02 * w, 1.0], [0.0, 0.0, 0.0]])
    wd, decay = w * np.sqrt(1 - 1e-4), np.exp(-0.01 * w * h)
    cosine, sine = np.cos(wd * h), np.sin(wd * h)
    step = (1.0 - decay * (cosine + 0.01 * w / wd * sine)) / w**2
    found = exponential(A * h)
    assert found[0] == pytest.approx([decay * (cosine + 0.01 * w / wd * sine), decay * sine / wd, step], rel=1e-11)


def test_the_exponential_keeps_small_entries_of_states_in_unlike_units() -> None:
    """A displacement loop around a force actuator, in metres, m/s and newtons, over steps of 1 us: the displacement
    that a constant force reference leaves, 1e-17 m/N, against the Taylor series in 80 bits.

    Each of its terms is smaller than the one before by 1e-2 or more: 12 of them are exact beyond double precision.
    """
    m, tau, k, c = 7.0, 1.5e-3, 1.6e5, 2e3
    A = np.array([[0, 1, 0, 0], [0, 0, 1 / m, 0], [-k / tau, -c / tau, -1 / tau, 1 / tau], [0, 0, 0, 0]])
    for h in (1e-4, 1e-5, 1e-6, 1e-7):
        term = wanted = np.eye(4, dtype=np.longdouble)
        for i in range(1, 40):
            term = term @ (A * h).astype(np.longdouble) / i
            wanted = wanted + term
        error = np.abs(exponential(A * h) - np.asarray(wanted, dtype=float))
        assert np.all(error <= 1e-13 * np.abs(wanted))  # some hundred rounding errors


def test_balancing_evens_rows_and_columns_and_is_exact() -> None:
    random = np.random.default_rng(2)
    even = random.normal(size=(6, 6))
    uneven = even * np.exp2([0, 10, -20, 3, 30, -7]) / np.exp2([0, 10, -20, 3, 30, -7])[:, None]
    scale = balancing(uneven)
    balanced = np.abs(uneven * scale / scale[:, None])
    np.fill_diagonal(balanced, 0.0)
    assert np.all(np.abs(np.log2(balanced.sum(axis=0) / balanced.sum(axis=1))) < 3.0)
    assert np.array_equal(np.log2(scale), np.round(np.log2(scale)))
    assert np.array_equal(balancing(np.diag([1e200, 3.0, 0.0])), np.ones(3))


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
