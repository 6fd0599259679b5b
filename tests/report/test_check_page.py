"""The page of a check, read back; and its document."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from made_up_check import checked

from rths_cli.experiment.check_command import Checked
from rths_cli.findings import Finding, stated
from rths_cli.quantities import METRICS, Interval, intervals_of
from rths_cli.report.check_page import MARGINS, REACH, as_document, page, pages

MOTION = ("check.peak", "check.limit", "check.rms_error", "check.tracking")


def cells(text: str, label: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.strip().startswith(label)]
    return line.strip().removeprefix(label).replace("|", " ").split()


def figure(found: Checked, name: str) -> float:
    return float(np.atleast_1d(np.asarray(found.metrics[f"check.{name}"]))[0])


def with_figure(found: Checked, name: str, value: float) -> Checked:
    return replace(found, metrics={**found.metrics, f"check.{name}": value})


def test_it_says_what_is_checked_and_the_verdict_last() -> None:
    text = page(checked())
    assert text.startswith("Check of my_case on the virtual table aps400, before anything moves")
    for label, words in {
        "building": "three_storey, damping low",
        "record": "el_centro x 0.3, 2000 Hz",
        "controller": "FF+FB, method best",
        "model": "cache, identified an hour ago",
        "note": "a warning",
        "verdict": "safe",
    }.items():
        assert f"{label:<24}{words}" in text.splitlines()
    assert text.splitlines()[1].split() == ["verdict", "safe"]
    assert max(len(line) for line in text.splitlines()) <= 100


def test_the_scale_of_a_model_is_stated_with_its_record() -> None:
    scaled = checked(scale={"length": 4.0, "time": 2.0}, record_s=26.87)
    text = " ".join(page(scaled).split())
    told = "prototype over model: length 4, time 2; 53.74 s of record are compressed to 26.87 s"
    assert f"scale {told}; everything below is in model scale" in text
    assert as_document([scaled])["cases"][0]["scale"] == {"length": 4.0, "time": 2.0}
    assert "prototype" not in page(checked())


def with_samples(found: Checked) -> Checked:
    radius, errors = 0.99994, np.array([1e-3, 2e-3, 3e-3])
    ranges = {
        "check.spectral_radius": Interval(radius, 0.9999, 1.0002, 0.5),
        "check.rms_error_m_s2": Interval(errors, 0.5 * errors, np.array([4e-3, 5e-3, math.inf]), 0.5),
        "check.loop_damping_ratio": Interval(np.ones(3), np.zeros(3), np.ones(3), 0.4),
    }
    return replace(found, metrics={**found.metrics, **ranges})


def test_the_range_over_samples_stands_beside_each_figure() -> None:
    assert "range over samples" not in page(checked())
    text = page(with_samples(checked()))
    assert "lies in each range with a probability of at least 40 %" in " ".join(text.split())
    assert cells(text, "error of storey 1, mm/s^2") == ["1.00", "0.500", "4.00"]
    assert cells(text, "error of storey 3, mm/s^2")[2] == "inf"
    assert max(len(line) for line in text.splitlines()) <= 100


def test_the_document_has_the_intervals_of_figures_that_carry_one() -> None:
    (plain,), (one,) = (as_document([each])["cases"] for each in (checked(), with_samples(checked())))
    assert "intervals" not in plain
    document = json.loads(json.dumps(one, allow_nan=False))
    assert document["metrics"]["check.rms_error_m_s2"] == [1e-3, 2e-3, 3e-3]
    assert document["intervals"]["check.rms_error_m_s2"] == {
        "low": [0.5e-3, 1e-3, 1.5e-3], "high": [4e-3, 5e-3, None], "probability": 0.5,
    }  # fmt: skip
    assert set(document["intervals"]) == set(intervals_of(with_samples(checked()).metrics))


def test_every_margin_stands_with_measured_response_and_model() -> None:
    found = checked()
    text = page(found)
    for label, leaf, scale in MARGINS:
        shown = [float(cell) for cell in cells(text, label.strip())]
        assert shown == pytest.approx([scale * figure(found, leaf + kind) for kind in ("", "_model")], rel=6e-3)
    words = " ".join(cells(text, "table error"))
    assert f"tolerated {100 * figure(found, 'tolerated_table_error'):.3g} %" in words
    assert f"required {100 * figure(found, 'required_table_error'):.3g} %" in words
    words = " ".join(cells(text, "up to 11 Hz"))
    assert f"tolerated {100 * figure(found, 'tolerated_table_error_in_band'):.3g} % or more" in words


def test_every_peak_stands_beside_its_limit_and_share() -> None:
    found = checked()
    text = page(found)
    for label, leaf, scale in REACH:
        peak, limit = figure(found, f"peak_{leaf}"), figure(found, f"limit_{leaf}")
        shown = [float(cell) for cell in cells(text, label)]
        assert shown == pytest.approx([scale * peak, scale * limit, 100 * peak / limit], rel=6e-3)
    assert float(cells(text, "largest safe scaling")[0]) == pytest.approx(figure(found, "largest_scaling"), rel=1e-5)
    none = page(with_figure(found, "largest_scaling", 0.0))
    assert " ".join(cells(none, "largest safe scaling")).startswith("none")


def test_modes_of_building_and_loop_stand_side_by_side() -> None:
    found = checked()
    text = page(found)
    for mode in range(3):
        wanted = [
            scale * float(np.asarray(found.metrics[f"check.{of}_{what}"])[mode])
            for of in ("building", "loop")
            for what, scale in (("frequency_hz", 1.0), ("damping_ratio", 100.0))
        ]
        assert [float(cell) for cell in cells(text, f"{mode + 1} ")] == pytest.approx(wanted, abs=6e-4)


@pytest.mark.parametrize(
    ("delay_s", "words"), [(0.00794, "7.94 ms on an ideal table"), (0.0, "any pure delay"), (math.inf, "no pure delay")]
)
def test_the_critical_delay_is_a_sentence(delay_s: float, words: str) -> None:
    assert words in " ".join(page(with_figure(checked(), "critical_delay_s", delay_s)).split())


def test_the_predicted_error_is_set_against_sim_delay() -> None:
    found = checked()
    error, late = (np.asarray(found.metrics[f"check.{n}"]) for n in ("rms_error_m_s2", "sim_delay_rms_error_m_s2"))
    text = page(found)
    assert [float(c) for c in cells(text, "SIM-DELAY, 5 ms, mm/s^2")] == pytest.approx(1e3 * late, rel=6e-3)
    assert [float(c) for c in cells(text, "predicted over SIM-DELAY")] == pytest.approx(error / late, rel=6e-3)
    assert [float(c) for c in cells(text, "together")][1:] == pytest.approx(1e3 * error, abs=6e-4)
    beyond = page(checked(drop=("check.sim_delay",)))
    assert "near its critical delay" in " ".join(cells(beyond, "SIM-DELAY, 5 ms"))


def test_an_unstable_loop_has_no_margins_reach_or_error_and_its_reasons_are_all_told() -> None:
    found = with_figure(checked("unstable", ("one thing", "another thing"), MOTION), "spectral_radius", 1.0002)
    text = page(found)
    assert cells(text, "margins")[0] == "none:" and "gain up" not in text
    assert (
        " ".join(cells(text, "table limits")) == " ".join(cells(text, "error")) == "not predicted: the loop is unstable"
    )
    assert [line.strip() for line in text.splitlines()][1:3] == [
        "verdict                 unstable: one thing",
        "another thing",
    ]
    assert cells(text, "spectral radius")[0] == "1.000200;"


def test_a_case_without_blocks_is_told_with_its_sentence_alone() -> None:
    found = replace(checked("unsafe", ("no feedback can be designed",)), metrics={}, notes=())
    text = page(found)
    assert "unsafe: no feedback can be designed" in text and "stability" not in text


def test_a_doubt_that_is_a_reason_is_told_once() -> None:
    doubt = "b.yaml:2:3: structure.numerical.masses_kg: are they in kg?"
    text = page(replace(checked("unsafe", (doubt, "no room")), notes=(stated(doubt), stated("another"))))
    assert text.count("are they in kg") == 1 and "another" in text


def test_a_safe_case_with_a_doubted_number_is_safe_only_if_it_is_right() -> None:
    found = replace(checked(), doubted=("table.limits.force_n",))
    said = "safe if table.limits.force_n is right"
    assert page(found).splitlines()[1].endswith(said) and said.replace("safe ", "") in pages([found, checked()])


def test_several_cases_begin_with_a_line_each() -> None:
    text = pages([checked(), checked("unsafe", ("too large",), case="other")])
    last = text.splitlines()[:2]
    assert last[0].split()[:3] == ["my_case", "(best)", "safe"] and "up to scaling" in last[0]
    assert last[1].split() == ["other", "(best)", "unsafe", "too", "large"]
    assert "Check of " not in text
    assert pages([checked(), checked(case="other")], full=True).count("Check of ") == 2


def test_one_case_is_the_verdict_and_what_decides_in_few_lines() -> None:
    found = replace(checked("unsafe", ("too large",)), notes=tuple(map(stated, ["a long note of many words " * 9] * 5)))
    lines = pages([found]).splitlines()
    assert len(lines) <= 14 and lines[0].split() == ["verdict", "unsafe:", "too", "large"]
    values, said = found.metrics, " ".join(" ".join(lines).split())
    error = np.asarray(values["check.rms_error_m_s2"])
    assert f"expected error {1e3 * error.max():.3g} mm/s^2 RMS (storey {1 + error.argmax()})" in said
    assert f"largest safe scaling {float(np.asarray(values['check.largest_scaling'])):g}" in said
    assert "more left out; rths check --full prints them whole)" in said
    for word in ("spectral radius", "delay margin", "of its limit", "more: rths check --full"):
        assert word in said
    unstable = with_figure(with_figure(found, "spectral_radius", 1.2), "growth", 5.0)
    assert "the loop is unstable" in pages([unstable]) and "delay margin" not in pages([unstable])


def test_the_document_is_plain_json_with_units_and_definitions() -> None:
    found = with_figure(checked("unsafe", ("why",)), "critical_delay_s", math.inf)
    document = json.loads(json.dumps(as_document([found]), allow_nan=False))
    (case,) = document["cases"]
    assert (case["case"], case["verdict"], case["reasons"], case["warnings"]) == (
        "my_case", "unsafe", ["why"], ["a warning"],
    )  # fmt: skip
    assert case["metrics"]["check.critical_delay_s"] is None
    wanted = np.asarray(found.metrics["check.rms_error_m_s2"]).tolist()
    assert case["metrics"]["check.rms_error_m_s2"] == wanted
    assert set(case["metrics"]) == set(case["units"]) == set(case["definitions"]) == set(found.metrics)
    assert case["definitions"]["check.growth"] == METRICS["check.growth"].definition


def test_only_safe_ends_well() -> None:
    assert [checked(verdict).exit_code for verdict in ("safe", "unsafe", "unstable")] == [0, 1, 1]


def test_json_gives_code_and_values_beside_the_texts() -> None:
    fault = Finding("loop.delay", {"tolerated_s": 5e-4, "required_s": 1e-3}, ("add_damping",)).at("at.run", run="EXP")
    found = replace(checked("unsafe"), refusals=(fault,), of_guard=(Finding("guard.unplanned"),))
    (case,) = as_document([found])["cases"]
    assert case["reasons"] == [case["findings"][0]["text"]] and case["guard"] == [case["findings"][2]["text"]]
    assert [one["severity"] for one in case["findings"]] == ["refuses", "notes", "notes"]
    first = case["findings"][0]
    assert first["values"] == {"tolerated_s": 5e-4, "required_s": 1e-3} and first["advice"] == ["add_damping"]
    assert [where["values"] for where in first["within"]] == [{"run": "EXP"}]
