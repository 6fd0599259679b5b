"""Whole runs on sensors that drift and jump behind the coupling of a virtual rig, whose truth is known."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import drifting_sensor_runs
from campaigns.drifting_rig import DriftingRig
from campaigns.drifting_sensor_runs import Added, Played, faults, nothing, outcome_of, played
from portfolio import parametrize_first

from rths_cli.analysis.metrics import error_figures
from rths_cli.case.load import load_cases
from rths_cli.errors import RigError
from rths_cli.experiment import real_stage
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import key
from rths_cli.experiment.one_table_run import AFTER_S, BEFORE_S
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, open_virtual
from rths_cli.experiment.real_stage import RealStage
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.run_signals import as_read, as_stored, drift_of, expected_of, findings_of, sensitivities
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result, read_series
from rths_cli.findings import sentences
from rths_cli.loop import guard
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.realtime_run import RAMP_UP_S

COUPLED = "table.sensors.high_pass_hz=0.1"
FEEDBACK = "controller={kind: FF+FB, command_weight: 0.01}"  # not the gentler one that the design chooses at 500 Hz
MV_PER_MIN = 1e-3 / 60.0


def setup_with(name: str, *settings: str) -> Setup:
    return make_setup(load_cases([name], ("sample_rate_hz=500", *settings))[0])


def added(channel: int, offset_v: float, drift_v_per_s: float, *jumps: tuple[float, float]) -> Added:
    one = np.eye(3)[channel]
    return Added(offset_v * one, drift_v_per_s * one, tuple((channel, at, by) for at, by in jumps))


@pytest.mark.campaign
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


@pytest.mark.campaign
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
    return {name: np.asarray(value) for name, value in causes.items()}


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


@pytest.mark.campaign
def test_the_file_of_a_real_run_has_the_errors_of_the_true_floors_and_names_the_channel(
    memory: Memory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through listening, ramps, raw log and result file, on a rig that is exchanged with from Python."""
    setup = setup_with("el_centro_low_ff", COUPLED, "runs=[sim,exp_rths]")
    known, dt = memory.known(setup, lambda _: None), setup.rig.dt_s
    start = round((BEFORE_S + RAMP_UP_S) / dt) + design_blocks(setup, known.found).blocks.lead_samples
    jump = (1, start + round(30.0 / dt), -5e-3)
    rig = DriftingRig(open_virtual(setup, (EXP_RTHS,), 0), [0.0, 5e-3, 5e-3], [0.0, 0.0, 3.0 * MV_PER_MIN], [jump])
    real = replace(setup, rig=replace(setup.rig, kind="made up"), overrides=("check", "model"))
    asked = Memory(known={key(real): known})
    monkeypatch.setattr(real_stage, "open_rig", lambda *_: rig)
    stage = RealStage(lambda label, view: False)
    try:
        ended = run_case(real, tmp_path / "a.h5", asked, "rths run", lambda _: None, stage=stage)
    finally:
        stage.close()
    assert ended.status == "complete", ended.reason
    told = " ".join(ended.warnings)
    assert "channel floor_3 has an offset of" in told, told
    assert re.search(r"channel floor_2 jumps by -5\.?0?\d? mV at (30.00|29.99)", told), told
    assert "channel table" not in told and "channel floor_2 has" not in told
    result = read_result(tmp_path / "a.h5")
    assert str(result.attributes["warnings"]).count("EXP-RTHS: channel floor_3") == 1
    samples = len(setup.motion.time_s)
    accel = np.diff(np.array(rig.true_velocity_m_s).T, axis=1) / dt
    sim = read_series(tmp_path / "a.h5", "sim/abs_accel_m_s2")
    true = error_figures(
        sim[1:], accel[1:, start - 1 : start - 1 + samples], dt, result.metrics["exp_rths.high_pass_hz"]
    ).rms
    assert result.metrics["exp_rths.rms_error_m_s2"][1:] == pytest.approx(true, rel=0.05, abs=1e-4)
    drift = 1e3 * result.metrics["exp_rths.sensor_drift_v_per_min"]
    assert drift == pytest.approx([0.0, 0.0, 3.0], abs=0.1)
    taken = read_series(tmp_path / "a.h5", "exp_rths/sensor_drift_m_s2")
    assert not taken[0].any() and np.abs(taken[2, -1]) > 0.1
    shown = read_series(tmp_path / "a.h5", "exp_rths/rest/samples_v")
    clock = read_series(tmp_path / "a.h5", "exp_rths/rest/rest_time_s")
    before = clock < 0.0
    assert before.sum() == round(BEFORE_S / dt) and (~before).sum() >= round(AFTER_S / dt)
    assert clock[~before].min() > samples * dt
    assert shown[2, before].mean() == pytest.approx(5e-3, abs=3e-4)
    assert shown[2, ~before].mean() == pytest.approx(5e-3 + 3.0 * MV_PER_MIN * (clock[~before].mean() + 2.0), abs=4e-4)


@pytest.mark.campaign
def test_a_run_that_a_jump_drives_to_its_stop_names_the_jump(memory: Memory) -> None:
    """Feedback follows a table sensor that jumps until the stroke ends: what is said of the sensor is the cause."""
    setup = setup_with("hachinohe_high_ff_fb", COUPLED, FEEDBACK)
    given = added(0, 0.0, 0.0, (9.7, 80e-3))
    run = played(setup, memory, given)
    assert run.stopped_by and faults(setup, given, run) == []
    assert any("channel table jumps by 80" in line and "9.70" in line for line in run.said(setup))


class EndStop(DriftingRig):
    """A drifting rig that gives up 20 samples after its table went beyond a place; its table sensor shows the hit."""

    beyond_m = np.inf
    place_m, hits = 0.0, 0

    def exchange(self, command_v: float) -> np.ndarray:
        samples = super().exchange(command_v)
        self.place_m += self.info.dt_s * self.true_velocity_m_s[-1][0]
        self.hits += int(self.hits > 0 or abs(self.place_m) > self.beyond_m)
        if self.hits > 20:
            raise RigError("the table is at its end stop")
        return samples + self.hits * np.array([0.05, 0.0, 0.0])


@parametrize_first(
    1,
    ("given", "beyond_m", "told"),
    [
        (added(0, 0.0, 0.0, (9.7, 50e-3)), 0.06, r"table jumps by (50|49\.\d|50\.\d) mV at 9\.70"),
        (added(0, 5e-3, 500.0 * MV_PER_MIN), 0.06, r"table has an offset of .* by (500|49\d|50\d) mV/min"),
        (nothing(3), 0.01, None),
        (nothing(3), 0.02, None),
    ],
    ids=["jump", "drift", "healthy, early", "healthy, late"],
)
@pytest.mark.campaign
def test_a_run_that_the_rig_ends_names_its_drifting_sensor_and_no_healthy_one(
    memory: Memory, monkeypatch: pytest.MonkeyPatch, given: Added, beyond_m: float, told: str | None
) -> None:
    setup = setup_with("hachinohe_high_ff_fb", COUPLED, FEEDBACK)
    known = memory.known(setup, lambda _: None)
    design = verdict_on(setup, known).design
    assert design is not None
    monkeypatch.setattr(drifting_sensor_runs, "DriftingRig", EndStop)
    monkeypatch.setattr(EndStop, "beyond_m", beyond_m)
    outcome, _ = outcome_of(setup, design, given, 1)
    assert outcome.rig_fault and outcome.whole is not None and outcome.reason == guard.NONE
    blocks = design.blocks
    for ended in (outcome, replace(outcome, reason=guard.RIG_FAULT, stopped_at_s=outcome.steps * setup.rig.dt_s)):
        found = drift_of(setup, expected_of(setup, known.found, blocks), ended)
        assert found is not None and found.removed.shape[1] == outcome.whole.command_v.size - outcome.whole.first
        said = sentences(findings_of("EXP-RTHS", found, setup, blocks.lead_samples))
        assert all("channel table" in line for line in said)
        assert any(re.search(told, line) for line in said) if told else not said, said
    for reason in (guard.NOT_A_NUMBER, guard.SATURATED, guard.STUCK, guard.LOST, guard.OVERRUN, guard.OPERATOR):
        assert drift_of(setup, expected_of(setup, known.found, blocks), replace(outcome, reason=reason)) is None
    for reason in (guard.STROKE, guard.VELOCITY, guard.TRACKING, guard.ENERGY, guard.END):
        assert drift_of(setup, expected_of(setup, known.found, blocks), replace(outcome, reason=reason)) is not None


@pytest.mark.campaign
def test_what_stood_in_for_lost_samples_accuses_no_healthy_sensor(
    memory: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.3 s of one channel that show another motion, as while a target stalls: told as a drift or jump, unless they are
    known to be missing. The run ends with 2 s that are missing too, as of a target that died at rest."""
    setup = setup_with("hachinohe_high_ff_fb", COUPLED, FEEDBACK)
    known = memory.known(setup, lambda _: None)
    design = verdict_on(setup, known).design
    assert design is not None
    outcome, _ = outcome_of(setup, design, nothing(3), 1)
    assert outcome.whole is not None
    dt, whole = setup.rig.dt_s, outcome.whole
    missing, shown = np.zeros(whole.command_v.size, dtype=bool), np.zeros_like(whole.corrected)
    missing[whole.first + round(20.0 / dt) :][: round(0.3 / dt)] = True
    missing[-round(2.0 / dt) :] = True
    shown[1, missing] = 2.0
    expected = expected_of(setup, known.found, design.blocks)
    corrected = whole.corrected + run_block(expected.correction, sensitivities(setup.rig)[:, None] * shown)
    for noted, healthy in ((missing, True), (None, False)):
        found = drift_of(setup, expected, replace(outcome, whole=replace(whole, corrected=corrected, missing=noted)))
        assert found is not None
        said = sentences(findings_of("EXP-RTHS", found, setup, design.blocks.lead_samples))
        assert (said == ()) == healthy, said


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("name", "part", "value"),
    [
        ("plant", None, 3), ("plant", "A", [[1.0, 2.0]]), ("plant", "B", [[float("nan")]]),
        ("correction", "D", [[1.0]]), ("estimator", "C", "x"), ("late", None, 0), ("late", None, 1e400),
        ("change", None, None), ("total", None, "x"),
        ("late", None, 10**400), ("corner_hz", None, [0.0, 0.0]), ("corner_hz", None, [0.0, 0.0, -1.0]),
        ("v_per_m_s2", None, [1.0, 0.0, 1.0]), ("v_per_m_s2", None, "x"),
    ],
)  # fmt: skip
def test_what_a_log_expects_of_the_rig_is_read_as_it_was_written_and_refused_where_it_does_not_fit(
    memory: Memory, name: str, part: str | None, value: object
) -> None:
    setup = setup_with("hachinohe_high_ff_fb", COUPLED, FEEDBACK)
    known = memory.known(setup, lambda _: None)
    design = verdict_on(setup, known).design
    assert design is not None
    expected, command_v = expected_of(setup, known.found, design.blocks), np.sin(np.arange(200.0))
    stored = json.loads(json.dumps(as_stored(expected)))
    again = as_read(stored, len(setup.rig.channels))
    assert (again.answer(command_v) == expected.answer(command_v)).all()
    assert (again.corner_hz, again.v_per_m_s2) == (expected.corner_hz, expected.v_per_m_s2)
    earlier = as_read({key: stored[key] for key in stored if key not in ("corner_hz", "v_per_m_s2")}, 3)
    assert earlier.corner_hz is None and earlier.v_per_m_s2 is None
    if part is None:
        stored[name] = value
    else:
        stored[name][part] = value
    with pytest.raises(ValueError):
        as_read(stored, len(setup.rig.channels))
