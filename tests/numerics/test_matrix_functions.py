"""Oracle: scipy.linalg, closed forms, and the equations themselves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from rths_cli.numerics.matrix_equations import doubled


def test_doubling_solves_the_discrete_equation() -> None:
    random = np.random.default_rng(1)
    A, B = np.diag([0.9999, 0.5, 1.1]) + 0.01 * random.normal(size=(3, 3)), random.normal(size=(3, 1))
    found = doubled(A, B @ B.T / 2.0, np.eye(3))
    assert found is not None
    assert found == pytest.approx(solve_discrete_are(A, B, np.eye(3), [[2.0]]), rel=1e-9)
    assert doubled(np.array([[1.5]]), np.array([[0.0]]), np.array([[1.0]])) is None
    assert doubled(np.array([[0.5]]), np.array([[1.0]]), np.array([[-1.0]])) is None  # 1 + reach cost is singular
