"""What a single case shows beside its tables: nothing twice, nothing dropped, kinds on one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from made_up import result

from rths_cli.quantities import Interval
from rths_cli.report.case_metric_tables import other_figures
from rths_cli.report.result_tables import tables
from rths_cli.report.results_by_case import entries
from rths_cli.report.to_text import text as printed


def listed(text: str) -> dict[str, str]:
    """Return what stands behind each path."""
    lines = text[text.index("Other figures") :].splitlines()[1:]
    return {line.split()[0]: " ".join(line.split()[2:]) for line in lines if line.startswith("  ")}


def of(*results) -> str:
    (entry,) = entries(results, {})
    return printed(other_figures(entry, ()))


def by_cause(storeys: int) -> dict[str, object]:
    found: dict[str, object] = {f"check.rms_error{c}_m_s2": np.full(storeys, 1e-3) for c in ("", "_coupling", "_noise")}
    return found | {f"check.tracking_rms{c}_m_s2": 1e-3 for c in ("", "_coupling", "_noise")}


def test_an_interval_stands_behind_its_figure_with_its_probability() -> None:
    metrics = {"check.growth": 0.5, "check.delay_margin_s": 0.002, "exp_rths.rms_error_m_s2": [0.1, 0.2]}
    made = result(metrics)
    intervals = {
        "check.growth": Interval(0.5, 0.25, np.inf, 0.8),
        "check.delay_margin_s": Interval(0.002, 0.001, 0.0025, 0.999),
        "exp_rths.rms_error_m_s2": Interval([0.1, 0.2], [0.05, 0.1], [0.3, 0.4], 0.5),
    }
    text = listed(of(replace(made, units=dict(made.units) | {"check.delay_margin_s": "s"}, intervals=intervals)))
    assert text == {
        "check.growth": "0.5 [0.25, inf] (80 %)",
        "check.delay_margin_s": "2.000 [1.000, 2.500] (99 %)",
        "exp_rths.rms_error_m_s2": "0.1 [0.05, 0.3] 0.2 [0.1, 0.4] (50 %)",
    }


def test_a_predicted_error_with_an_interval_is_listed_beside_the_table_of_causes() -> None:
    made = result(by_cause(3))
    ends = Interval(np.full(3, 1e-3), np.zeros(3), np.full(3, 2e-3), 0.5)
    assert "Other figures" not in of(made)
    text = of(replace(made, intervals=dict.fromkeys(("check.rms_error_m_s2", "check.rms_error_noise_m_s2"), ends)))
    assert listed(text) == {"check.rms_error_m_s2": "0.001 [0, 0.002] 0.001 [0, 0.002] 0.001 [0, 0.002] (50 %)"}


def test_the_kinds_of_a_figure_stand_on_its_line() -> None:
    text = of(
        result(
            {
                "exp_rths.fei_amplitude": 0.99,
                "exp_rths.fei_amplitude_true": 0.98,
                "exp_rths.j2": 0.1,
                "exp_rths.j2_full": 0.2,
                "feedback.gain_margin": 5.0,
                "feedback.gain_margin_model": 6.0,
                "check.peak_command_v": 3.0,
                "check.limit_command_v": 10.0,
                "check.limit_alone": 7.0,
            }
        )
    )
    assert listed(text) == {
        "check.limit_alone": "7",
        "check.peak_command_v": "3, limit 10",
        "exp_rths.fei_amplitude": "0.99, true 0.98",
        "exp_rths.j2": "0.1, full 0.2",
        "feedback.gain_margin": "5, model 6",
    }


def test_figures_by_cause_stand_in_their_table_and_not_again() -> None:
    text = of(result(by_cause(3) | {"check.growth": 0.5, "budget.unexplained_rms_m_s2": 1e-9}))
    assert text.startswith("Error by cause")
    assert listed(text) == {"budget.unexplained_rms_m_s2": "1e-09", "check.growth": "0.5"}


def test_storeys_that_the_table_leaves_out_stay_in_the_list() -> None:
    assert "check.rms_error_noise_m_s2" in listed(of(result(by_cause(20))))


def test_two_methods_have_a_block_each_and_share_a_line() -> None:
    one, other = ({**by_cause(1), "check.growth": value} for value in (0.5, 0.25))
    text = of(result(one, method="paper"), result(other, method="best"))
    assert text.count("Error by cause") == 2 and "Method paper\n\nError" in text
    assert listed(text)["check.growth"] == "paper: 0.5 | best: 0.25"


def test_sim_delay_that_diverged_says_so_though_the_run_was_refused() -> None:
    nan = np.full(3, np.nan)
    paths = ("sim_delay.rms_error_m_s2", "sim_delay.rms_error_m_s2_full")
    text = tables([result(dict.fromkeys(paths, nan), status="refused", status_reason="why")])
    (row,) = [line for line in text.splitlines() if line.startswith("SIM-DELAY, storey 1")][:1]
    assert row.replace("|", " ").split()[-4:] == ["diverged", "-", "diverged", "-"]
    (exp,) = [line for line in text.splitlines() if line.startswith("EXP-RTHS, storey 1")][:1]
    assert "refused" in exp
