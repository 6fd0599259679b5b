"""Intensity measures and spectra of motions whose measures are known in closed form: one sine pulse, a step, a decay.

Oracle of the spectra: the undamped oscillator under one cycle of a sine, solved by hand: during the pulse
u = -(A / (w^2 - p^2)) (sin pt - (p / w) sin wt), then free.
"""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.intensity import (
    average_sa,
    cumulative_velocity,
    duration,
    husid,
    integrate,
    mean_period,
    measures,
    spectrum,
)
from rths_cli.case.shipped_files import shipped
from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.numerics.lti import Array

G, DT_S, AMPLITUDE, PULSE_S, REST_S = 9.80665, 0.01, 2.0, 2.0, 4.0


def pulse() -> Array:
    """Return one cycle of a sine of 2 s, then rest."""
    t = np.arange(0.0, PULSE_S + REST_S + DT_S / 2, DT_S)
    return np.where(t <= PULSE_S, AMPLITUDE * np.sin(2.0 * np.pi * t / PULSE_S), 0.0)


def test_a_ramp_is_integrated_exactly() -> None:
    """a = t, v = t^2 / 2, u = t^3 / 6."""
    t = np.arange(0.0, 3.01, 0.5)
    velocity, displacement = integrate(t, 0.5)
    assert velocity == pytest.approx(t**2 / 2) and displacement == pytest.approx(t**3 / 6)


def peak_displacement(period_s: float) -> float:
    """Return max|u| of the undamped oscillator over pulse and rest, from the closed form at many instants."""
    p, w = 2.0 * np.pi / PULSE_S, 2.0 * np.pi / period_s
    t = np.linspace(0.0, PULSE_S, 200_001)
    if abs(p - w) < 1e-9:
        during = -AMPLITUDE / (2.0 * w**2) * (np.sin(w * t) - w * t * np.cos(w * t))
        speed = -AMPLITUDE / 2.0 * t[-1] * np.sin(w * t[-1])
    else:
        factor = -AMPLITUDE / (w**2 - p**2)
        during = factor * (np.sin(p * t) - p / w * np.sin(w * t))
        speed = factor * p * (np.cos(p * t[-1]) - np.cos(w * t[-1]))
    free = np.hypot(during[-1], speed / w) if period_s < REST_S else 0.0
    return float(max(np.abs(during).max(), free))


@pytest.mark.parametrize("period_s", [0.1, 0.137, 0.25, 0.5, 1.0, 1.7, 2.0, 3.1])
def test_spectra_of_a_sine_pulse_are_its_closed_form(period_s: float) -> None:
    found = spectrum(pulse(), DT_S, [period_s], 0.0)
    expected, w = peak_displacement(period_s), 2.0 * np.pi / period_s
    assert found.sd_m == pytest.approx([expected], rel=1e-3)
    assert found.sv_m_s == pytest.approx([w * expected], rel=1e-3)
    assert found.sa_m_s2 == pytest.approx([w**2 * expected], rel=1e-3)


def test_measures_of_a_sine_pulse_are_its_closed_form() -> None:
    found = measures(pulse(), DT_S)
    assert found.pga_m_s2 == pytest.approx(AMPLITUDE, rel=1e-3)
    assert found.pgv_m_s == pytest.approx(AMPLITUDE * PULSE_S / np.pi, rel=1e-3)
    assert found.pgd_m == pytest.approx(AMPLITUDE * PULSE_S**2 / (2.0 * np.pi), rel=1e-3)
    assert found.arias_m_s == pytest.approx(np.pi / (2.0 * G) * AMPLITUDE**2 * PULSE_S / 2.0, rel=1e-3)
    assert found.cav_m_s == pytest.approx(2.0 * AMPLITUDE * PULSE_S / np.pi, rel=1e-3)


@pytest.mark.parametrize(("low", "high"), [(0.05, 0.75), (0.05, 0.95)])
def test_durations_of_a_decay_are_its_closed_form(low: float, high: float) -> None:
    rate = 0.8  # of the energy, exp(-rate t): a share s is reached at -ln(1 - s) / rate
    accel = np.exp(-0.5 * rate * np.arange(0.0, 40.0, 0.005))
    expected = (np.log(1.0 - low) - np.log(1.0 - high)) / rate
    assert duration(husid(accel, 0.005), 0.005, low, high) == pytest.approx(expected, rel=1e-3)


def test_velocity_between_samples_of_opposite_sign_counts_both_triangles() -> None:
    assert cumulative_velocity(np.array([1.0, -1.0]), 1.0) == pytest.approx(0.5)
    assert cumulative_velocity(np.array([3.0, -1.0, 0.0]), 1.0) == pytest.approx(9 / 8 + 1 / 8 + 0.5)


@pytest.mark.parametrize("period_s", [0.2, 1.0])
def test_the_mean_period_of_a_long_sine_is_its_period(period_s: float) -> None:
    t = np.arange(0.0, 100.0, 0.01)
    assert mean_period(np.sin(2.0 * np.pi * t / period_s), 0.01) == pytest.approx(period_s, rel=2e-3)
    assert mean_period(np.zeros(500), 0.01) == 0.0


def test_housner_and_average_of_a_velocity_step_are_its_own() -> None:
    # a short pulse of area V leaves every softer oscillator with Sv = V times the damped peak factor
    accel = np.zeros(20_001)
    accel[1:5] = 10.0
    area, zeta = 0.0005 * 40.0, 0.05
    factor = np.exp(-zeta / np.sqrt(1.0 - zeta**2) * np.arccos(zeta))
    assert measures(accel, 0.0005).housner_m == pytest.approx(area * factor * 2.4, rel=2e-3)
    periods = np.arange(0.2, 3.01, 0.1) * 0.5
    expected = np.exp(np.log(2.0 * np.pi / periods * area * factor).mean())
    assert average_sa(accel, 0.0005, 0.5) == pytest.approx(expected, rel=2e-3)


def test_impossible_oscillators_are_refused() -> None:
    with pytest.raises(InputError, match="every period must be a positive number"):
        spectrum(pulse(), DT_S, [0.0])
    with pytest.raises(InputError, match="damping_ratio: 1 must be"):
        spectrum(pulse(), DT_S, [1.0], 1.0)


@pytest.mark.parametrize("program", ["eqsig", "pyrotd"])
@pytest.mark.parametrize("name", ["el_centro", "hachinohe"])
def test_spectra_agree_with_those_of_other_programs(program: str, name: str) -> None:
    """Both are given the straight lines between the samples: pyrotd takes a sum of sines between what it is given."""
    other = pytest.importorskip(program)
    record = read_accelerogram(shipped("records") / f"{name}.csv")
    accel, dt_s = record.accel_m_s2, record.dt_s
    periods = np.array([0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0])  # at least 10 intervals
    fine = np.interp(np.arange((accel.size - 1) * 8 + 1) / 8, np.arange(accel.size), accel)
    if program == "eqsig":
        signal = other.AccSignal(fine, dt_s / 8)
        signal.generate_response_spectrum(response_times=periods, xi=0.05)
        found = signal.s_a
    else:
        padded = np.concatenate([fine, np.zeros(fine.size)])  # its transform is circular
        spectra = other.calc_spec_accels(dt_s / 8, padded / 9.80665, 1.0 / periods, 0.05)
        found = 9.80665 * spectra.spec_accel
    assert spectrum(accel, dt_s, periods, 0.05).sa_m_s2 == pytest.approx(found, rel=0.01)
