"""The virtual table against the same equations solved by other programs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, equations, held, ideal_info, linear_table, play_plant, rig_info, run_plant, specimen
from portfolio import parametrize_first
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from rths_cli.case.virtual_physics_schema import AfterIdentification, VirtualPhysics
from rths_cli.numerics.lti import Array
from rths_cli.rigs.virtual.plant_kernel import less_than_exp
from rths_cli.rigs.virtual.virtual_rig import build_plant, changed

G = 9.80665
SHIPPED = VirtualPhysics()


def peak(values: Array) -> float:
    return float(np.abs(values).max())


def smooth_command(samples: int, dt_s: float, size_v: float) -> Array:
    time = np.arange(samples) * dt_s
    return size_v * (np.sin(2.0 * np.pi * 2.0 * time) + 0.4 * np.sin(2.0 * np.pi * 7.3 * time)) * np.tanh(5.0 * time)


def test_without_friction_the_table_is_the_exact_linear_one() -> None:
    """Against scipy's lsim and against exp(A dt), both on matrices built from the equations of motion."""
    command, interface_mass = np.random.default_rng(3).standard_normal(2000), 1.7
    info = ideal_info(latency_samples=0)
    samples, states, _ = play_plant(info, LINEAR, command, interface_mass_kg=interface_mass)
    a, b, rows, _ = linear_table(LINEAR, specimen(), 1549.0, interface_mass_kg=interface_mass)
    _, _, by_lsim = lsim(
        (a, b[:, None], np.eye(len(a)), np.zeros((len(a), 1))), command, np.arange(2000) * DT_S, interp=False
    )
    step, drive = held(a, b, DT_S)
    exact = np.zeros((len(a), 2000))
    for k in range(1999):
        exact[:, k + 1] = step @ exact[:, k] + drive * command[k]
    accelerations = samples / info.channels[0].sensitivity_v_per_unit
    for oracle in (by_lsim.T, exact):
        for i in range(7):
            assert peak(states[i] - oracle[i]) < 1e-9 * peak(oracle[i])
        assert peak(accelerations - rows @ oracle) < 1e-9 * peak(rows @ oracle)


@parametrize_first(
    1,
    ("physics", "command_v", "interface_mass"),
    [
        (SHIPPED, 0.15, 0.0),
        (SHIPPED.model_copy(update={"coulomb_n": 1.5}), 0.15, 2.0),
        (SHIPPED.model_copy(update={"force_limit_n": 60.0}), 2.0, 0.0),
        (SHIPPED.model_copy(update={"coulomb_n": 1.5, "coulomb_velocity_m_s": 2e-4}), 2.5, 0.0),
    ],
    ids=["friction", "strong friction", "force limit", "reversal from saturated friction within an interval"],
)
def test_friction_and_force_limit_agree_with_a_general_solver(
    physics: VirtualPhysics, command_v: float, interface_mass: float
) -> None:
    """The staircase command is solved interval by interval at rtol 1e-10; 0.3 s with reversals or clipping."""
    info, count = ideal_info(latency_samples=0), 600
    command = smooth_command(count, DT_S, command_v)
    _, states, _ = play_plant(info, physics, command, interface_mass_kg=interface_mass)
    rate = equations(physics, specimen(), interface_mass)
    wanted = np.zeros((7, count))
    for k in range(count - 1):
        solution = solve_ivp(
            lambda _, y, u=command[k]: rate(y, u)[0], (0.0, DT_S), wanted[:, k], "DOP853", rtol=1e-10, atol=1e-13
        )
        wanted[:, k + 1] = solution.y[:, -1]
    if physics.force_limit_n < 100.0:
        assert peak(wanted[2]) > 0.9 * physics.force_limit_n
    assert np.count_nonzero(np.diff(np.sign(wanted[1, 1:]))) >= 2
    for i in range(7):
        assert peak(states[i] - wanted[i]) < 1e-6 * peak(wanted[i])


HALVED = [
    (SHIPPED, 5e-4, 0.4),
    (SHIPPED.model_copy(update={"coulomb_n": 1.5}), 5e-4, 0.4),
    (SHIPPED.model_copy(update={"coulomb_n": 4.5}), 5e-4, 0.4),
    (SHIPPED.model_copy(update={"moving_mass_kg": 4.0}), 5e-4, 0.4),
    (SHIPPED, 1e-3, 0.4),
    (SHIPPED, 2.5e-4, 0.4),
    (SHIPPED.model_copy(update={"force_limit_n": 60.0}), 5e-4, 2.0),
    (SHIPPED, 1e-3, 4.0),
]


@parametrize_first(2, ("physics", "dt_s", "size_v"), HALVED)
def test_halving_the_inner_step_changes_nothing_by_a_millionth_of_the_peak(
    physics: VirtualPhysics, dt_s: float, size_v: float
) -> None:
    info = ideal_info(dt_s=dt_s, high_pass_hz=0.024)
    command = smooth_command(round(2.5 / dt_s), dt_s, size_v)
    plain, finer = (play_plant(info, physics, command, refine=refine) for refine in (0, 1))
    for channel in range(3):
        assert peak(plain[0][channel] - finer[0][channel]) < 1e-6 * peak(finer[0][channel])
        assert peak(plain[2][channel] - finer[2][channel]) < 1e-6 * peak(finer[2][channel])
    for i in range(7):
        assert peak(plain[1][i] - finer[1][i]) < 1e-6 * peak(finer[1][i])
    assert peak(plain[1] - finer[1]) > 0.0
    assert (peak(finer[1][2]) > 0.9 * physics.force_limit_n) == (size_v > 1.0)


def test_true_velocities_stand_in_the_middle_of_each_interval_and_are_absolute() -> None:
    command = smooth_command(1000, DT_S, 1.0)
    _, states, middle = play_plant(ideal_info(latency_samples=0), LINEAR, command)
    a, b, _, _ = linear_table(LINEAR, specimen(), 1549.0)
    half, drive = held(a[:7, :7], b[:7], 0.5 * DT_S)
    there = half @ states + np.outer(drive, command)
    assert peak(middle[0] - there[1]) < 1e-9 * peak(there[1])
    assert peak(middle[1:] - (there[1] + there[5:7])) < 1e-9 * peak(there[5:7])


def test_changes_after_identification_act_on_their_own_quantity_only() -> None:
    change = AfterIdentification(specimen_stiffness_factor=0.85, coulomb_factor=3.0, payload_factor=1.1)
    physics, parts = changed(SHIPPED, specimen(), change)
    assert physics == SHIPPED.model_copy(update={"coulomb_n": pytest.approx(0.9)})
    assert parts.masses_kg == pytest.approx(specimen().masses_kg * 1.1)
    assert np.allclose(parts.K, specimen().K * 0.85, rtol=1e-12)
    assert np.array_equal(parts.C, specimen().C)
    untouched = changed(SHIPPED, specimen(), AfterIdentification())
    assert untouched[0] == SHIPPED
    assert np.array_equal(untouched[1].K, specimen().K)


def test_changed_friction_stiffness_and_payload_reach_the_table() -> None:
    command, info = smooth_command(1500, DT_S, 0.4), ideal_info()
    base = run_plant(build_plant(info, SHIPPED, specimen(), 0.0), info, command)[0]
    for change in (
        AfterIdentification(coulomb_factor=3.0),
        AfterIdentification(specimen_stiffness_factor=0.85),
        AfterIdentification(payload_factor=1.1),
    ):
        physics, parts = changed(SHIPPED, specimen(), change)
        other = run_plant(build_plant(info, physics, parts, 0.0), info, command)[0]
        assert peak(other - base) > 0.01 * peak(base)


def test_sensors_with_their_shipped_corners_are_exact() -> None:
    info, command = ideal_info(latency_samples=0, high_pass_hz=0.024), np.random.default_rng(4).standard_normal(4000)
    samples, _, _ = play_plant(info, LINEAR, command)
    a, b, rows, _ = linear_table(LINEAR, specimen(), 1549.0, 0.024)
    step, drive = held(a, b, DT_S)
    state, wanted = np.zeros(len(a)), np.zeros_like(samples)
    for k in range(4000):
        wanted[:, k] = rows @ state / G
        state = step @ state + drive * command[k]
    assert peak(samples - wanted) < 1e-9 * peak(wanted)


@parametrize_first(1, ("high_pass_hz", "low_pass_hz"), [(0.0, 80.0), (0.5, 80.0), (3.0, 40.0)])
def test_sensors_answer_as_their_two_corners_say(high_pass_hz: float, low_pass_hz: float) -> None:
    """A sine of 5 Hz after its transient against table, hold and sensor in the frequency domain."""
    frequency, settle, count, dt_s = 5.0, 24000, 8000, 2.5e-4
    info = ideal_info(latency_samples=0, high_pass_hz=high_pass_hz, low_pass_hz=low_pass_hz, dt_s=dt_s)
    time = np.arange(settle + count) * dt_s
    samples, _, _ = play_plant(info, LINEAR, np.sin(2.0 * np.pi * frequency * time))
    late = np.exp(-2j * np.pi * frequency * time[settle:])
    measured = samples[0, settle:] @ late / (count / 2j) / info.channels[0].sensitivity_v_per_unit
    a, b, _, true = linear_table(LINEAR, specimen(), 1.0)
    s = 2j * np.pi * frequency
    wanted = true[0] @ np.linalg.solve(s * np.eye(len(a)) - a, b) * (1.0 - np.exp(-s * dt_s)) / (s * dt_s)
    wanted *= s / (s + 2.0 * np.pi * high_pass_hz) / (1.0 + s / (2.0 * np.pi * low_pass_hz))
    assert abs(measured / wanted - 1.0) < 2e-4


def test_noise_has_its_size_and_no_memory() -> None:
    from rths_cli.rigs.virtual.virtual_rig import VirtualRig

    info = ideal_info()
    rig = VirtualRig(info, build_plant(info, SHIPPED, specimen(), 3e-4), (5,))
    rig.arm()
    samples = np.array([rig.exchange(0.0).copy() for _ in range(10000)]) / info.channels[0].sensitivity_v_per_unit
    assert np.std(samples, axis=0) == pytest.approx(3e-4, rel=0.03)
    assert abs(np.corrcoef(samples[1:, 0], samples[:-1, 0])[0, 1]) < 0.04
    assert abs(np.corrcoef(samples[:, 0], samples[:, 1])[0, 1]) < 0.04


def test_one_bit_is_3_mm_s2_of_acceleration_and_2_4_um_of_command() -> None:
    info = rig_info(latency_samples=0, high_pass_hz=0.0)
    bit_v = 20.0 / 65536.0
    samples, states, _ = play_plant(info, LINEAR, np.full(8000, 1.4 * bit_v))
    assert states[0, -1] == pytest.approx(2.41e-6, rel=2e-3)
    samples, _, _ = play_plant(info, LINEAR, smooth_command(2000, DT_S, 1.0))
    steps = np.unique(np.abs(np.diff(np.unique(samples)))) * G
    assert steps.min() == pytest.approx(2.99e-3, rel=2e-3)
    assert np.allclose(samples / bit_v, np.round(samples / bit_v), atol=1e-9)


def test_samples_saturate_at_the_sensors_range_or_the_converters() -> None:
    jerk = np.full(200, 10.0)
    info = rig_info()
    samples, _, _ = play_plant(info, LINEAR, jerk)
    assert samples.max() == pytest.approx(5.0, abs=4e-4)  # 5 g of a +-10 V converter
    narrow = replace(info, converters=replace(info.converters, range_v=2.5, bits=8))
    samples, _, _ = play_plant(narrow, LINEAR, jerk)
    assert samples.max() == 2.5 - 5.0 / 256.0
    samples, _, _ = play_plant(narrow, LINEAR, -jerk)
    assert samples.min() == -2.5


def test_a_command_beyond_the_converter_acts_like_its_last_code() -> None:
    info = rig_info(latency_samples=0)
    bit_v = 20.0 / 65536.0
    over, last = (play_plant(info, LINEAR, np.full(50, u)) for u in (1e3, 10.0 - bit_v))
    assert np.array_equal(over[1], last[1])


def test_zero_switches_each_fault_of_the_sensors_off() -> None:
    """Without corners, bits and noise a sample is the acceleration of its own instant."""
    info = ideal_info(latency_samples=0, low_pass_hz=0.0)
    samples, states, _ = play_plant(info, LINEAR, smooth_command(500, DT_S, 1.0))
    true = linear_table(LINEAR, specimen(), 1.0)[3][:, :7] @ states
    assert peak(samples * G - true) < 1e-12 * peak(true)


def test_the_force_limit_clips_what_the_displacement_loop_asks_for() -> None:
    """A step of 2 V asks for 945 N; the force then rises to its limit as a first-order lag."""
    info = ideal_info(latency_samples=0)
    _, states, _ = play_plant(info, SHIPPED, np.full(8, 2.0))
    time = np.arange(8) * DT_S
    assert states[2] == pytest.approx(445.0 * (1.0 - np.exp(-time / 1.5e-3)), rel=1e-9)


def test_what_spares_an_exp_is_at_most_that_exp_and_not_far_below() -> None:
    """The level of inner steps is one too low where it were more, and an exp is called in vain where it is far less."""
    for x in np.concatenate([np.linspace(0.0, 2.0, 201), np.linspace(2.0, 80.0, 100)]):
        bound = less_than_exp.py_func(x)  # type: ignore[attr-defined]
        assert bound <= np.exp(x) * (1.0 + 1e-15)
        assert bound >= 0.75 * np.exp(x) or x > 2.0
