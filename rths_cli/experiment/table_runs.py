"""The runs of a case on its table: what is played, where, and how each one ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rths_cli.experiment import budget_metrics, dropout_counts, result_contents, run_metrics, sensor_drift_report
from rths_cli.experiment.lowest_frequency import lowest_reliable_hz
from rths_cli.experiment.rig_access import EXP_RTHS, SHAKE_TABLE, guard_limits, open_rig
from rths_cli.experiment.run_series import Series, on_record_clock, whole_building, without_drift
from rths_cli.experiment.sensor_drift_report import Expected, drift_of, expected_of
from rths_cli.experiment.setup import Progress, Setup, shown
from rths_cli.files.result_reader import BEGUN, COMPLETE
from rths_cli.interrupts import interruptible
from rths_cli.loop import guard
from rths_cli.loop.counted_clock import Outcome, Stillness, play
from rths_cli.loop.realtime_run import way_to_rest_s
from rths_cli.loop.step_arrays import NUMERICAL, RECORD

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.experiment.check_cases import Verdict
    from rths_cli.experiment.design import Design
    from rths_cli.files.result_reader import ResultWriter
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Array

BEFORE_S, AFTER_S = 1.0, 3.0  # in which the table is watched at rest before and after each run
INTERRUPTIONS = {guard.INTERRUPT: 130, guard.TERMINATION: 143}  # exit codes of orders that came by signals


@dataclass(frozen=True)
class Stop:
    """Why a run ended early: the status of its file and the exit code that goes with it."""

    status: str
    reason: str
    exit_code: int


@dataclass(frozen=True)
class Played:
    """What came of the table runs of a case: what stopped one first (None: nothing did), their metrics, and sentences
    for the user; `late`: what ended a run after its record was whole (None: nothing did); `remarks` on metrics."""

    stop: Stop | None
    values: dict[str, ArrayLike]
    said: tuple[str, ...] = ()
    late: Stop | None = None
    remarks: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TableRun:
    """One kind of run on the table: its group in the result, source of the desired motion, noise stream, label."""

    name: str
    source: int
    stream: int
    label: str


TABLE_RUNS = (
    TableRun("shake_table", RECORD, SHAKE_TABLE, "shake-table test"),
    TableRun("exp_rths", NUMERICAL, EXP_RTHS, "EXP-RTHS"),
)


class Stage(Protocol):
    """Where the runs of a case are played."""

    def play(self, setup: Setup, design: Design, expected: Expected, run: TableRun, writer: ResultWriter) -> Outcome:
        """Play one run, whose channels are compared with what is expected; the result file may be closed meanwhile."""

    def written(self) -> None:
        """Take note that the result file holds everything that was played."""


class VirtualStage:
    """Plays on virtual rigs, in no time."""

    def play(self, setup: Setup, design: Design, expected: Expected, run: TableRun, writer: ResultWriter) -> Outcome:
        """Play one run."""
        return play_run(setup, design, run.source, run.stream)

    def written(self) -> None:
        """Do nothing: nothing was kept elsewhere."""


def play_all(
    setup: Setup,
    identified: Identification,
    checked: Verdict,
    design: Design,
    sim: Response,
    writer: ResultWriter,
    progress: Progress,
    stage: Stage,
) -> Played:
    """Play the table runs of the case and write them."""
    stop: Stop | None = None
    late: Stop | None = None
    values: dict[str, ArrayLike] = {}
    said: list[str] = []
    remarks: dict[str, str] = {}
    for run in TABLE_RUNS:
        if run.name not in setup.case.runs or (stop is not None and setup.rig.can.moves_hardware):
            continue
        if run.source == NUMERICAL and (refusal := refusal_of(setup, checked)):
            _note(writer, run.name, refusal)
            stop = replace(stop, reason=f"{stop.reason}; {refusal.reason}") if stop else refusal
            continue
        if late is not None and setup.rig.can.moves_hardware:
            stop = replace(late, reason=f"{run.label} was not begun: {late.reason}")
            _note(writer, run.name, stop)
            continue
        progress(f"{run.label}, {setup.case.table.kind} table")
        writer.about({f"{run.name}_status": BEGUN})
        blocks, lead = design.blocks, design.blocks.lead_samples
        expected = expected_of(setup, identified, blocks)
        outcome = stage.play(setup, design, expected, run, writer)
        series = on_record_clock(outcome, lead, setup.rig.dt_s, len(setup.motion.time_s))
        drift = drift_of(setup, expected, outcome)
        if drift is not None and drift.any:
            said += sensor_drift_report.sentences(run.label, drift, setup, lead)
            series = without_drift(series, drift.removed, lead, blocks.estimator)
        stopped = why_ended(run.label, outcome, len(setup.motion.time_s) * setup.rig.dt_s)
        stop = stop or stopped
        late = late or after_the_record(run.label, outcome, setup.rig.dt_s)
        hybrid = hybrid_of(setup, series) if run.source == NUMERICAL else None
        result_contents.write_table_run(writer, run.name, setup, series, hybrid)
        if outcome.whole is not None:
            result_contents.write_rest(writer, run.name, setup, outcome.whole)
        _note(writer, run.name, stopped)
        if found := dropout_counts.of_live(series.live, setup.rig.dt_s):
            values |= dropout_counts.as_figures(run.name, found)
        if stopped is None and drift is not None:
            values |= sensor_drift_report.as_figures(run.name, drift, setup, lead)
        if stopped is None:
            values |= figures_of_run(setup, run.name, series, sim, hybrid)
            remarks |= run_metrics.remarks(setup, run.name, series.desired[0])
        if stopped is None and hybrid is not None:
            values |= budget_metrics.of_exp_rths(checked.loop, series, hybrid[2], sim)
    return Played(stop, values, tuple(said), late, remarks)


def refused(writer: ResultWriter, runs: Sequence[str], reason: str) -> Stop:
    """Return that no table run of a case is played, and why; its file says so of each."""
    stop = Stop("refused", reason, 1)
    for run in TABLE_RUNS:
        if run.name in runs:
            _note(writer, run.name, stop)
    return stop


def _note(writer: ResultWriter, run: str, stopped: Stop | None) -> None:
    """Write how one run ended: its file tells how the first that ended early did."""
    told = {f"{run}_status": stopped.status, f"{run}_status_reason": stopped.reason} if stopped else {}
    writer.about(told or {f"{run}_status": COMPLETE})


def refusal_of(setup: Setup, checked: Verdict) -> Stop | None:
    """Return why EXP-RTHS is not run, None when it is safe or when that is overridden."""
    if not checked.refused or "check" in setup.overrides:
        return None
    advice = (
        f"rths check {shown(setup.case.path)} with the same options tells more, --override check runs it all the same"
    )
    return Stop("refused", f"EXP-RTHS refused, {checked.verdict}: {'; '.join(checked.reasons)}; {advice}", 1)


def play_run(setup: Setup, design: Design, source: int, stream: int) -> Outcome:
    """Play the ground motion through the blocks and the rig: directly (RECORD) or through the numerical part."""
    rig, limits, dt_s = open_rig(setup, (stream,), setup.case.seed), guard_limits(setup), setup.rig.dt_s
    still = Stillness(*(round(each / dt_s) for each in (BEFORE_S, way_to_rest_s(limits), AFTER_S)))
    drive = drive_of(setup, design)
    return interruptible(lambda: play(rig, setup.rig, design.blocks, source, drive, limits, still=still))


def drive_of(setup: Setup, design: Design) -> Array:
    """Return the ground's acceleration, velocity and displacement (n + lead, 3); its clock ends before the table's."""
    motion, lead = setup.motion, design.blocks.lead_samples
    drive = np.column_stack([motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m])
    return np.vstack([drive, np.repeat(drive[-1:], lead, axis=0)])


def hybrid_of(setup: Setup, series: Series) -> tuple[Array, Array, Array]:
    """Return displacement, velocity and acceleration of the whole building in a hybrid test."""
    dt, scheme = setup.rig.dt_s, setup.case.integration
    return whole_building(setup.building, series, setup.motion.accel_m_s2, dt, scheme)


def figures_of_run(
    setup: Setup, run: str, series: Series, sim: Response, hybrid: tuple[Array, Array, Array] | None
) -> dict[str, ArrayLike]:
    """Return the figures of a table run that reached the end of the record."""
    dt, virtual = setup.rig.dt_s, setup.rig.can.records_truth
    lowest_hz = lowest_reliable_hz(setup)
    true = series.true_accel[0] if virtual else None
    values = run_metrics.tracking(run, series.desired[0], series.measured[0], true, dt, lowest_hz)
    values[f"{run}.high_pass_hz"] = lowest_hz
    if hybrid is not None:
        storeys = true_accel(hybrid[2], series) if virtual else None
        values |= run_metrics.against_sim(run, sim.abs_accel_m_s2, hybrid[2], storeys, dt, lowest_hz)
    return values | run_metrics.of_table_run(setup, run, series, sim, hybrid)


def true_accel(abs_accel: Array, series: Series) -> Array:
    """Return the storeys' accelerations with true ones on table and specimen in place of the measured."""
    computed = abs_accel[: len(abs_accel) - len(series.true_accel)]
    return np.vstack([computed, series.true_accel]) if len(computed) else series.true_accel


def why_ended(label: str, outcome: Outcome, record_s: float) -> Stop | None:
    """Return why a run did not reach the end of its record, None when it did: what came first, then what the rig
    says."""
    fault, limit = outcome.rig_fault, outcome.stopped_by_limit
    if outcome.played or not (fault or limit):
        return None
    at = _instant(outcome, record_s)
    says_more = fault and outcome.reason in (guard.NONE, guard.RIG_FAULT, guard.LOST)
    said = f"{label} {at}: {fault}" if says_more else f"{label}: {limit} {at}{f'; {fault}' if fault else ''}"
    if outcome.reason in INTERRUPTIONS and not fault and outcome.stopped_at_s > -outcome.ramp_s:
        said = f"{said}, the table was led to rest"
    return _stop(outcome, said)


def after_the_record(label: str, outcome: Outcome, dt_s: float) -> Stop | None:
    """Return what ended a run after its record was played whole, None where nothing did. The run itself is complete:
    what counts is the exit code, and the reason, which says how much of the rest is missing."""
    fault, limit = outcome.rig_fault, outcome.stopped_by_limit
    if not outcome.played or not (fault or limit):
        return None
    watched_s = outcome.whole.after_v.shape[1] * dt_s if outcome.whole is not None else 0.0
    what = "; ".join(filter(None, (limit, fault)))
    missing = "" if watched_s >= AFTER_S else (
        f"; the table was watched at rest for {watched_s:.2f} s of {AFTER_S:g} s, offset and drift of the sensors are "
        "told from what there is"
    )  # fmt: skip
    said = f"{label}: the record was played whole; after it: {what}{missing}"
    return _stop(outcome, said)


def _stop(outcome: Outcome, said: str) -> Stop:
    """Return status and exit code that go with what ended a run."""
    if outcome.reason in INTERRUPTIONS:
        return Stop("interrupted", said, INTERRUPTIONS[outcome.reason])
    if outcome.reason == guard.WATCHER_FAILED:
        return Stop("failed", said, 5)
    if outcome.rig_fault or outcome.reason in (guard.LOG_FAILED, guard.RIG_FAULT):
        return Stop("failed", said, 4)
    return Stop("aborted", said, 3)


def _instant(outcome: Outcome, record_s: float) -> str:
    """Return when a run ended early, in the time of its record."""
    if not outcome.log.state.size:  # on the counted clock, without ramps
        return f"at {outcome.stopped_at_s:.3f} s"
    if outcome.stopped_at_s <= -outcome.ramp_s:
        return "at rest, before the table moved"
    if outcome.stopped_at_s <= 0.0:
        return "in the ramp-up, before the record began"
    return f"at {outcome.stopped_at_s:.3f} s of {record_s:.3f} s"
