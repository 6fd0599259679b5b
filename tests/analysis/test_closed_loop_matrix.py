"""The closed-loop matrix against two independent assemblies of the same loop, and against a run that grows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, ideal_info, specimen
from hybrid import best_like, closed_loop, ground, open_limits, paper_like, true_model
from open_loop import open_loop, points, rig_as_identified

from rths_cli.analysis.closed_loop import closed_loop_matrix, modes_in_loop, spectral_radius
from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.control.designed_blocks import Blocks
from rths_cli.loop.simulated_time_run import play
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

Maker = Callable[[RigInfo, float], Blocks]
AROUND = 1.1 * points(np.linspace(7.0, 900.0, 25), DT_S)  # a polynomial is known by its values


def determinant(matrix: Array, z: ComplexArray) -> ComplexArray:
    return np.array([np.linalg.det(p * np.eye(len(matrix)) - matrix) for p in z])


def specimen_alone(z: ComplexArray) -> ComplexArray:
    """Return prod(z - exp(s dt)) over the poles of the specimen on a table held still: hidden in the rig's chain."""
    parts = specimen()
    inverse = 1.0 / parts.masses_kg[:, None]
    poles = np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse * parts.K, -inverse * parts.C]]))
    return np.prod(z[:, None] - np.exp(poles * DT_S), axis=1)


@pytest.mark.parametrize("latency", [0, 1, 2, 24])
@pytest.mark.parametrize("interface_mass", [0.0, 1.2])
@pytest.mark.parametrize("make", [paper_like, best_like])
def test_its_characteristic_polynomial_is_that_of_the_true_loop(
    make: Maker, interface_mass: float, latency: int
) -> None:
    """All but what the chain hides, and 6 sensor integrators of the other assembly; commands on their way are zeros."""
    info = ideal_info(latency_samples=latency)
    blocks = replace(make(ideal_info(latency_samples=min(latency, 2)), interface_mass), latency_samples=latency)
    rig, _ = rig_as_identified(info, interface_mass)
    found = closed_loop_matrix(replace(rig, ripple_m_s2_per_v=0.0), blocks)
    exact = closed_loop(info, blocks, interface_mass).M
    empty = len(found) + 6 - len(exact) - 4
    assert empty >= 0
    wanted = determinant(exact, AROUND) / (AROUND - 1.0) ** 6 * specimen_alone(AROUND) * AROUND**empty
    assert np.abs(determinant(found, AROUND) / wanted - 1.0).max() < 1e-6


def test_what_the_rig_has_beyond_the_correction_of_the_staircase_acts() -> None:
    """A rig with a net ripple: as if the step's correction were smaller by it."""
    info = ideal_info()
    blocks = best_like(info, ripple=-1.35)
    rig, _ = rig_as_identified(info)
    left = replace(rig, ripple_m_s2_per_v=0.4, ripple_sum_m_s2_per_v=0.002)
    found = closed_loop_matrix(left, blocks)
    less = replace(blocks, ripple_m_s2_per_v=-1.75, ripple_sum_m_s2_per_v=blocks.ripple_sum_m_s2_per_v - 0.002)
    other = closed_loop_matrix(replace(rig, ripple_m_s2_per_v=0.0), less)
    none = closed_loop_matrix(replace(rig, ripple_m_s2_per_v=0.0), blocks)
    assert np.abs(found - other).max() < 1e-10
    assert np.abs(found - none).max() > 1e-4
    one = closed_loop_matrix(replace(left, ripple_sum_m_s2_per_v=0.0), blocks)
    assert np.abs(found - one).max() > 1e-7


@pytest.mark.parametrize("make", [paper_like, best_like])
def test_a_direct_path_from_command_to_samples_is_solved(make: Maker) -> None:
    """A rig whose model holds its own latency: det of the cut loop times one minus its gain."""
    info = ideal_info()
    blocks = make(info, 0.0)
    rig = replace(identified_rig(true_model(0.0), specimen(), info, True), ripple_m_s2_per_v=0.0)
    assert np.abs(rig.plant.D).max() > 1e-3
    found, exact = closed_loop_matrix(rig, blocks), open_loop(rig.plant, replace(blocks, correction=rig.correction))
    assert len(found) == len(exact.A)
    assert np.abs(determinant(found, AROUND) / exact.determinant(AROUND) - 1.0).max() < 1e-6


def test_the_radius_is_the_growth_of_a_run() -> None:
    """Blocks for one sample of latency on a rig with 24."""
    info = ideal_info(latency_samples=24, range_v=1e9)
    blocks = replace(paper_like(ideal_info()), latency_samples=24)
    radius = spectral_radius(closed_loop_matrix(rig_as_identified(info)[0], blocks))
    assert radius > 1.0 + 1e-5
    drive = 1e-6 * ground(16000)
    drive[2000:] = 0.0
    rig = VirtualRig(info, build_plant(info, LINEAR, specimen(), 0.0), (0,))
    place = play(rig, info, blocks, NUMERICAL, drive, open_limits(info)).log.true_displacement_m
    early, late = np.abs(place[7000:9000]).max(), np.abs(place[14000:16000]).max()
    assert np.log(late / early) / 7000 == pytest.approx(np.log(radius), rel=0.03)


def test_the_radius_of_a_rotation_is_its_factor() -> None:
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert spectral_radius(0.97 * turn) == pytest.approx(0.97)
    assert spectral_radius(np.diag([0.5, -1.2])) == pytest.approx(1.2)


def test_each_root_stands_for_one_mode_and_none_for_one_that_does_not_oscillate() -> None:
    pairs = np.array([-1.0 + 10.0j, -1.2 + 10.3j])
    roots = np.concatenate([pairs, pairs.conj(), [-500.0]])
    own_hz, own = np.array([10.0, 10.1, 400.0]) / (2.0 * np.pi), np.array([0.1, 0.1, 1.2])
    frequency_hz, ratio = modes_in_loop(roots, own_hz, own)
    np.testing.assert_allclose(frequency_hz[:2] * 2.0 * np.pi, np.abs(pairs), rtol=1e-12)
    np.testing.assert_allclose(ratio[:2], -pairs.real / np.abs(pairs), rtol=1e-12)
    assert np.isnan(frequency_hz[2]) and np.isnan(ratio[2])
