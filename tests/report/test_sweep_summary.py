"""The summary of a sweep: shares and percentiles of hand-made runs, in text and JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from rths_cli.files.sweep_file import Figure, Sweep
from rths_cli.report.sweep_page import document, page, percentiles, summary, summary_section
from rths_cli.report.to_text import text as printed

TRACKING, STOREYS, MARGIN = "exp_rths.tracking_rms_m_s2", "exp_rths.rms_error_m_s2", "check.gain_margin"
SCHEMA = Path(__file__).parents[2] / "configs" / "report.schema.json"


def made(study: str = "case: x") -> Sweep:
    """Return 101 safe runs with errors 0 to 100, and 19 of an unstable case that was refused, margins infinite."""
    runs = np.r_[np.arange(101.0), np.full(19, np.nan)]
    margin = np.r_[np.full(101, 2.0), np.full(19, np.inf)]
    about = {
        "case_name": "x", "rig": "r", "rig_kind": "virtual", "seeds": "0:0", "status": "complete", "plan_sha256": "0",
    }  # fmt: skip
    texts = {
        "status": ("complete",) * 101 + ("refused",) * 19,
        "verdict": ("safe",) * 101 + ("unstable",) * 19,
        "reason": ("",) * 120,
    }
    figures = {
        TRACKING: Figure(runs, "m/s^2", "t"),
        STOREYS: Figure(np.outer(runs, [1.0, 10.0]), "m/s^2", "s"),
        MARGIN: Figure(margin, "1", "m"),
    }
    return Sweep(about, "", "", 1, {}, np.zeros(120, dtype=np.int64), texts, figures, study)


def test_shares_count_all_runs_and_percentiles_those_that_have_the_metric() -> None:
    found = summary(made())
    assert found["statuses"] == {
        "complete": {"runs": 101, "share": 101 / 120},
        "refused": {"runs": 19, "share": 19 / 120},
    }
    assert found["verdicts"]["unstable"]["share"] == 19 / 120
    assert found["metrics"][TRACKING] == {
        "units": "m/s^2",
        "runs": 101,
        "percentiles": {"5": 5.0, "16": 16.0, "50": 50.0, "84": 84.0, "95": 95.0},
    }
    assert found["metrics"][STOREYS]["percentiles"]["84"] == pytest.approx([84.0, 840.0])
    assert found["metrics"][STOREYS]["runs"] == [101, 101]
    assert list(found["metrics"][MARGIN]["percentiles"].values()) == [2.0, 2.0, 2.0, 2.0, None]  # infinite


def test_small_percentiles_have_three_digits() -> None:
    small = made().figures | {TRACKING: Figure(made().figures[TRACKING].values / 3e5, "m/s^2", "t")}
    rows = [
        line.replace("|", " ").split()
        for line in printed([summary_section(replace(made(), figures=small))]).splitlines()
    ]
    assert [TRACKING, "1.67e-05", "5.33e-05", "0.000167", "0.000280", "0.000317"] in rows


def test_no_run_with_the_metric_gives_none() -> None:
    assert np.isnan(percentiles(np.full((3, 2), np.nan))).all()


def test_the_document_is_of_the_schema() -> None:
    schema = json.loads(SCHEMA.read_text())
    told = json.loads(json.dumps(document(made(), Path("x.h5"))["summary"], allow_nan=False))
    jsonschema.Draft202012Validator({**schema["$defs"]["summary"], "$defs": schema["$defs"]}).validate(told)


def test_the_text_of_a_study_has_shares_and_percentiles() -> None:
    text = page(made(), Path("x.h5"))
    assert "Of 120 runs: 101 complete (84.2 %), 19 refused (15.8 %)." in text
    assert "Verdict of the check: 101 safe (84.2 %), 19 unstable (15.8 %)." in text
    rows = [line.replace("|", " ").split() for line in text.splitlines()]
    assert [f"{STOREYS}[2]", "50.000", "160.00", "500.00", "840.00", "950.00"] in rows
    assert [MARGIN, "2.0000", "2.0000", "2.0000", "2.0000", "-"] in rows
    assert max(len(line) for line in text.splitlines()) <= 100


def test_a_sweep_without_a_study_prints_none() -> None:
    assert summary_section(made("")) == []
