"""A test with the virtual actuator from identification to metrics, its compensators, and the limits of its driver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError, RigError
from rths_cli.experiment import actuator
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result, read_series
from rths_cli.laboratory.describe import inspect_structure
from rths_cli.report.answer import answer, verdict
from rths_cli.rigs.from_case import driver

ROOT = Path(__file__).parents[2]


def _setup(folder: Path, *settings: str) -> Setup:
    """Return the shipped case under the first 6 s of its record, identified in 40 s."""
    lines = [one for one in (ROOT / "records" / "el_centro.csv").read_text().splitlines() if not one.startswith("#")]
    (folder / "short.csv").write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *lines[:300]]) + "\n")
    of_all = (f"record.file={folder / 'short.csv'}", "identification.duration_s=40")
    return make_setup(load_cases(["el_centro_actuator"], [*of_all, *settings])[0])


@pytest.fixture(scope="module")
def memory() -> Memory:
    return Memory()


def test_the_run_is_sim_and_the_identified_is_the_plant(tmp_path: Path, memory: Memory) -> None:
    """The plant's response from its three equations, by hand; the specimen's numbers are those of its file."""
    setup = _setup(tmp_path)
    assert run_case(setup, tmp_path / "a.h5", memory, "test", lambda _: None).status == "complete"
    names = ("sim/rel_disp_m", "exp_rths/truth/table_disp_m", "exp_rths/base_shear_n", "sim/base_shear_n")
    storeys, measured, shear, true = (read_series(tmp_path / "a.h5", one) for one in names)
    sim = storeys[-1]
    assert np.abs(measured - sim).max() < 4e-3 * np.abs(sim).max()
    assert np.sqrt(np.mean((shear - true) ** 2)) < 0.01 * np.sqrt(np.mean(true**2))
    assert "stated, none is computed for a displacement interface yet" in verdict(read_result(tmp_path / "a.h5"))
    told = answer(read_result(tmp_path / "a.h5"))
    assert "\nActuator 0." in told and "Table" not in told and "--figures" not in told
    found = memory.identify(setup, lambda _: None)
    own = actuator.specimen_of(found)
    assert own.K[0, 0] == pytest.approx(1.19e6, rel=1e-3)
    assert own.masses_kg[0] == pytest.approx(29.13, rel=3e-3)
    assert own.C[0, 0] == pytest.approx(114.2, rel=0.1)
    physics = setup.case.table.physics
    hz = np.array([0.5, 3.0, 10.0, 25.0])
    s = 2j * np.pi * hz
    valve = s**2 + physics.valve_damping_rad_s * s + physics.valve_stiffness_rad2_s2
    moved = (s + physics.oil_column_rad_s) * (29.13 * s**2 + 114.2 * s + 1.19e6) + physics.velocity_feedback * s
    place = physics.command_gain * physics.valve_gain / (valve * moved + physics.valve_gain)
    late = np.exp(-1.5 * s * setup.rig.dt_s)  # one sample of latency, half a sample of hold
    assert found.best.response(hz) == pytest.approx(0.005 * s**2 * place * late, rel=5e-3)


@pytest.mark.parametrize(
    "kind",
    ["ats", "predictive", *(pytest.param(one, marks=pytest.mark.campaign) for one in ("ats_conditional", "amb"))],
)
def test_compensators_of_displacement_run(tmp_path: Path, memory: Memory, kind: str) -> None:
    told = "{kind: predictive, low_pass_s: 0.003}" if kind == "predictive" else f"{{kind: {kind}}}"
    setup = _setup(tmp_path, f"controller={told}")
    ended = run_case(setup, tmp_path / "a.h5", memory, "test", lambda _: None)
    assert ended.status == "complete"
    sim, true = (read_series(tmp_path / "a.h5", one) for one in ("sim/rel_disp_m", "exp_rths/truth/table_disp_m"))
    assert np.abs(true - sim[-1]).max() < 0.02 * np.abs(sim[-1]).max()


def test_beyond_its_stroke_the_rig_stops_and_its_force_is_limited(tmp_path: Path) -> None:
    setup = _setup(tmp_path)
    info, building = setup.rig, setup.building
    short = replace(info, limits=replace(info.limits, stroke_m=0.002))
    rig = driver(setup.case, short, building, (0, 1), False)
    rig.open()
    rig.arm()
    with pytest.raises(RigError, match=r"end stop \(0\.002 m\)"):
        for _ in range(2000):
            rig.exchange(1.0)
    rig.close()
    rig = driver(setup.case, info, building, (0, 1), False)
    rig.open()
    rig.arm()
    shown = np.array([rig.exchange(8.0).copy() for _ in range(2000)]) / [200.0, 1e-3]  # 40 mm of 1.19e6 N/m: 48 kN
    rig.close()
    limit = setup.case.table.physics.force_limit_n
    assert np.abs(shown[:, 1]).max() == pytest.approx(limit, abs=5.0 * setup.case.table.sensors.force_noise_n)
    assert shown[-500:, 0].mean() == pytest.approx(limit / 1.19e6, rel=0.02)  # where the spring holds the limited force


def test_what_is_not_served_is_refused_with_its_reason(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="controller: FF\\+FB tracks an acceleration; use FF, none, or a compensator"):
        _setup(tmp_path, "controller=FF+FB")
    with pytest.raises(InputError, match="its specimen is moved by an actuator"):
        inspect_structure("el_centro_actuator")


@pytest.mark.parametrize("peak", [0.0, 3.0])
def test_a_predicted_peak_is_exceeded_in_one_test_of_twenty(peak: float) -> None:
    """By drawing the noise of 4,000 tests."""
    sizes, random = np.full(200, peak), np.random.default_rng(4)
    sizes[7:] *= 0.3
    level = actuator.rarely_exceeded(sizes, 0.5)
    tests = sizes + 0.5 * random.standard_normal((4_000, 200))
    assert (np.abs(tests).max(axis=1) > level).mean() == pytest.approx(actuator.RARE, abs=0.012)
    assert actuator.rarely_exceeded(sizes, 0.0) == peak
