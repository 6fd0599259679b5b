"""What is said of loops whose parameters move, on loops whose stability is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rths_cli.analysis.adaptive_loop import common_lyapunov, judged
from rths_cli.control.interface import Adapted
from rths_cli.numerics.lti import Array


def bounds(least: float, most: float, rate: float) -> Adapted:
    return Adapted(("g",), ("",), np.array([0.0]), np.array([least]), np.array([most]), np.array([rate]))


def rotation(angle: float, size: float, stretch: float = 1.0) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return size * np.array([[c, -s * stretch], [s / stretch, c]])


def test_a_corner_beyond_the_unit_circle_is_found() -> None:
    """Spectral radius 0.9 + 0.2 g: 1.0 at g = 0.5."""
    found = judged(lambda p: np.array([[0.9 + 0.2 * p[0], 1.0], [0.0, 0.5]]), bounds(-1.0, 1.0, 0.1), 0.001)
    assert found.worst_radius == pytest.approx(1.1) and found.worst == pytest.approx([1.0])
    assert found.told.startswith("safe at its start; unstable at g = 1") and not found.proved


def test_an_unstable_point_inside_is_found_though_both_corners_are_stable() -> None:
    """Radius 1.05 - g^2, for g from -0.5 to 0.5: unstable within |g| < 0.224 only, where the search ends at 0."""
    found = judged(lambda p: np.diag([1.05 - p[0] ** 2, 0.1]), bounds(-0.5, 0.5, 0.1), 0.001)
    assert found.worst_radius == pytest.approx(1.05, abs=1e-6)


def test_one_function_for_all_corners_is_a_proof() -> None:
    """|p| <= 0.1 beside 0.8: the 2-norm of every matrix is below 1, so P = 1 is a common Lyapunov function."""
    found = judged(lambda p: 0.8 * rotation(0.3, 1.0) + p[0] * np.eye(2), bounds(-0.1, 0.1, 1e-3), 0.001)
    assert found.proved and found.told.endswith("safe for any change within the bounds")


def test_frozen_stable_is_not_safe_for_any_change() -> None:
    """Two rotations, stretched along different axes: each decays, their alternation grows (the product's radius is
    above 1). No common function may be found, and switching without a limit of the rate must show the growth."""
    ends = rotation(0.5 * math.pi, 0.98, 3.0), rotation(0.5 * math.pi, 0.98, 1.0 / 3.0)
    assert np.abs(np.linalg.eigvals(ends[0] @ ends[1])).max() > 8.0
    assert common_lyapunov(list(ends), ends[0]) is None
    found = judged(lambda p: ends[0] + (0.5 + 0.5 * p[0]) * (ends[1] - ends[0]), bounds(-1.0, 1.0, 1.0), 0.001)
    assert found.told.endswith("in the simulated switching")


def test_a_parametric_resonance_shows_in_the_switching_only() -> None:
    """An oscillator of 0.02 rad a sample whose stiffness moves by +-50 %: stable at every frozen value; at a rate that
    allows a change at twice its frequency (Mathieu) it grows, at a hundredth of that rate it does not."""

    def matrix(p: Array) -> Array:
        return 0.9996 * np.array([[1.0, 0.02], [-0.02 * (1.0 + p[0]), 1.0 - 4e-4]])

    fast, slow = (judged(matrix, bounds(-0.5, 0.5, rate), 0.001) for rate in (0.5 * 0.04 / math.pi * 2.0, 1e-5))
    assert not fast.found_unstable and not fast.proved and not fast.switching_stable
    assert slow.switching_stable


def test_the_function_found_is_one() -> None:
    matrices = [0.8 * rotation(0.3, 1.0, stretch) for stretch in (1.0, 1.1)]
    P = common_lyapunov(matrices, matrices[0])
    assert P is not None and np.linalg.eigvalsh(P)[0] > 0.0
    assert all(np.linalg.eigvalsh(one.T @ P @ one - P)[-1] < 0.0 for one in matrices)
