"""One run on the table (shake-table test or EXP-RTHS): plan it, play it on the virtual rig, why it ended, its
metrics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.experiment import actuator, lost_samples, run_metrics, run_signals
from rths_cli.experiment.late_answers import answer_findings, answer_metrics
from rths_cli.experiment.planned_motion import PlannedMotion, effective_limits, foreseen_causes
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, SHAKE_TABLE, guard_limits, open_rig
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.run_signals import (
    BuildingMotion,
    Expected,
    OwnInterface,
    SensorDrift,
    Series,
    drift_of,
    expected_of,
    on_record_clock,
    whole_building,
    without_drift,
)
from rths_cli.findings import Finding
from rths_cli.loop import guard
from rths_cli.loop.guard import stopping_at_stuck
from rths_cli.loop.realtime_run import way_to_rest_s
from rths_cli.loop.simulated_time_run import Outcome, Stillness, Whole, play
from rths_cli.loop.step_arrays import NUMERICAL, RECORD

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.error_attribution import Cause
    from rths_cli.analysis.error_budget import Undisturbed
    from rths_cli.analysis.predicted_error import PredictionInputs
    from rths_cli.analysis.sim import Response
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.loop.diagnosis import Foreseen
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.loop.run_log import Log
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values

BEFORE_S, AFTER_S = 1.0, 3.0  # time at rest that is recorded before and after each run
INTERRUPTIONS = {guard.INTERRUPT: 130, guard.TERMINATION: 143}  # exit codes of orders given by signals


@dataclass(frozen=True)
class Stop:
    """Why a run ended early: the status of its file and the exit code that goes with it; `findings`: of a refusal or of
    the guard."""

    status: str
    reason: str
    exit_code: int
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class RunKind:
    """One kind of run on the table: its group in the result, source of the desired motion, noise stream, label."""

    name: str
    source: int
    stream: int
    label: str


SHAKE_TABLE_TEST = RunKind("shake_table", RECORD, SHAKE_TABLE, "shake-table test")
HYBRID_TEST = RunKind("exp_rths", NUMERICAL, EXP_RTHS, "EXP-RTHS")
TABLE_RUNS = (SHAKE_TABLE_TEST, HYBRID_TEST)


@dataclass(frozen=True)
class RunPlan:
    """A run before it is played: its blocks, its drive and the limits of its guard.

    `drive` (n + lead, 3): acceleration, velocity and displacement of the ground in SI units. `expected`: prediction
    with which the channels are compared to find drift, for which the rest before and after the run is recorded; None:
    no comparison and no such rest. `foreseen`: causes of a stop that the plan tells already, by the guard's reason.
    """

    setup: Setup
    design: Design
    kind: RunKind
    drive: Array
    limits: GuardLimits
    expected: Expected | None
    foreseen: Foreseen = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """One run on the table, on the record's clock, from which metrics, result files and rows of sweeps are made.

    `building`: motion of the whole building in EXP-RTHS; None in a shake-table test, and if only accelerations are
    needed and all of them are measured. `rest`: channels at rest before and after the run, None if not recorded.
    `drift`: offset, drift and jumps that were removed from `series`. `stopped`: why the run ended before its record
    did; `late`: what ended it after its record; None: nothing. `metrics`, `remarks` and the
    `causes` of its error are empty until `evaluated`.
    """

    kind: RunKind
    lead_samples: int
    series: Series
    building: BuildingMotion | None
    rest: Whole | None = None
    drift: SensorDrift | None = None
    stopped: Stop | None = None
    late: Stop | None = None
    warnings: tuple[Finding, ...] = ()
    metrics: Values = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)
    causes: tuple[Cause, ...] = ()

    @property
    def abs_accel_m_s2(self) -> Array | None:
        """Return the storeys' absolute accelerations (n_storeys, n) in EXP-RTHS, None in a shake-table test."""
        if self.kind.source != NUMERICAL:
            return None
        return self.series.measured if self.building is None else self.building.abs_accel_m_s2


def plan_run(
    setup: Setup,
    design: Design,
    kind: RunKind,
    identified: Identification | None = None,
    planned: PlannedMotion | None = None,
) -> RunPlan:
    """Return the plan of a run; with `identified`, its channels are compared with the identified rig to find drift.

    `planned`: the motion that the run needs, to which the guard's limits are set; None: those of the rig file alone.
    """
    compared = identified is not None and not actuator.is_of_actuator(setup)
    expected = expected_of(setup, identified, design.blocks) if compared and identified is not None else None
    limits = effective_limits(guard_limits(setup), planned)
    return RunPlan(setup, design, kind, drive_of(setup, design), limits, expected, foreseen_causes(limits, planned))


def drive_of(setup: Setup, design: Design) -> Array:
    """Return acceleration, velocity and displacement of the ground (n + lead, 3), with `lead` rows after its end.

    After the record the ground keeps its last acceleration. A velocity beside a displacement that stands still would be
    a jump for a feedforward that weighs both.
    """
    motion, lead = setup.motion, design.blocks.lead_samples
    drive = np.column_stack([motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m])
    accel, velocity, displacement = drive[-1]
    after_s = setup.rig.dt_s * np.arange(1, lead + 1)
    moved = velocity * after_s + 0.5 * accel * after_s**2
    further = np.column_stack([np.full(lead, accel), velocity + accel * after_s, displacement + moved])
    return np.vstack([drive, further])


def play_run(plan: RunPlan, seed: int, log: Log | None = None) -> Outcome:
    """Play a run on the counted clock; the source is the ground motion itself (RECORD) or the numerical substructure.

    `log`: log of an earlier run of the same sizes, which is overwritten. With a lean one the run is played without what
    only watches it; where it does not reach its end like this, or a channel keeps its code for long enough to be stuck,
    it is played again with all of it.
    """
    setup, limits, dt_s = plan.setup, plan.limits, plan.setup.rig.dt_s
    rig = open_rig(setup, (plan.kind.stream,), seed)
    if log is not None and log.lean and plan.expected is None:
        blocks, source = plan.design.blocks.without_watch(), plan.kind.source
        outcome = play(rig, setup.rig, blocks, source, plan.drive, stopping_at_stuck(limits), log)
        if outcome.played and not outcome.rig_fault:
            return outcome
    still = None
    if plan.expected is not None:
        still = Stillness(*(round(each / dt_s) for each in (BEFORE_S, way_to_rest_s(limits), AFTER_S)))
    return play(rig, setup.rig, plan.design.blocks, plan.kind.source, plan.drive, limits, log, still, plan.foreseen)


def run_of(
    outcome: Outcome,
    setup: Setup,
    kind: RunKind,
    lead_samples: int,
    expected: Expected | None,
    only_accelerations: bool = False,
) -> Run:
    """Return the outcome of a play as a run on the record's clock, with sensor drift removed and without metrics.

    With `only_accelerations`, displacements and velocities of the building are computed only if its accelerations need
    them.
    """
    dt_s, samples = setup.rig.dt_s, len(setup.motion.time_s)
    series = on_record_clock(outcome, lead_samples, dt_s, samples)
    if actuator.is_of_actuator(setup):
        series, only_accelerations = actuator.with_felt_force(series), False
    drift = drift_of(setup, expected, outcome) if expected is not None else None
    warnings: tuple[Finding, ...] = ()
    if drift is not None and drift.any and expected is not None:
        warnings = run_signals.findings_of(kind.label, drift, setup, lead_samples)
        series = without_drift(series, drift.removed, lead_samples, expected.estimator)
    if kind.source == NUMERICAL:
        warnings += answer_findings(kind.name, kind.label, answer_metrics(kind.name, series))
    every_storey_is_measured = len(setup.building.numerical.masses_kg) == 1
    building = None
    if kind.source == NUMERICAL and not (only_accelerations and every_storey_is_measured):
        by_laws = kind.name in setup.recorded and not setup.building.linear  # a recording does not hold their forces
        knows = setup.knows_storeys and not by_laws
        own = OwnInterface(setup.motion, knows) if by_laws or "numerical" in setup.parts else None
        building = whole_building(setup.building, series, setup.motion.accel_m_s2, dt_s, setup.case.integration, own)
    return Run(
        kind, lead_samples, series, building, outcome.whole, drift,
        why_ended(kind.label, outcome, samples * dt_s), after_the_record(kind.label, outcome, dt_s), warnings,
    )  # fmt: skip


def evaluated(
    run: Run,
    setup: Setup,
    sim: Response,
    loop: PredictionInputs | None,
    replay: Callable[[], Undisturbed] | None = None,
) -> Run:
    """Return a run with its metrics; a run that ended early has only its counts of lost samples
    and late answers.

    `loop`: inputs of the error budget (None: no budget is computed). `replay` makes the test that its disturbances are
    played with; None: the building has no laws.
    """
    values: dict[str, ArrayLike] = {}
    if found := lost_samples.of_live(run.series.live, setup.rig.dt_s):
        values |= lost_samples.lost_sample_metrics(run.kind.name, found)
    if run.kind.source == NUMERICAL:
        values |= answer_metrics(run.kind.name, run.series)
    if run.stopped is not None:
        return replace(run, metrics=values)
    values |= metrics_of_record(run, setup, sim)
    causes: tuple[Cause, ...] = ()
    if run.abs_accel_m_s2 is not None:
        test = replay() if replay is not None else None
        budget, causes = run_metrics.of_exp_rths(loop, run.series, run.abs_accel_m_s2, sim, test)
        values |= budget
    return replace(
        run,
        metrics=values,
        causes=causes,
        remarks=run_metrics.remarks(
            setup, run.kind.name, run.series.desired[2 if actuator.is_of_actuator(setup) else 0]
        ),
    )


def metrics_of_record(run: Run, setup: Setup, sim: Response) -> Values:
    """Return the metrics of a run that reached the end of its record, without those of its timing."""
    if actuator.is_of_actuator(setup):
        assert run.building is not None
        return {**errors_of(run, setup, sim), **actuator.metrics(setup, run.kind.name, run.series, sim, run.building)}
    values: dict[str, ArrayLike] = {}
    if run.drift is not None:
        values |= run_signals.as_figures(run.kind.name, run.drift, setup, run.lead_samples)
    values |= errors_of(run, setup, sim)
    if run.abs_accel_m_s2 is not None:
        lowest_hz = lowest_reliable_hz(setup)
        values |= run_metrics.relative_errors(
            run.kind.name, values, sim.abs_accel_m_s2, setup.rig.dt_s, lowest_hz, setup.case.test_band_hz
        )
    return values | run_metrics.of_table_run(setup, run.kind.name, run.series, sim, run.building)


def errors_of(run: Run, setup: Setup, sim: Response, room: Array | None = None) -> Values:
    """Return a run's tracking errors and, of EXP-RTHS, its errors to SIM; `room` as `room_for_pairs` gives it."""
    lowest_hz, truth, accel = lowest_reliable_hz(setup), run.series.has_truth, run.abs_accel_m_s2
    series, storeys = run.series, None
    table: run_metrics.Compared | None = None
    if not actuator.is_of_actuator(setup):
        table = (series.desired[0], series.measured[0], series.true_accel[0] if truth else None)
    if accel is not None:
        storeys = (sim.abs_accel_m_s2, accel, series.with_true(accel) if truth else None)
    values = run_metrics.errors(run.kind.name, table, storeys, setup.rig.dt_s, lowest_hz, room, setup.case.test_band_hz)
    if table is None:
        values = {**values, **run_metrics.relative_errors(
            run.kind.name, values, sim.abs_accel_m_s2, setup.rig.dt_s, lowest_hz, setup.case.test_band_hz
        )}  # fmt: skip
    return {**values, f"{run.kind.name}.high_pass_hz": lowest_hz}


def true_accelerations(run: Run, setup: Setup) -> Array | None:
    """Return the building's true accelerations (n_storeys, n) in a complete EXP-RTHS, None where nobody knows them."""
    accel = run.abs_accel_m_s2
    if accel is None or run.stopped is not None or not run.series.has_truth:
        return None
    return run.series.with_true(accel)


def why_ended(label: str, outcome: Outcome, record_s: float) -> Stop | None:
    """Return why a run did not reach the end of its record, None if it did: the first reason, then the rig's fault."""
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
    """Return what ended a run after its complete record, None if nothing did.

    The run itself is complete. The result has the exit code, and a reason that states how much of the rest is missing.
    """
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
    found = () if outcome.stop is None else (outcome.stop,)
    if outcome.reason in INTERRUPTIONS:
        return Stop("interrupted", said, INTERRUPTIONS[outcome.reason], found)
    if outcome.reason == guard.WATCHER_FAILED:
        return Stop("failed", said, 5, found)
    if outcome.rig_fault or outcome.reason in (guard.LOG_FAILED, guard.RIG_FAULT):
        return Stop("failed", said, 4, found)
    return Stop("aborted", said, 3, found)


def _instant(outcome: Outcome, record_s: float) -> str:
    """Return in words when a run ended early, in the time of its record."""
    if not outcome.log.state.size:  # on the counted clock, without ramps
        return f"at {outcome.stopped_at_s:.3f} s"
    if outcome.stopped_at_s <= -outcome.ramp_s:
        return "at rest, before the table moved"
    if outcome.stopped_at_s <= 0.0:
        return "in the ramp-up, before the record began"
    return f"at {outcome.stopped_at_s:.3f} s of {record_s:.3f} s"
