"""A run of a sweep is played without what only watches it: the same signals to the last bit, and the same stops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.experiment.one_table_run import RunPlan, play_run
from rths_cli.loop.guard import STUCK, TRACKING
from rths_cli.loop.run_log import Sizes, empty_log
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.studies.grid_points import check_points
from rths_cli.studies.study_plan import Asked
from rths_cli.studies.sweep_runs import Shared

CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: FF+FB\n"
SEED = 7
REST = 80  # samples of the record before it moves, 0.8 s
QUIET = "table.sensors.noise_rms_m_s2=0"


def planned(folder: Path, *settings: str) -> RunPlan:
    time_s = np.arange(0.0, 3.5, 0.01)
    accel = 1.5 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / 3.5) ** 2
    lines = "\n".join(f"{a:.6f}" for a in (*np.zeros(REST), *accel))
    (folder / "short.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{lines}\n")
    (folder / "a.yaml").write_text(CASE)
    shared = Shared(("check",), lambda _: None)
    asked = Asked(str(folder / "a.yaml"), settings, (), None)
    plan = shared.ready(check_points(asked, shared, lambda _: None).case(0)).plan
    assert plan is not None
    return plan


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> RunPlan:
    return planned(tmp_path_factory.mktemp("lean"))


def lean(plan: RunPlan) -> Outcome:
    channels = len(plan.setup.rig.channels)
    return play_run(plan, SEED, empty_log(len(plan.drive), Sizes(channels, 1), lean=True, truths=channels))


def assert_alike(lean: Outcome, full: Outcome) -> None:
    assert (lean.reason, lean.stopped_at_s, lean.steps) == (full.reason, full.stopped_at_s, full.steps)
    assert (lean.played, lean.rig_fault) == (full.played, full.rig_fault)
    done = slice(0, full.steps)
    for name in ("true_velocity_m_s", "corrected", "desired"):
        ours, theirs = getattr(lean.log, name), getattr(full.log, name)
        assert ours[:, done].tobytes() == theirs[: len(ours), done].tobytes(), name


@pytest.mark.campaign
def test_a_lean_run_has_the_signals_of_a_full_one(plan: RunPlan) -> None:
    full = play_run(plan, SEED)
    assert full.played
    assert_alike(lean(plan), full)


def test_a_lean_run_that_a_limit_stops_is_stopped_as_a_full_one(plan: RunPlan) -> None:
    tight = replace(plan, limits=plan.limits._replace(tracking_error=0.03))
    full = play_run(tight, SEED)
    assert full.reason == TRACKING and not full.played
    assert_alike(lean(tight), full)
    assert lean(tight).stopped_by_limit == full.stopped_by_limit


@pytest.mark.campaign
def test_channels_that_rest_are_judged_by_what_they_should_show(tmp_path: Path) -> None:
    """Without noise every channel keeps its code while the table rests: no reason to stop."""
    quiet = planned(tmp_path, QUIET)
    full = play_run(quiet, SEED)
    assert full.played and not np.ptp(full.log.corrected[:, : round(0.7 / quiet.setup.rig.dt_s)])
    assert_alike(lean(quiet), full)


@pytest.mark.campaign
def test_a_stuck_channel_stops_a_lean_run_as_a_full_one(tmp_path: Path) -> None:
    """A converter of few bits keeps its code while the table moves."""
    coarse = planned(tmp_path, QUIET, "table.converters.bits=11")
    coarse = replace(coarse, limits=coarse.limits._replace(stuck=np.full_like(coarse.limits.stuck, 1e-4)))
    full = play_run(coarse, SEED)
    assert full.reason == STUCK and full.stopped_at_s > 0.5
    assert_alike(lean(coarse), full)
