"""The table of errors by cause, read back."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.report.case_metric_tables import CAUSES, budget
from rths_cli.report.to_text import text as printed

FITTED = {"budget.table_gain_error": 0.00123, "budget.table_delay_error_s": -4.2e-6, "budget.friction_v": 2.35e-4}


def figures(kind: str, storeys: int, seed: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    found = {f"{kind}.rms_error_{cause}_m_s2": random.uniform(1e-5, 1e-1, storeys) for cause in CAUSES}
    return found | {f"{kind}.tracking_rms_{cause}_m_s2": random.uniform(1e-5, 1e-1) for cause in CAUSES}


def rows(text: str) -> dict[str, list[str]]:
    """Return the cells of each row by its label."""
    return {
        label: line.partition("|")[2].replace("|", " ").split()
        for label in CAUSES.values()
        for line in text.splitlines()
        if line.startswith(label)
    }


def test_no_figures_no_table() -> None:
    assert budget({"exp_rths.rms_error_m_s2": [1.0]}) == []


@pytest.mark.parametrize("kinds", [("check",), ("budget",), ("check", "budget")])
def test_every_figure_stands_in_its_place(kinds: tuple[str, ...]) -> None:
    metrics = {path: value for seed, kind in enumerate(kinds) for path, value in figures(kind, 3, seed).items()}
    text = printed([budget(metrics | FITTED)])
    assert max(len(line) for line in text.splitlines()) <= 100
    found = rows(text)
    for cause, label in CAUSES.items():
        wanted = [1e3 * metrics[f"{kind}.tracking_rms_{cause}_m_s2"] for kind in kinds]
        for storey in range(3):
            wanted += [1e3 * metrics[f"{kind}.rms_error_{cause}_m_s2"][storey] for kind in kinds]
        assert [float(cell) for cell in found[label]] == pytest.approx(wanted, abs=5.1e-4)


def test_the_whole_error_measured_is_the_runs_own() -> None:
    metrics = figures("budget", 1, 0) | FITTED | figures("check", 1, 1)
    metrics |= {"exp_rths.rms_error_m_s2": np.array([0.02]), "exp_rths.tracking_rms_m_s2": 0.004}
    metrics |= {"check.rms_error_m_s2": np.array([0.03]), "check.tracking_rms_m_s2": 0.005}
    together = next(line for line in printed([budget(metrics)]).splitlines() if line.startswith("together"))
    assert together.replace("|", " ").split()[1:] == ["5.000", "4.000", "30.000", "20.000"]


def test_a_cause_that_one_side_does_not_know_is_a_dash_and_one_that_none_knows_is_not_there() -> None:
    metrics = {"check.rms_error_coupling_m_s2": np.array([1e-3]), "budget.rms_error_coupling_m_s2": np.array([2e-3])}
    metrics |= {"check.rms_error_noise_m_s2": np.array([3e-3])} | FITTED
    found = rows(printed([budget(metrics)]))
    assert set(found) == {"coupling", "sensor noise"}
    assert found["sensor noise"] == ["-", "-", "3.000", "-"]


def test_many_storeys_leave_out_the_middle_ones() -> None:
    text = printed([budget(figures("check", 20, 0) | figures("budget", 20, 1) | FITTED)])
    assert "storey 1|" in text and "storey 20" in text and "storey 9" not in text
    assert max(len(line) for line in text.splitlines()) <= 100


def test_what_the_run_says_of_the_table_is_said() -> None:
    text = printed([budget(figures("budget", 1, 0) | FITTED)])
    assert "gain +0.123 %" in text and "delay -4.2 microseconds" in text and "0.235 mV" in text


def test_a_figure_stands_with_two_standard_uncertainties_and_one_below_them_is_not_named() -> None:
    offs = {
        "budget.table_gain_error_uncertainty": 0.0002,
        "budget.table_delay_error_uncertainty_s": 2.2e-6,
        "budget.friction_uncertainty_v": 1e-5,
    }
    text = " ".join(printed([budget(figures("budget", 1, 0) | FITTED | offs)]).split())
    assert "gain +0.123 +- 0.04 %" in text and "0.235 +- 0.02 mV" in text
    assert "delay not significant (within +-4.4 microseconds)" in text and "-4.2" not in text
    assert "Not significant: the uncertainty (two standard ones) is larger than the figure" in text
    whole = {path: value for path, value in figures("budget", 1, 0).items() if "_lost_" not in path}
    assert "the record does not say more" in " ".join(printed([budget(whole | FITTED | offs)]).split())
    sure = offs | {"budget.table_delay_error_uncertainty_s": 1e-6}
    assert "not significant" not in printed([budget(figures("budget", 1, 0) | FITTED | sure)]).lower()
