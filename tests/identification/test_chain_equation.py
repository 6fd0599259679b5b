"""Slopes of the storeys' equation, against differences of its residual."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.identification.specimen_fit import Lines, evaluated, frequency_slopes, modal

MASSES = (np.array([6.9]), np.array([6.91, 6.95]), np.array([5.0, 6.0, 4.5]))


def noisy_lines(masses: np.ndarray, seed: int) -> Lines:
    """Return lines that no chain explains: every term of the slopes counts, and the residual is large."""
    random = np.random.default_rng(seed)
    values = random.standard_normal((2, len(masses) + 1, 80))
    s = 2j * np.pi * np.linspace(0.5, 20.0, 80)
    motion = values[0] + 1j * values[1]
    return Lines(s, 3.0 * motion[0], motion[1:] + np.outer(np.arange(1.0, len(masses) + 1), motion[0]))


def point(masses: np.ndarray) -> np.ndarray:
    """Return logarithms of stiffnesses and damping ratios that differ from storey to storey."""
    n = len(masses)
    return np.log(np.concatenate([np.linspace(4000.0, 9000.0, n), np.linspace(0.03, 0.08, n)]))


@pytest.mark.parametrize("masses", MASSES)
def test_slopes_give_the_gradient(masses: np.ndarray) -> None:
    lines, theta = [noisy_lines(masses, seed) for seed in (0, 1)], point(masses)

    def half_square(at: np.ndarray, late_s: float = 0.0) -> float:
        late = [Lines(x.s, x.table * np.exp(-x.s * late_s), x.floors) for x in lines]
        residual, _ = evaluated(late, masses, at)
        return 0.5 * float(residual @ residual)

    residual, slopes = evaluated(lines, masses, theta)
    steps = 1e-5 * np.eye(len(theta))
    expected = [(half_square(theta + step) - half_square(theta - step)) / 2e-5 for step in steps]
    expected.append((half_square(theta, 1e-7) - half_square(theta, -1e-7)) / 2e-7)
    assert slopes @ residual == pytest.approx(np.array(expected), rel=2e-5)


@pytest.mark.parametrize("masses", MASSES)
def test_slopes_are_those_of_the_residual_where_the_chain_explains_all(masses: np.ndarray) -> None:
    theta, lines = point(masses), noisy_lines(masses, 2)
    omega, shapes = modal(masses, np.exp(theta[: len(masses)]))
    given = np.multiply.outer(2.0 * np.exp(theta[len(masses) :]) * omega, lines.s) + (omega**2)[:, None]
    state = (0.3 * lines.s + 5.0) / (lines.s**2 + given)
    floors = shapes @ ((masses @ shapes)[:, None] * given / (lines.s**2 + given) * lines.table + state)
    exact = [Lines(lines.s, lines.table, floors)]
    residual, slopes = evaluated(exact, masses, theta)
    assert np.linalg.norm(residual) < 1e-10 * np.linalg.norm(floors)
    for row, step in zip(slopes, 1e-6 * np.eye(len(theta)), strict=False):
        ahead, behind = (evaluated(exact, masses, theta + sign * step)[0] for sign in (1.0, -1.0))
        assert np.linalg.norm(row - (ahead - behind) / 2e-6) < 1e-5 * np.linalg.norm(row)


def test_frequency_slopes_are_those_of_the_frequencies() -> None:
    masses, stiffness = MASSES[2], np.array([4000.0, 6500.0, 9000.0])
    omega, shapes = modal(masses, stiffness)
    slopes = frequency_slopes(omega, shapes, stiffness)
    for storey, step in enumerate(1e-6 * np.eye(3)):
        ahead, behind = (modal(masses, stiffness * np.exp(sign * step))[0] for sign in (1.0, -1.0))
        assert slopes[:, storey] == pytest.approx((ahead - behind) / 2e-6, rel=1e-7)


def test_frequencies_that_arithmetic_cannot_tell_are_numbers() -> None:
    """Storeys 10^24 times softer than others: eigenvalues are lost in rounding, some come out negative, and equal."""
    masses, stiffness = np.full(5, 5.0), np.array([1e-14, 1e10, 1e-14, 1e10, 1e-14])
    omega, _ = modal(masses, stiffness)
    assert (omega > 0.0).all() and (np.diff(omega) >= 0.0).all()
    lines, theta = noisy_lines(masses, 3), np.log(np.concatenate([stiffness, np.full(5, 0.05)]))
    assert all(np.isfinite(each).all() for each in evaluated([lines], masses, theta))
