"""Integration schemes of the numerical substructure, against recursions written out here and the exact solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rths_cli.control.numerical_substructure import Scheme, all_storeys, amplitude_and_lag, check_scheme, interface
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.structure import Numerical, storey_matrix

SCHEMES: tuple[Scheme, ...] = ("cr", "newmark")


def chain(storeys: int = 2, ratio: float = 0.02) -> Numerical:
    """Return storeys near 7 kg and 7.3 kN/m with unequal dashpots, which modal damping is not."""
    masses = np.array([6.0, 7.0, 6.5])[:storeys]
    stiffness, dashpots = np.array([8000.0, 7000.0, 7300.0])[:storeys], np.array([3.0, 1.0, 0.3])[:storeys]
    return Numerical(masses, storey_matrix(stiffness), storey_matrix(dashpots * ratio * 450.0))


def textbook_cr(part: Numerical, inputs: Array, h: float) -> Array:
    """Step Chen and Ricles' equations 3-5, matrix parameters included: disp, vel, absolute accel (3 p, n)."""
    M, C, K = np.diag(part.masses_kg), part.C, part.K
    alpha1 = 4.0 * np.linalg.inv(4.0 * M + 2.0 * h * C + h**2 * K) @ M
    alpha2 = alpha1
    x, v = np.zeros(len(M)), np.zeros(len(M))
    rows = []
    for ground, shear in inputs.T:
        load = -M.sum(axis=1) * ground
        load[-1] += shear
        accel = np.linalg.solve(M, load - C @ v - K @ x)
        rows.append(np.concatenate([x, v, accel + ground]))
        x, v = x + h * v + h**2 * alpha2 @ accel, v + h * alpha1 @ accel
    return np.array(rows).T


def textbook_newmark(part: Numerical, inputs: Array, h: float, beta: float, gamma: float) -> Array:
    """Step Newmark's method in its predictor-corrector form for any beta and gamma: disp, vel, absolute accel."""
    M, C, K = np.diag(part.masses_kg), part.C, part.K
    x, v, a = np.zeros(len(M)), np.zeros(len(M)), np.zeros(len(M))
    rows = []
    for k, (ground, shear) in enumerate(inputs.T):
        load = -M.sum(axis=1) * ground
        load[-1] += shear
        if k == 0:
            a = np.linalg.solve(M + gamma * h * C, load)  # at rest half a step before
            v = gamma * h * a
        else:
            x = x + h * v + h**2 * (0.5 - beta) * a
            v = v + h * (1.0 - gamma) * a
            a = np.linalg.solve(M + gamma * h * C + beta * h**2 * K, load - C @ v - K @ x)
            x, v = x + beta * h**2 * a, v + gamma * h * a
        rows.append(np.concatenate([x, v, a + ground]))
    return np.array(rows).T


def play(part: Numerical, inputs: Array, h: float, scheme: Scheme) -> Array:
    """Run the block of all storeys from rest: (3 p, n)."""
    block = all_storeys(part, h, scheme)
    state, out = np.zeros(len(block.A)), np.empty((len(block.C), inputs.shape[1]))
    for k in range(inputs.shape[1]):
        out[:, k] = block.C @ state + block.D @ inputs[:, k]
        state = block.A @ state + block.B @ inputs[:, k]
    return out


@pytest.mark.parametrize("storeys", [1, 2, 3])
@pytest.mark.parametrize("h", [5e-4, 8e-3])
def test_the_block_is_the_textbook_recursion(storeys: int, h: float) -> None:
    part = chain(storeys, 0.5)
    inputs = np.random.default_rng(3).standard_normal((2, 300)) * [[1.0], [30.0]]
    for scheme, wanted in (
        ("cr", textbook_cr(part, inputs, h)),
        ("newmark", textbook_newmark(part, inputs, h, 0.0, 0.5)),
    ):
        found = play(part, inputs, h, scheme)
        assert np.abs(found - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.parametrize("scheme", ["exact", *SCHEMES])
def test_the_steps_block_is_the_interface_of_all_storeys(scheme: Scheme) -> None:
    part, h = chain(3), 1e-3
    whole, own = all_storeys(part, h, scheme), interface(part, h, scheme)
    assert whole.outputs[8] == "abs_accel_m_s2_3"
    assert whole.outputs[5] == "rel_vel_m_s_3"
    assert whole.outputs[2] == "rel_disp_m_3"
    assert np.array_equal(own.C, whole.C[[8, 5, 2]])
    assert np.array_equal(own.D, whole.D[[8, 5, 2]])
    assert np.array_equal(own.A, whole.A)


def test_the_base_shear_accelerates_the_interface_at_once() -> None:
    """CR by one over the mass; Newmark by one over the mass and half a step of dashpot, for one storey."""
    part, h = chain(1), 1e-3
    assert interface(part, h, "cr").D[0] == pytest.approx([0.0, 1.0 / 6.0])
    heavier = 6.0 + 0.5 * h * part.C[0, 0]
    assert interface(part, h, "newmark").D[0] == pytest.approx([1.0 - 6.0 / heavier, 1.0 / heavier])
    assert interface(part, h, "newmark").D[1, 1] == pytest.approx(0.5 * h / heavier)


def forced(part: Numerical, h: float, end_s: float, scheme: Scheme) -> tuple[Array, Array]:
    """Return a scheme's displacement of the interface and the exact one under smooth ground motion and base shear."""
    time = np.arange(round(end_s / h) + 1) * h

    def loads(t: Array) -> Array:
        return np.array([np.sin(14.0 * t) * np.sin(2.0 * t) ** 3, 40.0 * np.sin(1.5 * t) ** 4])

    p, inverse = len(part.masses_kg), 1.0 / part.masses_kg

    def rate(t: float, y: Array) -> Array:
        ground, shear = loads(np.asarray(t))
        force = -part.C @ y[p:] - part.K @ y[:p]
        force[-1] += shear
        return np.concatenate([y[p:], inverse * force - ground])

    exact = solve_ivp(rate, (0.0, end_s), np.zeros(2 * p), t_eval=time, rtol=1e-10, atol=1e-13, method="DOP853").y
    return play(part, loads(time), h, scheme)[p - 1], exact[p - 1]


@pytest.mark.parametrize("scheme", ["exact", *SCHEMES])
def test_a_forced_oscillation_converges_with_the_square_of_the_step(scheme: Scheme) -> None:
    """Of `exact` this is the straight line between samples that stands for a curve."""
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        found, exact = forced(chain(2), h, 2.0, scheme)
        errors.append(np.abs(found - exact).max() / np.abs(exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx([2.0, 2.0], abs=0.15)
    assert errors[-1] < 1e-3


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_free_oscillation_converges_with_the_square_of_the_step(scheme: Scheme) -> None:
    """Eigenvalues over the step against those of the damped chain: error h^2, modes paired by frequency."""
    part = chain(2)
    minus = [-np.linalg.solve(np.diag(part.masses_kg), m) for m in (part.K, part.C)]
    exact = np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], minus]))
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        found = np.log(np.linalg.eigvals(all_storeys(part, h, scheme).A).astype(complex)) / h
        nearest = np.abs(found[:, None] - exact[None, :]).min(axis=0)
        errors.append((nearest / np.abs(exact)).max())
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.05)


@pytest.mark.parametrize("ratio", [0.0, 0.02, 1.0])
@pytest.mark.parametrize("h", [1e-3, 0.05, 1.0, 100.0])
def test_cr_is_stable_at_any_step(h: float, ratio: float) -> None:
    part = chain(3, ratio)
    assert np.abs(np.linalg.eigvals(all_storeys(part, h, "cr").A)).max() < 1.0 + 1e-7
    check_scheme(part, h, "cr")


@pytest.mark.parametrize("ratio", [0.0, 0.02, 1.0])
def test_newmark_is_refused_beyond_its_limit_and_nowhere_else(ratio: float) -> None:
    part = chain(2, ratio)
    highest = np.sqrt(np.linalg.eigvals(part.K / part.masses_kg[:, None]).real.max())
    limit = 2.0 / highest
    for scheme in ("exact", "cr", "newmark"):
        check_scheme(part, 0.999 * limit, scheme)
    for scheme in ("exact", "cr"):
        check_scheme(part, 1.5 * limit, scheme)
    with pytest.raises(InputError) as refused:
        check_scheme(part, 1.001 * limit, "newmark")
    (sentence,) = refused.value.faults
    for word in ("integration: newmark", f"{1e3 * 1.001 * limit:.4g} ms", f"{1e3 * limit:.4g} ms", "sample_rate_hz"):
        assert word in sentence
    grown = textbook_newmark(part, np.vstack([np.eye(1, 200)[0], np.zeros(200)]), 1.1 * limit, 0.0, 0.5)
    assert np.abs(grown[0, -1]) > 10.0 * np.abs(grown[0, :50]).max()


@pytest.mark.parametrize("h", [5e-4, 2e-3])
def test_the_lag_of_a_scheme_is_that_of_its_closed_form(h: float) -> None:
    """One storey: z-transforms written by hand for CR and Newmark; the straight line hardly lags."""
    part = replace(chain(1), C=np.array([[20.0]]))
    m, c, k = 6.0, 20.0, 8000.0
    frequency = np.array([0.7, 3.0, 5.0, 10.0, 40.0])
    s = 2j * np.pi * frequency
    z = np.exp(s * h)
    true = s**2 / (m * s**2 + c * s + k)
    step = 4.0 / (4.0 * m + 2.0 * h * c + h**2 * k)  # alpha over m
    v, x = h * step * m / (z - 1.0), h**2 * step * m * z / (z - 1.0) ** 2  # per unit of relative acceleration
    newmark_v, newmark_x = 0.5 * h * (z + 1.0) / (z - 1.0), h**2 * z / (z - 1.0) ** 2
    for scheme, schemes in (("cr", 1.0 / (m + c * v + k * x)), ("newmark", 1.0 / (m + c * newmark_v + k * newmark_x))):
        amplitude, lag = amplitude_and_lag(part, interface(part, h, scheme), frequency)
        assert lag == pytest.approx(-np.angle(schemes / true) / (2.0 * np.pi * frequency), abs=1e-12)
        assert amplitude == pytest.approx(np.abs(schemes / true) - 1.0, abs=1e-9)
        assert np.abs(lag).max() > 1e-7
        if scheme == "cr":  # of first order in the step: alpha stands between acceleration and velocity
            assert amplitude[-1] == pytest.approx(c * h / (2.0 * m), abs=k * h**2 / (10.0 * m))
    _, lag = amplitude_and_lag(part, interface(part, h, "exact"), frequency)
    assert lag == pytest.approx(np.full(5, c * h**2 / (12.0 * m)), rel=0.01)  # of the dashpot's velocity, a 500th step
