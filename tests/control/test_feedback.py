"""LQG feedback: its equations, its stability on the table, and what it promises."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bench import DT_S, LINEAR, held, linear_table, specimen
from hybrid import true_model

from rths_cli.control import feedback
from rths_cli.control.feedback import (
    DEFAULT,
    Feedback,
    Weights,
    design,
    grid_hz,
    is_stable,
    lqg,
    none,
    sampled_table,
    sensitivity,
    unlimited,
)
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, Frf, Model, StateSpace
from rths_cli.numerics.matrix_equations import riccati_gain

MODEL = true_model(1.5 * DT_S)
GRID = grid_hz(MODEL, DT_S)


@cache
def designed(wanted_hz: float | None = 20.0, limit: float = 1.5, weights: Weights = DEFAULT) -> Feedback:
    """Return a design on the model alone."""
    return design(MODEL, None, DT_S, wanted_hz, limit, weights)


def loop_radius(model: Model, block: Block) -> float:
    """Return how the sampled closed loop grows per step, by running it from a random state."""
    t, block = sampled_table(model, DT_S), unlimited(block)
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
    a, b, c, direct, drive, drive_direct = feedback.lqg_plant(feedback.sampled_table(MODEL, DT_S), DT_S, DEFAULT)
    cost = direct.T @ direct + 3.0
    gain = riccati_gain(a, b, c.T @ c, cost, c.T @ direct)
    assert riccati_residual(a, b, c.T @ c, cost, c.T @ direct, gain) < 1e-6
    variance = drive_direct @ drive_direct.T + 0.5**2
    observer = riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T)
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


@pytest.mark.campaign
@pytest.mark.parametrize("wanted_hz", [None, 20.0, 8.0])
def test_a_design_keeps_its_promises(wanted_hz: float | None) -> None:
    found = designed(wanted_hz)
    assert 0.9 * (wanted_hz or 40.0) <= found.bandwidth_hz <= (wanted_hz or 40.0)
    fine = np.geomspace(0.05, 450.0, 4000)
    loop = MODEL.response(fine) * found.block.response(fine)[0, 0]
    peaks = np.abs(1.0 / (1.0 + loop))
    assert found.sensitivity_peak == pytest.approx(peaks.max(), rel=1e-4)
    assert found.measured.peak_hz == pytest.approx(fine[peaks.argmax()], rel=0.03)
    assert found.bandwidth_hz == pytest.approx(fine[np.abs(loop) > 1.0].max(), rel=3e-3)
    assert found.sensitivity_peak <= 1.5
    assert loop_radius(MODEL, found.block) < 1.0
    inside = (fine > 2.0) & (fine < 10.0)
    assert np.abs(sensitivity(found.block, MODEL.response(fine), fine))[inside].max() < 0.95


def test_a_tight_sensitivity_limit_slows_the_feedback_down() -> None:
    wide, tight = (designed(35.0, limit) for limit in (1.5, 1.18))
    assert tight.sensitivity_peak <= 1.18 < wide.sensitivity_peak
    assert tight.bandwidth_hz < wide.bandwidth_hz


@pytest.mark.parametrize(("dt_s", "samples"), [(1e-3, 4), (2.5e-3, 2)])
def test_a_slow_loop_still_gets_the_feedback_that_exists(dt_s: float, samples: int) -> None:
    late = true_model((samples + 0.5) * dt_s)
    found = design(late, None, dt_s, None, 1.5)
    assert found.sensitivity_peak <= 1.5
    t = sampled_table(late, dt_s)
    k = unlimited(found.block)
    closed = np.block([[t.A - t.B @ k.D @ t.C, t.B @ k.C], [-k.B @ t.C, k.A]])
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    band = np.linspace(1.0, 12.0, 100)
    assert np.abs(sensitivity(k, late.response(band), band)).min() < 0.9
    assert found.measured.peak_hz < 0.5 / dt_s


def test_an_impossible_limit_is_one_sentence() -> None:
    with pytest.raises(InputError) as caught:
        design(MODEL, None, DT_S, 2.0, 1.001)
    (sentence,) = caught.value.faults
    assert sentence.startswith("controller: no feedback with a sensitivity peak of 1.001 or less is of use")
    assert "max_sensitivity" in sentence


def test_weights_without_a_solution_are_one_sentence() -> None:
    with pytest.raises(InputError) as caught:
        design(MODEL, None, DT_S, None, 1.5, Weights((1.0, 12.0), 1e-9))
    assert len(caught.value.faults) == 1
    assert "command_weight" in caught.value.faults[0]


def test_the_measured_response_replaces_the_model_as_far_as_it_reaches() -> None:
    frequency = np.linspace(0.4, 70.0, 700)
    measured = Frf(frequency, 1.3 * MODEL.response(frequency), np.ones(700), np.full(700, 0.02), 10)
    table = feedback.table_response(MODEL, measured, DT_S)
    assert np.array_equal(table.frequency_hz, GRID)
    assert np.array_equal(table.modelled, MODEL.response(GRID))
    ratio = table.measured / table.modelled
    inside = (GRID >= 0.4) & (GRID <= 70.0)
    assert ratio[GRID >= 0.4] == pytest.approx(np.full((GRID >= 0.4).sum(), 1.3), rel=1e-9)
    assert ratio[GRID < 0.4] == pytest.approx(np.ones((GRID < 0.4).sum()), rel=1e-12)
    assert table.relative_error[inside] == pytest.approx(0.02)
    assert not table.relative_error[~inside].any()
    louder = design(MODEL, measured, DT_S, 20.0, 1.5)
    assert louder.bandwidth_hz <= 20.0
    level = np.abs(louder.block.response(np.array([20.0]))[0, 0])
    assert level < 0.9 * np.abs(designed().block.response(np.array([20.0]))[0, 0])


def without_alias(model: Model) -> StateSpace:
    """Return the sampled table less what the step takes out of its samples, the alias of the hold's staircase.

    A table that is G = gain / s at high frequency, held and sampled at dt, has -gain dt / 12 of a command's change
    beyond what one without aliases would have.
    """
    t, n, ripple = sampled_table(model, DT_S), 7, -model.gain * DT_S / 12.0
    c = t.C.copy()  # states: the table's, then the late commands, the oldest first
    last = np.zeros((1, len(t.A) + 1))
    last[0, n] = 1.0
    a = np.vstack([np.hstack([t.A, np.zeros((len(t.A), 1))]), last])
    c = np.hstack([c, [[ripple]]])
    c[0, n] -= ripple
    return StateSpace(a, np.vstack([t.B, [[0.0]]]), c, t.D)


def closed_radius(model: Model, block: Block, gain: float = 1.0, delay: int = 0) -> float:
    """Return the spectral radius of table and feedback with another loop gain and further samples of delay."""
    t, k = without_alias(model), unlimited(block)
    for _ in range(delay):
        t = feedback.delayed(t, 1)
    closed = np.block([[t.A, gain * t.B @ k.C], [-k.B @ t.C, k.A - gain * k.B @ t.D @ k.C]])
    return float(np.abs(np.linalg.eigvals(closed)).max())


@pytest.mark.parametrize("samples", [1, 4])
def test_the_margins_are_where_the_sampled_loop_turns_unstable(samples: int) -> None:
    """Factors on the gain and whole samples of delay, by the eigenvalues of the closed loop."""
    model = true_model((samples + 0.5) * DT_S)
    found = design(model, None, DT_S, None, 1.5)
    assert found.measured == found.modelled
    factor = found.modelled.gain_margin
    assert closed_radius(model, found.block, 0.99 * factor) < 1.0 < closed_radius(model, found.block, 1.01 * factor)
    whole = int(found.modelled.delay_margin_s / DT_S)
    assert closed_radius(model, found.block, 1.0, whole) < 1.0 < closed_radius(model, found.block, 1.0, whole + 1)


def test_lines_at_which_the_table_is_louder_slow_the_feedback_down() -> None:
    """The limit holds on the measured response and on the model alone, whichever is worse."""
    frequency = np.linspace(0.4, 70.0, 1400)
    bump = 1.0 + 1.4 * np.exp(-(((frequency - 25.0) / 4.0) ** 2)) * np.exp(-2.3j)
    measured = Frf(frequency, bump * MODEL.response(frequency), np.ones(1400), np.zeros(1400), 10)
    alone, found = (design(MODEL, frf, DT_S, None, 1.25) for frf in (None, measured))
    fine = np.linspace(0.5, 60.0, 5000)
    table = np.interp(fine, frequency, bump.real) + 1j * np.interp(fine, frequency, bump.imag)
    table = table * MODEL.response(fine)
    assert np.abs(sensitivity(alone.block, table, fine)).max() > 1.3
    assert np.abs(sensitivity(found.block, table, fine)).max() <= 1.2501
    assert np.abs(sensitivity(found.block, MODEL.response(fine), fine)).max() <= 1.2501
    assert found.measured.sensitivity_peak != pytest.approx(found.modelled.sensitivity_peak, rel=1e-3)


def test_a_model_that_is_worse_than_the_data_counts_too() -> None:
    """Measured half as loud as the model: on the data alone the feedback could be faster than the model permits."""
    late, frequency = true_model(4.5 * DT_S), np.linspace(0.4, 250.0, 5000)
    late = Model(late.zeros, late.poles, late.gain, late.delay_s, (0.5, 240.0), 0.0, 1, DT_S)
    quiet = Frf(frequency, 0.5 * late.response(frequency), np.ones(5000), np.zeros(5000), 10)
    found = design(late, quiet, DT_S, None, 1.1)
    fine = np.geomspace(0.05, 450.0, 4000)
    assert np.abs(sensitivity(found.block, late.response(fine), fine)).max() <= 1.1001
    assert found.modelled.sensitivity_peak > 1.02 * found.measured.sensitivity_peak


def test_doubtful_lines_raise_the_stated_peak_by_what_they_may_hide() -> None:
    frequency = np.linspace(0.4, 70.0, 1400)
    measured = Frf(frequency, MODEL.response(frequency), np.ones(1400), np.full(1400, 0.09), 10)
    table = feedback.table_response(MODEL, measured, DT_S)
    loud = lqg(MODEL, 0.05, DT_S)  # its peak lies where the lines are
    found = feedback.with_margins(loud, table)
    loop = MODEL.response(GRID) * found.block.response(GRID)[0, 0]
    error = np.where((GRID >= 0.4) & (GRID <= 70.0), 0.18, 0.0)[:, None] * np.exp(2j * np.pi * np.arange(360) / 360)
    worst = np.abs(1.0 / (1.0 + loop[:, None] * (1.0 + error))).max()
    assert found.worst_peak == pytest.approx(max(worst, found.sensitivity_peak), rel=1e-3)
    assert worst > 0.999 * found.worst_peak


def test_a_measured_loop_that_goes_round_is_no_feedback() -> None:
    """A table with the opposite sign, quiet enough to keep the sensitivity limit, would be fed back positively."""
    frequency = np.linspace(0.01, 400.0, 8000)
    wide = true_model(1.5 * DT_S)
    wide = Model(wide.zeros, wide.poles, wide.gain, wide.delay_s, (0.05, 390.0), 0.0, 1, DT_S)
    opposite = Frf(frequency, -8.0 * wide.response(frequency), np.ones(8000), np.zeros(8000), 10)
    strong = design(wide, None, DT_S, 20.0, 1.5).block
    assert not feedback.with_margins(strong, feedback.table_response(wide, opposite, DT_S)).same_side
    assert feedback.with_margins(strong, feedback.table_response(wide, None, DT_S)).same_side


def test_the_observer_follows_the_command_that_was_applied() -> None:
    """Written out: the state of the plant's observer, driven by what was applied and by the error that was measured."""
    model, noise = true_model(0.5 * DT_S), 0.5
    block = lqg(model, noise, DT_S)
    a, b, c, d, drive, drive_direct = feedback.lqg_plant(feedback.sampled_table(model, DT_S), DT_S, DEFAULT)
    b, d = b[:, 0], float(d[0, 0])
    variance = drive_direct @ drive_direct.T + noise**2
    gain = riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T)[0]
    random, limit = np.random.default_rng(4), 0.02
    state, estimate, clipped, low = np.zeros(1 + len(a)), np.zeros(len(a)), 0, 0.0
    share = 1.0 - np.exp(-2.0 * np.pi * 0.1 * DT_S)  # of the high pass, which sums what was applied
    for error in 3.0 * random.standard_normal(400):
        wanted = float(block.C[0] @ state)
        applied = float(np.clip(wanted, -limit, limit))
        clipped += applied != wanted
        assert state == pytest.approx([*estimate, low], rel=1e-9, abs=1e-12)
        state = block.A @ state + block.B @ np.array([error, applied - wanted])
        through = applied + low  # before the high pass, as far as it was applied: what the observer is told
        estimate = a @ estimate + b * through + gain * (-error - c[0] @ estimate - d * through)
        low += share * applied
    assert 100 < clipped < 400


@pytest.mark.campaign
def test_an_offset_behind_an_ac_coupling_moves_the_table_aside_and_no_further() -> None:
    """A constant error and the line that the correction of an AC coupling of 0.2 Hz makes of it, for 100 s, played
    sample by sample: the command comes to rest at the offset's response times the ratio of both corners."""
    table, block = sampled_table(MODEL, DT_S), lqg(MODEL, 1.0, DT_S)
    seconds = DT_S * np.arange(round(100.0 / DT_S))
    command, left = [], np.zeros(len(table.A))
    state = np.zeros(len(block.A))
    for error in 0.02 * (1.0 + 2.0 * np.pi * 0.2 * seconds):
        sent = block.C @ state
        command.append(float(sent[0]))
        moved = error - table.C @ left - table.D @ sent
        state, left = block.A @ state + block.B[:, 0] * moved, table.A @ left + table.B @ sent
    n = len(block.A) - 1
    still = np.eye(n) - block.A[:n, :n]
    gain = block.C[0, :n] @ np.linalg.solve(still, block.B[:n, 0])  # without its high pass, at rest
    assert command[-1] == pytest.approx(2.0 * 0.02 * gain, rel=5e-3)
    assert np.abs(command).max() <= 1.05 * abs(command[-1])
    assert abs(command[-1] - command[round(50.0 / DT_S)]) < 1e-3 * abs(command[-1])


def test_without_a_high_pass_the_regulator_has_the_plants_states_and_no_other() -> None:
    """The high pass alone is between the two: their ratio is (z - 1) / (z - p)."""
    with_it, without = (lqg(MODEL, 1.0, DT_S, replace(DEFAULT, high_pass_hz=hz)) for hz in (0.1, 0.0))
    assert len(without.A) == len(with_it.A) - 1
    low = np.array([0.02, 0.1, 1.0, 20.0])
    z = np.exp(2j * np.pi * low * DT_S)
    ratio = with_it.response(low)[0, 0] / without.response(low)[0, 0]
    assert np.abs(ratio - (z - 1.0) / (z - np.exp(-2.0 * np.pi * 0.1 * DT_S))).max() < 1e-6


def test_a_table_with_a_direct_path_is_told_through_the_observer_too() -> None:
    """The shortfall enters by B - L D: with a direct path the two differ."""
    model = true_model(0.0)
    model = Model(model.zeros, model.poles[:6], model.gain / np.prod(-model.poles[6:]).real, 0.0, (0.5, 60.0))
    a, b, c, d, drive, drive_direct = feedback.lqg_plant(feedback.sampled_table(model, DT_S), DT_S, DEFAULT)
    assert abs(d[0, 0]) > 1e-3
    variance = drive_direct @ drive_direct.T + 1.0
    gain = riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T).T
    assert np.array_equal(lqg(model, 1.0, DT_S).B[:-1, 1:], b - gain @ d)


@pytest.mark.parametrize(
    ("weights", "band"), [(Weights((1.0, 12.0), 0.3), (2.0, 10.0)), (Weights((20.0, 40.0), 0.01), (1.0, 2.0))]
)
def test_other_weights_remove_less_where_the_default_works(weights: Weights, band: tuple[float, float]) -> None:
    """A dearer command, or a disturbance elsewhere: same limit on |S|, less taken off the error in the band."""
    f = np.linspace(*band, 50)
    plain, other = (designed(20.0, 1.5, w).block for w in (DEFAULT, weights))
    size = [np.abs(sensitivity(block, MODEL.response(f), f)).mean() for block in (plain, other)]
    assert size[1] > 1.05 * size[0]


def test_a_delay_that_only_roots_stand_for_goes_on_beyond_the_data() -> None:
    """A model without its delay, on the response with it: beyond the lines the phase falls on as the true table's."""
    late, frequency = true_model(4.5 * DT_S), np.linspace(0.4, 60.0, 1200)
    rootless = Model(late.zeros, late.poles, late.gain, 0.0, (0.5, 60.0), 0.0, 4, DT_S)
    measured = Frf(frequency, late.response(frequency), np.ones(1200), np.full(1200, 1e-3), 10)
    table = feedback.table_response(rootless, measured, DT_S)
    ratio = (table.measured / late.response(table.frequency_hz))[table.frequency_hz > 0.4]
    assert np.abs(np.angle(ratio)).max() < 0.05
    assert np.abs(ratio).min() > 0.99
    end = np.flatnonzero(table.frequency_hz > 60.0)
    level = np.abs(table.measured[end]) * np.sqrt(table.frequency_hz[end])
    assert level.min() > 0.99 * abs(late.response(np.array([60.0]))[0]) * np.sqrt(60.0)
    found, fine = design(rootless, measured, DT_S, None, 1.5), np.geomspace(0.05, 800.0, 6000)
    assert np.abs(sensitivity(found.block, late.response(fine), fine)).max() < 1.55
    assert found.modelled.sensitivity_peak < 0.95 * found.measured.sensitivity_peak


def test_lines_that_say_nothing_are_left_out() -> None:
    frequency = np.linspace(0.4, 70.0, 700)
    response, error = MODEL.response(frequency), np.full(700, 0.01)
    response[300:320], error[300:320] = 9.0 * response[300:320], 0.5
    response[600:], error[600:] = 0.0, 2.0
    table = feedback.table_response(MODEL, Frf(frequency, response, np.ones(700), error, 10), DT_S)
    assert table.measured == pytest.approx(table.modelled, rel=1e-9)
    assert table.relative_error.max() == pytest.approx(0.01)


def test_the_disturbance_lies_in_the_band_asked_for() -> None:
    """Its two poles, sampled: exp(-w dt) at both corners."""
    a = feedback.lqg_plant(feedback.sampled_table(MODEL, DT_S), DT_S, Weights((3.0, 30.0)))[0]
    poles = np.sort(np.linalg.eigvals(a[-2:, -2:]).real)
    assert poles == pytest.approx(np.exp(-2.0 * np.pi * np.array([30.0, 3.0]) * DT_S), rel=1e-12)


def test_no_feedback_is_zero() -> None:
    assert none(DT_S).response(np.array([1.0]))[0, 0, 0] == 0.0


def test_a_measured_response_that_is_no_number_has_no_feedback() -> None:
    frequency = np.arange(0.5, 60.0, 0.05)
    nothing = Frf(
        frequency, np.full(frequency.size, np.nan + 0j), np.ones(frequency.size), np.zeros(frequency.size), 10
    )
    with pytest.raises(InputError, match="no feedback"):
        design(MODEL, nothing, DT_S, None, 1.5)
