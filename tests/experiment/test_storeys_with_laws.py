"""Whole runs of a building whose computed storey has a law: EXP-RTHS on the virtual table against SIM."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from docs_running import shortened
from portfolio import parametrize_first
from scipy.integrate import cumulative_trapezoid

import rths_cli
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.run_metrics import of_laws
from rths_cli.experiment.setup import make_setup

LAWS = {
    "bilinear": {"kind": "bilinear", "yield_displacement_m": 0.002, "hardening": 0.05},
    "parallel": [
        {"kind": "clough", "yield_displacement_m": 0.002, "hardening": 0.05},
        {"kind": "viscous_power", "coefficient": 5.0, "exponent": 0.4},
    ],
}


def case(law: Any) -> dict[str, Any]:
    return {
        "name": "yields",
        "structure": {"extends": "three_storey", "numerical": {"law": [law]}},
        "damping": "low",
        "record": "el_centro",
        "scaling": 0.30,
        "controller": "FF+FB",
        "runs": ["sim", "exp_rths"],
    }


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["tuned_mass_damper", "viscous_damper"])
def test_a_shipped_building_gives_a_good_test(name: str, tmp_path: Path) -> None:
    """The third one, base_isolated, is run by its tutorial."""
    shortened(Path(__file__).parents[2] / "records" / "el_centro.csv", tmp_path / "short.csv", 400)
    settings = {"record.file": str(tmp_path / "short.csv"), "runs": ["sim", "exp_rths"]}
    result = rths_cli.run(f"el_centro_{name}", settings=settings, output=tmp_path)
    assert result.status == "complete"
    assert (result.metrics["exp_rths.nrmse_percent"] < 1.0).all()


def energy_left(result: Any) -> float:
    """Return what remains of the energy that ground and base shear put into the computed storey, over its largest
    value, less kinetic energy, work of the dashpot and work of spring and laws, by the trapezoidal rule."""
    run, motion = result.exp_rths, result.record
    numerical = make_setup(load_cases(["el_centro_low_ff"])[0]).building.numerical  # of the same building
    u, v, shear = run.rel_disp_m[0], run.rel_vel_m_s[0], run.base_shear_n
    put = cumulative_trapezoid((shear - numerical.masses_kg[0] * motion.ground_accel_m_s2) * v, dx=1 / 2000)
    damped = cumulative_trapezoid(numerical.C[0, 0] * v**2, dx=1 / 2000)
    stored = cumulative_trapezoid(run.restoring_force_n[0], u)
    left = put - 0.5 * numerical.masses_kg[0] * v[1:] ** 2 - damped - stored
    return float(np.abs(left).max() / np.abs(put).max())


@pytest.mark.campaign
@parametrize_first(1, "name", LAWS)
def test_a_hybrid_test_follows_sim_of_a_yielding_storey(name: str) -> None:
    """What SIM computes by events is what the step, table and specimen do: within 0.6 % in every storey."""
    result = rths_cli.run(case(LAWS[name]))
    assert result.status == "complete"
    assert (result.metrics["exp_rths.nrmse_percent"] < 0.6).all()
    assert (result.metrics["exp_rths.nrmse_percent_true"] < 0.6).all()
    drift = result.metrics["exp_rths.peak_inter_storey_drift_m"]
    np.testing.assert_allclose(drift, result.metrics["sim.peak_inter_storey_drift_m"], rtol=0.02)
    assert drift[0] > 2.0 * 0.002
    for run in ("sim", "exp_rths"):
        ductility = result.metrics[f"{run}.ductility"]
        assert ductility[0] == pytest.approx(result.metrics[f"{run}.peak_inter_storey_drift_m"][0] / 0.002)
        assert np.isnan(ductility[1:]).all()
    work, wanted = (result.metrics[f"{run}.restoring_work_j"][0] for run in ("exp_rths", "sim"))
    assert work == pytest.approx(wanted, rel=0.01) and wanted > 0.1
    residual, expected = (result.metrics[f"{run}.residual_drift_m"] for run in ("exp_rths", "sim"))
    assert abs(residual[0] - expected[0]) < 0.03 * drift[0]
    assert np.isnan(residual[1:]).all()  # accelerometers do not know those on the table
    unsure, change = (result.metrics[f"exp_rths.residual_drift_{name}_m"][0] for name in ("uncertainty", "change"))
    assert abs(residual[0] - expected[0]) < 3.0 * unsure and change <= unsure < 2.0 * change
    assert energy_left(result) < 1e-3
    for run in (result.sim, result.exp_rths):  # the loop's area is the work
        area = np.trapezoid(run.restoring_force_n[0], run.inter_storey_drift_m[0])
        assert area == pytest.approx(wanted, rel=0.01)
    assert np.isnan(result.exp_rths.restoring_force_n[1:]).all()
    assert result.exp_rths.part_value_names == "law_force_1_n (N)"
    assert np.abs(result.exp_rths.part_values[0]).max() > 5.0
    assert "simulated on the rig as identified" in result.attributes["warnings"]


def test_a_computed_storey_above_the_highest_law_works_by_its_spring() -> None:
    """Storey 1 of four has a law, storey 2 is computed too; the storeys on the table are not known."""
    building = make_setup(load_cases(["el_centro_base_isolated"])[0]).building
    disp = np.array([[0.0, 0.003], [0.0, 0.005], [0.0, 0.006], [0.0, 0.007]])
    found = of_laws("exp_rths", building, disp, np.array([[0.0, -10.0]]))
    work = [0.5 * 11000 * 0.003**2 - 0.5 * 10.0 * 0.003, 0.5 * 7354 * 0.002**2, np.nan, np.nan]
    np.testing.assert_allclose(np.asarray(found["exp_rths.restoring_work_j"]), work)


def test_sim_alone_needs_no_step_that_is_stable(tmp_path: Path) -> None:
    """A damper too stiff for the loop at 2 kHz: SIM is that of a dashpot, the check and a hybrid test are refused."""
    shortened(Path(__file__).parents[2] / "records" / "el_centro.csv", tmp_path / "short.csv", 250)
    settings = {"record.file": str(tmp_path / "short.csv"), "runs": ["sim"]}
    stiff = case({"kind": "maxwell", "spring_n_per_m": 1e9, "dashpot_n_s_per_m": 50.0})
    dashpot = case({"kind": "viscous_power", "coefficient": 50.0, "exponent": 1.0})
    results = [rths_cli.run(one, settings=settings) for one in (stiff, dashpot)]
    found, wanted = (result.sim.abs_accel_m_s2 for result in results)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
    assert "tangents" not in str(results[0].attributes["warnings"])  # no loop is judged
    with pytest.raises(InputError, match="its stiffest tangent"):
        rths_cli.check(stiff, settings=settings)
    with pytest.raises(InputError, match="its stiffest tangent"):
        rths_cli.run(stiff)
