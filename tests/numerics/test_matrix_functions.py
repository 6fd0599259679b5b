"""Oracle: scipy.linalg, closed forms, and the equations themselves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from rths_cli.numerics.lti import Array
from rths_cli.numerics.matrix_equations import (
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


def test_doubling_solves_the_discrete_equation() -> None:
    random = np.random.default_rng(1)
    A, B = np.diag([0.9999, 0.5, 1.1]) + 0.01 * random.normal(size=(3, 3)), random.normal(size=(3, 1))
    found = doubled(A, B @ B.T / 2.0, np.eye(3))
    assert found is not None
    assert found == pytest.approx(solve_discrete_are(A, B, np.eye(3), [[2.0]]), rel=1e-9)
    assert doubled(np.array([[1.5]]), np.array([[0.0]]), np.array([[1.0]])) is None
    assert doubled(np.array([[0.5]]), np.array([[1.0]]), np.array([[-1.0]])) is None  # 1 + reach cost is singular
