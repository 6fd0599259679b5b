"""Errors over time are those that the RMS beside them is of: without drift, in the test band."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rths_cli.analysis.metrics import error_figures
from rths_cli.files.result_reader import Result
from rths_cli.numerics.lti import Array
from rths_cli.report.figures.figure_data import Source
from rths_cli.report.figures.histories import error_panel
from rths_cli.report.filtered_errors import evaluated_error
from rths_cli.report.page import histories

DT = 0.002
TIME = DT * np.arange(20000)
FAST = 0.02 * np.sin(2.0 * np.pi * 3.0 * TIME)
DRIFTING = FAST + 0.3 + 0.01 * TIME + 0.1 * np.sin(2.0 * np.pi * 0.01 * TIME)


def result_with(metrics: dict[str, float]) -> Result:
    return Result(Path("a.h5"), {"sample_rate_hz": 1.0 / DT}, "", "", dict(metrics), {}, {}, ("exp_rths",))


def middle(values: Array) -> Array:
    return values[5000:15000]


def test_drift_is_left_out_and_motion_stays() -> None:
    shown = evaluated_error(result_with({"exp_rths.high_pass_hz": 0.1}), "exp_rths", DRIFTING, DT)
    np.testing.assert_allclose(middle(shown), middle(FAST), atol=2e-4)
    whole = evaluated_error(result_with({}), "exp_rths", DRIFTING, DT)
    np.testing.assert_allclose(middle(whole), middle(DRIFTING), atol=2e-4)


def test_its_rms_is_the_one_in_the_file() -> None:
    shown = evaluated_error(result_with({"exp_rths.high_pass_hz": 0.1}), "exp_rths", DRIFTING, DT)
    assert np.sqrt(np.mean(shown**2)) == pytest.approx(error_figures(DRIFTING, 0.0 * TIME, DT, 0.1).rms, rel=1e-3)


def test_the_figure_and_the_page_draw_it() -> None:
    result = result_with({"exp_rths.high_pass_hz": 0.1})
    panel = error_panel(Source(result), "an error", "exp_rths", TIME, DRIFTING, "")
    np.testing.assert_allclose(middle(panel.lines[0].values), 1e3 * middle(FAST), atol=0.2)
    trace = histories.error_trace(result, "exp_rths", {"sim": DRIFTING, "exp_rths": 0.0 * TIME}, TIME)
    np.testing.assert_allclose(middle(trace.values), 1e3 * middle(FAST), atol=0.2)


@pytest.mark.parametrize("samples", [0, 1, 2, 3, 40, 900])
def test_a_short_error_has_its_length(samples: int) -> None:
    shown = evaluated_error(result_with({"exp_rths.high_pass_hz": 0.1}), "exp_rths", DRIFTING[:samples], DT)
    assert shown.shape == (samples,) and np.isfinite(shown).all() == (samples != 1)
