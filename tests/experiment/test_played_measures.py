"""Intensity measures of the ground motion as it is played, in results and sweeps: closed forms of a sine, and scipy.

The motion is whole periods of a sine with its unfiltered peaks, so that every measure of it is known by hand.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import lsim

from rths_cli.analysis.intensity import average_sa
from rths_cli.case.load import load_cases
from rths_cli.experiment.run_case import measures_of
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result, read_series
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import metrics_of
from rths_cli.report.figures import draw
from rths_cli.structure import similitude_of

HZ, PEAK, PERIODS, DT_S = 1.0, 2.0, 8, 0.001
TIME_S = np.arange(round(PERIODS / HZ / DT_S) + 1) * DT_S


def case_in(folder: Path, record: dict[str, object] | None = None, **keys: object) -> Path:
    accel = PEAK * np.cos(2.0 * np.pi * HZ * TIME_S)
    columns = np.column_stack([TIME_S, accel])
    np.savetxt(folder / "sine.csv", columns, "%.9f", ",", header="time_s,accel_m_s2", comments="")
    of_file = {"file": "sine.csv", "baseline": "none", **(record or {})}
    case = {
        "structure": "three_storey", "damping": "low", "record": of_file,
        "scaling": 0.5, "controller": "FF+FB", "record_filter": {"corner_hz": 0}, "runs": ["sim"], **keys,
    }  # fmt: skip
    path = folder / "sine.yaml"
    path.write_text(json.dumps(case))
    return path


def setup_in(folder: Path, **keys: object) -> Setup:
    return make_setup(load_cases([case_in(folder, **keys)])[0])


def test_the_measures_of_a_sine_are_those_of_its_closed_forms(tmp_path: Path) -> None:
    setup = setup_in(tmp_path)
    found = {name.partition(".")[2]: value for name, value in measures_of(setup, SharedValues()).items()}
    a, w, length_s = 0.5 * PEAK, 2.0 * np.pi * HZ, PERIODS / HZ
    assert set(found) == {path.partition(".")[2] for path in metrics_of("ground")}
    assert found["pga_m_s2"] == pytest.approx(a)
    assert found["pgv_m_s"] == pytest.approx(a / w, rel=1e-4)
    assert found["pgd_m"] == pytest.approx(2.0 * a / w**2, rel=1e-4)
    assert found["arias_m_s"] == pytest.approx(np.pi / (2.0 * 9.80665) * a**2 * length_s / 2.0, rel=1e-4)
    assert found["cav_m_s"] == pytest.approx(2.0 / np.pi * a * length_s, rel=1e-4)

    def at_s(share: float) -> float:  # of the integral of cos^2
        return float(brentq(lambda t: (t + np.sin(2.0 * w * t) / (2.0 * w)) / length_s - share, 0.0, length_s))

    assert found["d5_75_s"] == pytest.approx(at_s(0.75) - at_s(0.05), rel=1e-3)
    assert found["d5_95_s"] == pytest.approx(at_s(0.95) - at_s(0.05), rel=1e-3)
    assert found["mean_period_s"] == pytest.approx(1.0 / HZ, rel=0.02)
    building = setup.building
    w1 = np.sqrt(np.linalg.eigvals(np.linalg.solve(building.M, building.K)).real.min())
    system = ([[0.0, 1.0], [-(w1**2), -0.1 * w1]], [[0.0], [-1.0]], [[1.0, 0.0]], [[0.0]])
    moved_m = np.abs(lsim(system, setup.motion.accel_m_s2, setup.motion.time_s)[1]).max()
    assert found["t1_s"] == pytest.approx(2.0 * np.pi / w1, rel=1e-3)  # of the damped building
    assert found["sd_t1_m"] == pytest.approx(moved_m, rel=1e-3)
    assert found["sv_t1_m_s"] == pytest.approx(w1 * moved_m, rel=1e-3)
    assert found["sa_t1_m_s2"] == pytest.approx(w1**2 * moved_m, rel=1e-3)
    assert found["sa_avg_m_s2"] == average_sa(setup.motion.accel_m_s2, setup.motion.dt_s, found["t1_s"])


def test_measures_scale_to_the_prototype_by_their_units(tmp_path: Path) -> None:
    """A motion that is 4 times as strong and 2 times as long in time has 32 times the Arias intensity."""
    from rths_cli.case.structure_schema import read_scale

    scale = read_scale(("length=16", "acceleration=4"))
    assert scale is not None
    of = similitude_of(scale)
    known = metrics_of("ground")
    factors = {
        name: of.factor(known[f"ground.{name}"].scales_as) for name in ("arias_m_s", "cav_m_s", "d5_95_s", "pgd_m")
    }
    assert factors == pytest.approx({"arias_m_s": 32.0, "cav_m_s": 8.0, "d5_95_s": 2.0, "pgd_m": 16.0})


def test_result_and_figure_have_the_motion_as_written_where_it_is_changed(tmp_path: Path) -> None:
    from rths_cli.experiment.model_choice import Memory
    from rths_cli.experiment.run_case import run_case
    from rths_cli.numerics.shared_values import SharedValues as Values

    for record, names in (
        ({}, {"as it is played"}),
        ({"band_hz": [0.5, 5]}, {"as its file has it", "as it is played"}),
    ):
        setup = setup_in(tmp_path, record=record)
        path = tmp_path / f"{len(names)}.h5"
        run_case(setup, path, Memory(None), "rths run", lambda _: None, Values())  # type: ignore[arg-type]
        result = read_result(path)
        assert result.metrics["ground.pga_m_s2"] == pytest.approx(np.abs(setup.motion.accel_m_s2).max())
        figure = draw("ground_motion", result, "two")
        axes = figure.axes
        assert {text.get_text() for text in figure.legends[0].get_texts()} == names
        assert f"PGA {result.metrics['ground.pga_m_s2']:.3g}"[:6] in axes[0].get_title(loc="right")
        if len(names) == 2:
            written = read_series(path, "record/as_written_accel_m_s2")
            assert written == pytest.approx(0.5 * PEAK * np.cos(2.0 * np.pi * HZ * setup.motion.time_s), abs=1e-4)
            assert "record_treatment" in result.attributes
