"""Run cases: identify, design, SIM, SIM-DELAY, shake-table test, EXP-RTHS, and write one result file each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rths_cli.analysis.critical_delay import critical_delay
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.case.load import resolved_yaml
from rths_cli.files.results import Metric, ResultWriter, check_writable
from rths_cli.loop import guard
from rths_cli.loop.blocks import NUMERICAL, RECORD
from rths_cli.loop.drive import Outcome, play
from rths_cli.workflows import budget, contents, figures, merit
from rths_cli.workflows.check_cases import Verdict, verdict_on
from rths_cli.workflows.kept import Kept
from rths_cli.workflows.known import Known, Memory
from rths_cli.workflows.provenance import attributes
from rths_cli.workflows.rigs import EXP_RTHS, SHAKE_TABLE, guard_limits, open_rig
from rths_cli.workflows.series import Series, on_record_clock, whole_building
from rths_cli.workflows.setup import Progress, Setup, building_key, make_setups, motion_key, shown
from rths_cli.workflows.warnings import of_case

if TYPE_CHECKING:
    from rths_cli.analysis.sim import Response
    from rths_cli.analysis.sim_delay import DelayedResponse
    from rths_cli.case.models import Case
    from rths_cli.lti import Array
    from rths_cli.workflows.controllers import Design

BYTES_PER_SAMPLE = 600  # of a result file, for the check of free space
INTERRUPTIONS = {guard.INTERRUPT: 130, guard.TERMINATION: 143}  # exit codes of orders that came by signals


@dataclass(frozen=True)
class Ended:
    """How one case ended: its file (None when nothing was written), status, reason and exit code."""

    name: str
    path: Path | None
    status: str
    reason: str
    exit_code: int
    warnings: tuple[str, ...] = ()
    replaced: bool = False


@dataclass(frozen=True)
class Stop:
    """Why a run ended early: the status of its file and the exit code that goes with it."""

    status: str
    reason: str
    exit_code: int


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


def prepare_all(
    cases: Sequence[Case], output: Path, overrides: tuple[str, ...] = (), kept: Kept | None = None
) -> list[Setup]:
    """Read and check everything of every case before the first one starts; raises InputError with all faults."""
    setups = make_setups(cases, overrides, kept)
    samples = sum(len(setup.motion.time_s) for setup in setups)
    check_writable(output, BYTES_PER_SAMPLE * samples)
    return setups


def moves_table(case: Case) -> bool:
    """Tell whether a case has a run on the table."""
    return bool({"shake_table", "exp_rths"} & set(case.runs))


def run_case(
    setup: Setup,
    path: Path,
    memory: Memory,
    command_line: str,
    progress: Progress,
    kept: Kept | None = None,
    stage: Stage | None = None,
) -> Ended:
    """Run one case and write its result file; raises InputError when it cannot be run or written.

    With `kept`, cases share what they have in common. `stage` plays the runs, on a virtual rig when there is none.
    """
    case, kept = setup.case, kept or Kept()
    known = memory.known(setup, progress) if moves_table(case) else None
    checked = verdict_on(setup, known, "exp_rths" in case.runs, kept=kept) if known else None
    cautions, replaced = _cautions(setup, known, checked), path.exists()
    with ResultWriter(path, _attributes(setup, checked, known, command_line, cautions)) as writer:
        writer.case(case.yaml_text, resolved_yaml(case))
        contents.write_record(writer, setup)
        sim, values = _simulations(setup, writer, kept, progress)
        stop = None
        if known is not None and checked is not None:
            stop, measured = _on_table(setup, known, checked, sim, writer, progress, stage or VirtualStage())
            values |= measured
        writer.metrics(values)
        if stop is None:
            stop = acceptance(case.accept, values)
        writer.finish(stop.status, stop.reason)  # type: ignore[arg-type]
    if stage is not None:
        stage.written()
    return Ended(case.name, path, stop.status, stop.reason, stop.exit_code, cautions, replaced)


def _cautions(setup: Setup, known: Known | None, checked: Verdict | None) -> tuple[str, ...]:
    """Return what a user should read before trusting the result."""
    said = of_case(setup, known.found if known else None, checked.design if checked else None)
    if checked is None or not checked.refused or "check" not in setup.overrides:
        return said
    return (*said, f"the check of EXP-RTHS is overridden, it says {checked.verdict}: {'; '.join(checked.reasons)}")


def _attributes(
    setup: Setup, checked: Verdict | None, known: Known | None, command_line: str, cautions: Sequence[str]
) -> dict[str, str | int | float]:
    """Return the root attributes of the result file."""
    model = {"model_source": known.source if known else "", "warnings": "\n".join(cautions)}
    verdict = {"check_verdict": checked.verdict if checked else ""}
    return attributes(setup, checked.design if checked else None, command_line) | model | verdict


def _on_table(
    setup: Setup, known: Known, checked: Verdict, sim: Response, writer: ResultWriter, progress: Progress, stage: Stage
) -> tuple[Stop | None, dict[str, Metric]]:
    """Write what is known of rig and blocks, play the table runs; return what stopped one first and the figures."""
    design = checked.design
    if design is None:
        return Stop("refused", "; ".join(checked.reasons), 1), {}
    contents.write_identification(writer, known.found, design)
    contents.write_controller(writer, design)
    values = contents.design_figures(setup, known.found, design) | checked.figures
    rejected = known.faults(setup.overrides)
    if rejected:
        return Stop("refused", rejected[0], 1), values
    stop, measured = _experiments(setup, checked, design, sim, writer, progress, stage)
    return stop, values | measured


def _refusal(setup: Setup, checked: Verdict) -> Stop | None:
    """Return why EXP-RTHS is not run, None when it is safe or when that is overridden."""
    if not checked.refused or "check" in setup.overrides:
        return None
    advice = (
        f"rths check {shown(setup.case.path)} with the same options tells more, --override check runs it all the same"
    )
    return Stop("refused", f"EXP-RTHS refused, {checked.verdict}: {'; '.join(checked.reasons)}; {advice}", 1)


def _simulations(
    setup: Setup, writer: ResultWriter, kept: Kept, progress: Progress
) -> tuple[Response, dict[str, Metric]]:
    """Write SIM and SIM-DELAY; return SIM, which every error is measured against, and the figures."""
    case, dt, ground = setup.case, setup.rig.dt_s, setup.motion.accel_m_s2
    asked = (motion_key(case), building_key(case))
    progress("SIM")
    sim = kept.get("sim", asked, lambda: simulate(setup.building, dt, ground))
    values: dict[str, Metric] = {}
    if "sim" in case.runs:
        contents.write_response(writer, "sim", setup, sim)
        values |= figures.solution_error("sim", sim.error_estimate)
    if "sim_delay" in case.runs:
        progress(f"SIM-DELAY, {1e3 * case.delay_s:g} ms")
        delayed, found = kept.get("sim_delay", (*asked, case.delay_s), lambda: _sim_delay(setup, sim))
        contents.write_response(writer, "sim_delay", setup, delayed)
        values |= found
    return sim, values


def _sim_delay(setup: Setup, sim: Response) -> tuple[DelayedResponse, dict[str, Metric]]:
    """Return SIM-DELAY and its figures."""
    dt, building = setup.rig.dt_s, setup.building
    delayed = simulate_delayed(building, dt, setup.motion.accel_m_s2, setup.case.delay_s, sim=sim)
    values = figures.against_sim("sim_delay", sim.abs_accel_m_s2, delayed.abs_accel_m_s2, None, dt)
    values |= figures.solution_error("sim_delay", delayed.error_estimate)
    values |= figures.critical(critical_delay(building))
    if delayed.diverged_at_s is not None:
        values["sim_delay.diverged_at_s"] = figures.scalar(delayed.diverged_at_s, "s", "when SIM-DELAY was cut")
    return delayed, values


def _experiments(
    setup: Setup,
    checked: Verdict,
    design: Design,
    sim: Response,
    writer: ResultWriter,
    progress: Progress,
    stage: Stage,
) -> tuple[Stop | None, dict[str, Metric]]:
    """Play the table runs of the case, write them, and return what stopped one first and the figures."""
    stop: Stop | None = None
    values: dict[str, Metric] = {}
    for run in TABLE_RUNS:
        if run.name not in setup.case.runs or (stop is not None and setup.rig.kind != "virtual"):
            continue
        if run.source == NUMERICAL and (refusal := _refusal(setup, checked)):
            stop = replace(stop, reason=f"{stop.reason}; {refusal.reason}") if stop else refusal
            continue
        progress(f"{run.label}, {setup.case.table.kind} table")
        outcome = stage.play(setup, design, run, writer)
        series = on_record_clock(outcome, design.blocks.lead_samples, setup.rig.dt_s, len(setup.motion.time_s))
        stopped = why_ended(run.label, outcome, setup.rig.dt_s)
        stop = stop or stopped
        hybrid = _hybrid(setup, series) if run.source == NUMERICAL else None
        contents.write_table_run(writer, run.name, setup, series, hybrid)
        if stopped is None:
            values |= _figures(setup, run.name, series, sim, hybrid)
        if stopped is None and hybrid is not None:
            values |= budget.of_exp_rths(checked.loop, series, hybrid[2], sim)
    return stop, values


class Stage(Protocol):
    """Where the runs of a case are played."""

    def play(self, setup: Setup, design: Design, run: TableRun, writer: ResultWriter) -> Outcome:
        """Play one run; the result file may be closed meanwhile."""

    def written(self) -> None:
        """Take note that the result file holds everything that was played."""


class VirtualStage:
    """Plays on virtual rigs, in no time."""

    def play(self, setup: Setup, design: Design, run: TableRun, writer: ResultWriter) -> Outcome:
        """Play one run."""
        return play_run(setup, design, run.source, run.stream)

    def written(self) -> None:
        """Do nothing: nothing was kept elsewhere."""


def play_run(setup: Setup, design: Design, source: int, stream: int) -> Outcome:
    """Play the ground motion through the blocks and the rig: directly (RECORD) or through the numerical part."""
    rig = open_rig(setup, (stream,), setup.case.seed)
    return play(rig, setup.rig, design.blocks, source, drive_of(setup, design), guard_limits(setup))


def drive_of(setup: Setup, design: Design) -> Array:
    """Return the ground's acceleration, velocity and displacement (n + lead, 3); its clock ends before the table's."""
    motion, lead = setup.motion, design.blocks.lead_samples
    drive = np.column_stack([motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m])
    return np.vstack([drive, np.repeat(drive[-1:], lead, axis=0)])


def _hybrid(setup: Setup, series: Series) -> tuple[Array, Array, Array]:
    """Return displacement, velocity and acceleration of the whole building in a hybrid test."""
    dt, scheme = setup.rig.dt_s, setup.case.integration
    return whole_building(setup.building, series, setup.motion.accel_m_s2, dt, scheme)


def _figures(
    setup: Setup, run: str, series: Series, sim: Response, hybrid: tuple[Array, Array, Array] | None
) -> dict[str, Metric]:
    """Return the figures of a table run that reached the end of the record."""
    dt, virtual = setup.rig.dt_s, setup.rig.kind == "virtual"
    values = figures.tracking(run, series.desired[0], series.measured[0], series.true_accel[0] if virtual else None, dt)
    if hybrid is not None:
        values |= figures.against_sim(
            run, sim.abs_accel_m_s2, hybrid[2], true_accel(hybrid[2], series) if virtual else None, dt
        )
    return values | merit.of_table_run(setup, run, series, sim, hybrid)


def true_accel(abs_accel: Array, series: Series) -> Array:
    """Return the storeys' accelerations with true ones on table and specimen in place of the measured."""
    computed = abs_accel[: len(abs_accel) - len(series.true_accel)]
    return np.vstack([computed, series.true_accel]) if len(computed) else series.true_accel


def why_ended(label: str, outcome: Outcome, dt_s: float) -> Stop | None:
    """Return why a run did not reach its end, None when it did."""
    fault, limit = outcome.rig_fault, outcome.stopped_by_limit
    if not (fault or limit):
        return None
    if fault and outcome.reason in (guard.RIG_FAULT, guard.LOST):
        limit = ""  # the fault says more
    said = f"{label}: {'; '.join(filter(None, (limit, fault)))} at {outcome.stopped_at_s:.3f} s"
    if outcome.reason in INTERRUPTIONS:
        return Stop(
            "interrupted", said + ("" if fault else ", the table was led to rest"), INTERRUPTIONS[outcome.reason]
        )
    if outcome.reason == guard.WATCHER_FAILED:
        return Stop("failed", said, 5)
    if fault or outcome.reason == guard.LOG_FAILED:
        return Stop("failed", said, 4)
    return Stop("aborted", said, 3)


def acceptance(limits: Mapping[str, float], values: Mapping[str, Metric]) -> Stop:
    """Return how a completed case ends: accepted, or refused by one of its own limits on figures."""
    failed = []
    for path, limit in limits.items():
        name, _, index = path.partition("[")
        if name not in values:
            failed.append(f"{path} was not computed")
            continue
        value = np.atleast_1d(np.asarray(values[name].value, dtype=float))
        if index and int(index[:-1]) > value.size:
            failed.append(f"{path}: the figure has {value.size} value{'s' if value.size > 1 else ''}")
            continue
        chosen = value[int(index[:-1]) - 1] if index else value[np.argmax(np.abs(value))]
        if not abs(chosen) <= limit:  # a signed figure is limited either way
            failed.append(f"{path} = {chosen:.4g} is beyond its accept limit {limit:g}")
    return Stop("complete", "; ".join(failed), 1 if failed else 0)
