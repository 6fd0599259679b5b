"""Results in prototype scale: every figure and series times the factor written here by hand, or as it was."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import h5py
import jsonschema
import numpy as np
import page_reader
import page_results
import pytest
from made_up_results import write_result

import rths_cli
from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result, ResultWriter, read_result
from rths_cli.quantities import Interval
from rths_cli.report.answer import answer, answers
from rths_cli.report.figures import draw
from rths_cli.report.formats.csv_table import tidy
from rths_cli.report.formats.json_document import document
from rths_cli.report.formats.junit import junit
from rths_cli.report.input_files import Inputs
from rths_cli.report.page import page
from rths_cli.report.report_contents import Contents, contents
from rths_cli.report.report_options import Asked, check_asked, read_asked
from rths_cli.report.result_scale import in_model_scale, in_prototype_scale, reported, series
from rths_cli.report.result_tables import tables

LENGTH, ACCELERATION, MASS = 4.0, 0.64, 30.0
TIME, FORCE = 2.5, 19.2
SCALE = {"scale_length": LENGTH, "scale_acceleration": ACCELERATION, "scale_mass": MASS, "report_in": "prototype"}
SCHEMA = Path(__file__).parents[2] / "configs" / "report.schema.json"
FACTORS = {
    "exp_rths.peak_abs_accel_m_s2": ACCELERATION,
    "exp_rths.peak_rel_disp_m": LENGTH,
    "exp_rths.peak_inter_storey_drift_m": LENGTH,
    "exp_rths.peak_drift_ratio": 1.0,
    "exp_rths.peak_storey_shear_n": FORCE,
    "exp_rths.peak_building_base_shear_n": FORCE,
    "exp_rths.building_base_shear_ratio": ACCELERATION,  # shear over mass times gravity, which is not scaled
    "exp_rths.rms_error_m_s2": ACCELERATION,
    "exp_rths.rms_error_m_s2_true_full": ACCELERATION,
    "exp_rths.nrmse_percent": 1.0,
    "exp_rths.energy_error_j": FORCE * LENGTH,
    "exp_rths.tracking_rms_m_s2": ACCELERATION,
    "exp_rths.tracking_indicator_m2_s4": ACCELERATION**2,
    "exp_rths.tracking_delay_s": 1.0,
    "exp_rths.high_pass_hz": 1.0,
    "sim_delay.critical_delay_s": 1.0,
    "sim_delay.psi": 1.0,
    "sim_delay.diverged_at_s": TIME,
    "check.peak_force_n": 1.0,
    "check.limit_displacement_m": 1.0,
    "check.delay_margin_s": 1.0,
    "identification.natural_frequency_hz": 1.0,
    "budget.rms_error_friction_m_s2": ACCELERATION,
}
BY_STOREY = ("abs_accel", "rel_disp", "drift", "storey_shear", "rms_error", "nrmse", "natural")


def stored(path: Path, accept: str = "", scale: dict[str, object] = SCALE, **attributes: object) -> Result:
    """Write a result whose figures are all 2, or 2 and 3."""
    about = {
        "case_name": path.stem, "method": "best", "rig": "bench", "rig_kind": "virtual", "sample_rate_hz": 200.0,
        "record_name": "quake", "scaling": 1.0, "damping_name": "low", "controller": "FF",
        "exp_rths_status": "complete",
    }  # fmt: skip
    with ResultWriter(path, {**about, **scale, **attributes}) as writer:
        writer.case("case\n", f"accept: {accept}\n" if accept else "")
        values = {name: np.array([2.0, 3.0]) if any(part in name for part in BY_STOREY) else 2.0 for name in FACTORS}
        writer.metrics(values)
        writer.finish("complete", "")
    return read_result(path, whole=True)


@pytest.fixture
def result(tmp_path: Path) -> Result:
    return stored(tmp_path / "one.h5")


@pytest.mark.campaign
@pytest.mark.parametrize("path", list(FACTORS))
def test_every_kind_of_figure_has_its_factor(result: Result, path: str) -> None:
    found = in_prototype_scale(result).metrics[path]
    assert np.asarray(found) == pytest.approx(FACTORS[path] * np.asarray(result.metrics[path]), rel=1e-14)


def test_model_scale_is_what_is_stored(result: Result) -> None:
    there = in_prototype_scale(result)
    assert in_model_scale(there) is result
    assert in_prototype_scale(there) is there  # never converted twice
    assert reported([there], "model") == [result]


def test_ends_of_intervals_are_converted_with_their_figure(result: Result) -> None:
    path = "exp_rths.rms_error_m_s2"
    one = Interval(np.array([2.0, 3.0]), np.array([1.0, 2.0]), np.array([4.0, np.inf]), 0.9)
    found = in_prototype_scale(replace(result, intervals={path: one})).intervals[path]
    assert np.asarray(found.low) == pytest.approx(ACCELERATION * np.array([1.0, 2.0]))
    assert np.asarray(found.high) == pytest.approx([ACCELERATION * 4.0, np.inf])
    assert found.probability == 0.9


def test_published_figures_are_those_of_the_model_and_converted(tmp_path: Path) -> None:
    text = json.dumps({"exp_rths.rms_error_m_s2": [0.1, None], "exp_rths.tracking_delay_s": 0.5})
    found = in_prototype_scale(stored(tmp_path / "one.h5", reference_json=text)).attributes["reference_json"]
    assert json.loads(str(found)) == {
        "exp_rths.rms_error_m_s2": [pytest.approx(0.1 * ACCELERATION), None],
        "exp_rths.tracking_delay_s": 0.5,
    }


def test_a_report_is_in_one_scale(tmp_path: Path) -> None:
    """As the cases state it; where they differ, in model scale; a result without a scale has one only."""
    prototype, model = stored(tmp_path / "a.h5"), stored(tmp_path / "b.h5", report_in="model")
    plain = read_result(write_result(tmp_path / "c.h5"))
    assert [in_model_scale(one) is one for one in reported([prototype, plain])] == [False, True]
    assert reported([prototype, model, plain]) == [prototype, model, plain]
    assert reported([plain]) == [plain]
    assert [in_model_scale(one) is one for one in reported([prototype, model, plain], "prototype")] == [
        False, False, True,
    ]  # fmt: skip
    assert reported([prototype], "model") == [prototype]


def test_the_answer_states_scale_and_factors(result: Result) -> None:
    text = " ".join(answer(in_prototype_scale(result)).split())
    assert "Prototype scale; prototype over model: length 4, time 2.5, velocity 1.6, acceleration 0.64" in text
    assert "mass 30, force 19.2, stiffness 4.8" in text
    assert "Rig and loop are in model scale" in text
    assert "Base shear of the building (EXP-RTHS): 38.4 N, 1.28 of its weight." in text
    text = " ".join(answer(result).split())
    assert "Model scale; prototype over model: length 4," in text and "Rig and loop" not in text
    assert "Base shear of the building (EXP-RTHS): 2.00 N, 2.00 of its weight." in text


def test_several_answers_name_the_cases_of_each_scale(tmp_path: Path) -> None:
    both = [stored(tmp_path / "a.h5"), stored(tmp_path / "b.h5", scale_length=9.0)]
    text = " ".join(answers(reported(both)).split())
    assert "Prototype scale (a); prototype over model: length 4," in text
    assert "Prototype scale (b); prototype over model: length 9," in text


def test_a_result_without_a_scale_says_nothing_of_one(tmp_path: Path) -> None:
    plain = stored(tmp_path / "c.h5", scale={})
    assert "rototype" not in answer(plain) and "rototype" not in tables([plain])
    drawn = draw("responses", read_result(write_result(tmp_path / "d.h5")), "one")
    assert "scale" not in heading(drawn)


def test_tables_state_scale_and_factors(result: Result) -> None:
    text = tables([in_prototype_scale(result)])
    assert text.startswith("Scale\n  Prototype scale; prototype over model: length 4,")
    assert "1.28" in text and "1.92" in text  # of 2 and 3 m/s^2


def made(*results: Result) -> Contents:
    return contents(Inputs(results, (), ()), (), None, keep_going=True)


def test_json_carries_scale_and_factors_by_its_schema(result: Result, tmp_path: Path) -> None:
    plain = read_result(write_result(tmp_path / "c.h5"), whole=True)
    found = document(made(in_prototype_scale(result), plain))
    jsonschema.validate(found, json.loads(SCHEMA.read_text()))
    scale = found["results"][0]["scale"]
    assert scale["reported_in"] == "prototype"
    assert (scale["factors"]["time"], scale["factors"]["force"]) == (TIME, pytest.approx(FORCE))
    assert "scale" not in found["results"][1]
    model = document(made(result))["results"][0]
    assert model["scale"]["reported_in"] == "model"
    assert model["metrics"]["exp_rths.peak_rel_disp_m"] == [2.0, 3.0]


def test_csv_carries_the_scale_where_there_is_one(result: Result, tmp_path: Path) -> None:
    plain = read_result(write_result(tmp_path / "c.h5"), whole=True)
    rows = list(csv.DictReader(io.StringIO(tidy(made(in_prototype_scale(result), plain)))))
    ours = [row for row in rows if row["file"].endswith("one.h5")]
    assert {(row["reported_in"], row["scale_length"], row["scale_mass"]) for row in ours} == {
        ("prototype", "4.0", "30.0")
    }
    (second,) = (row for row in ours if row["figure"] == "exp_rths.peak_rel_disp_m" and row["number"] == "2")
    assert float(second["value"]) == 12.0
    assert {row["reported_in"] for row in rows if row not in ours} == {""}
    assert "reported_in" not in tidy(made(plain))


def test_accept_limits_are_judged_in_model_scale(tmp_path: Path) -> None:
    """The limit is 2.5 m of the model, which has 2; the prototype has 8."""
    found = in_prototype_scale(stored(tmp_path / "one.h5", accept='{"exp_rths.peak_rel_disp_m[1]": 2.5}'))
    assert document(made(found))["results"][0]["accept"][0]["value"] == 2.0
    assert 'failures="0"' in junit([found])
    assert "2, limit 2.5" in page_reader.read(page([found], "rths report")).words()


@pytest.fixture(scope="module")
def series_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("scaled") / "made_up.h5", **SCALE)


def test_series_of_the_building_are_converted_and_those_of_the_rig_are_not(series_file: Path) -> None:
    there = in_prototype_scale(read_result(series_file))
    with h5py.File(series_file) as file:
        for name, factor in {
            "record/ground_accel_m_s2": ACCELERATION, "sim/abs_accel_m_s2": ACCELERATION, "sim/time_s": TIME,
            "exp_rths/time_s": TIME, "exp_rths/command_v": 1.0, "exp_rths/truth/table_disp_m": LENGTH,
            "exp_rths/timing/compute_s": 1.0, "exp_rths/timing/time_s": 1.0, "identification/delay_s": 1.0,
            "identification/frequency_hz": 1.0, "exp_rths/floor": 1.0,
        }.items():  # fmt: skip
            assert series(there, name) == pytest.approx(factor * file[name][()], rel=1e-14), name


@pytest.mark.parametrize("name", ["tracking", "responses", "errors"])
def test_figures_over_time_are_those_of_the_model_on_other_axes(series_file: Path, name: str) -> None:
    result = read_result(series_file)
    model, whole = draw(name, result, "one"), draw(name, in_prototype_scale(result), "one")
    for ours, theirs in zip(model.axes[:1], whole.axes[:1], strict=True):
        line, other = ours.lines[0], theirs.lines[0]
        assert np.asarray(other.get_xdata()) == pytest.approx(TIME * np.asarray(line.get_xdata()))
        assert np.asarray(other.get_ydata()) == pytest.approx(
            ACCELERATION * np.asarray(line.get_ydata()), nan_ok=True, abs=1e-12
        )
    assert "prototype scale" in heading(whole) and "model scale" in heading(model)


def heading(figure: object) -> str:
    return " ".join(figure.get_suptitle().split())  # type: ignore[attr-defined]


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["table_response", "spectra", "delay_and_gain", "limits"])
def test_figures_of_the_rig_are_in_model_scale(series_file: Path, name: str) -> None:
    result = read_result(series_file)
    model, other = draw(name, result, "two"), draw(name, in_prototype_scale(result), "two")
    assert "model scale" in heading(other)
    for ours, theirs in zip(model.axes, other.axes, strict=True):
        for line, same in zip(ours.lines, theirs.lines, strict=True):
            assert np.array_equal(line.get_xydata(), same.get_xydata(), equal_nan=True)


@pytest.mark.campaign
def test_the_page_plots_the_prototype(tmp_path: Path) -> None:
    result = page_results.write(tmp_path / "made_up.h5", **SCALE)
    first, second = (page_reader.data(page([one], "rths report")) for one in (result, in_prototype_scale(result)))
    for kind in ("runs", "storeys"):
        for view, other in zip(first["results"][0][kind], second["results"][0][kind], strict=True):
            for chart, its in zip(view["charts"], other["charts"], strict=True):
                for trace, same in zip(chart["traces"], its["traces"], strict=True):
                    ours, theirs = first["series"][trace["series"]], second["series"][same["series"]]
                    assert theirs["dt"] == pytest.approx(TIME * ours["dt"])
                    peak, its_peak = (max(map(abs, page_reader.series(one)[1])) for one in (ours, theirs))
                    assert its_peak == pytest.approx(ACCELERATION * peak, rel=1e-4)
    words = page_reader.read(page([in_prototype_scale(result)], "rths report")).words()
    assert "Prototype scale; prototype over model: length 4," in words


def test_the_option_converts_results_and_baseline_alike(tmp_path: Path) -> None:
    ours, before = tmp_path / "a.h5", tmp_path / "before.h5"
    stored(ours, report_in="model")
    stored(before, report_in="model", case_name="a")
    asked = Asked(
        (ours,), "json", None, None, "", "one", "case", "", (), before, None, False, None, report_in="prototype"
    )
    check_asked(asked)
    found = read_asked(asked, lambda _: None)
    assert found.inputs.results[0].metrics["exp_rths.tracking_rms_m_s2"] == pytest.approx(2.0 * ACCELERATION)
    assert found.baseline is not None
    (case,) = found.baseline.changes
    change = next(one for one in case.changes if one.place[0] == "exp_rths.tracking_rms_m_s2")
    assert (change.before, change.now) == (pytest.approx(2.0 * ACCELERATION),) * 2


def test_a_baseline_without_a_scale_is_not_compared_in_prototype_scale(tmp_path: Path) -> None:
    ours, before = tmp_path / "a.h5", tmp_path / "before.h5"
    stored(ours)
    stored(before, scale={}, case_name="a")
    asked = Asked((ours,), "json", None, None, "", "one", "case", "", (), before, None, False, None)
    with pytest.raises(InputError, match=r"before.h5 states no scale.*give --report-in model"):
        read_asked(asked, lambda _: None)
    found = read_asked(replace(asked, report_in="model"), lambda _: None)
    assert found.inputs.results[0].metrics["exp_rths.tracking_rms_m_s2"] == 2.0


def test_results_without_a_scale_are_named_beside_prototypes(tmp_path: Path) -> None:
    both = [stored(tmp_path / "a.h5"), stored(tmp_path / "b.h5", scale={})]
    text = " ".join(tables(reported(both)).split())
    assert "Prototype scale (a); prototype over model: length 4," in text
    assert "No scale is stated for b: shown as stored." in text


def test_a_scale_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "one.h5"
    stored(path)
    with h5py.File(path, "a") as file:
        file.attrs["scale_length"] = -1.0
    with pytest.raises(InputError, match="scale_length"):
        read_result(path)


def test_python_has_the_factors_and_draws_the_scale_of_the_case(tmp_path: Path) -> None:
    metrics = {"exp_rths.rms_error_m_s2": np.array([0.01, 0.02, 0.03])}
    result = rths_cli.load(page_results.write(tmp_path / "a.h5", metrics=metrics, **SCALE).path)
    assert result.scale_factors is not None
    assert result.scale_factors["time"] == TIME and result.scale_factors["force"] == pytest.approx(FORCE)
    assert "prototype scale" in heading(rths_cli.plot(result, "tracking"))
    assert result.metrics["exp_rths.rms_error_m_s2"] == pytest.approx([0.01, 0.02, 0.03])  # as stored
    assert rths_cli.load(page_results.write(tmp_path / "b.h5").path).scale_factors is None
