"""SIM-DELAY line by line against its solution in time; the loop's roots against roots known beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.closed_loop import loop_roots, modes_in_loop
from rths_cli.analysis.fourier_lines import delayed_rms, lines_for
from rths_cli.analysis.metrics import error_figures
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.structure import Building, Numerical, Specimen, assemble
from rths_cli.structure.shear_chain import storey_matrix

DT_S = 0.0005


def building(interface_mass_kg: float) -> Building:
    """Return five storeys, cut at the second."""
    numerical = Numerical(np.array([8.0, 7.0]), storey_matrix([9000.0, 8000.0]), storey_matrix([40.0, 30.0]))
    specimen = Specimen(np.array([6.9, 6.5, 6.0]), storey_matrix([7300.0, 7000.0, 6500.0]), storey_matrix([30.0] * 3))
    return Building(numerical, specimen, interface_mass_kg, *assemble(numerical, specimen, interface_mass_kg), ())


@pytest.mark.parametrize(("interface_mass_kg", "delay_s"), [(0.0, 0.0), (0.0, 0.003), (1.5, 0.006)])
def test_errors_of_sim_delay_are_those_of_its_solution_in_time(interface_mass_kg: float, delay_s: float) -> None:
    whole = building(interface_mass_kg)
    time = np.arange(round(15.0 / DT_S)) * DT_S
    points = np.random.default_rng(3).normal(size=301)
    ground = np.interp(time, 0.05 * np.arange(301), points) * np.exp(-0.8 * time) * np.sin(0.2 * time)
    sim = simulate(whole, DT_S, ground)
    lines = lines_for(len(time), DT_S, 20.0)
    floors = specimen_state_space(whole.specimen).response(lines.frequency_hz)[:, 0]
    given = np.vstack([np.ones((1, lines.count)), floors])
    found = delayed_rms(lines, whole, given, lines.of(ground), lines.of(sim.abs_accel_m_s2), delay_s)
    delayed = simulate_delayed(whole, DT_S, ground, delay_s).abs_accel_m_s2
    scale = error_figures(sim.abs_accel_m_s2, 0.0 * sim.abs_accel_m_s2, DT_S).rms
    wanted = error_figures(sim.abs_accel_m_s2, delayed, DT_S).rms
    assert found == pytest.approx(wanted, rel=2e-3, abs=1e-3 * scale.max())
    assert (wanted.min() > 0.02 * scale.max()) == (delay_s > 0.0)


def test_roots_come_slowest_first_and_each_mode_finds_its_own() -> None:
    frequency, ratio = np.array([2.3, 6.5, 9.3]), np.array([0.026, 0.066, 0.056])
    size = 2.0 * np.pi * frequency
    roots = size * (-ratio + 1j * np.sqrt(1.0 - ratio**2))
    others = np.array([-300.0 + 200.0j, -1.0 + 90.0j])
    matrix = np.zeros((12, 12))
    for place, root in enumerate([*roots[::-1], *others]):
        z = np.exp(root * DT_S)
        matrix[2 * place : 2 * place + 2, 2 * place : 2 * place + 2] = [[z.real, z.imag], [-z.imag, z.real]]
    matrix[10, 10], matrix[11, 11] = 0.99, 1e-3  # neither oscillates
    mixed = np.random.default_rng(1).normal(size=(12, 12))
    found = loop_roots(mixed @ matrix @ np.linalg.inv(mixed), DT_S)
    assert len(found) == 5 and np.all(np.diff(found.real) <= 0.0)
    hz, damping = modes_in_loop(found, frequency * 1.01, ratio * 0.9)
    assert hz == pytest.approx(frequency, rel=1e-6) and damping == pytest.approx(ratio, rel=1e-5)
