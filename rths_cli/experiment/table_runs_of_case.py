"""The table runs of one case in their order: which are played, skipped or refused, and their results written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

from rths_cli.experiment import result_contents
from rths_cli.experiment.error_after_run import AfterRun, error_after_run
from rths_cli.experiment.error_budget_metrics import told_causes
from rths_cli.experiment.one_table_run import (
    HYBRID_TEST,
    TABLE_RUNS,
    Run,
    RunKind,
    RunPlan,
    Stop,
    evaluated,
    plan_run,
    play_run,
    run_of,
    true_accelerations,
)
from rths_cli.experiment.rig_access import session_of
from rths_cli.experiment.setup import Progress, Setup, shown
from rths_cli.experiment.unit_plausibility import doubts_building, unit_doubts
from rths_cli.files.result_reader import BEGUN, COMPLETE
from rths_cli.interrupts import interruptible
from rths_cli.rigs.from_case import true_values_of_run

if TYPE_CHECKING:
    from rths_cli.analysis.sim import Response
    from rths_cli.experiment.check_command import Verdict
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.model_choice import Known
    from rths_cli.files.result_reader import ResultWriter
    from rths_cli.loop.simulated_time_run import Outcome
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values
    from rths_cli.structure import Building


@dataclass(frozen=True)
class Played:
    """Outcome of the table runs of a case: the first stop (None: there was none), metrics and warnings.

    `late` is what ended a run after its complete record (None: nothing did); `remarks` belong to metrics. `true_accel`
    (n_storeys, n) in m/s^2 is the building's true motion in a complete EXP-RTHS, None where nobody knows it; `after` is
    what its records tell of its true error.
    """

    stop: Stop | None
    values: Values
    said: tuple[str, ...] = ()
    late: Stop | None = None
    remarks: Mapping[str, str] = field(default_factory=dict)
    true_accel: Array | None = None
    after: AfterRun = field(default_factory=AfterRun)


class Stage(Protocol):
    """Where the runs of a case are played.

    `told` is the building with the specimen that the rig of a package said to have in the last run, None where it said
    nothing.
    """

    told: Building | None

    def play(self, plan: RunPlan, writer: ResultWriter) -> Outcome:
        """Play one run; the result file may be closed meanwhile."""

    def written(self) -> None:
        """Called when the result file holds everything that was played."""


class VirtualStage:
    """Plays runs on virtual rigs, which need no real time; their specimens stand in their rig files."""

    told: Building | None = None

    def play(self, plan: RunPlan, writer: ResultWriter) -> Outcome:
        """Play one run."""
        return interruptible(lambda: play_run(plan, plan.setup.case.seed))

    def written(self) -> None:
        """Do nothing: there are no other files of the runs."""


def play_all(
    setup: Setup,
    known: Known,
    checked: Verdict,
    design: Design,
    sim: Response,
    writer: ResultWriter,
    progress: Progress,
    stage: Stage,
) -> Played:
    """Play the table runs of the case and write them."""
    all_of_them = Played(None, {})
    for kind in TABLE_RUNS:
        stop, late = all_of_them.stop, all_of_them.late
        if kind.name not in setup.case.runs or (_ended(stop) and setup.rig.can.moves_hardware):
            continue
        if refusal := refusal_of(setup, checked, kind):
            _note(writer, kind.name, refusal)
            stop = replace(stop, reason=f"{stop.reason}; {refusal.reason}") if stop else refusal
            all_of_them = replace(all_of_them, stop=stop)
            continue
        if late is not None and setup.rig.can.moves_hardware:
            stop = replace(late, reason=f"{kind.label} was not begun: {late.reason}")
            _note(writer, kind.name, stop)
            all_of_them = replace(all_of_them, stop=stop)
            continue
        progress(f"{kind.label}, {setup.case.table.kind} table")
        writer.about({f"{kind.name}_status": BEGUN})
        plan = plan_run(setup, design, kind, known.found, checked.planned.get(kind.name))
        outcome = stage.play(plan, writer)
        run = run_of(outcome, setup, kind, design.blocks.lead_samples, plan.expected)
        if run.stopped is not None and checked.refuses(kind.name):
            told = f"{checked.of_run(kind.name)[0]} by its check, which was overridden; {run.stopped.reason}"
            run = replace(run, stopped=replace(run.stopped, reason=told))
        write_run(writer, setup, run)
        _note(writer, kind.name, run.stopped)
        run = evaluated(run, setup, sim, checked.loop, checked.replay)
        if causes := told_causes(run.causes):
            writer.about(causes)
        all_of_them = _with(all_of_them, run)
        if kind is HYBRID_TEST:
            after = error_after_run(checked.uncertain, run)
            if after.why_none:
                writer.about({"no_true_error_bound": after.why_none})
            values = {**all_of_them.values, **after.values}
            all_of_them = replace(all_of_them, true_accel=true_accelerations(run, setup), after=after, values=values)
    return all_of_them


def _ended(stop: Stop | None) -> bool:
    """Return whether an earlier run ended early; one that was refused moved nothing."""
    return stop is not None and stop.status != "refused"


def _with(before: Played, run: Run) -> Played:
    """Return the outcome of the earlier runs together with one more."""
    return Played(
        before.stop or run.stopped,
        {**before.values, **run.metrics},
        (*before.said, *run.warnings),
        before.late or run.late,
        {**before.remarks, **run.remarks},
    )


def write_run(writer: ResultWriter, setup: Setup, run: Run) -> None:
    """Write the series of a run."""
    seed, stream = setup.case.seed, (run.kind.stream,)
    drawn = true_values_of_run(setup.case, setup.rig, (seed, *stream), session_of(setup, stream, seed))
    hidden = result_contents.true_arrays(drawn)
    result_contents.write_table_run(writer, run.kind.name, setup, run.series, run.building, hidden)
    if run.rest is not None:
        result_contents.write_rest(writer, run.kind.name, setup, run.rest)


def refused(writer: ResultWriter, runs: Sequence[str], reason: str) -> Stop:
    """Return the outcome for a case whose table runs are refused; the file states the reason for each."""
    stop = Stop("refused", reason, 1)
    for kind in TABLE_RUNS:
        if kind.name in runs:
            _note(writer, kind.name, stop)
    return stop


def _note(writer: ResultWriter, run: str, stopped: Stop | None) -> None:
    """Write status and reason of one run."""
    told = {f"{run}_status": stopped.status, f"{run}_status_reason": stopped.reason} if stopped else {}
    writer.about(told or {f"{run}_status": COMPLETE})


def why_none(setup: Setup, known: Known, checked: Verdict) -> str:
    """Return why no run on the table is played, empty if they may be."""
    if checked.design is None:
        return "; ".join(checked.reasons)
    faults = known.faults(setup.overrides)[:1]
    return "; ".join((*unit_doubts(setup), *faults)) if faults else ""


def why_unsafe(setup: Setup, checked: Verdict, kind: RunKind = HYBRID_TEST) -> str:
    """Return why a table run is not played, empty if it is safe or overridden."""
    if not checked.refuses(kind.name) or "check" in setup.overrides:
        return ""
    verdict, reasons = checked.of_run(kind.name)
    doubts = unit_doubts(setup)
    others = [reason for reason in reasons if reason not in doubts]
    if others and doubts_building(setup):  # what a wrong unit makes of the loop tells nobody what to change
        others = [f"{len(others)} more {'reasons' if len(others) > 1 else 'reason'}, which a wrong unit would explain"]
    return f"{verdict}: {'; '.join([*doubts, *others])}"


def refusal_of(setup: Setup, checked: Verdict, kind: RunKind = HYBRID_TEST) -> Stop | None:
    """Return the refusal of a table run, None if it is safe or overridden."""
    why = why_unsafe(setup, checked, kind)
    if not why:
        return None
    advice = (
        f"rths check {shown(setup.case.path)} with the same options tells more, --override check runs it all the same"
    )
    return Stop("refused", f"{kind.label} refused, {why}; {advice}", 1)
