"""The true reference: against buildings put together by hand, and equal to the declared one where that is true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.analysis.nonlinear_sim_delay import simulate_delayed_with_laws
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.experiment.true_reference import TrueReference, true_reference, true_reference_metrics
from rths_cli.files.result_reader import read_result
from rths_cli.numerics.lti import Array
from rths_cli.rigs.from_case import true_building
from rths_cli.structure import Building, Specimen
from rths_cli.structure.storey_laws import BoucWen, Clough, arranged

K1, K2, K3 = 7353.980, 7331.560, 7376.400
YIELDING = (
    "[{kind: clough, yield_displacement_m: 0.001, hardening: 0.05}, {kind: bouc_wen, yield_displacement_m: 0.001}]"
)
HIDDEN = "table.physics.specimen_laws"
DAMAGED = "table.after_identification={specimen_stiffness_factor: 0.7, payload_factor: 1.1}"


def setup_of(*settings: str, case: str = "el_centro_low_ff_fb") -> Setup:
    """Return a setup with the first ten seconds of its record."""
    setup = make_setup(load_cases([case], settings)[0])
    motion = setup.motion
    cut = replace(
        motion,
        **{
            name: getattr(motion, name)[: round(10.0 / setup.rig.dt_s)]
            for name in ("time_s", "accel_m_s2", "velocity_m_s", "displacement_m")
        },
    )
    return replace(setup, motion=cut)


def by_hand(setup: Setup, factor: float, payload: float) -> Building:
    """Return the building with another specimen, its matrices written down storey by storey."""
    declared = setup.building
    k1, c1 = declared.numerical.K[0, 0], declared.numerical.C[0, 0]
    k2, k3 = factor * K2, factor * K3
    (m2, m3), m1 = declared.specimen.masses_kg * payload, declared.M[0, 0]
    upper, damping = np.array([[k2 + k3, -k3], [-k3, k3]]), declared.specimen.C
    K = np.array([[k1 + k2, -k2, 0.0], [-k2, k2 + k3, -k3], [0.0, -k3, k3]])
    C = np.zeros((3, 3))
    C[1:, 1:], C[0, 1:], C[1:, 0] = damping, -damping.sum(axis=0), -damping.sum(axis=1)
    C[0, 0] = c1 + damping.sum()
    specimen = Specimen(np.array([m2, m3]), upper, damping)
    return Building(declared.numerical, specimen, 0.0, np.diag([m1, m2, m3]), C, K)


def peak_difference(found: Array, wanted: Array) -> float:
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def said(_: str) -> None:
    """Take a word on progress."""


def test_a_specimen_as_declared_is_not_solved_again() -> None:
    setup = setup_of()
    assert true_building(setup.case, setup.building) is setup.building
    sim, told = simulate(setup.building, setup.rig.dt_s, setup.motion.accel_m_s2), []
    truth = true_reference(setup, sim, told.append)
    assert truth is not None and truth.as_declared and truth.sim_accel is sim.abs_accel_m_s2 and told == []
    found = {
        "exp_rths.rms_error_m_s2_true": np.array([1.0, 2.0, 3.0]),
        "exp_rths.nrmse_percent_true": np.array([0.1, 0.2, 0.3]),
        "sim_delay.rms_error_m_s2": np.array([10.0, 10.0, 10.0]),
        "sim_delay.nrmse_percent": np.array([1.0, 1.0, 1.0]),
    }
    values = true_reference_metrics(setup, truth, sim.abs_accel_m_s2, found)
    assert np.array_equal(values["exp_rths.true_reference_rms_error_m_s2"], [1.0, 2.0, 3.0])
    assert np.array_equal(values["exp_rths.true_reference_ratio"], [0.1, 0.2, 0.3])
    assert set(values) == {
        "exp_rths.true_reference_rms_error_m_s2", "exp_rths.true_reference_nrmse_percent",
        "sim_delay.true_reference_rms_error_m_s2", "sim_delay.true_reference_nrmse_percent",
        "exp_rths.true_reference_ratio",
    }  # fmt: skip


def test_a_damaged_specimen_is_that_of_a_building_built_by_hand() -> None:
    setup = setup_of(DAMAGED)
    dt_s, ground = setup.rig.dt_s, setup.motion.accel_m_s2
    truth = true_reference(setup, simulate(setup.building, dt_s, ground), said)
    building = by_hand(setup, 0.7, 1.1)
    sim = simulate(building, dt_s, ground)
    late = simulate_delayed(building, dt_s, ground, setup.case.delay_s, sim=sim)
    assert truth is not None and truth.delayed_accel is not None and not truth.as_declared
    assert peak_difference(truth.sim_accel, sim.abs_accel_m_s2) < 1e-5  # stiffnesses written with seven digits
    assert peak_difference(truth.delayed_accel, late.abs_accel_m_s2) < 1e-5
    declared = simulate(setup.building, dt_s, ground).abs_accel_m_s2
    assert peak_difference(declared, sim.abs_accel_m_s2) > 0.1


@pytest.mark.campaign
def test_a_yielding_specimen_is_that_of_a_building_built_by_hand() -> None:
    setup = setup_of(f"{HIDDEN}={YIELDING}")
    dt_s, ground = setup.rig.dt_s, setup.motion.accel_m_s2
    truth = true_reference(setup, simulate(setup.building, dt_s, ground), said)
    laws = arranged(((), (Clough(K2, 0.001, 0.05),), (BoucWen(K3, 0.001, 0.0, p=1.0, psi=0.1, lambda_=0.5),)))
    building = replace(by_hand(setup, 1.0, 1.0), laws=laws)
    sim = simulate_with_laws(building, dt_s, ground)
    late = simulate_delayed_with_laws(building, dt_s, ground, setup.case.delay_s, sim=sim)
    assert truth is not None and truth.delayed_accel is not None
    assert peak_difference(truth.sim_accel, sim.abs_accel_m_s2) < 1e-5
    assert peak_difference(truth.delayed_accel, late.abs_accel_m_s2) < 1e-5
    drift = np.diff(sim.rel_disp_m, axis=0)
    assert (np.abs(drift).max(axis=1) > 0.0015).all()  # ductility above 1.5


def test_errors_are_those_of_the_true_motion_to_the_true_building() -> None:
    setup = setup_of("runs=[sim, exp_rths]")
    time = setup.motion.time_s
    wave = np.sin(2.0 * np.pi * 2.0 * time) * np.hanning(len(time))
    sim_accel = np.outer([1.0, 2.0, 4.0], wave)
    values = true_reference_metrics(setup, TrueReference(sim_accel, None, False), 1.01 * sim_accel, {})
    assert values["exp_rths.true_reference_nrmse_percent"] == pytest.approx(1.0, rel=1e-6)
    rms = np.asarray(values["exp_rths.true_reference_rms_error_m_s2"])
    assert rms == pytest.approx(0.01 * np.sqrt(np.mean(sim_accel**2, axis=1)), rel=1e-3)
    assert len(values) == 2
    late = true_reference_metrics(setup, TrueReference(sim_accel, 1.1 * sim_accel, False), 1.01 * sim_accel, {})
    assert late["exp_rths.true_reference_ratio"] == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize("stated", ["[{}]", "{}"])
def test_hidden_laws_that_do_not_fit_are_refused_with_their_place(stated: str) -> None:
    law = "{kind: bilinear, yield_displacement_m: 0.001}"
    with pytest.raises(InputError, match=r"specimen_laws.* an entry for each of 2 storeys .* got 1; state null"):
        setup_of(f"{HIDDEN}={stated.format(law)}")


def played(path: Path, memory: Memory, *settings: str) -> Mapping[str, Any]:
    """Return the metrics of a case's result."""
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], ("runs=[sim, sim_delay, exp_rths]", *settings))[0])
    run_case(setup, path, memory, "test", said)
    return read_result(path).metrics


@pytest.mark.campaign
def test_a_result_holds_both_errors(tmp_path: Path, memory: Memory) -> None:
    """The specimen as declared: the same; damaged: control answers for a twentieth of what the declaration misses."""
    same = played(tmp_path / "same.h5", memory)
    for ours, other in (("exp_rths", "_true"), ("sim_delay", "")):
        wanted = same[f"{ours}.rms_error_m_s2{other}"]
        assert np.array_equal(same[f"{ours}.true_reference_rms_error_m_s2"], wanted)
    damaged = played(tmp_path / "damaged.h5", memory, "table.after_identification.specimen_stiffness_factor=0.85")
    declared, true = damaged["exp_rths.rms_error_m_s2_true"], damaged["exp_rths.true_reference_rms_error_m_s2"]
    assert np.array_equal(damaged["sim_delay.rms_error_m_s2"], same["sim_delay.rms_error_m_s2"])
    assert (true < 0.05 * declared).all()
    assert (damaged["exp_rths.true_reference_ratio"] < 0.06).all()
    assert damaged["exp_rths.true_reference_ratio"] == pytest.approx(
        true / damaged["sim_delay.true_reference_rms_error_m_s2"]
    )
