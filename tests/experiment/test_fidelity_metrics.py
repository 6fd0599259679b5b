"""Further figures of merit: which series, storey and band each path holds. Oracles: sines, scaled storeys."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rths_cli.experiment.run_case import acceptance
from rths_cli.experiment.run_metrics import (
    criteria_of_storeys,
    delays,
    energy,
    errors,
    fidelity,
    of_table_run,
    response,
)
from rths_cli.experiment.setup import RUNS
from rths_cli.quantities import METRICS, Values, metrics_of
from rths_cli.rigs.description import capabilities_of

DT_S = 1 / 2000
TIME_S = DT_S * np.arange(40_000)
RATE = 2 * np.pi * 2.5
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
Parts = tuple[SimpleNamespace, SimpleNamespace, SimpleNamespace, Motion]


def sine(amplitude: float = 1.0, delay_s: float = 0.0, frequency_hz: float = 2.5) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * frequency_hz * (TIME_S - delay_s))


def values(figures: Values) -> dict[str, float]:
    return {path: float(np.asarray(value)) for path, value in figures.items() if not np.ndim(value)}


def test_each_path_of_the_table_holds_its_series() -> None:
    """Measured 3 ms late and a tenth large with 60 Hz on it, true 1 ms early and a fifth small."""
    measured = sine(1.1, 0.003) + sine(0.2, 0.0, 60.0)
    found = values(fidelity("exp_rths", sine(), measured, sine(0.8, -0.001), DT_S))
    assert (found["exp_rths.fei_amplitude"], found["exp_rths.fei_delay_s"]) == pytest.approx((1.1, 0.003))
    assert (found["exp_rths.fei_amplitude_true"], found["exp_rths.fei_delay_s_true"]) == pytest.approx((0.8, -0.001))
    assert found["exp_rths.j1_s"] == pytest.approx(0.003)
    error = abs(1.1 * np.exp(-1j * RATE * 0.003) - 1)
    assert found["exp_rths.j2"] == pytest.approx(error, rel=2e-3)
    assert found["exp_rths.j3"] == pytest.approx(error, rel=2e-2)
    assert found["exp_rths.j2_full"] == pytest.approx(np.hypot(error, 0.2), rel=1e-6)
    assert found["exp_rths.j3_full"] == pytest.approx(error + 0.2, rel=1e-2)
    indicator = 0.5 * 1.1 * RATE * TIME_S[-1] * np.sin(RATE * 0.003)
    assert found["exp_rths.tracking_indicator_m2_s4"] == pytest.approx(indicator, rel=2e-3)


def test_tracking_of_measured_and_true_are_told_apart() -> None:
    """Measured 2 ms late and true 1 ms early, each with an amplitude of its own; without a true one, no such path."""
    measured, true = sine(1.1, 0.002), sine(0.7, -0.001)

    def tracking(true: np.ndarray | None) -> dict[str, float]:
        told = errors("shake_table", (sine(), measured, true), None, DT_S)
        return values({**told, **delays("shake_table", sine(), measured, true, DT_S)})

    found = tracking(true)
    for value, suffix, delay_s in ((measured, "", 0.002), (true, "_true", -0.001)):
        assert found[f"shake_table.tracking_delay_s{suffix}"] == pytest.approx(delay_s, rel=1e-2)
        error = sine() - value
        assert found[f"shake_table.tracking_rms_m_s2{suffix}_full"] == pytest.approx(np.sqrt(np.mean(error**2)))
        assert found[f"shake_table.tracking_max_m_s2{suffix}_full"] == pytest.approx(np.abs(error).max())
        assert found[f"shake_table.tracking_rms_m_s2{suffix}"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-2)
    alone = tracking(None)
    assert alone == {path: value for path, value in found.items() if "_true" not in path}


@pytest.mark.parametrize(
    ("storeys", "interface", "places"),
    [
        (3, 1, {"j4": 1, "j5": 1, "j6": 2, "j8": 2, "j7": 3, "j9": 3}),  # the benchmark's
        (3, 2, {"j4": 2, "j5": 2, "j6": 1, "j8": 1, "j7": 3, "j9": 3}),
        (5, 3, {"j4": 3, "j5": 3, "j6": 1, "j8": 1, "j7": 2, "j9": 2}),
        (2, 1, {"j4": 1, "j5": 1}),
    ],
)
def test_each_criterion_belongs_to_its_storey(storeys: int, interface: int, places: dict[str, int]) -> None:
    """Storey i is wrong by i percent everywhere and by ten more percent of a burst above the band."""
    sim = np.stack([storey * sine() for storey in range(1, storeys + 1)])
    share = 0.01 * np.arange(1, storeys + 1)[:, None]
    burst = np.hanning(len(TIME_S)) * sine(0.1, 0.0, 62.5)  # rms 0.1 sqrt(3 / 16), peaks with the other sine
    exp = sim * (1 + share) + np.arange(1, storeys + 1)[:, None] * burst
    figures = response("exp_rths", sim, exp, interface, DT_S)
    assert set(figures) == {f"exp_rths.{name}{suffix}" for name in places for suffix in ("", "_full")}
    for name, storey in places.items():
        expected = 0.01 * storey
        full = np.hypot(expected, 0.1 * np.sqrt(3 / 8)) if name in ("j4", "j6", "j7") else expected + 0.1
        assert f"j{name[1]}" in {f"j{number}" for number in criteria_of_storeys(interface, storeys)[storey]}
        assert float(figures[f"exp_rths.{name}"]) == pytest.approx(expected, rel=5e-3)
        assert float(figures[f"exp_rths.{name}_full"]) == pytest.approx(full, rel=5e-3)


def test_energy_is_of_desired_less_measured_over_the_input() -> None:
    """A force in phase with the velocity error: half of force times error for 20 s, less at the record's ends."""
    desired, measured = sine(0.0), -RATE * 0.002 * np.cos(RATE * TIME_S)
    found = values(energy("exp_rths", desired, measured, 0.5 * measured, 30.0 * sine(), 0.4, DT_S))
    assert found["exp_rths.energy_error_j"] == pytest.approx(0.5 * 30.0 * 0.002 * 20.0, rel=1e-2)
    assert found["exp_rths.energy_error_ratio"] == pytest.approx(found["exp_rths.energy_error_j"] / 0.4)
    assert found["exp_rths.energy_error_j_true"] == pytest.approx(0.5 * found["exp_rths.energy_error_j"])
    still = values(energy("exp_rths", desired, measured, None, sine(), 0.0, DT_S))
    assert np.isnan(still["exp_rths.energy_error_ratio"]) and "exp_rths.energy_error_j_true" not in still


@pytest.fixture
def parts() -> Parts:
    """Return a made-up setup (cut at storey 2 of 3), series, SIM and hybrid motion."""
    building = SimpleNamespace(
        M=np.diag([2.0, 3.0, 5.0]),
        mass_kg=10.0,
        influence=None,
        shear_masses_kg=np.array([2.0, 3.0, 5.0]),
        numerical=SimpleNamespace(masses_kg=np.array([2.0, 3.0])),
        heights_m=np.array([0.3, 0.3, 0.3]),
    )
    ground = SimpleNamespace(accel_m_s2=sine(-0.1), time_s=TIME_S)
    case = SimpleNamespace(record_filter=SimpleNamespace(corner_hz=0.25), test_band_hz=11.0)
    rig = SimpleNamespace(dt_s=DT_S, can=capabilities_of("virtual"), channels=[SimpleNamespace(high_pass_hz=0.024)])
    setup = SimpleNamespace(rig=rig, building=building, motion=ground, case=case)
    measured = np.stack([sine(1.02, 0.002), sine()])
    series = SimpleNamespace(
        desired=np.stack([sine(), 0 * TIME_S, 0 * TIME_S]),
        measured=measured,
        true_accel=np.stack([sine(1.03, 0.001), sine()]),
        base_shear_n=12.0 * sine(),
        law_force_n=None,
        has_truth=True,
    )
    sim = SimpleNamespace(abs_accel_m_s2=np.stack([sine()] * 3), rel_vel_m_s=np.stack([sine(0.1)] * 3))
    still = np.zeros((3, len(TIME_S)))
    return setup, series, sim, (still, still, np.stack([sine(1.05), sine(1.06), sine(1.07)]))


def test_a_hybrid_run_has_every_path_known_beforehand(parts: Parts) -> None:
    setup, series, sim, hybrid = parts
    figures = of_table_run(setup, "exp_rths", series, sim, hybrid)
    known = metrics_of("exp_rths")
    others = (
        ".tracking_",
        "_error_m_s2",
        "peak_error_percent",
        ".nrmse_",
        ".sensor_",
        ".high_pass_hz",
        "_steps",
        ".longest_gap_s",
        ".ductility",
        ".residual_drift_m",
        ".true_error_",
        ".error_over_expected",
        ".residual_drift_change_m",
        ".residual_drift_uncertainty_m",
        ".base_shear_uncertainty",
        ".restoring_work_j",
        ".true_reference_",
        ".identified_reference_",
        ".measured_loop_",
        "_over_declared",
        ".program_",
        "disp_nrmse",
        ".rms_disp_error_m",
        ".peak_measured_force_n",
        ".stiffness_change",
        ".specimen_",
        ".without_specimen_percent",
        ".recording_",
        ".following_",
        ".computing_",
    )
    assert {path for path in known if not any(part in path for part in others)} == {
        path for path in figures if ".tracking_" not in path
    }
    assert set(figures) <= set(known)
    assert all(bool(np.ndim(value)) == bool(METRICS[path].over) for path, value in figures.items())
    found = values(figures)
    assert (found["exp_rths.j4"], found["exp_rths.j6"], found["exp_rths.j7"]) == pytest.approx(
        (0.06, 0.05, 0.07), rel=5e-3
    )
    assert (found["exp_rths.fei_delay_s"], found["exp_rths.fei_delay_s_true"]) == pytest.approx((0.002, 0.001))
    work = 0.5 * 10.0 * 0.1 * 0.1 * 20.0  # 10 kg, velocity 0.1, acceleration 0.1, 20 s
    ratio = found["exp_rths.energy_error_j"] / found["exp_rths.energy_error_ratio"]
    assert ratio == pytest.approx(work, rel=1e-3)
    error = -1j * (1 - 1.02 * np.exp(-1j * RATE * 0.002)) / RATE  # velocity over acceleration amplitude
    assert found["exp_rths.energy_error_j"] == pytest.approx(0.5 * 12.0 * 20.0 * error.real, rel=2e-2)


def test_other_runs_and_other_rigs_have_fewer(parts: Parts) -> None:
    setup, series, sim, hybrid = parts
    table = of_table_run(setup, "shake_table", series, sim, None)
    assert set(table) <= set(METRICS) and {path.partition(".")[0] for path in table} == {"shake_table"}
    assert not any(".j4" in path or "energy" in path for path in table)
    series.has_truth = False
    assert not any(path.endswith("_true") for path in of_table_run(setup, "exp_rths", series, sim, hybrid))


def test_a_limit_on_a_signed_figure_holds_either_way() -> None:
    figures = {
        "exp_rths.fei_delay_s": -0.0003,
        "exp_rths.rms_error_m_s2": [0.1, -0.4, 0.2],
    }
    for path, limit, code in (
        ("exp_rths.fei_delay_s", 0.0002, 1),
        ("exp_rths.fei_delay_s", 0.0004, 0),
        ("exp_rths.rms_error_m_s2", 0.3, 1),
        ("exp_rths.rms_error_m_s2", 0.5, 0),
        ("exp_rths.rms_error_m_s2[3]", 0.3, 0),
    ):
        ended = acceptance({path: limit}, figures)
        assert ended.exit_code == code, (path, limit)
    reason = acceptance({"exp_rths.fei_delay_s": 0.0002}, figures).reason
    assert "exp_rths.fei_delay_s = -0.0003 is beyond its accept limit 0.0002" in reason


def test_the_page_on_judging_explains_every_metric_that_is_a_formula() -> None:
    page = (Path(__file__).parents[2] / "docs" / "background" / "metrics.md").read_text()
    known = {re.sub("(_true)?(_full)?$", "", path.partition(".")[2]) for path in metrics_of(*RUNS)}
    formulas = {name for name in known if re.match(r"fei_|tracking_indicator|energy_error|j[1-9]", name)}
    lines = [line for line in page.splitlines() if line.startswith(("## ", "| `"))]
    told = {name for line in lines for name in re.findall("`([^`]+)`", line.split("|")[1] if "|" in line else line)}
    assert len(formulas) == 14 and told == formulas
