"""Kalman filter and predicted base shear against their equations."""

from __future__ import annotations

import numpy as np
import pytest
from bench import DT_S, held, specimen
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov

from rths_cli.control.kalman_filter import (
    carried_by_correction,
    kalman_block,
    kalman_gain,
    measured_shear,
    plus_residual,
    predicted_shear,
    specimen_state_space,
    with_residual,
)
from rths_cli.control.latency_budget import shear_response
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.structure import Specimen, storey_matrix

FREQUENCY_HZ = np.array([1.0, 3.0, 5.0, 6.5, 8.4, 9.3, 10.0, 20.0, 100.0])


def matrices() -> tuple[Array, Array, Array]:
    """Return A, b, C of Eq. 2.5: table acceleration to the floors' absolute accelerations."""
    parts = specimen()
    inverse = np.diag(1.0 / parts.masses_kg)
    rate = np.hstack([-inverse @ parts.K, -inverse @ parts.C])
    return np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), rate]), np.array([0.0, 0.0, -1.0, -1.0]), rate


def test_the_gain_solves_the_riccati_equation() -> None:
    """A P + P A' + Q b b' - P C' C P / r = 0 with L = P C' / r, P from an independent long integration."""
    a, b, c = matrices()
    q, r = 1e3, 1.0

    def rate(_: float, flat: Array) -> Array:
        p = flat.reshape(4, 4)
        return (a @ p + p @ a.T + q * np.outer(b, b) - p @ c.T @ c @ p / r).ravel()

    p = solve_ivp(rate, (0.0, 20.0), np.zeros(16), "LSODA", rtol=1e-9, atol=1e-12).y[:, -1].reshape(4, 4)
    gain = kalman_gain(specimen_state_space(specimen()), q, r)
    assert gain == pytest.approx(p @ c.T / r, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("floors", [1, 2, 5, 8])
@pytest.mark.parametrize("ratio", [1e-6, 1e-4, 0.16, 1e3, 3e5, 1e9])
def test_any_ratio_of_noise_has_its_gain(floors: int, ratio: float) -> None:
    """The covariance is that of a Lyapunov equation with the gain in it, and the filter forgets what it was wrong."""
    stiffness = storey_matrix([3000.0] * floors)
    system = specimen_state_space(Specimen(np.full(floors, 7.0), stiffness, 1e-3 * stiffness))
    gain = kalman_gain(system, 3.0 * ratio, 3.0)
    closed = system.A - gain @ system.C
    assert np.linalg.eigvals(closed).real.max() < 0.0
    covariance = solve_continuous_lyapunov(closed, -ratio * system.B @ system.B.T - gain @ gain.T)
    assert gain == pytest.approx(covariance @ system.C.T, rel=0, abs=1e-7 * np.abs(gain).max())


def test_a_specimen_that_nobody_sees_has_no_filter() -> None:
    """Without stiffness and damping the floors feel nothing, and nothing brings an estimate back."""
    drifting = Specimen(np.array([7.0]), np.zeros((1, 1)), np.zeros((1, 1)))
    with pytest.raises(InputError, match=r"^kalman: .* with q / r = 1e\+03"):
        kalman_gain(specimen_state_space(drifting), 1e3, 1.0)


def continuous_shear(knows_table: bool) -> tuple[Array, Array]:
    """Return lag in s and noise gain of the base shear by the continuous filter's transfer function."""
    a, b, c = matrices()
    gain, masses = kalman_gain(specimen_state_space(specimen()), 1e3, 1.0), specimen().masses_kg
    lag, noise = [], []
    for f in FREQUENCY_HZ:
        s = 2j * np.pi * f
        floors = c @ np.linalg.solve(s * np.eye(4) - a, b)
        from_floors = c @ np.linalg.solve(s * np.eye(4) - a + gain @ c, gain)
        from_table = c @ np.linalg.solve(s * np.eye(4) - a + gain @ c, b) * knows_table
        ratio = masses @ (from_floors @ floors + from_table) / (masses @ floors)
        lag.append(-np.angle(ratio) / (2.0 * np.pi * f))
        noise.append(np.linalg.norm(masses @ from_floors) / np.linalg.norm(masses))
    return np.array(lag), np.array(noise)


@pytest.mark.parametrize("knows_table", [False, True])
def test_lag_and_noise_gain_are_those_of_the_continuous_filter(knows_table: bool) -> None:
    block = kalman_block(specimen(), 1e3, 1.0, DT_S, knows_table)
    lag, noise = shear_response(block, measured_shear(specimen(), 0.0), specimen(), FREQUENCY_HZ)
    wanted_lag, wanted_noise = continuous_shear(knows_table)
    assert lag == pytest.approx(wanted_lag, abs=4e-6)
    assert noise[:-1] == pytest.approx(wanted_noise[:-1], rel=5e-3)
    assert noise[-1] == pytest.approx(wanted_noise[-1], rel=5e-2)


def test_the_printed_filter_is_late_and_the_informed_one_is_not() -> None:
    late, informed = (
        shear_response(
            kalman_block(specimen(), 1e3, 1.0, DT_S, knows), measured_shear(specimen(), 0.0), specimen(), FREQUENCY_HZ
        )[0]
        for knows in (False, True)
    )
    assert late[[2, 3, 4, 5]] == pytest.approx(np.array([0.43, 1.32, 0.48, 0.55]) * 1e-3, abs=4e-5)
    assert np.abs(informed).max() < 4e-6


def test_the_filter_estimates_the_specimens_motion() -> None:
    """With exact signals the informed filter follows displacement, velocity and acceleration from rest."""
    a, b, c = matrices()
    step, drive = held(a, b, DT_S / 20.0)
    block = kalman_block(specimen(), 1e3, 1.0, DT_S, knows_table=True)
    state, x, worst, peak = np.zeros(4), np.zeros(4), np.zeros(6), np.zeros(6)
    for k in range(4000):
        table = np.sin(2.0 * np.pi * 3.0 * k * DT_S) * np.tanh(k / 400.0)
        wanted = np.concatenate([x, c @ x])
        found = block.C @ state + block.D @ np.concatenate([[table], c @ x])
        worst, peak = np.maximum(worst, np.abs(found - wanted)), np.maximum(peak, np.abs(wanted))
        state = block.A @ state + block.B @ np.concatenate([[table], c @ x])
        for j in range(20):
            middle = (k + (j + 0.5) / 20.0) * DT_S
            x = step @ x + drive * np.sin(2.0 * np.pi * 3.0 * middle) * np.tanh(middle / DT_S / 400.0)
    assert (worst < 2e-4 * peak).all()


def test_measured_shear_is_eq_2_6() -> None:
    shear, rng = measured_shear(specimen(), 1.7), np.random.default_rng(1)
    table, floors = 0.4, rng.standard_normal(2)
    estimated, corrected = np.concatenate([rng.standard_normal(4), floors]), np.array([table, 9.0, 9.0])
    estimate, recent, measured, desired = shear.of_one()
    f = estimate @ estimated + measured @ corrected
    assert f == pytest.approx(-1.7 * table - 6.91 * floors[0] - 6.95 * floors[1], rel=1e-12)
    assert recent.size == 0
    assert desired == 0.0


@pytest.mark.parametrize("lead", [1, 2, 5])
@pytest.mark.parametrize("interface_mass", [0.0, 1.7])
def test_predicted_shear_is_the_specimen_carried_on(lead: int, interface_mass: float) -> None:
    """Eq. 2.5 by a general solver over n_p samples under straight lines of desired acceleration, then Eq. 2.6."""
    rng, (a, b, c) = np.random.default_rng(2), matrices()
    start, desired, table = 1e-2 * rng.standard_normal(4), rng.standard_normal(lead + 1), 0.3
    shear = predicted_shear(specimen(), interface_mass, lead, DT_S)
    estimate, recent, measured, weight = shear.of_one()
    found = estimate @ np.concatenate([start, [5.0, 5.0]]) + recent @ desired[:-1]
    found += measured @ np.array([table, 7.0, 7.0]) + weight * desired[-1]
    x = start
    for j in range(lead):
        rate = lambda t, y, j=j: a @ y + b * (desired[j] + (desired[j + 1] - desired[j]) * t / DT_S)  # noqa: E731
        x = solve_ivp(rate, (0.0, DT_S), x, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
    error = desired[0] - table
    wanted = -specimen().masses_kg @ (c @ x) - interface_mass * (desired[-1] - error)
    assert found == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("lead", [1, 2, 6])
@pytest.mark.parametrize("change", [1.0, 0.85, 1.3])
def test_a_changed_specimen_errs_by_the_cube_of_the_frequency_over_the_corner(lead: int, change: float) -> None:
    """In harmonic motion of a specimen with other stiffness the base shear at k + n_p is off by some (f / corner)^3 of
    what the two specimens differ by, and the square of the lead's phase. Transfer functions written out here."""
    corner, parts = 40.0, specimen()
    carried = carried_by_correction(parts, 1e3, 1.0, lead * DT_S)
    block = with_residual(kalman_block(parts, 1e3, 1.0, DT_S, True), parts, corner, lead * DT_S, carried)
    plain = predicted_shear(parts, 0.0, lead, DT_S)
    for f in (1.0, 2.5, 6.0, 12.0):
        s = 2j * np.pi * f
        ahead = np.exp(s * DT_S * np.arange(lead + 1))
        floors, nominal = (
            1.0 - s**2 * np.linalg.solve(s**2 * np.diag(parts.masses_kg) + s * parts.C + k * parts.K, parts.masses_kg)
            for k in (change, 1.0)
        )
        true = -parts.masses_kg @ floors * ahead[-1]
        differ = abs(parts.masses_kg @ (floors - nominal))
        outputs = block.response(np.array([f]))[:, :, 0] @ np.concatenate([[1.0], floors])
        _, recent, _, weight = plain.of_one()
        known = recent @ ahead[:-1] + weight * ahead[-1]
        found = plus_residual(plain).of_one()[0] @ outputs + known - true
        share = 10.0 * (f / corner) ** 3 + abs(s * lead * DT_S) ** 2
        assert abs(found) < share * differ + (abs(s) * DT_S) ** 2 * abs(true)
