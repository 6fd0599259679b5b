"""The answer at the end of a run: its grade, its tables in three significant digits, its widths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rths_cli.analysis.grade import (
    GOOD,
    POOR,
    USABLE,
    Compensation,
    GradeLimits,
    PhysicalPart,
    changes_of,
    compensation_of,
    deviations_of,
    grade_of,
)
from rths_cli.files.result_reader import ResultWriter, read_result
from rths_cli.findings import Finding, as_json
from rths_cli.report.answer import answer, answers, notes, one_line, shown_storeys, verdict, verdict_lines
from rths_cli.report.numbers import three
from rths_cli.report.to_text import in_room, laid_out_in

NAMES = ("friction", "latency")


def figures(percent: tuple[float, ...] = (0.2, 0.1, 0.1), delayed: float = 0.1, friction: float = 0.9) -> dict:
    """Return the metrics of a run whose SIM has an RMS of 0.5 m/s^2 in each storey, and `percent` the bound."""
    rms = 0.005 * np.array(percent)
    return {
        "exp_rths.nrmse_percent": np.array(percent),
        "exp_rths.rms_error_m_s2": rms,
        "exp_rths.true_error_bound_percent": np.array(percent),
        "exp_rths.true_error_median_percent": 0.5 * np.array(percent),
        "sim_delay.rms_error_m_s2": np.full(3, delayed),
        "sim_delay.nrmse_percent": np.full(3, 200.0 * delayed),
        "exp_rths.peak_abs_accel_m_s2": np.array([1.4951, 2.1, 2.8]),
        "exp_rths.peak_rel_disp_m": np.array([0.00551, 0.00993, 0.01255]),
        "exp_rths.peak_inter_storey_drift_m": np.array([0.00551, 0.004436, 0.002633]),
        "exp_rths.peak_building_base_shear_n": 40.58,
        "exp_rths.building_base_shear_ratio": 0.1991,
        "budget.rms_error_friction_m_s2": friction * rms,
        "budget.rms_error_latency_m_s2": np.sqrt(1.0 - friction**2) * rms,
    }


def written(
    path: Path, values: dict, case: str = "grade_limits: {}\n", status: str = "complete", **attributes: str
) -> Path:
    about = {
        "case_name": "own", "method": "best", "rig": "bench", "rig_kind": "virtual", "sample_rate_hz": 200.0,
        "record_name": "quake", "scaling": 0.3, "damping_name": "low", "damping_first_mode_ratio": 0.026,
        "controller": "FF+FB", "exp_rths_status": "complete", "check_verdict": "safe",
    }  # fmt: skip
    structure = "structure: {numerical: {masses_kg: [7.0]}, experimental: {masses_kg: [7.0, 7.0]}}\n"
    with ResultWriter(path, about | attributes) as writer:
        writer.case("case\n", structure + case)
        writer.metrics(values)
        writer.finish(status, attributes.get("status_reason", ""))  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize(
    ("percent", "grade"),
    [
        ((1.9, 0.1, 0.1), GOOD),
        ((0.1, 2.1, 0.1), USABLE),
        ((0.1, 0.1, 5.1), POOR),
    ],
)
def test_the_grade_is_that_of_the_bound_of_the_worst_storey(percent, grade) -> None:  # type: ignore[no-untyped-def]
    """The error against the declared building and SIM-DELAY's change no word."""
    for delayed in (1e-4, 0.2, np.inf):
        values = figures(percent, delayed) | {"exp_rths.nrmse_percent": np.full(3, 9.0)}
        found = grade_of(values, GradeLimits())
        assert found is not None and found.grade == grade
        assert found.storey == int(np.argmax(percent)) + 1
    assert grade_of({"exp_rths.nrmse_percent": np.full(3, 0.1)}, GradeLimits()) is None  # no bound, no word
    assert grade_of(figures((0.1, np.nan, 0.1)), GradeLimits()) is None


def test_a_compensation_is_worth_little_beside_a_bad_sim_delay_or_where_it_harms() -> None:
    limits = GradeLimits()
    assert Compensation(0.09, 1, 30.0).worth_it(limits) and not Compensation(0.11, 1, 30.0).worth_it(limits)
    assert Compensation(0.9, 1, 0.1).worth_it(limits) and not Compensation(5.0, 1, 0.1).worth_it(limits)
    found = compensation_of(figures((0.1, 0.4, 0.1), 0.005))  # SIM-DELAY: 1 % of SIM
    assert found is not None and (found.ratio, found.storey) == (pytest.approx(0.2), 2)
    assert compensation_of(figures(delayed=np.nan)) is None


def test_a_specimen_matters_by_its_shear_and_by_what_the_test_would_be_without_it() -> None:
    limits = GradeLimits()
    assert PhysicalPart(3.6, 120.0).matters(limits) and PhysicalPart(3.6, np.nan).matters(limits)
    assert not PhysicalPart(0.002, 40.0).matters(limits) and not PhysicalPart(0.5, 1.0).matters(limits)


def test_deviations_are_told_beyond_their_uncertainty_with_storey_and_sign(tmp_path: Path) -> None:
    nan = np.nan
    values = figures() | {
        "exp_rths.stiffness_over_declared": np.array([nan, 0.96, 1.015]),
        "exp_rths.stiffness_over_declared_error": np.array([nan, 0.01, 0.01]),
        "exp_rths.damping_over_declared": np.array([1.5, 1.02]),
        "exp_rths.damping_over_declared_error": np.array([0.1, 0.2]),
    }
    named = [(one.what, one.place, round(one.percent, 6)) for one in deviations_of(values)]
    assert named == [("stiffness of storey", 2, -4.0), ("damping ratio of the specimen's mode", 1, 50.0)]
    said = verdict(read_result(written(tmp_path / "a.h5", values)))
    assert (
        "The specimen is not the declared one: damping ratio of the specimen's mode 1 +50 +- 10 %, stiffness of "
        in said
    )
    assert (
        "stiffness of storey 2 -4.0 +- 1.0 %; declare it so (against SIM as declared the test is 0.200 % off)." in said
    )


def test_what_was_measured_stands_in_the_second_line_and_what_is_hardly_worth_it_behind(tmp_path: Path) -> None:
    values = figures((0.3, 0.1, 0.1), 0.001) | {
        "exp_rths.specimen_share": 3.6, "exp_rths.without_specimen_percent": 124.0,
    }  # fmt: skip
    first, *more = verdict_lines(read_result(written(tmp_path / "a.h5", values)))
    assert first.startswith("GOOD: ") and more == [
        "Measured 0.300 % of SIM as declared; likely 0.750 of SIM-DELAY; limits good 2 %, usable 5 %, 1."
    ]
    light = values | {"exp_rths.specimen_share": 0.002, "sim_delay.nrmse_percent": np.full(3, 0.03)}
    said = verdict(read_result(written(tmp_path / "b.h5", light)))
    assert "hardly worth it: true error 5.00 of SIM-DELAY's, worse than no compensation (limit 1, storey 1)." in said
    assert "The specimen hardly matters: its base shear is 0.00200 of the interface floor's inertia force (at" in said
    assert "without it computed storeys move within 124 % of SIM (at least 2 %); the test says little about it" in said


def test_a_specimen_that_changed_is_told(tmp_path: Path) -> None:
    values = figures() | {
        "exp_rths.stiffness_change": np.array([np.nan, -0.2, 0.01]),
        "exp_rths.stiffness_change_error": np.array([np.nan, 0.01, 0.01]),
    }
    assert changes_of(values | {"exp_rths.specimen_changed": 0.0}) == ()
    result = read_result(written(tmp_path / "a.h5", values | {"exp_rths.specimen_changed": 1.0}))
    assert "THE SPECIMEN CHANGED since its identification: stiffness of storey 2 -20.0 +- 1.0 %; SIM is" in verdict(
        result
    )


def test_without_a_bound_there_is_no_word_but_the_reason(tmp_path: Path) -> None:
    values = {path: value for path, value in figures().items() if "true_error" not in path}
    path = written(tmp_path / "a.h5", values, no_true_error_bound="the run is too short")
    assert verdict(read_result(path)) == "NOT GRADED: no bound of the true error is stated, the run is too short."


def test_the_cause_is_named_where_it_makes_half_of_the_squares() -> None:
    assert grade_of(figures(friction=0.9), GradeLimits()).cause == "friction"  # type: ignore[union-attr]
    assert grade_of(figures(friction=0.2), GradeLimits()).cause == "latency"  # type: ignore[union-attr]
    values = figures(friction=0.6) | {"budget.rms_error_specimen_m_s2": 0.7 * figures()["exp_rths.rms_error_m_s2"]}
    assert grade_of(values, GradeLimits()).cause == ""  # type: ignore[union-attr]


def test_what_the_loop_does_not_explain_is_the_calibrations() -> None:
    for loop, cause in ((0.6, "calibration"), (0.8, "friction")):
        values = figures() | {
            "exp_rths.measured_loop_rms_error_m_s2": np.full(3, loop),
            "exp_rths.true_error_median_m_s2": np.ones(3),
            "exp_rths.true_error_calibration_m_s2": np.full(3, 0.8),
            "budget.rms_error_declared_m_s2": np.full(3, 9.0),  # no part of the true error
        }
        assert grade_of(values, GradeLimits()).cause == cause  # type: ignore[union-attr]


def test_what_moves_the_table_unseen_is_not_blamed_on_the_calibration() -> None:
    values = figures() | {
        "exp_rths.measured_loop_rms_error_m_s2": np.full(3, 0.3),
        "exp_rths.true_error_median_m_s2": np.ones(3),
        "exp_rths.true_error_calibration_m_s2": np.full(3, 0.1),
    }
    assert grade_of(values, GradeLimits()).cause == ""  # type: ignore[union-attr]
    rounded = {"check.rms_error_quantisation_m_s2": np.full(3, 0.9)}
    assert grade_of(values | rounded, GradeLimits()).cause == "quantisation"  # type: ignore[union-attr]


def test_the_noise_of_samples_is_not_blamed_on_the_specimen() -> None:
    """The budget measures both in one; what the check predicted of the samples tells them apart."""
    rms = figures()["exp_rths.rms_error_m_s2"]
    values = figures(friction=0.2) | {"budget.rms_error_specimen_m_s2": 5.0 * rms}
    assert grade_of(values, GradeLimits()).cause == "specimen"  # type: ignore[union-attr]
    for rounded, noise, cause in ((4.0, 1.0, "quantisation"), (1.0, 4.0, "noise"), (3.0, 0.0, "specimen")):
        predicted = {"check.rms_error_quantisation_m_s2": rounded * rms, "check.rms_error_noise_m_s2": noise * rms}
        assert grade_of(values | predicted, GradeLimits()).cause == cause  # type: ignore[union-attr]


def test_without_a_hybrid_test_there_is_no_grade(tmp_path: Path) -> None:
    values = {"sim.peak_abs_accel_m_s2": np.ones(3), "sim.peak_inter_storey_drift_m": np.ones(3)}
    path = written(tmp_path / "sim.h5", values, exp_rths_status="refused", exp_rths_status_reason="unsafe: margin")
    assert verdict(read_result(path)) == "REFUSED: unsafe: margin"
    assert "peaks in SIM" in answer(read_result(path))


def test_limits_of_the_case_decide(tmp_path: Path) -> None:
    strict = written(
        tmp_path / "a.h5", figures(), "grade_limits: {good_percent: 0.15, good_ratio: 0.1, usable_percent: 5.0}\n"
    )
    told = verdict(read_result(strict))
    assert told.startswith(
        "USABLE: true error below 0.200 % of SIM (95 %), likely 0.100 %, storey 1, virtual rig; most"
    )
    assert "; most of it by friction; if" in told
    assert "likely 0.00500 of SIM-DELAY; limits good 0.15 %, usable 5 %, 0.1." in told


def test_a_test_that_was_called_unsafe_says_so(tmp_path: Path) -> None:
    path = written(tmp_path / "a.h5", figures(), check_verdict="unsafe")
    told = verdict(read_result(path))
    assert told.startswith("CHECK OVERRIDDEN. The check called the test unsafe. Its accuracy alone: GOOD: ")
    assert ": good, check overridden on a virtual rig, true error below" in one_line(read_result(path))


def test_a_true_error_beyond_its_stated_bound_is_told(tmp_path: Path) -> None:
    for beyond in (False, True):
        values = figures() | {
            "exp_rths.true_reference_rms_error_m_s2": np.array([0.5, 0.9, 5.0]),
            "exp_rths.true_error_bound_m_s2": np.array([1.0, 1.0, 2.0 if beyond else 8.0]),
        }
        said = verdict(read_result(written(tmp_path / f"{beyond}.h5", values)))
        assert ("the simulated truth is 2.50 times the stated bound of storey 3" in said) == beyond


def test_a_doubt_on_units_stands_before_the_grade(tmp_path: Path) -> None:
    path = written(tmp_path / "a.h5", figures(), units_in_doubt="structure.experimental.masses_kg")
    told = verdict(read_result(path))
    assert told.startswith("UNITS DOUBTFUL. A wrong unit is likely in structure.experimental.masses_kg, so")
    assert "Its accuracy alone: GOOD: " in told
    assert ": good, units doubtful on a virtual rig, true error below" in one_line(read_result(path))
    other = written(tmp_path / "b.h5", figures(), check_verdict="unsafe")
    compared = answers([read_result(path), read_result(other)])
    assert [line.split()[1] for line in compared.splitlines() if line.split()[:1] in (["a"], ["b"])] == [
        "doubtful",
        "overridden",
    ]


def test_an_aborted_test_says_why(tmp_path: Path) -> None:
    path = written(
        tmp_path / "a.h5", {}, status="aborted", exp_rths_status="aborted",
        status_reason="force beyond its limit", exp_rths_status_reason="force beyond its limit",
    )  # fmt: skip
    assert verdict(read_result(path)) == "ABORTED: force beyond its limit"


def test_an_aborted_test_of_the_table_stands_beside_the_refusal(tmp_path: Path) -> None:
    path = written(
        tmp_path / "a.h5", {}, status="aborted", exp_rths_status="refused", exp_rths_status_reason="unsafe: no room",
        shake_table_status="aborted", shake_table_status_reason="shake-table test: stroke at 2 s",
    )  # fmt: skip
    assert verdict(read_result(path)) == "REFUSED: unsafe: no room; before it shake-table test: stroke at 2 s"


GOLDEN = """\
GOOD: true error below 0.200 % of SIM (95 %), likely 0.100 %, storey 1, virtual
  rig; if sensors and masses are as declared.
Measured 0.200 % of SIM as declared; likely 0.00500 of SIM-DELAY; limits good
  2 %, usable 5 %, 0.1.
own: 30 % quake, damping low (2.6 %), FF+FB, virtual rig bench

                    peaks in EXP-RTHS      RMS error of acceleration
storey       abs. accel  displ  drift  EXP-RTHS  EXP-RTHS  SIM-DELAY
                  m/s^2     mm     mm    mm/s^2  % of SIM     mm/s^2
3 roof             2.80   12.6   2.63     0.500     0.100        100
2                  2.10   9.93   4.44     0.500     0.100        100
1 interface        1.50   5.51   5.51      1.00     0.200        100

Base shear of the building (EXP-RTHS): 40.6 N, 0.199 of its weight.
note: one thing
"""


def test_the_answer_of_one_result(tmp_path: Path) -> None:
    path = written(tmp_path / "own.h5", figures(), warnings="one thing")
    text = answer(read_result(path), 80)
    assert text.startswith(GOLDEN)
    rest = " ".join(text.removeprefix(GOLDEN).split())
    assert rest == f"result {path}; more: rths report --full, --figures DIR or --format html"


@pytest.mark.parametrize("width", [20, 60, 72, 80, 100, 200])
def test_it_fits_from_60_columns_on(tmp_path: Path, width: int) -> None:
    values = figures() | {"exp_rths.peak_drift_ratio": np.full(3, 1.5e-3)}
    lines = answer(read_result(written(tmp_path / "o.h5", values)), width).splitlines()
    paths = [line for line in lines if str(tmp_path) in line]  # a path is not broken
    assert max(len(line) for line in lines if line not in paths) <= min(max(width, 60), 100)
    assert any("% height" in line for line in lines)


def test_of_a_tall_building_the_three_that_drift_most_and_the_roof_are_shown(tmp_path: Path) -> None:
    drift = np.array([1.0, 9.0, 2.0, 8.0, 7.0, 3.0, 0.5])
    values = {"sim.peak_inter_storey_drift_m": drift, "sim.peak_abs_accel_m_s2": drift}
    result = read_result(written(tmp_path / "tall.h5", values))
    assert shown_storeys(result, "sim") == [6, 4, 3, 1]


def test_of_a_tall_building_the_storeys_that_the_verdict_names_are_shown(tmp_path: Path) -> None:
    drift, percent = np.array([1.0, 9.0, 2.0, 8.0, 7.0, 3.0, 0.5]), np.full(7, 0.4)
    percent[2] = 0.9
    error, delayed = percent.copy(), np.full(7, 100.0)
    delayed[5] = 2.0
    bound = np.ones(7)
    bound[0] = 9.0
    values = {
        "sim.peak_inter_storey_drift_m": drift, "sim.peak_abs_accel_m_s2": drift, "exp_rths.nrmse_percent": percent,
        "exp_rths.rms_error_m_s2": error, "sim_delay.rms_error_m_s2": delayed,
        "exp_rths.true_error_median_percent": percent, "exp_rths.true_error_bound_percent": bound,
        "sim_delay.nrmse_percent": delayed,
    }  # fmt: skip
    result = read_result(written(tmp_path / "tall.h5", values))
    said = verdict(result)
    assert "storey 6)" in said and ", storey 1," in said
    assert shown_storeys(result, "sim") == [6, 5, 4, 3, 1, 0]
    peaks = {"exp_rths.peak_error_percent": np.array([9.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])}
    assert 0 in shown_storeys(read_result(written(tmp_path / "peak.h5", values | peaks)), "sim")
    only = {k: v for k, v in values.items() if k.startswith("sim.")} | peaks
    assert shown_storeys(read_result(written(tmp_path / "only.h5", only)), "sim") == [6, 4, 3, 1, 0]


def test_several_results_are_compared_row_by_row(tmp_path: Path) -> None:
    paths = [
        written(tmp_path / "first.h5", figures()),
        written(tmp_path / "second.h5", figures((3.0, 0.1, 0.1))),
        written(tmp_path / "third.h5", {}, exp_rths_status="refused", exp_rths_status_reason="unsafe: margin"),
    ]
    lines = answers([read_result(path) for path in paths], 80).splitlines()
    assert lines[3].split() == ["first", "good", "0.200", "0.00500", "2.80", "40.6"]
    assert lines[4].split() == ["second", "usable", "3.00", "0.0750", "2.80", "40.6"]
    assert lines[5].split() == ["third", "refused", "-", "-", "-", "-"]
    assert "third: REFUSED: unsafe: margin" in lines and max(map(len, lines[:7])) <= 80
    said = " ".join(" ".join(lines).split())
    assert "Grades of tests on virtual rigs follow from the 95 % bound of the true error. Limits: good 2 %, us" in said


def test_a_real_rig_is_not_called_virtual(tmp_path: Path) -> None:
    real, other = written(tmp_path / "real.h5", figures(), rig_kind="udp"), written(tmp_path / "v.h5", figures())
    told = verdict(read_result(real))
    assert told.startswith("GOOD: true error below 0.200 % of SIM (95 %), likely ") and "virtual" not in told
    assert "virtual" not in one_line(read_result(real))
    both = answers([read_result(real), read_result(other)], 100)
    assert "Grades of tests (v: virtual) follow" in both


NOTE = "a {} that stands in a sentence of so many words that it does not fit in a line; it is {}, state {} to decide"
SHAPE = {
    "peak_abs_accel_m_s2": 3.0,
    "peak_rel_disp_m": 0.01,
    "peak_inter_storey_drift_m": 0.01,
    "peak_drift_ratio": 0.1,
}


def of_five_storeys() -> dict:
    values = {f"exp_rths.{name}": np.linspace(0.5, 1.0, 5) * factor for name, factor in SHAPE.items()}
    values |= {
        f"exp_rths.{name}": np.full(5, 0.1)
        for name in (
            "nrmse_percent",
            "rms_error_m_s2",
            "peak_error_percent",
            "true_error_bound_percent",
            "true_error_median_percent",
        )
    }
    values |= {"exp_rths.peak_building_base_shear_n": 1.0, "exp_rths.building_base_shear_ratio": 0.1}
    return values | {
        "exp_rths.fei_delay_s": 1e-3, "exp_rths.fei_amplitude": 1.0, "sim_delay.rms_error_m_s2": np.full(5, 9.0)
    }  # fmt: skip


def test_one_case_with_much_to_say_takes_16_lines_of_three_storeys_and_19_of_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    warnings = "\n".join(NOTE.format(k, k, f"key_{k}") for k in "abcdefgh")
    result = read_result(written(Path("one.h5"), of_five_storeys(), warnings=warnings))
    lines = answer(result, 100).splitlines()
    assert len(lines) == 19 and max(map(len, lines)) <= 100
    of_three = read_result(written(Path("three.h5"), figures(), warnings=warnings))
    assert len(answer(of_three, 100).splitlines()) <= 16
    shown = sum(line.startswith("note: ") for line in lines)
    assert shown >= 1 and f"(notes shortened, {8 - shown} more left out; rths run --full prints them whole)" in lines
    whole = " ".join(answer(result, 80, whole=True).split())
    assert all(NOTE.format(k, k, f"key_{k}") in whole for k in "abcdefgh") and "shortened" not in whole


def test_the_first_note_has_the_room_that_the_others_leave() -> None:
    first = "overridden, it says unsafe: " + " ".join(f"{k} m is predicted, {k} m is the limit;" for k in range(12))
    with laid_out_in(80):
        lines = [line.text for line in in_room([first, NOTE.format("b", "b", "key_b")], 5, "rths run --full")]
    assert len(lines) == 5 and lines[4] == "(notes shortened; rths run --full prints them whole)"
    assert " ".join(line.strip() for line in lines[:3]).removesuffix(" ...") in first and lines[2].endswith(" ...")
    assert lines[3].startswith("a b that stands in") and lines[3].endswith(" ...")


def test_eight_cases_take_30_lines_of_80_columns_and_each_has_its_first_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    results = []
    for k, letter in enumerate("abcdefgh"):
        own = NOTE.format(letter, letter, f"key_{letter}")
        drift = Finding("sensor.unusable", {"channel": "table", "from_s": k + 1.0})
        said = "\n".join([own, f"more: {own}", f"and more: {own}", str(drift), "of all"])
        noted = {"warnings": said, "findings": as_json([drift])}
        path = written(Path(f"case_of_a_long_name_{k}.h5"), figures(), **noted, reference_title="a paper")
        results.append(read_result(path))
    lines = answers(results, 80).splitlines()
    assert len(lines) <= 30 and max(map(len, lines)) <= 80
    for k, letter in enumerate("abcdefgh"):
        assert any(line.startswith(f"note: case_of_a_long_name_{k}: a {letter} that stands in") for line in lines)
    shown = sum(line.startswith("note: ") for line in lines)
    assert shown >= 8 and any(line.startswith(f"(notes shortened, {26 - shown} more left out;") for line in lines)
    whole = " ".join(answers(results, 80, whole=True).split())
    assert whole.count("channel table is not usable") == 8 and whole.count("state key_h to decide") == 3
    assert "with --full, or --paper" in " ".join(lines)


def test_notes_that_differ_in_figures_alone_are_told_once(tmp_path: Path) -> None:
    jumps = [Finding("sensor.jump", {"channel": "floor_3", "jump_v": 1e-3 * k, "at_s": 2.0}) for k in range(6)]
    results = [
        read_result(written(tmp_path / f"c{k}.h5", figures(), warnings=f"{jump}\nof all", findings=as_json([jump])))
        for k, jump in enumerate(jumps)
    ]
    lines = answers(results, 80).splitlines()
    jumped, of_all = [line for line in lines if line.startswith("note: ")]
    assert f"note: all (figures of c0): {jumps[0]}".startswith(jumped) and of_all == "note: of all"
    other = read_result(written(tmp_path / "other.h5", figures(), warnings="of all"))
    text = " ".join(answers([*results, other], 80).split())
    assert "note: c0, c1, c2 and 3 more (figures of c0): channel floor_3 jumps" in text


def test_peaks_far_from_sims_are_told_where_the_error_is_small(tmp_path: Path) -> None:
    exact = {
        "sim.peak_abs_accel_m_s2": np.array([1.4951, 2.1, 2.8]) / np.array([1.0, 1.05, 1.2]),
        "sim.peak_building_base_shear_n": 40.0,
    }
    (told,) = notes([read_result(written(tmp_path / "a.h5", figures() | exact))])
    assert told.text.startswith("peaks of EXP-RTHS are more than 10 % off: acceleration of storey 3 2.80 m/s^2, in SIM")
    assert "base shear" not in told.text
    less = exact | {"sim.peak_abs_accel_m_s2": np.array([1.4951, 2.1, 2.8]) / 1.05}
    assert notes([read_result(written(tmp_path / "b.h5", figures() | less))]) == []
    assert notes([read_result(written(tmp_path / "c.h5", figures((7.0, 0.1, 0.1)) | exact))]) == []  # said by the grade


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.99951, "1.00"), (158.04, "158"), (1234.6, "1230"), (0.0074642, "0.00746"), (-2.5, "-2.50"),
     (np.inf, "-"), (3.21e-7, "3.21e-07"), (123456.0, "1.23e+05")],
)  # fmt: skip
def test_three_significant_digits(value: float, text: str) -> None:
    assert three(value) == text


def test_a_case_in_one_line(tmp_path: Path) -> None:
    good = read_result(written(tmp_path / "own.h5", figures()))
    told = "own: good on a virtual rig, true error below 0.200 % of SIM (95 %), likely 0.100 %"
    assert one_line(good) == f"{told}; {good.path}"
    refused = written(tmp_path / "no.h5", {}, exp_rths_status="refused", exp_rths_status_reason="unsafe: margin")
    assert one_line(read_result(refused)) == f"no: REFUSED: unsafe: margin; {refused}"


def test_a_test_beyond_its_accept_limits_is_not_called_good(tmp_path: Path) -> None:
    said = "exp_rths.rms_error_m_s2[3] = 0.0005 is beyond its accept limit 0.0001"
    case = "accept:\n  exp_rths.rms_error_m_s2[3]: 0.0001\n"
    result = read_result(written(tmp_path / "own.h5", figures(), case, status_reason=said))
    assert verdict(result).startswith(f"NOT ACCEPTED: {said}. GOOD: true error below 0.200 % of SIM")
    assert one_line(result).startswith(f"own: NOT ACCEPTED: {said}")
    other = read_result(written(tmp_path / "other.h5", figures()))
    lines = answers([result, other], 80).splitlines()
    assert lines[3].split()[:3] == ["own", "not", "accept."] and any("NOT ACCEPTED" in line for line in lines)


def test_a_fault_after_the_record_is_told(tmp_path: Path) -> None:
    result = read_result(written(tmp_path / "own.h5", figures(), status_reason="the rig failed after the record"))
    assert verdict(result).startswith("BUT: the rig failed after the record. GOOD: ")


def test_a_file_without_relative_errors_is_not_graded(tmp_path: Path) -> None:
    result = read_result(written(tmp_path / "old.h5", {}, rths_version="0.1.0"))
    assert (
        verdict(result)
        == "NOT GRADED: the file, written by rths 0.1.0, states no bound of the true error after the run."
    )


def test_damaged_limits_are_the_usual_ones(tmp_path: Path) -> None:
    case = "grade_limits: {good_percent: many, gut: 1, usable_percent: 3}\n"
    told = verdict(read_result(written(tmp_path / "a.h5", figures(), case)))
    assert told.startswith("GOOD") and "limits good 2 %, usable 3 %, 0.1." in told


def test_a_diverged_sim_delay_and_another_band_are_told(tmp_path: Path) -> None:
    values = figures(delayed=np.nan) | {"sim_delay.diverged_at_s": 1.234}
    told = verdict(read_result(written(tmp_path / "a.h5", values, test_band_hz=30.0)))
    assert told.startswith("GOOD: true error up to 30 Hz below 0.200 % of SIM (95 %), likely ")
    assert "; SIM-DELAY diverged at 1.23 s and is not compared. Measured" in told
    assert told.endswith("; limits good 2 %, usable 5 %.")


def test_a_refused_test_tells_of_a_diverged_sim_delay_and_has_no_column_of_dashes(tmp_path: Path) -> None:
    values = {"sim.peak_abs_accel_m_s2": np.ones(3), "sim_delay.rms_error_m_s2": np.full(3, np.nan)}
    refused = {"exp_rths_status": "refused", "exp_rths_status_reason": "unsafe: margin"}
    path = written(tmp_path / "a.h5", values | {"sim_delay.diverged_at_s": 1.234}, **refused)
    lines = answer(read_result(path), 80).splitlines()
    assert "SIM-DELAY diverged at 1.23 s and is not compared." in lines
    assert any("abs. accel" in line for line in lines) and "RMS error of acceleration" not in str(lines)


def test_effective_delay_and_gain_stand_below_the_errors(tmp_path: Path) -> None:
    values = figures() | {
        "exp_rths.fei_delay_s": 1.25e-4,
        "exp_rths.fei_amplitude": 0.9876,
        "exp_rths.peak_error_percent": np.array([0.5, 1.5, 1.0]),
    }
    text = " ".join(answer(read_result(written(tmp_path / "o.h5", values)), 80).split())
    assert "Table 0.125 ms late, gain 0.9876 (FEI); worst peak error 1.50 % (storey 2)." in text
    early = values | {"exp_rths.fei_delay_s": -1.25e-4}
    assert "Table 0.125 ms early," in " ".join(answer(read_result(written(tmp_path / "e.h5", early)), 80).split())


def test_a_note_is_printed_once_and_not_after_the_verdict_that_says_it(tmp_path: Path) -> None:
    refused = {"exp_rths_status": "refused", "exp_rths_status_reason": "unsafe: no room; raise it"}
    (tmp_path / "b").mkdir()
    one = read_result(written(tmp_path / "one.h5", figures(), warnings="same\nsame\nown"))
    two = read_result(written(tmp_path / "two.h5", {}, warnings="no room\nsame", **refused))
    assert list(map(str, notes([one]))) == ["same", "own"] and list(map(str, notes([two]))) == ["same"]
    assert list(map(str, notes([one, two]))) == ["same", "one: own"]
    text = answers([one, two], 80)
    assert text.count("same") == 1 and "note: one: own\n" in text
    assert "Storeys and base shear below" not in answer(two)
