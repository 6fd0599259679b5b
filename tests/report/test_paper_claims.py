"""The paper's claims: numbers chosen so that each claim is known to hold, to fail, or to be open."""

import math

from made_up import HIGH, LOW, figures, paper_cases, result

from rths_cli.report.paper_tables import CLAIMS, HELD, NOT_HELD, UNJUDGED, claims_lines, judge
from rths_cli.report.results_by_case import entries
from rths_cli.report.to_text import text as printed

TRACKS, DELAY, DAMPING, PEAK = CLAIMS


def verdicts(claim, results, suffix=""):
    found = judge(claim, entries(results, {}), suffix)
    return {(verdict.source, verdict.where): (verdict.verdict, verdict.because) for verdict in found}


def test_all_claims_hold_for_numbers_made_to_hold():
    cases = paper_cases()
    for claim, count in ((TRACKS, 4 + 1), (DELAY, 8 + 2), (DAMPING, 4 + 1), (PEAK, 4 + 1)):
        found = verdicts(claim, cases)
        assert len(found) == count
        assert {verdict for verdict, _ in found.values()} == {HELD}


def test_the_numbers_compared_are_told():
    cases = paper_cases()
    low = "30 % el_centro, low"
    assert verdicts(TRACKS, cases)["best", low][1] == "shake table test 0.0006 < 0.0012; RTHS 0.0007 < 0.0013"
    assert verdicts(TRACKS, cases)["published", low][1] == "shake table test 0.0004 < 0.0030; RTHS 0.0027 < 0.0058"
    assert verdicts(PEAK, cases)["published", low][1] == "0.1007 < 0.1922"
    assert (
        verdicts(DELAY, cases)["paper", f"{low}, FF+FB"][1]
        == "1: 0.0016 < 0.0800; 2: 0.0024 < 0.1200; 3: 0.0032 < 0.1600"
    )
    where = "30 % el_centro, FF+FB: high against low"
    assert (
        verdicts(DAMPING, cases)["published", where][1] == "1: 0.0023 < 0.0158; 2: 0.0428 < 0.0466; 3: 0.0500 < 0.0615"
    )


def test_one_figure_the_wrong_way_turns_only_its_own_verdict():
    changes = {
        "exp_rths.tracking_rms_m_s2": (0.0014, {TRACKS}),
        "shake_table.tracking_rms_m_s2": (0.0012, {TRACKS}),
        "exp_rths.tracking_max_m_s2": (0.0090, {PEAK}),
        "exp_rths.rms_error_m_s2": ([0.0008, 0.1200, 0.0016], {DELAY}),
    }
    for path, (value, claims) in changes.items():
        cases = paper_cases()
        cases[5].metrics[path] = value  # best, low, FF+FB
        for claim in CLAIMS:
            turned = [key for key, (verdict, _) in verdicts(claim, cases).items() if verdict != HELD]
            assert [source for source, _ in turned] == (["best"] if claim in claims else []), (path, claim.text)
            assert all("el_centro, low" in where for _, where in turned)
    cases[7].metrics["exp_rths.rms_error_m_s2"] = [0.0009, 0.0005, 0.0005]  # best, high: storey 1 above low's
    assert verdicts(DAMPING, cases)["best", "30 % el_centro, FF+FB: high against low"][0] == NOT_HELD


def test_a_missing_result_is_named():
    cases = paper_cases()
    aborted = cases[5]
    aborted.attributes["status"] = "aborted"
    found = verdicts(TRACKS, cases)
    assert found["best", "30 % el_centro, low"] == (UNJUDGED, "FF+FB aborted")
    assert found["paper", "30 % el_centro, low"][0] == HELD
    assert verdicts(DELAY, cases)["best", "30 % el_centro, low, FF+FB"][0] == UNJUDGED
    assert verdicts(DAMPING, cases)["best", "30 % el_centro, FF+FB: high against low"] == (UNJUDGED, "low aborted")
    del cases[4]  # best, low, FF
    assert verdicts(PEAK, cases)["best", "30 % el_centro, low"] == (UNJUDGED, "FF was not run; FF+FB aborted")
    only = [one for one in paper_cases() if one.attributes["damping_name"] == "low"]
    assert verdicts(DAMPING, only)["best", "30 % el_centro, FF"] == (UNJUDGED, "another damping level was not run")


def test_a_diverged_sim_delay_and_an_absent_figure_leave_the_claim_open():
    cases = [result(figures((0.1,) * 4, (math.nan,) * 3, LOW))]
    assert verdicts(DELAY, cases)["best", "30 % el_centro, low, FF+FB"] == (UNJUDGED, "SIM-DELAY diverged")
    del cases[0].metrics["exp_rths.rms_error_m_s2"]
    cases[0].metrics["sim_delay.rms_error_m_s2"] = LOW
    assert verdicts(DELAY, cases)["best", "30 % el_centro, low, FF+FB"][1] == "EXP-RTHS has no such figure"


def test_damping_levels_are_ordered_by_ratio_and_unknown_ones_not_judged():
    def cases(**ratios):
        named = {"a": LOW, "b": HIGH}
        return [
            result(figures((0.1,) * 4, LOW, named[k]), damping=k, controller="FF", damping_first_mode_ratio=r)
            for k, r in ratios.items()
        ]

    assert verdicts(DAMPING, cases(a=0.02, b=0.03))["best", "30 % el_centro, FF: b against a"][0] == HELD
    assert verdicts(DAMPING, cases(a=0.03, b=0.02))["best", "30 % el_centro, FF: a against b"][0] == NOT_HELD
    unknown = verdicts(DAMPING, cases(a=0.02, b=""))
    assert unknown == {("best", "30 % el_centro, FF"): (UNJUDGED, "the ratio of damping b is not known")}


def test_true_figures_that_turn_a_verdict_are_told():
    text = printed([claims_lines(entries(paper_cases(), {}))])
    assert "1. FF+FB tracks better than FF (RMS tracking error): published held 1 of 1; paper held 2 of 2;" in text
    assert "another verdict" not in text
    cases = paper_cases()
    cases[5].metrics["exp_rths.rms_error_m_s2_true"] = [0.0007, 0.0011, 0.1700]
    lines = printed([claims_lines(entries(cases, {}))]).splitlines()
    told = lines[lines.index("Where true figures give another verdict than measured ones:") + 1 :]
    assert told == [
        "  2. 30 % el_centro, low, FF+FB",
        "    not held          best       1: 0.0007 < 0.0800; 2: 0.0011 < 0.1200; 3: 0.1700 >= 0.1600",
    ]


def test_a_method_that_was_not_run_is_told_once():
    text = printed([claims_lines(entries([one for one in paper_cases() if one.attributes["method"] == "best"], {}))])
    assert text.count("Method paper was not run") == 1 and "    held              paper" not in text
