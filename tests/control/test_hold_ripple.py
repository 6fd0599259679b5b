"""The hold's size and its alias in a table's samples, against the exact sampled table with sensors and correction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import LINEAR, held, linear_table, rig_info, specimen
from hybrid import best_like, closed_loop, storeys, true_model

from rths_cli.analysis.closed_loop import closed_loop_matrix, loop_response, spectral_radius
from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.control.sensor_correction import correction
from rths_cli.numerics.lti import Array, ComplexArray, Model, staircase

FREQUENCY_HZ = np.array([0.5, 1.0, 2.0, 4.0, 7.0, 10.0])
SIMPLE = Model(np.zeros(2, dtype=complex), np.array([-90.0 + 0j]), 1.0, 7.5e-4, (0.5, 60.0), 0.0, 1, 5e-4)


def sampled_and_smooth(rate_hz: float, high_pass_hz: float) -> tuple[ComplexArray, ComplexArray]:
    """Return the response of the table's corrected samples to a command held at once, and of its acceleration to a
    smooth one half a sample late and as much smaller as the hold makes it."""
    info = rig_info(dt_s=1.0 / rate_hz, high_pass_hz=high_pass_hz)
    a, b, sensed, true = linear_table(LINEAR, specimen(), 1549.0, high_pass_hz)
    step, drive = held(a, b, info.dt_s)
    s = 2j * np.pi * FREQUENCY_HZ
    z = np.exp(s * info.dt_s)
    raw = np.array([sensed[0] @ np.linalg.solve(point * np.eye(len(a)) - step, drive) for point in z])
    scale = info.channels[0].sensitivity_v_per_unit
    smooth = np.array([true[0] @ np.linalg.solve(point * np.eye(len(a)) - a, b) for point in s])
    hold = (1.0 - 1.0 / z) / (s * info.dt_s)
    return raw * scale * correction(info.channels, info.dt_s).response(FREQUENCY_HZ)[0, 0], smooth * hold


def ripples(rate_hz: float, high_pass_hz: float, coupling_hz: float) -> ComplexArray:
    """Return what the samples have beyond the smooth response, per unit of the staircase's alias; the samples here are
    not late at all, the alias is by one."""
    sampled, smooth = sampled_and_smooth(rate_hz, high_pass_hz)
    late = np.exp(-2j * np.pi * FREQUENCY_HZ / rate_hz)
    return (sampled - smooth) * late / staircase(FREQUENCY_HZ, 1, 1.0 / rate_hz, coupling_hz)


@pytest.mark.parametrize("rate_hz", [1000.0, 2000.0])
def test_the_alias_is_one_number_at_every_frequency(rate_hz: float) -> None:
    """Real, and with AC coupling the same as without, when its integral is counted; not otherwise."""
    bare, found, without = (ripples(rate_hz, *hz) for hz in ((0.0, 0.0), (0.024, 0.024), (0.024, 0.0)))
    assert bare.real == pytest.approx(bare.real.mean(), rel=2e-3)
    assert bare.real.mean() < -1.0
    assert np.abs(bare.imag / bare.real).max() < 0.02
    assert np.abs(found / bare - 1.0).max() < 2e-4
    assert np.abs(without / bare - 1.0)[:2].min() > 0.02


def test_what_integrates_the_alias_is_the_sensors_correction() -> None:
    info, dt = rig_info(high_pass_hz=3.0, low_pass_hz=0.0), 5e-4
    integrates = correction(info.channels, dt).response(FREQUENCY_HZ)[0, 0] * info.channels[0].sensitivity_v_per_unit
    wanted = integrates * staircase(FREQUENCY_HZ, 2, dt)
    assert staircase(FREQUENCY_HZ, 2, dt, 3.0) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("latency", [0, 1, 3])
def test_a_models_alias_is_its_difference_and_sum_of_commands(latency: int) -> None:
    model = Model(
        np.zeros(2, dtype=complex), np.array([-90.0 + 0j]), 1.0, 7.5e-4, (0.5, 60.0), -1.4, latency, 5e-4, 0.3
    )
    late = np.exp(-2j * np.pi * FREQUENCY_HZ * 5e-4)
    one, other = (late ** max(latency, 1) * late**more for more in (0, 1))
    wanted = -1.4 * (one - other) + model.ripple_sum_m_s2_per_v * (one + other)
    assert model.alias(FREQUENCY_HZ) == pytest.approx(wanted, rel=1e-12)
    assert model.ripple_sum_m_s2_per_v == pytest.approx(-1.4 * np.pi * 0.3 * 5e-4)
    assert model.sampled_response(FREQUENCY_HZ) - model.response(FREQUENCY_HZ) == pytest.approx(wanted, rel=1e-9)
    assert replace(model, coupling_hz=0.0).ripple_sum_m_s2_per_v == 0.0


def mean_over_hold(frequency_hz: Array, dt_s: float) -> Array:
    """Return the mean of a sine over dt, by the midpoint rule."""
    inside = (np.arange(2000) + 0.5) / 2000 - 0.5
    return np.cos(2.0 * np.pi * frequency_hz[:, None] * dt_s * inside).mean(axis=1)


def test_the_holds_size_is_the_mean_of_a_sine_over_it() -> None:
    f = np.array([1.0, 60.0, 400.0])
    size = np.abs(SIMPLE.response(f) / replace(SIMPLE, dt_s=0.0).response(f))
    assert size == pytest.approx(mean_over_hold(f, 5e-4), rel=1e-6)


def test_the_stored_block_is_what_the_step_takes_out() -> None:
    info = rig_info(latency_samples=3)
    blocks = replace(best_like(info), ripple_sum_m_s2_per_v=-0.2)
    unit = np.exp(-2j * np.pi * FREQUENCY_HZ * info.dt_s)
    wanted = -1.35 * unit**3 * (1.0 - unit) - 0.2 * unit**3 * (1.0 + unit)
    assert blocks.staircase().response(FREQUENCY_HZ)[0, 0] == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("high_pass_hz", [0.0, 0.024])
def test_nothing_is_left_of_the_alias_where_the_rig_is_known(high_pass_hz: float) -> None:
    """The loop's table answers as the smooth model when step and rig have the same alias; with another one, or without
    its integral, the difference stays."""
    info = rig_info(dt_s=1e-3, high_pass_hz=high_pass_hz)
    smooth = replace(true_model(1.5e-3), dt_s=1e-3, coupling_hz=high_pass_hz)
    own = identified_rig(smooth, specimen(), info, True).ripple_m_s2_per_v
    model = replace(smooth, ripple_m_s2_per_v=-own)  # so that the rig has the alias of its own hold, no more
    rig = identified_rig(model, specimen(), info, True)
    assert abs(rig.ripple_m_s2_per_v) < 1e-9
    z = np.exp(2j * np.pi * FREQUENCY_HZ * info.dt_s)

    def table(ripple: float, total: float) -> ComplexArray:
        blocks = replace(best_like(info), ripple_m_s2_per_v=ripple, ripple_sum_m_s2_per_v=total)
        return loop_response(rig, blocks, all_storeys(storeys(), info.dt_s), z).rig[0]

    known = table(model.ripple_m_s2_per_v, model.ripple_sum_m_s2_per_v)
    assert np.abs(known / model.response(FREQUENCY_HZ) - 1.0).max() < 3e-4
    unknown = table(0.0, 0.0)
    assert unknown == pytest.approx(known + model.alias(FREQUENCY_HZ), rel=1e-9)


@pytest.mark.parametrize("total", [0.0, -0.05])
def test_the_loops_matrix_has_difference_and_sum_as_the_step_takes_them_out(total: float) -> None:
    """Against the matrix of the true table; without AC coupling its samples have no sum, so that the step adds one."""
    info = rig_info(high_pass_hz=0.0)
    blocks = replace(best_like(info), ripple_sum_m_s2_per_v=total)
    own = identified_rig(true_model(1.5 * info.dt_s), specimen(), info, True).ripple_m_s2_per_v
    model = replace(true_model(1.5 * info.dt_s), ripple_m_s2_per_v=-own)
    rig = identified_rig(model, specimen(), info, True)
    roots = np.linalg.eigvals(closed_loop(info, blocks).M)
    slowest = np.abs(roots[np.abs(roots - 1.0) > 1e-7]).max()  # integrators of an AC coupling that is not there
    assert spectral_radius(closed_loop_matrix(rig, blocks)) == pytest.approx(slowest, rel=1e-7)
