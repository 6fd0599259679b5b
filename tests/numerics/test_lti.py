"""Frequency responses of linear systems against a dense solution at every point."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.numerics.lti import FEW_POINTS, Array, Block, ComplexArray, StateSpace

DT_S = 5e-4
HZ = np.concatenate([[0.0], np.geomspace(0.05, 800.0, 300)])


def random(n: int, m: int, p: int) -> tuple[Array, Array, Array, Array]:
    """Return matrices whose eigenvalues lie within the unit circle."""
    draw = np.random.default_rng(n).standard_normal
    a = draw((n, n))
    return 0.98 * a / np.abs(np.linalg.eigvals(a)).max(), draw((n, m)), draw((p, n)), draw((p, m))


def by_solving(a: Array, b: Array, c: Array, d: Array, points: ComplexArray) -> ComplexArray:
    return np.array([c @ np.linalg.solve(p * np.eye(len(a)) - a, b.astype(complex)) + d for p in points]).transpose(
        1, 2, 0
    )


@pytest.mark.parametrize(("n", "m", "p"), [(1, 1, 1), (2, 2, 3), (7, 1, 4), (40, 3, 2)])
def test_a_block_responds_as_solved_point_by_point(n: int, m: int, p: int) -> None:
    matrices = random(n, m, p)
    exact = by_solving(*matrices, np.exp(2j * np.pi * HZ * DT_S))
    found = Block("any", *matrices, DT_S).response(HZ)
    assert found.shape == (p, m, HZ.size)
    assert np.abs(found - exact).max(axis=2) == pytest.approx(0.0, abs=1e-12 * np.abs(exact).max())
    few = Block("any", *matrices, DT_S).response(HZ[:FEW_POINTS])
    assert few == pytest.approx(exact[..., :FEW_POINTS], rel=1e-10)


def test_more_points_than_fit_at_once_are_all_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rths_cli.numerics.lti.POINTS_AT_ONCE", 7 * 2 * 50)
    matrices = random(7, 2, 3)
    exact = by_solving(*matrices, np.exp(2j * np.pi * HZ * DT_S))
    assert Block("any", *matrices, DT_S).response(HZ) == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-8, 1e-4])
def test_a_defective_chain_and_one_nearly_so_respond_as_solved(apart: float) -> None:
    """A shift register behind a chain of equal poles: no eigenvectors span the states."""
    a = np.diag([0.9, 0.9 + apart, 0.9 - apart, 0.0, 0.0, apart]) + np.diag([1.0, 1.0, 0.5, 1.0, 1.0], -1)
    b, c, d = np.eye(6)[:, :1], np.vstack([np.eye(6)[-1:], np.ones((1, 6))]), np.zeros((2, 1))
    exact = by_solving(a, b, c, d, np.exp(2j * np.pi * HZ * DT_S))
    assert Block("chain", a, b, c, d, DT_S).response(HZ) == pytest.approx(exact, rel=1e-10)


def test_slow_motion_sampled_fast_keeps_its_digits() -> None:
    """An accelerometer of 0.1 Hz on a motion sampled at 2 kHz: poles within 3e-4 of one, in closed form."""
    w, zeta = 2.0 * np.pi * 0.1, 0.02
    step = np.array([[1.0, DT_S], [-DT_S * w**2, 1.0 - 2.0 * zeta * w * DT_S]])
    block = Block("slow", step, np.array([[0.0], [DT_S]]), np.array([[-(w**2), -2.0 * zeta * w]]), np.eye(1), DT_S)
    rate = (np.exp(2j * np.pi * HZ * DT_S) - 1.0) / DT_S
    exact = rate**2 / (rate**2 + 2.0 * zeta * w * rate + w**2)
    assert np.abs(block.response(HZ)[0, 0, 1:] / exact[1:] - 1.0).max() < 2e-10


def test_states_of_very_different_size_and_a_continuous_system() -> None:
    scale = 10.0 ** np.array([0.0, 6.0, -6.0, 3.0, 0.0, -3.0, 8.0])
    a, b, c, d = random(7, 2, 3)
    a, b, c = 50.0 * scale[:, None] * a / scale, scale[:, None] * b, c / scale
    exact = by_solving(a, b, c, d, 2j * np.pi * HZ)
    assert StateSpace(a, b, c, d).response(HZ) == pytest.approx(exact, rel=1e-9)


def test_without_states_a_block_is_its_gain() -> None:
    block = Block("gain", np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[2.0, 3.0]]), DT_S)
    assert (block.response(HZ) == np.array([2.0, 3.0])[None, :, None]).all()


@pytest.mark.parametrize("turned", [False, True])
def test_a_delayed_oscillator_responds_in_closed_form_in_any_order_of_its_states(turned: bool) -> None:
    """Five registers before an oscillator and three behind it, shuffled; turned, every state acts on every other."""
    root = np.exp((-0.05 + 1j) * 0.3)
    a = np.diag(np.ones(9), -1)
    a[5, 4], a[5:7, 5:7] = 1.0, [[2.0 * root.real, -(abs(root) ** 2)], [1.0, 0.0]]
    a[7, 6] = 1.0
    b, c, d = np.eye(10)[:, :1], np.eye(10)[-1:], np.zeros((1, 1))
    random = np.random.default_rng(5)
    basis = np.linalg.qr(random.normal(size=(10, 10)))[0] if turned else np.eye(10)[random.permutation(10)]
    z = np.exp(2j * np.pi * HZ * DT_S)
    exact = 1.0 / (z**2 - 2.0 * root.real * z + abs(root) ** 2) / z**8
    found = Block("delayed", basis @ a @ basis.T, basis @ b, c @ basis.T, d, DT_S).response(HZ)[0, 0]
    assert found == pytest.approx(exact, rel=1e-12)
