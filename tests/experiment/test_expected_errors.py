"""Measured beside expected errors: what is told, and what not."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.true_error import TrueError
from rths_cli.experiment.true_reference import disagreement, expected_error_metrics
from rths_cli.findings import sentences


def values(measured: list[float], expected: list[float], percent: float = 2.0) -> dict[str, object]:
    found: dict[str, object] = {
        "check.expected_error_m_s2": np.array(expected),
        "exp_rths.rms_error_m_s2": np.array(measured),
        "exp_rths.nrmse_percent": percent * np.array(measured) / max(measured),
    }
    return found | dict(expected_error_metrics(None, found))


def test_what_the_check_expected_is_not_told_again() -> None:
    assert disagreement(values([0.010, 0.020], [0.0069, 0.0295])) == ()
    assert disagreement(values([0.010, 0.020], [0.001, 0.002], percent=0.4)) == ()
    assert disagreement({}) == ()


def test_the_storey_that_is_farthest_off_is_told() -> None:
    (said,) = sentences(disagreement(values([0.010, 0.020], [0.005, 0.005])))
    assert said.startswith("measured and expected error differ: 20 mm/s^2 at storey 2 is 4 times") and "causes" in said
    (said,) = sentences(disagreement(values([0.010, 0.020], [0.025, 0.020])))
    assert "10 mm/s^2 at storey 1 is 0.4 times" in said and "more careful" in said


def test_the_rank_of_a_true_error_is_its_probability() -> None:
    drawn = np.column_stack([np.arange(1000.0), 2.0 * np.arange(1000.0)])
    predicted = TrueError(*(np.zeros(2) for _ in range(3)), None, drawn)
    found = expected_error_metrics(predicted, {"exp_rths.true_reference_rms_error_m_s2": np.array([250.0, 250.0])})
    assert np.asarray(found["exp_rths.true_error_rank"]) == pytest.approx([0.25, 0.125])
