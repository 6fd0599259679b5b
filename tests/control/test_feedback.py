"""LQG feedback: its equations, its stability on the table, and what it promises."""

from __future__ import annotations

import numpy as np
import pytest
from bench import DT_S, LINEAR, held, linear_table, specimen
from hybrid import true_model

from rths_cli.control import feedback
from rths_cli.control.feedback import design, grid_hz, is_stable, lqg, none, sampled_table, sensitivity
from rths_cli.errors import InputError
from rths_cli.lti import Array, Block, Frf, Model

MODEL = true_model(1.5 * DT_S)
GRID = grid_hz(DT_S)


def loop_radius(model: Model, block: Block) -> float:
    """Return how the sampled closed loop grows per step, by running it from a random state."""
    t = sampled_table(model, DT_S)
    table, state = np.random.default_rng(0).standard_normal(len(t.A)), np.zeros(len(block.A))
    size = []
    for k in range(20000):
        # without direct paths on both sides at once there is no algebraic loop
        assert t.D[0, 0] * block.D[0, 0] == 0.0
        command = block.C @ state
        accel = t.C @ table + t.D[:, 0] * command
        command = command - block.D[:, 0] * accel
        table, state = t.A @ table + t.B[:, 0] * command, block.A @ state - block.B[:, 0] * accel
        if k % 1000 == 999:
            scale = np.linalg.norm(np.concatenate([table, state]))
            table, state = table / scale, state / scale
            size.append(scale)
    return float(np.mean(size[-10:]) ** 1e-3)


def riccati_residual(a: Array, b: Array, q: Array, r: Array, s: Array, gain: Array) -> float:
    """Return how far a gain is from minimising its cost: cost matrix by repeated steps, then the gain it implies."""
    cost = np.zeros_like(a)
    for _ in range(10000):
        inner = np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a + s.T)
        cost = q + a.T @ cost @ a - (a.T @ cost @ b + s) @ inner
    return float(np.abs(inner - gain).max() / np.abs(gain).max())


def test_the_gain_is_the_fixed_point_of_its_riccati_recursion() -> None:
    a, b, c, direct, drive, drive_direct = feedback._plant(MODEL, DT_S)
    cost = direct.T @ direct + 3.0
    gain = feedback._riccati_gain(a, b, c.T @ c, cost, c.T @ direct)
    assert riccati_residual(a, b, c.T @ c, cost, c.T @ direct, gain) < 1e-6
    variance = drive_direct @ drive_direct.T + 0.5**2
    observer = feedback._riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T)
    assert riccati_residual(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T, observer) < 1e-6


def test_the_sampled_table_is_the_table_behind_a_hold_and_its_delay() -> None:
    """1.5 samples of delay are the hold's half and one whole sample; the samples are those of the held command."""
    a, b, _, true = linear_table(LINEAR, specimen(), 1.0)
    step, drive = held(a[:7, :7], b[:7], DT_S)
    low = np.linspace(0.5, 200.0, 80)
    z = np.exp(2j * np.pi * low * DT_S)
    wanted = np.array([true[0, :7] @ np.linalg.solve(x * np.eye(7) - step, drive) / x for x in z])
    t = sampled_table(MODEL, DT_S)
    found = Block("t", t.A, t.B, t.C, t.D, DT_S).response(low)[0, 0]
    assert np.abs(found / wanted - 1.0).max() < 1e-7


def test_a_model_without_a_delay_is_sampled_as_it_is() -> None:
    free, low = true_model(0.0), np.linspace(0.5, 40.0, 80)
    t = sampled_table(free, DT_S)
    found = Block("t", t.A, t.B, t.C, t.D, DT_S).response(low)[0, 0]
    assert np.abs(found / free.response(low) - 1.0).max() < 3e-3


@pytest.mark.parametrize("noise", [0.1, 1.0, 10.0])
def test_the_regulator_is_stable_on_the_model(noise: float) -> None:
    block = lqg(MODEL, noise, DT_S)
    assert is_stable(MODEL, block, DT_S)
    assert loop_radius(MODEL, block) < 1.0


def test_instability_is_seen() -> None:
    block = lqg(MODEL, 0.3, DT_S)
    loud = Block(block.name, block.A, block.B, 20.0 * block.C, block.D, DT_S)
    assert not is_stable(MODEL, loud, DT_S)
    assert loop_radius(MODEL, loud) > 1.0
    late = true_model(21.5 * DT_S)
    assert is_stable(late, block, DT_S) == (loop_radius(late, block) < 1.0)


@pytest.mark.parametrize("wanted_hz", [None, 20.0, 8.0])
def test_a_design_keeps_its_promises(wanted_hz: float | None) -> None:
    found = design(MODEL, None, DT_S, wanted_hz, 1.5)
    assert 0.9 * (wanted_hz or 40.0) <= found.bandwidth_hz <= (wanted_hz or 40.0)
    fine = np.geomspace(0.05, 450.0, 4000)
    loop = MODEL.response(fine) * found.block.response(fine)[0, 0]
    peaks = np.abs(1.0 / (1.0 + loop))
    assert found.sensitivity_peak == pytest.approx(peaks.max(), rel=1e-3)
    assert found.peak_hz == pytest.approx(fine[peaks.argmax()], rel=0.03)
    assert found.bandwidth_hz == pytest.approx(fine[np.abs(loop) > 1.0].max(), rel=0.012)
    assert found.sensitivity_peak <= 1.5
    assert loop_radius(MODEL, found.block) < 1.0
    inside = (fine > 2.0) & (fine < 10.0)
    assert np.abs(sensitivity(found.block, MODEL.response(fine), fine))[inside].max() < 0.95


def test_a_tight_sensitivity_limit_slows_the_feedback_down() -> None:
    wide, tight = (design(MODEL, None, DT_S, 35.0, limit) for limit in (1.5, 1.18))
    assert tight.sensitivity_peak <= 1.18 < wide.sensitivity_peak
    assert tight.bandwidth_hz < wide.bandwidth_hz


@pytest.mark.parametrize(("dt_s", "samples"), [(1e-3, 4), (2.5e-3, 2)])
def test_a_slow_loop_still_gets_the_feedback_that_exists(dt_s: float, samples: int) -> None:
    late = true_model((samples + 0.5) * dt_s)
    found = design(late, None, dt_s, None, 1.5)
    assert found.sensitivity_peak <= 1.5
    t = sampled_table(late, dt_s)
    k = found.block
    closed = np.block([[t.A - t.B @ k.D @ t.C, t.B @ k.C], [-k.B @ t.C, k.A]])
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    band = np.linspace(1.0, 12.0, 100)
    assert np.abs(sensitivity(k, late.response(band), band)).min() < 0.9
    assert found.peak_hz < 0.5 / dt_s


def test_an_impossible_limit_is_one_sentence() -> None:
    with pytest.raises(InputError) as caught:
        design(MODEL, None, DT_S, 2.0, 1.001)
    (sentence,) = caught.value.faults
    assert sentence.startswith("controller: no feedback with a sensitivity peak of 1.001 or less is of use")
    assert "max_sensitivity" in sentence


def test_the_measured_response_replaces_the_model_inside_its_band_only() -> None:
    frequency = np.linspace(0.4, 70.0, 700)
    measured = Frf(frequency, 1.3 * MODEL.response(frequency), np.ones(700), np.zeros(700), 10)
    table = feedback.table_response(MODEL, measured, DT_S)
    ratio = table / MODEL.response(GRID)
    inside = (GRID >= 0.5) & (GRID <= 60.0)
    assert ratio[inside] == pytest.approx(np.full(inside.sum(), 1.3), rel=1e-9)
    assert ratio[~inside] == pytest.approx(np.ones((~inside).sum()), rel=1e-12)
    louder = design(MODEL, measured, DT_S, 20.0, 1.5)
    assert louder.bandwidth_hz <= 20.0
    level = np.abs(louder.block.response(np.array([20.0]))[0, 0])
    assert level < 0.9 * np.abs(design(MODEL, None, DT_S, 20.0, 1.5).block.response(np.array([20.0]))[0, 0])


def test_no_feedback_is_zero() -> None:
    assert none(DT_S).response(np.array([1.0]))[0, 0, 0] == 0.0
