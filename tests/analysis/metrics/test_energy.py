"""Oracles: work of harmonic motion in closed form, negative damping of a late spring, the balance of energies."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rths_cli.analysis.metrics import error_energy_j, input_energy_j, velocity_error_m_s
from rths_cli.analysis.sim import simulate
from rths_cli.errors import InputError
from rths_cli.structure import Building

DT_S = 1 / 2000
TIME_S = DT_S * np.arange(200_001)  # 100 s
RATE = 2 * np.pi * 2.3


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.5])
def test_work_of_a_harmonic_force_over_whole_cycles(phase: float) -> None:
    """Half of force times velocity error times cos(phase), every second: 2.3 Hz for 100 s is 230 cycles."""
    force, error = 40.0 * np.cos(RATE * TIME_S + phase), 0.003 * np.cos(RATE * TIME_S)
    fed = error_energy_j(force, error, DT_S)
    assert fed[0] == 0.0
    assert fed[-1] == pytest.approx(0.5 * 40.0 * 0.003 * 100.0 * np.cos(phase), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("delay_s", [0.001, 0.005, -0.002])
@pytest.mark.parametrize("bias_m_s2", [0.0, 0.01])
def test_a_late_spring_feeds_in_what_negative_damping_would(delay_s: float, bias_m_s2: float) -> None:
    """A spring k that follows late adds pi k X^2 sin(w delay) per cycle; an accelerometer's bias must not show."""
    stiffness, amplitude = 7000.0, 0.01
    shear = -stiffness * amplitude * np.sin(RATE * (TIME_S - delay_s))
    desired, measured = (-(RATE**2) * amplitude * np.sin(RATE * (TIME_S - late)) for late in (0.0, delay_s))
    fed = error_energy_j(shear, velocity_error_m_s(desired - measured + bias_m_s2, DT_S), DT_S)[-1]
    expected = 230 * np.pi * stiffness * amplitude**2 * np.sin(RATE * delay_s)
    assert fed == pytest.approx(expected, rel=5e-3)


def test_a_late_mass_takes_out_what_a_late_spring_feeds_in() -> None:
    """The force of a rigid mass on the interface is -m a: its sign is the other."""
    mass, amplitude, delay_s = 13.86, 0.01, 0.002
    desired, measured = (-(RATE**2) * amplitude * np.sin(RATE * (TIME_S - late)) for late in (0.0, delay_s))
    fed = error_energy_j(-mass * measured, velocity_error_m_s(desired - measured, DT_S), DT_S)[-1]
    assert fed == pytest.approx(-230 * np.pi * mass * RATE**2 * amplitude**2 * np.sin(RATE * delay_s), rel=5e-3)


@pytest.mark.parametrize("frequency_hz", [0.3, 0.5, 2.0, 9.0])
def test_velocity_of_a_sine_keeps_phase_and_the_gain_of_the_high_pass(frequency_hz: float) -> None:
    rate = 2 * np.pi * frequency_hz
    found = velocity_error_m_s(rate * np.cos(rate * TIME_S) + 0.2, DT_S)
    gain = 1 / (1 + (0.1 / frequency_hz) ** 4)  # squared 2nd-order Butterworth
    middle = slice(80_000, 120_000)
    assert_allclose(found[middle], gain * np.sin(rate * TIME_S[middle]), rtol=0, atol=1e-3)


def test_input_energy_is_what_is_stored_and_dissipated(default_building: Building) -> None:
    """Kinetic and strain energy plus the dashpots' work of SIM under noise; M, C and K of the whole building."""
    M, C, K = default_building.M, default_building.C, default_building.K
    coarse = np.random.default_rng(5).normal(size=400)
    ground = np.interp(np.arange(20_000), 50 * np.arange(400), coarse)
    moved = simulate(default_building, DT_S, ground)
    x, v = moved.rel_disp_m, moved.rel_vel_m_s
    stored = 0.5 * np.einsum("it,ij,jt->t", v, M, v) + 0.5 * np.einsum("it,ij,jt->t", x, K, x)
    power = np.einsum("it,ij,jt->t", v, C, v)
    lost = DT_S * (np.cumsum(power) - 0.5 * power - 0.5 * power[0])
    found = input_energy_j(M, v, ground, DT_S)
    assert found == pytest.approx(stored + lost, abs=1e-4 * found.max())


def test_input_energy_of_one_storey_in_resonance() -> None:
    """In the steady state at resonance every cycle puts in pi m^2 A^2 / c."""
    mass, dashpot, ground = 7.0, 20.0, 0.3
    velocity = -mass * ground / dashpot * np.sin(RATE * TIME_S)
    found = input_energy_j(np.array([[mass]]), velocity[None], ground * np.sin(RATE * TIME_S), DT_S)[-1]
    assert found == pytest.approx(230 * np.pi * (mass * ground) ** 2 / (dashpot * RATE), rel=1e-9)


def test_different_lengths_are_named() -> None:
    with pytest.raises(InputError, match=r"velocity_error_m_s has shape \(3,\), but base_shear_n has \(4,\)"):
        error_energy_j(np.arange(4.0), np.arange(3.0), DT_S)


@pytest.fixture(scope="module")
def default_building() -> Building:
    """Return the paper's building with lower damping."""
    from rths_cli.case.load import load_cases
    from rths_cli.experiment.setup import make_setup

    return make_setup(load_cases(["el_centro_low_ff_fb"])[0]).building


def test_each_of_several_errors_is_integrated_for_itself() -> None:
    errors = np.random.default_rng(6).standard_normal((2, 3000))
    together = velocity_error_m_s(errors, DT_S)
    assert np.array_equal(together, [velocity_error_m_s(each, DT_S) for each in errors])
    assert np.abs(together[0] - together[1]).max() > 0.01
