"""One case of `rths run` from start to end: model, check, SIM, SIM-DELAY, table runs in their order (played,
skipped or refused), accept limits, result file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rths_cli.analysis import grade
from rths_cli.analysis.closed_loop import critical_delay_range
from rths_cli.analysis.references import reference_of
from rths_cli.case.load import resolved_yaml
from rths_cli.experiment import result_contents, run_metrics, true_reference
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check_command import Verdict, verdict_on
from rths_cli.experiment.error_after_run import AfterRun, error_after_run
from rths_cli.experiment.identify_output import try_folder
from rths_cli.experiment.lost_samples import losses_of_runs
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
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
from rths_cli.experiment.provenance import attributes
from rths_cli.experiment.real_rig_readiness import session_of
from rths_cli.experiment.recorded_run import OWN
from rths_cli.experiment.run_metrics import lowest_reliable_hz, told_causes
from rths_cli.experiment.setup import OwnSamples, Progress, Setup, building_key, make_setups, motion_key, shown
from rths_cli.experiment.unit_plausibility import doubts_building, keys_in_doubt, unit_doubts
from rths_cli.files.foreign_models import is_foreign
from rths_cli.files.hdf5_opening import RECORDED
from rths_cli.files.result_reader import BEGUN, COMPLETE, ResultWriter
from rths_cli.findings import Finding, sentences, stated
from rths_cli.interrupts import interruptible
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.rigs.from_case import laboratory_number, true_values_of_run

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.error_budget import Undisturbed
    from rths_cli.analysis.predicted_error import PredictionInputs
    from rths_cli.analysis.sim import Response
    from rths_cli.analysis.sim_delay import DelayedResponse
    from rths_cli.case.case_schema import Case
    from rths_cli.control.interface import OwnParts
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.true_reference import TrueReference
    from rths_cli.loop.simulated_time_run import Outcome
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values
    from rths_cli.structure import Building

BYTES_PER_SAMPLE = {"all": 600, "essential": 100, "none": 20}  # of a result file, for the check of free space
PRECEDENCE = (143, 130, 5, 4, 3, 2, 1)  # precedence of exit codes, the first one wins
LOG_BYTES_PER_SAMPLE = 400  # of the raw logs of two runs on a real rig, for the same check


@dataclass(frozen=True)
class Played:
    """Outcome of the table runs of a case: the first stop (None: there was none), metrics and warnings.

    `late` is what ended a run after its complete record (None: nothing did); `remarks` belong to metrics. `true_accel`
    (n_storeys, n) in m/s^2 is the building's true motion in a complete EXP-RTHS, None where nobody knows it; `after` is
    what its records tell of its true error.
    """

    stop: Stop | None
    values: Values
    said: tuple[Finding, ...] = ()
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
    known: IdentifiedModel,
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
        if kind.name not in setup.case.runs or (_ended(stop) and setup.moves_hardware):
            continue
        if refusal := refusal_of(setup, checked, kind):
            _note(writer, kind.name, refusal)
            stop = _both(stop, refusal)
            all_of_them = replace(all_of_them, stop=stop)
            continue
        if late is not None and setup.moves_hardware:
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
        run = _written(run, setup, sim, writer, checked.loop, checked.replay)
        all_of_them = _with(all_of_them, run)
        if kind is HYBRID_TEST:
            found = error_after_run(checked.uncertain, run, setup.rig.interface == "displacement")
            all_of_them = _with_error(all_of_them, setup, run, found, writer)
    return all_of_them


def _written(
    run: Run,
    setup: Setup,
    sim: Response,
    writer: ResultWriter,
    loop: PredictionInputs | None = None,
    replay: Callable[[], Undisturbed] | None = None,
) -> Run:
    """Write the series and the end of a run, and return it with its metrics."""
    write_run(writer, setup, run)
    _note(writer, run.kind.name, run.stopped)
    run = evaluated(run, setup, sim, loop, replay)
    if causes := told_causes(run.causes):
        writer.about(causes)
    return run


def _with_error(before: Played, setup: Setup, run: Run, after: AfterRun, writer: ResultWriter) -> Played:
    """Return the outcome with what a hybrid test tells of its true error."""
    if after.why_none:
        writer.about({"no_true_error_bound": after.why_none})
    values = {**before.values, **after.values}
    return replace(before, true_accel=true_accelerations(run, setup), after=after, values=values)


def judge_recorded(setup: Setup, memory: Memory, sim: Response, writer: ResultWriter, progress: Progress) -> Played:
    """Write and judge the runs of a case that were made elsewhere."""
    from rths_cli.experiment.recording_faults import judged

    all_of_them = Played(None, {})
    for kind in TABLE_RUNS:
        if (recorded := setup.recorded.get(kind.name)) is None:
            continue
        progress(f"{kind.label}, recorded")
        writer.about(recorded.attributes)
        run = run_of(recorded.outcome, setup, kind, 0, None)
        run = _written(replace(run, warnings=(*recorded.told, *run.warnings)), setup, sim, writer)
        all_of_them = _with(all_of_them, replace(run, metrics={**run.metrics, **recorded.figures}))
        if kind is not HYBRID_TEST:
            continue
        found = judged(setup, run, recorded)
        after = AfterRun(why_none=found.another) if found.another else _error_of_recorded(setup, memory, run, progress)
        values, said = (
            {**found.values, **all_of_them.values},
            (*found.told, *all_of_them.said, *_noise_of(setup, after)),
        )
        all_of_them = _with_error(replace(all_of_them, values=values, said=said), setup, run, after, writer)
        if found.another:
            why = stated(found.another)
            stop = all_of_them.stop or Stop("complete", str(why), 1)
            all_of_them = replace(all_of_them, stop=stop, said=(why, *all_of_them.said))
    return all_of_them


def _noise_of(setup: Setup, after: AfterRun) -> tuple[Finding, ...]:
    """Return what the bound of a recorded run takes of the case's controller, which is not the recorded one."""
    if after.true_error is None:
        return ()
    kind = setup.case.controller.kind
    told = f"the bound takes noise and rounding of the samples to move the table as under the case's controller, {kind}"
    return (stated(told, "notes"),)


def _error_of_recorded(setup: Setup, memory: Memory, run: Run, progress: Progress) -> AfterRun:
    """Return what a recorded run tells of its true error, which needs the model of its table that the case names."""
    model = setup.case.identification.model
    if model is None or is_foreign(model):
        told = "identify it from its own measurements (rths identify --data) and name the file: identification.model"
        return AfterRun(
            why_none=f"what sensors and masses hide is known only with an identified model of the table; {told}"
        )
    known = memory.at_rest(setup, progress)
    if faults := known.faults(setup.overrides):
        return AfterRun(why_none="; ".join(sentences(faults)))
    checked = verdict_on(setup, known, table_test=False)
    if checked.uncertain is None:
        why = "; ".join(sentences(checked.findings)) or "the loop of its controller is not known"
        return AfterRun(why_none=f"nothing is predicted of the noise in a test with the controller of the case: {why}")
    return error_after_run(checked.uncertain, run)


def _both(stop: Stop | None, refusal: Stop) -> Stop:
    if stop is None:
        return refusal
    return replace(stop, reason=f"{stop.reason}; {refusal.reason}", findings=(*stop.findings, *refusal.findings))


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


def refused(writer: ResultWriter, runs: Sequence[str], why: Sequence[Finding]) -> Stop:
    """Return the outcome for a case whose table runs are refused; the file states the reason for each."""
    stop = Stop("refused", "; ".join(sentences(why)), 1, tuple(why))
    for kind in TABLE_RUNS:
        if kind.name in runs:
            _note(writer, kind.name, stop)
    return stop


def _note(writer: ResultWriter, run: str, stopped: Stop | None) -> None:
    """Write status and reason of one run."""
    told = {f"{run}_status": stopped.status, f"{run}_status_reason": stopped.reason} if stopped else {}
    writer.about(told or {f"{run}_status": COMPLETE})


def why_none(setup: Setup, known: IdentifiedModel, checked: Verdict) -> tuple[Finding, ...]:
    """Return why no run on the table is played, () if they may be."""
    if checked.design is None:
        return checked.findings
    faults = known.faults(setup.overrides)[:1]
    return (*unit_doubts(setup), *faults) if faults else ()


def why_unsafe(setup: Setup, checked: Verdict, kind: RunKind = HYBRID_TEST) -> Finding | None:
    """Return why a table run is not played, None if it is safe or overridden."""
    if not checked.refuses(kind.name) or "check" in setup.overrides:
        return None
    verdict, findings = checked.of_run(kind.name)
    doubts = unit_doubts(setup)
    others = tuple(one for one in findings if one not in doubts)
    if others and doubts_building(setup):  # what a wrong unit makes of the loop tells nobody what to change
        others = (Finding("run.more_reasons", {"count": len(others)}),)
    return Finding("run.unsafe", {"verdict": verdict, "reasons": (*doubts, *others)})


def refusal_of(setup: Setup, checked: Verdict, kind: RunKind = HYBRID_TEST) -> Stop | None:
    """Return the refusal of a table run, None if it is safe or overridden."""
    why = why_unsafe(setup, checked, kind)
    if why is None:
        return None
    refused = Finding("run.refused", {"run": kind.label, "why": why, "case": shown(setup.case.path)})
    return Stop("refused", str(refused), 1, (refused,))


@dataclass(frozen=True)
class Ended:
    """The end of one case."""

    name: str  # of the case
    path: Path | None  # result file; None: nothing was written
    status: str  # of the result file
    reason: str  # "" for a complete and accepted case
    exit_code: int
    warnings: tuple[str, ...] = ()  # one sentence each
    replaced: bool = False  # whether a result file of the same name was replaced
    seconds: float = 0.0  # that it took


def prepare_all(
    cases: Sequence[Case], output: Path, overrides: tuple[str, ...] = (), shared: SharedValues | None = None,
    parts: OwnParts | None = None, samples: OwnSamples = (), series: str = "all",
) -> list[Setup]:  # fmt: skip
    """Read and check all cases completely before the first one starts; raises InputError with all faults."""
    setups = make_setups(cases, overrides, shared, parts, samples)
    prepare_folder(setups, output, series)
    return setups


def prepare_folder(setups: Sequence[Setup], output: Path, series: str) -> None:
    """Raise InputError unless the files of all cases can be written to a folder, and have room there."""
    try_folder(output, sum(_bytes(setup, series) for setup in setups))


def _bytes(setup: Setup, series: str) -> int:
    """Return the number of bytes that the files of a case may need."""
    logged = LOG_BYTES_PER_SAMPLE if setup.moves_hardware else 0
    return (BYTES_PER_SAMPLE[series] + logged) * len(setup.motion.time_s)


def moves_table(case: Case) -> bool:
    """Return whether a case has a run on the table, which is not one that was made elsewhere."""
    return bool({"shake_table", "exp_rths"} & set(case.runs)) and not case.recorded


def run_case(
    setup: Setup,
    path: Path,
    memory: Memory,
    command_line: str,
    progress: Progress,
    shared: SharedValues | None = None,
    stage: Stage | None = None,
    series: str = "all",
) -> Ended:
    """Run one case and write its result file; raises InputError if it cannot be run or written.

    With `shared`, cases compute common values once. `stage` plays the runs; None: on a virtual rig. `series`: those
    that the file keeps, one of `KEPT_SERIES`.
    """
    case, shared = setup.case, shared or SharedValues()
    known = memory.known(setup, progress) if moves_table(case) else None
    checked = verdict_on(setup, known, "exp_rths" in case.runs, shared=shared) if known else None
    cautions, replaced = _cautions(setup, known, checked), path.exists()
    about = _attributes(setup, checked, known, command_line, cautions) | {"series": series}
    with ResultWriter(path, about, lasting=setup.moves_hardware) as writer:
        writer.case(case.yaml_text, resolved_yaml(case))
        result_contents.write_record(writer, setup)
        if not setup.recorded:
            result_contents.write_laboratory(writer, setup)
        sim, values = _simulations(setup, writer, shared, progress)
        played = judge_recorded(setup, memory, sim, writer, progress)
        values, cautions = {**values, **played.values}, (*played.said, *cautions)
        truth = truth_of(setup, sim, shared, progress) if "exp_rths" in case.runs and not setup.recorded else None
        if known is not None and checked is not None:
            played = _on_table(setup, known, checked, sim, writer, progress, stage or VirtualStage())
            values |= played.values
            if stage is not None and stage.told is not None:
                result_contents.write_told_specimen(writer, setup, stage.told)
                if played.true_accel is not None:
                    truth = _truth_told(setup, stage.told, progress)
            if truth is not None and played.true_accel is not None:
                values |= true_reference.true_reference_metrics(setup, truth, played.true_accel, values)
            values |= true_reference.expected_error_metrics(played.after.true_error, values)
            if "exp_rths.residual_drift_m" in values and not setup.declared:
                change_m = change_of_residual_drift(setup, sim, shared)
                values |= true_reference.residual_drift_metrics(setup, sim, change_m, values)
            cautions = (*played.said, *true_reference.disagreement(values), *cautions)
        cautions = (*losses_of_runs(values), *cautions)
        late = (stated(played.late.reason, "warns"),) if played.late else ()
        writer.about(result_contents.told((*late, *cautions), played.stop.findings if played.stop else ()))
        named = checked.remarks if checked else {}
        writer.metrics(values, {**result_contents.remarks(setup), **named, **played.remarks})
        stop = _also(played.stop or acceptance(case.accept, values), played.late)
        writer.finish(stop.status, stop.reason)  # type: ignore[arg-type]
    if stage is not None:
        stage.written()
    replaced = replaced and writer.path == path
    return Ended(case.name, writer.path, stop.status, stop.reason, stop.exit_code, sentences(cautions), replaced)


def _also(stop: Stop, late: Stop | None) -> Stop:
    """Return the end of a case, changed if something ended a run after its complete record."""
    if late is None or late.reason in stop.reason:
        return stop
    reason = "; ".join(filter(None, (stop.reason, late.reason)))
    return replace(stop, reason=reason, exit_code=worst_code((stop.exit_code, late.exit_code)))


def worst_code(codes: Iterable[int]) -> int:
    """Return the exit code of several cases: the one with the highest precedence, 0 if all are 0."""
    there = set(codes)
    return next((code for code in PRECEDENCE if code in there), 0)


def _cautions(setup: Setup, known: IdentifiedModel | None, checked: Verdict | None) -> tuple[Finding, ...]:
    """Return the warnings that a user should read before trusting the result."""
    said = of_case(setup, known.found if known else None, checked.design if checked else None)
    if checked is not None and checked.remedy and (not checked.refused or "check" in setup.overrides):
        said = (checked.remedy, *said)
    if checked is None or "check" not in setup.overrides:
        return said
    overridden = []
    for kind in TABLE_RUNS:
        if kind.name in setup.case.runs and checked.refuses(kind.name):
            verdict, reasons = checked.of_run(kind.name)
            overridden.append(Finding("run.overridden", {"run": kind.label, "verdict": verdict, "reasons": reasons}))
    return (*overridden, *said)


def _attributes(
    setup: Setup, checked: Verdict | None, known: IdentifiedModel | None, command_line: str, cautions: Sequence[Finding]
) -> dict[str, str | int | float]:
    """Return the root attributes of the result file."""
    model = {"model_source": known.source if known else "", **result_contents.told(cautions)}
    main = "exp_rths" if "exp_rths" in setup.case.runs else "shake_table"
    judged = checked.of_run(main)[0] if checked else ""
    verdict = {"check_verdict": judged, "units_in_doubt": ", ".join(keys_in_doubt(setup))}
    made = {"controller": OWN, "rig_kind": RECORDED} if setup.recorded else {}
    made_from = checked.design.model if checked and checked.design else None
    return attributes(setup, made_from, command_line) | model | verdict | made


def _on_table(
    setup: Setup,
    known: IdentifiedModel,
    checked: Verdict,
    sim: Response,
    writer: ResultWriter,
    progress: Progress,
    stage: Stage,
) -> Played:
    """Write identification, check and blocks to the result file, and play the table runs."""
    design = checked.design
    why = why_none(setup, known, checked)
    if design is None:
        return Played(refused(writer, setup.case.runs, why), {})
    result_contents.write_identification(writer, known.found, design)
    result_contents.write_session(writer, setup, known.found)
    result_contents.write_controller(writer, design)
    values = result_contents.design_figures(setup, known.found, design) | checked.figures
    if why:
        return Played(refused(writer, setup.case.runs, why), values)
    played = play_all(setup, known, checked, design, sim, writer, progress, stage)
    return replace(played, values={**values, **played.values})


def _simulations(
    setup: Setup, writer: ResultWriter, shared: SharedValues, progress: Progress
) -> tuple[Response, dict[str, ArrayLike]]:
    """Write SIM and SIM-DELAY; return SIM, the reference of all errors, and the metrics."""
    case, asked = setup.case, _of_sim(setup)
    shared = _for(setup, shared)
    progress("SIM")
    sim = interruptible(lambda: sim_of(setup, shared))
    values: dict[str, ArrayLike] = dict(measures_of(setup, shared))
    if "sim" in case.runs:
        result_contents.write_response(writer, "sim", setup, sim)
        values["sim.solution_error"] = sim.error_estimate
        values |= response_metrics("sim", setup.building, sim)
    if "sim_delay" in case.runs:
        progress(f"SIM-DELAY, {1e3 * case.delay_s:g} ms")
        delayed, found = shared.get(
            "sim_delay",
            (*asked, case.delay_s, lowest_reliable_hz(setup), case.test_band_hz),
            lambda: interruptible(lambda: _sim_delay(setup, sim)),
        )
        result_contents.write_response(writer, "sim_delay", setup, delayed)
        values |= found
    return sim, values


def truth_of(setup: Setup, sim: Response, shared: SharedValues, progress: Progress) -> TrueReference | None:
    """Return the true reference, None where nobody knows the specimen; cases with the same record, building and rig
    compute it once."""
    case = setup.case
    rig = case.table.model_dump_json(), laboratory_number(case)
    key = (*_of_sim(setup), *rig, case.delay_s, "sim_delay" in case.runs)
    return _for(setup, shared).get(
        "true_reference", key, lambda: interruptible(lambda: true_reference.true_reference(setup, sim, progress))
    )


def _truth_told(setup: Setup, told: Building, progress: Progress) -> TrueReference:
    """Return the true reference of the specimen that the rig of a package says it has; nobody else shares it."""
    return interruptible(lambda: true_reference.reference_of_building(setup, told, progress))


def change_of_residual_drift(setup: Setup, sim: Response, shared: SharedValues) -> Array:
    """Return what 1 % of base shear makes of SIM's residual drift; cases with the same record and building share it."""
    change = true_reference.change_by_base_shear_m
    return shared.get("residual_drift", _of_sim(setup), lambda: interruptible(lambda: change(setup, sim)))


def sim_of(setup: Setup, shared: SharedValues) -> Response:
    """Return SIM, the reference of all errors; cases with the same record and building compute it once."""
    dt, ground = setup.rig.dt_s, setup.motion.accel_m_s2
    return _for(setup, shared).get(
        "sim", _of_sim(setup), lambda: reference_of(setup.building).sim(setup.building, dt, ground)
    )


def measures_of(setup: Setup, shared: SharedValues) -> Values:
    """Return the intensity measures of the ground motion; cases with the same record and building compute them once."""
    return _for(setup, shared).get(
        "measures", _of_sim(setup), lambda: interruptible(lambda: run_metrics.of_ground(setup.motion, setup.building))
    )


def _for(setup: Setup, shared: SharedValues) -> SharedValues:
    """Return where a setup's SIM may be shared: with no other case if its building is the caller's own, or its ground
    motion that of a recording."""
    return SharedValues() if setup.declared or setup.recorded else shared


def _of_sim(setup: Setup) -> tuple[object, ...]:
    """Return the key of SIM for SharedValues: everything that it depends on."""
    return motion_key(setup.case), building_key(setup.case)


def response_metrics(run: str, building: Building, found: Response) -> dict[str, ArrayLike]:
    """Return the metrics of a computed response."""
    values = run_metrics.of_building(run, building, found.rel_disp_m, found.abs_accel_m_s2)
    if found.laws is not None:
        work_j = found.laws.work_j[:, -1]
        values |= run_metrics.of_laws(run, building, found.rel_disp_m, found.laws.force_n, work_j)
    return values


def _sim_delay(setup: Setup, sim: Response) -> tuple[DelayedResponse, dict[str, ArrayLike]]:
    """Return SIM-DELAY and its metrics."""
    dt, building = setup.rig.dt_s, setup.building
    delayed = reference_of(building).sim_delay(building, dt, setup.motion.accel_m_s2, setup.case.delay_s, sim)
    lowest_hz = lowest_reliable_hz(setup)
    storeys = (sim.abs_accel_m_s2, delayed.abs_accel_m_s2, None)
    band_hz = setup.case.test_band_hz
    values = dict(run_metrics.errors("sim_delay", None, storeys, dt, lowest_hz, test_band_hz=band_hz))
    values |= run_metrics.relative_errors("sim_delay", values, sim.abs_accel_m_s2, dt, lowest_hz, band_hz)
    values |= response_metrics("sim_delay", building, delayed)
    values["sim_delay.high_pass_hz"] = lowest_hz
    values["sim_delay.solution_error"] = delayed.error_estimate
    critical = critical_delay_range(building).smallest.delay_s
    if math.isfinite(critical):  # infinite: every delay is stable, or none is critical by itself
        values["sim_delay.critical_delay_s"] = critical
        if critical > 0.0:
            values["sim_delay.psi"] = math.log10(1e3 * critical)
    if delayed.diverged_at_s is not None:
        values["sim_delay.diverged_at_s"] = delayed.diverged_at_s
    return delayed, values


def acceptance(limits: Mapping[str, float], values: Values) -> Stop:
    """Return the end of a completed case: accepted, or not, by its own limits on metrics."""
    failed = []
    for path, limit in limits.items():
        found = values.get(grade.figure(path))
        if found is None:
            failed.append(f"{path} was not computed")
            continue
        judged = grade.judge(path, limit, found)
        if judged.value is None:
            count = np.size(found)
            failed.append(f"{path}: the figure has {count} value{'s' if count > 1 else ''}")
        elif not judged.met:
            failed.append(f"{path} = {judged.value:.4g} is beyond its accept limit {limit:g}")
    return Stop("complete", "; ".join(failed), 1 if failed else 0)
