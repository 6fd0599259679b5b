"""Drifts and shears against springs and dashpots, statics, and plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from test_sim import DT_S, noise, random_building

from rths_cli.analysis.sim import simulate
from rths_cli.analysis.structural_response import inter_storey_drift_m, peaks, storey_shear_n
from rths_cli.structure import storey_values


@pytest.mark.parametrize("seed", range(6))
def test_the_shear_of_a_storey_is_that_of_its_spring_and_dashpot(seed: int) -> None:
    """Stiffnesses and dashpots storey by storey make it from the motion, mass times acceleration from the inertia."""
    building = random_building(seed)
    response = simulate(building, DT_S, noise(8.0, DT_S, seed))
    below, above = building.numerical, building.specimen
    springs = np.concatenate([storey_values(below.K), storey_values(above.K)])
    dashpots = np.concatenate([storey_values(below.C), storey_values(above.C)])
    drift = [response.rel_disp_m[0], *(response.rel_disp_m[1:] - response.rel_disp_m[:-1])]
    rate = [response.rel_vel_m_s[0], *(response.rel_vel_m_s[1:] - response.rel_vel_m_s[:-1])]
    wanted = springs[:, None] * np.array(drift) + dashpots[:, None] * np.array(rate)
    found = storey_shear_n(np.diag(building.M), response.abs_accel_m_s2)
    peak = np.abs(wanted).max(axis=1)
    assert (np.abs(found - wanted).max(axis=1) <= 1e-9 * peak).all() and peak.min() > 0.1
    np.testing.assert_allclose(inter_storey_drift_m(response.rel_disp_m), drift, rtol=0.0, atol=1e-15)


def test_the_shear_above_the_cut_is_the_force_on_the_interface() -> None:
    """Eq. 2.6 without a mass of the interface on the table."""
    building = random_building(2)
    response = simulate(building, DT_S, noise(4.0, DT_S))
    shear = storey_shear_n(np.diag(building.M), response.abs_accel_m_s2)
    np.testing.assert_allclose(shear[len(building.numerical.masses_kg)], response.base_shear_n, rtol=0.0, atol=1e-9)


def test_peaks_are_of_absolute_values_and_the_base_shear_is_of_all_floors() -> None:
    disp = np.array([[0.0, -3.0, 1.0], [0.0, -2.0, 4.0]])
    accel = np.array([[1.0, -2.0, 0.0], [3.0, 1.0, -5.0]])
    found = peaks(np.array([2.0, 10.0]), disp, accel)
    assert found.rel_disp_m.tolist() == [3.0, 4.0] and found.inter_storey_drift_m.tolist() == [3.0, 3.0]
    assert found.storey_shear_n.tolist() == [50.0, 50.0] and found.base_shear_n == 50.0
    assert found.abs_accel_m_s2.tolist() == [2.0, 5.0]
    assert found.base_shear_ratio == pytest.approx(50.0 / (12.0 * 9.80665))
    assert found.drift_ratio(np.array([3.0, 2.0])).tolist() == [1.0, 1.5]
