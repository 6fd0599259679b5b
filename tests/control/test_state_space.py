"""State-space forms and their discretisation against scipy's own."""

from __future__ import annotations

import numpy as np
import pytest
from bench import DT_S, LINEAR, linear_table, specimen
from hybrid import storeys, true_model
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import cont2discrete, freqs_zpk, zpk2ss

from rths_cli.control.numerical_substructure import all_storeys, interface
from rths_cli.control.state_space import Hold, discretise, from_roots, modal, static
from rths_cli.numerics.lti import StateSpace
from rths_cli.structure import Numerical

ZEROS = np.array([-2.0 + 20.0j, -2.0 - 20.0j, 0.0, 0.0], dtype=complex)
POLES = np.array([-3.0 + 22.0j, -3.0 - 22.0j, -90.0, -200.0 + 150.0j, -200.0 - 150.0j], dtype=complex)
FREQUENCY_HZ = np.geomspace(0.05, 200.0, 60)


@pytest.mark.parametrize("zeros", [ZEROS, ZEROS[:2], np.append(ZEROS, -30.0)])
def test_modal_form_has_the_response_of_its_roots(zeros: np.ndarray) -> None:
    system = from_roots(zeros, POLES, 7.5)
    found = system.response(FREQUENCY_HZ)[0, 0]
    _, wanted = freqs_zpk(zeros, POLES, 7.5, worN=2.0 * np.pi * FREQUENCY_HZ)
    assert np.abs(found / wanted - 1.0).max() < 1e-9
    a, b, c, d = zpk2ss(zeros, POLES, 7.5)
    second = StateSpace(a, b, c, d).response(FREQUENCY_HZ)[0, 0]
    assert np.abs(found / second - 1.0).max() < 1e-6
    assert np.sort_complex(np.linalg.eigvals(system.A)) == pytest.approx(np.sort_complex(POLES), rel=1e-12)
    assert np.isrealobj(system.A)


NEARLY = np.array([-2000.0, -2000.1, -2000.3], dtype=complex)
EQUAL = np.array([-500.0, -500.0, -500.0], dtype=complex)


@pytest.mark.parametrize("zeros", [ZEROS, ZEROS[:2], np.append(ZEROS, -30.0), np.append(ZEROS, [-1e7, -2e7])])
@pytest.mark.parametrize("more", [NEARLY, NEARLY[:2], EQUAL, EQUAL[:2], np.append(NEARLY, EQUAL)])
def test_poles_may_nearly_coincide(zeros: np.ndarray, more: np.ndarray) -> None:
    poles = np.append(POLES, more)
    system = from_roots(zeros, poles, 7.5)
    found = system.response(FREQUENCY_HZ)[0, 0]
    _, wanted = freqs_zpk(zeros, poles, 7.5, worN=2.0 * np.pi * FREQUENCY_HZ)
    assert np.abs(found / wanted - 1.0).max() < 1e-7  # at 0.05 Hz s^2 is what is left of numbers near one
    assert np.isrealobj(system.A) and len(system.A) == len(poles)
    largest = max(np.abs(system.B).max(), np.abs(system.C).max() / np.abs(wanted).max())
    assert largest < 1e4  # no numbers that cancel


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_integrators_may_be_several(count: int) -> None:
    poles = np.append(POLES, np.zeros(count))
    system = from_roots(ZEROS[:2], poles, 7.5)
    _, wanted = freqs_zpk(ZEROS[:2], poles, 7.5, worN=2.0 * np.pi * FREQUENCY_HZ)
    assert np.abs(system.response(FREQUENCY_HZ)[0, 0] / wanted - 1.0).max() < 1e-9


@pytest.mark.parametrize("more", [NEARLY, EQUAL])
def test_held_samples_of_nearly_equal_poles_are_exact(more: np.ndarray) -> None:
    """A zero-order hold at dc and at a steady sine: the sampled response sums the aliases of the continuous one."""
    poles, dt_s, f = np.append(POLES, more), 0.002, np.array([0.5, 3.0, 11.0, 40.0])
    found = discretise(from_roots(ZEROS, poles, 7.5), dt_s, "zoh", "b", ("u",), ("y",)).response(f)[0, 0]
    at = f[:, None] + np.arange(-2000, 2001) / dt_s
    _, beyond = freqs_zpk(ZEROS, poles, 7.5, worN=2.0 * np.pi * at.ravel())
    hold = np.exp(-1j * np.pi * at * dt_s) * np.sinc(at * dt_s)
    wanted = (beyond.reshape(at.shape) * hold).sum(axis=1)
    assert np.abs(found / wanted - 1.0).max() < 1e-6


def test_modal_form_sums_its_fractions() -> None:
    poles = np.array([-5.0, -1.0 + 4.0j, -1.0 - 4.0j])
    weights = np.array([2.0, 0.5 - 3.0j, 0.5 + 3.0j])
    s = 2j * np.pi * FREQUENCY_HZ
    wanted = 0.25 + sum(w / (s - p) for p, w in zip(poles, weights, strict=True))
    assert np.abs(modal(poles, weights, 0.25).response(FREQUENCY_HZ)[0, 0] - wanted).max() < 1e-12


@pytest.mark.parametrize("method", ["foh", "zoh"])
def test_a_discrete_block_is_exact_for_its_kind_of_input(method: str) -> None:
    """Against a general solver between samples, the input a straight line (foh) or held (zoh)."""
    system, dt_s, u = from_roots(ZEROS, POLES, 50.0), 0.004, np.random.default_rng(0).standard_normal(60)
    u[0] = 0.0
    block = discretise(system, dt_s, method, "b", ("u",), ("y",))
    state, x, found, wanted = np.zeros(len(block.A)), np.zeros(len(system.A)), [], []
    for k in range(59):
        found.append((block.C @ state + block.D[:, 0] * u[k])[0])
        state = block.A @ state + block.B[:, 0] * u[k]
        wanted.append((system.C @ x + system.D[:, 0] * u[k])[0])
        slope = (u[k + 1] - u[k]) / dt_s if method == "foh" else 0.0
        rate = lambda t, y, start=u[k], slope=slope: system.A @ y + system.B[:, 0] * (start + slope * t)  # noqa: E731
        x = solve_ivp(rate, (0.0, dt_s), x, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
    assert np.abs(np.array(found) - wanted).max() < 1e-8 * np.abs(wanted).max()


def test_bilinear_maps_the_frequency_axis() -> None:
    system, dt_s = from_roots(ZEROS, POLES, 50.0), 0.002
    found = discretise(system, dt_s, "bilinear", "b", ("u",), ("y",)).response(FREQUENCY_HZ)[0, 0]
    warped = np.tan(np.pi * FREQUENCY_HZ * dt_s) / (np.pi * dt_s)
    assert np.abs(found / system.response(warped)[0, 0] - 1.0).max() < 1e-9


def test_a_static_block_is_its_gain() -> None:
    gain = np.array([[1.0, -2.0], [0.5, 3.0], [0.0, 1.0]])
    block = static(gain, 1e-3, "s", ("a", "b"), ("x", "y", "z"))
    assert np.array_equal(block.response(np.array([3.0]))[:, :, 0], gain)
    nothing = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), gain)
    assert np.array_equal(discretise(nothing, 1e-3, "foh", "s", (), ()).D, gain)


@pytest.mark.parametrize("part", [storeys(1), storeys(3)])
def test_the_numerical_part_is_exact_for_straight_lines(part: Numerical) -> None:
    """Eq. 2.3 with both inputs straight lines between samples, carried on by one matrix exponential of the chain."""
    p, dt_s = len(part.masses_kg), 5e-4
    rng = np.random.default_rng(6)
    inputs = rng.standard_normal((2, 400)) * [[1.0], [30.0]]
    inputs[:, 0] = 0.0
    inverse = np.linalg.inv(np.diag(part.masses_kg))
    rate = np.hstack([-inverse @ part.K, -inverse @ part.C])
    force = inverse[:, -1:]
    b = np.vstack([np.zeros((p, 2)), np.hstack([-np.ones((p, 1)), force])])
    chain = np.zeros((2 * p + 4, 2 * p + 4))
    chain[: 2 * p, : 2 * p] = np.vstack([np.hstack([np.zeros((p, p)), np.eye(p)]), rate])
    chain[: 2 * p, 2 * p : 2 * p + 2], chain[2 * p : 2 * p + 2, 2 * p + 2 :] = b, np.eye(2)
    step = expm(chain * dt_s)[: 2 * p]
    for block, rows in ((interface(part, dt_s), True), (all_storeys(part, dt_s), False)):
        state, x, worst, peak = np.zeros(2 * p), np.zeros(2 * p), 0.0, 0.0
        for k in range(399):
            y = block.C @ state + block.D @ inputs[:, k]
            absolute = rate @ x + force[:, 0] * inputs[1, k]
            wanted = np.concatenate([x, absolute])
            if rows:
                wanted = np.array([absolute[-1], x[2 * p - 1], x[p - 1]])
            worst, peak = max(worst, np.abs(y - wanted).max()), max(peak, np.abs(wanted).max())
            state = block.A @ state + block.B @ inputs[:, k]
            x = step @ np.concatenate([x, inputs[:, k], (inputs[:, k + 1] - inputs[:, k]) / dt_s])
        assert worst < 1e-10 * peak


def test_the_table_written_by_its_roots_is_the_table() -> None:
    a, b, _, true = linear_table(LINEAR, specimen(), 1.0)
    s = 2j * np.pi * FREQUENCY_HZ
    wanted = np.array([true[0] @ np.linalg.solve(x * np.eye(len(a)) - a, b) for x in s])
    model = true_model(0.0)
    held = model.response(FREQUENCY_HZ) / np.sinc(FREQUENCY_HZ * DT_S)
    assert np.abs(held / wanted - 1.0).max() < 1e-9
    assert (
        np.abs(from_roots(model.zeros, model.poles, model.gain).response(FREQUENCY_HZ)[0, 0] / wanted - 1.0).max()
        < 1e-6
    )


@pytest.mark.parametrize("method", ["foh", "zoh", "bilinear"])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (6, 2)])
def test_blocks_are_those_of_scipy(method: Hold, n: int, m: int) -> None:
    draw = np.random.default_rng(n).standard_normal
    system = StateSpace(30.0 * draw((n, n)), draw((n, m)), draw((3, n)), draw((3, m)))
    block = discretise(system, 0.004, method, "any", (), ())
    exact = cont2discrete((system.A, system.B, system.C, system.D), 0.004, method=method)
    for found, wanted in zip((block.A, block.B, block.C, block.D), exact, strict=False):
        assert found == pytest.approx(wanted, rel=1e-12, abs=1e-13)


def test_a_held_command_of_a_stiff_oscillator_keeps_its_small_entries() -> None:
    """An oscillator of 100 Hz over steps of 0.1 ms in closed form: entries from 1e-9 to 1."""
    w, h = 2 * np.pi * 100.0, 1e-4
    system = StateSpace(
        np.array([[0.0, 1.0], [-(w**2), -0.02 * w]]), np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))
    )
    found = discretise(system, h, "zoh", "b", ("u",), ("x", "v"))
    wd, decay = w * np.sqrt(1 - 1e-4), np.exp(-0.01 * w * h)
    cosine, sine = np.cos(wd * h), np.sin(wd * h)
    step = (1.0 - decay * (cosine + 0.01 * w / wd * sine)) / w**2
    assert found.A[0] == pytest.approx([decay * (cosine + 0.01 * w / wd * sine), decay * sine / wd], rel=1e-11)
    assert found.B[0, 0] == pytest.approx(step, rel=1e-11)


@pytest.mark.parametrize("h", [1e-4, 1e-5, 1e-6, 1e-7])
def test_a_held_command_keeps_small_entries_of_states_in_unlike_units(h: float) -> None:
    """A displacement loop around a force actuator, in metres, m/s and newtons: the displacement that a constant force
    reference leaves in 1 us, 1e-17 m/N, against the Taylor series in 80 bits.

    Each of its terms is smaller than the one before by 1e-2 or more: 12 of them are exact beyond double precision.
    """
    m, tau, k, c = 7.0, 1.5e-3, 1.6e5, 2e3
    system = StateSpace(
        np.array([[0, 1, 0], [0, 0, 1 / m], [-k / tau, -c / tau, -1 / tau]]),
        np.array([[0], [0], [1 / tau]]),
        np.eye(3),
        np.zeros((3, 1)),
    )
    chain = np.block([[system.A, system.B], [np.zeros((1, 4))]])
    term = wanted = np.eye(4, dtype=np.longdouble)
    for i in range(1, 40):
        term = term @ (chain * h).astype(np.longdouble) / i
        wanted = wanted + term
    found = discretise(system, h, "zoh", "b", ("u",), ("x", "v", "f"))
    error = np.abs(np.hstack([found.A, found.B]) - np.asarray(wanted, dtype=float)[:3])
    assert np.all(error <= 1e-13 * np.abs(wanted[:3]))  # some hundred rounding errors
