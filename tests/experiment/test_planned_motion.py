"""The guard's limits of a run: set to the motion that it needs, so that no faulty sensor drives the table far, what
grows is stopped while it is small, and no healthy run is stopped (benchmarks/sensor_faults_at_peak.py)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from campaigns.sensor_faults import BOTH, Ended, faulty_runs, healthy, planned, played
from portfolio import keep_first, parametrize_first

from rths_cli.case.load import load_cases
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, SHAKE_TABLE_TEST, RunKind, RunPlan
from rths_cli.experiment.planned_motion import PlannedMotion, effective_limits, foreseen_causes, guard_findings
from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.findings import sentences
from rths_cli.identification.results import Identification
from rths_cli.loop.guard import ACCELERATION, COMMAND, STROKE, TRACKING

DT_S, RECORD_S, PEAK_M_S2 = 0.005, 8.0, 0.9
Made = tuple[Setup, Identification, Design]
Make = Callable[..., Made]


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory, memory: Memory) -> Make:
    """Return a maker of short tests of the paper's building at 500 Hz, with settings as of `--set`."""
    path = tmp_path_factory.mktemp("records") / "bursts.csv"
    time = np.arange(0.0, RECORD_S, DT_S)
    bursts = np.sin(2.0 * np.pi * 2.2 * time) * np.sin(np.pi * time / RECORD_S) ** 2 + 0.3 * np.sin(11.0 * time)
    accel = PEAK_M_S2 * bursts * np.tanh(time) * np.tanh(RECORD_S - time)
    rows = "\n".join(f"{t:.4f},{a:.8f}" for t, a in zip(time, accel, strict=True))
    path.write_text(f"time_s,accel_m_s2\n{rows}\n")

    def made(*settings: str) -> Made:
        whole = (f"record={path}", "scaling=1", "sample_rate_hz=500", *settings)
        setup = make_setup(load_cases(["el_centro_low_ff_fb"], whole)[0])
        found = memory.identify(setup, lambda _: None)
        return setup, found, design_blocks(setup, found)

    return made


@pytest.fixture(scope="module")
def usual(make: Make) -> Made:
    return make()


@pytest.mark.campaign
@parametrize_first(
    1,
    ("kind", "settings"),
    [
        *((kind, one) for kind in BOTH for one in ((), ("controller=FF",), ("table.converters.bits=9",))),
        (SHAKE_TABLE_TEST, ("controller=none",)),  # without a controller this hybrid loop does not settle
        (SHAKE_TABLE_TEST, ("controller={kind: predictive_adaptive}", "table.converters.bits=9", "scaling=0.2")),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_no_healthy_run_is_stopped(make: Make, settings: tuple[str, ...], kind: RunKind) -> None:
    stopped, _, _ = healthy(planned(*make(*settings), kind))
    assert stopped == ""


@pytest.fixture(scope="module", params=keep_first(1, BOTH), ids=lambda kind: kind.name)
def ends(request: pytest.FixtureRequest, usual: Made) -> list[Ended]:
    plan = planned(*usual, request.param)
    _, samples_v, place_m = healthy(plan)
    return list(faulty_runs(plan, samples_v, place_m))


def test_a_sensor_that_fails_at_the_peak_leaves_the_table_near_its_motion(ends: list[Ended]) -> None:
    assert [one for one in ends if not one.stays] == []
    assert [one for one in ends if not one.rests] == []


def test_a_sensor_that_fails_is_named_and_no_other(ends: list[Ended]) -> None:
    assert [(one.kind, one.channel, one.sentence) for one in ends if one.named in ("false", "none")] == []


def unstable(plan: RunPlan, factor: float) -> RunPlan:
    """Return a plan whose feedback is louder than that of which its limits are."""
    blocks = plan.design.blocks
    louder = replace(blocks.feedback, C=factor * blocks.feedback.C, D=factor * blocks.feedback.D)
    return replace(plan, design=replace(plan.design, blocks=replace(blocks, feedback=louder)))


@pytest.mark.campaign
def test_an_oscillation_that_grows_is_stopped_while_it_is_in_proportion_to_the_test(usual: Made) -> None:
    plan = planned(*usual, SHAKE_TABLE_TEST)
    _, samples_v, place_m = healthy(plan)
    tried = (played(unstable(plan, factor)) for factor in (3.0, 4.5, 7.0, 10.0, 15.0, 22.0, 33.0))
    outcome, rig = next((outcome, rig) for outcome, rig in tried if not outcome.played)
    assert not outcome.played
    assert np.abs(rig.place_m).max() <= 1.5 * np.abs(place_m).max()
    assert outcome.reason in (TRACKING, ACCELERATION)
    seen, usually = (np.abs(np.array(one)[:, 0]).max() for one in (rig.samples, samples_v.T))
    assert seen <= 3.0 * usually
    assert "channel floor" not in outcome.stopped_by_limit


@pytest.mark.campaign
def test_no_limit_of_the_rig_file_is_raised_and_the_lower_ones_are_told(usual: Made) -> None:
    setup, _, _ = usual
    own = replace(setup, rig=replace(setup.rig, limits=replace(setup.rig.limits, tracking_error_m_s2=3.0)))
    needs = PlannedMotion(8.7e-3, 8.8e-3, 1e-3, np.array([0.8, 1.2, 1.6]), 0.8, 0.05, "")
    limits = effective_limits(guard_limits(own), needs)
    assert limits.tracking_error < 0.8  # of a demand of 0.8: what a dead sensor shows
    assert 8.8e-3 < limits.reach_m < 1.5 * 8.7e-3
    assert np.all(limits.abort > needs.accel_m_s2)
    told = " ".join(sentences(guard_findings(own, "EXP-RTHS", needs)))
    assert "tracking_error_m_s2 3 m/s^2" in told and "stroke_m 0.079 m" in told
    loud = replace(needs, accel_m_s2=np.full(3, 44.0), tracking_error_m_s2=10.0)
    assert np.all(effective_limits(guard_limits(own), loud).abort <= 45.0)
    assert effective_limits(guard_limits(own), loud).tracking_error == 3.0
    assert effective_limits(limits, None) is limits


def test_a_command_out_of_range_that_was_foreseen_accuses_no_sensor(usual: Made) -> None:
    limits = guard_limits(usual[0])
    needs = PlannedMotion(8.7e-3, 8.8e-3, 1e-3, np.array([0.8, 1.2, 1.6]), 0.8, 0.05, "")
    assert foreseen_causes(limits, needs) == {}
    grows = foreseen_causes(limits, replace(needs, predicted=False))
    assert "it does not settle either" in grows[COMMAND].what and TRACKING in grows
    far = foreseen_causes(limits, replace(needs, reach_m=0.1))
    assert "predicted to need 100 mm" in far[STROKE].what and TRACKING not in far
    deaf = foreseen_causes(limits, replace(needs, listens=False))
    assert "no sensor takes part" in deaf[COMMAND].what and TRACKING not in deaf
    for one in (*grows.values(), *far.values(), *deaf.values()):
        assert "channel" not in one.what and "cable" not in one.advice
    assert planned(*usual, HYBRID_TEST).foreseen == {}
