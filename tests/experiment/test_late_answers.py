"""Late answers of a program, counted from what the step has logged."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from rths_cli.control.interface import Logged
from rths_cli.experiment.late_answers import answer_findings, answer_metrics
from rths_cli.findings import sentences


def test_each_event_counts_once() -> None:
    rows = {
        "program_extrapolated": [0, 1, 1, 0, 0, 1, 0, 0],
        "program_late_s": [0, 0, 0, 0.002, 0, 0, 0.007, 0],
        "program_slowed": [0, 1, 0, 0, 0, 0, 1, 1],
    }
    series: Any = SimpleNamespace(logs=tuple(Logged(name, "1") for name in rows), logged=np.array([*rows.values()]))
    found = answer_metrics("exp_rths", series)
    assert found == {
        "exp_rths.program_late_answers": 2,
        "exp_rths.program_slow_downs": 3,
        "exp_rths.program_extrapolations": 2,
        "exp_rths.program_latest_s": 0.007,
    }
    (told,) = sentences(answer_findings("exp_rths", "EXP-RTHS", found))
    assert "answered late 2 times, by 7 ms at most; 3 requests were left out" in told


def test_without_late_answers_nothing_is_told() -> None:
    series: Any = SimpleNamespace(
        logs=(Logged("program_extrapolated", "1"), Logged("program_late_s", "s"), Logged("program_slowed", "1")),
        logged=np.zeros((3, 5)),
    )
    assert answer_findings("exp_rths", "EXP-RTHS", answer_metrics("exp_rths", series)) == ()
    assert answer_metrics("exp_rths", SimpleNamespace(logs=(), logged=np.zeros((0, 5)))) == {}  # type: ignore[arg-type]
