"""Whole runs on sensors that drift and jump behind the coupling of a virtual rig, whose truth is known."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.workflows.known import Memory
from rths_cli.workflows.lowest_frequency import lowest_reliable_hz
from rths_cli.workflows.setup import Setup, make_setup

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from drifting_sensors import Added, Played, faults, nothing, played

COUPLED = "table.sensors.high_pass_hz=0.1"
MV_PER_MIN = 1e-3 / 60.0


def setup_with(name: str, *settings: str) -> Setup:
    return make_setup(load_cases([name], ("sample_rate_hz=500", *settings))[0])


def added(channel: int, offset_v: float, drift_v_per_s: float, *jumps: tuple[float, float]) -> Added:
    one = np.eye(3)[channel]
    return Added(offset_v * one, drift_v_per_s * one, tuple((channel, at, by) for at, by in jumps))


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("el_centro_low_ff_fb", added(2, 5e-3, 2.0 * MV_PER_MIN)),
        ("hachinohe_low_ff", added(0, -5e-3, 0.5 * MV_PER_MIN, (9.7, -5e-3))),
        ("hachinohe_high_ff_fb", added(1, 5e-3, -5.0 * MV_PER_MIN, (17.3, 5e-3))),
        ("el_centro_low_ff", nothing(3)),
    ],
)
def test_errors_are_those_of_the_true_floors_and_the_channel_is_named(memory: Memory, name: str, given: Added) -> None:
    setup = setup_with(name, COUPLED)
    run = played(setup, memory, given)
    assert faults(setup, given, run) == []
    said = run.said(setup)
    for channel, one in enumerate(setup.rig.channels):
        drifts, jumps = bool(given.drift_v_per_s[channel]), [jump for jump in given.jumps if jump[0] == channel]
        assert any(f"channel {one.name} has an offset" in line and "mV/min" in line for line in said) >= drifts
        assert any(f"channel {one.name} jumps by" in line for line in said) == bool(jumps)
    if not (given.offset_v.any() or given.jumps):
        assert said == [] and not run.found.any


def test_the_budget_puts_drift_on_the_sensors_and_not_on_the_specimen(memory: Memory) -> None:
    setup = setup_with("el_centro_low_ff_fb", COUPLED)
    clean = budget_of(played(setup, memory, nothing(3)))
    found = budget_of(played(setup, memory, added(2, 5e-3, 2.0 * MV_PER_MIN)))
    assert "drift" not in clean and found["drift"].max() < 2e-3
    for cause in ("specimen", "friction", "model", "rest"):
        assert found[cause] == pytest.approx(clean[cause], rel=0.1, abs=1e-4)
    assert found["unexplained"].max() < 1e-5


def budget_of(run: Played) -> dict[str, np.ndarray]:
    """Return the errors (n_storeys,) of a run by cause."""
    prefix = "budget.rms_error_"
    causes = {path.removeprefix(prefix).removesuffix("_m_s2"): m for path, m in run.budget.items() if prefix in path}
    causes["unexplained"] = run.budget["budget.unexplained_rms_m_s2"]
    return {name: np.asarray(metric.value) for name, metric in causes.items()}


def test_the_lowest_frequency_follows_filter_coupling_and_length() -> None:
    setup = setup_with("el_centro_low_ff_fb")
    assert lowest_reliable_hz(setup) == 0.1
    assert lowest_reliable_hz(setup_with("el_centro_low_ff_fb", "record_filter={corner_hz: 0.1}")) == pytest.approx(
        0.04
    )
    assert lowest_reliable_hz(setup_with("el_centro_low_ff_fb", "record_filter={corner_hz: 2.0}")) == 0.1
    coupled = setup_with("el_centro_low_ff_fb", "table.sensors.high_pass_hz=0.6")
    assert lowest_reliable_hz(coupled) == pytest.approx(0.2)
    short = replace(setup, motion=replace(setup.motion, time_s=setup.motion.time_s[:4000]))
    assert lowest_reliable_hz(short) == pytest.approx(0.125)
