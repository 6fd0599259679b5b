"""Run cases: identify, design, SIM, SIM-DELAY, shake-table test, EXP-RTHS, and write one result file each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.critical_delay import critical_delay
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.case.load import resolved_yaml
from rths_cli.errors import InputError
from rths_cli.files.results import Metric, ResultWriter, check_writable
from rths_cli.loop.blocks import NUMERICAL, RECORD
from rths_cli.loop.drive import Outcome, play
from rths_cli.workflows import budget, contents, figures, merit
from rths_cli.workflows.controllers import Design, design_blocks
from rths_cli.workflows.known import Known, Memory
from rths_cli.workflows.provenance import attributes
from rths_cli.workflows.rigs import EXP_RTHS, SHAKE_TABLE, guard_limits, open_rig
from rths_cli.workflows.series import Series, on_record_clock, whole_building
from rths_cli.workflows.setup import Progress, Setup, make_setup
from rths_cli.workflows.warnings import of_case

if TYPE_CHECKING:
    from rths_cli.analysis.sim import Response
    from rths_cli.case.models import Case
    from rths_cli.identification.evaluate import Identification
    from rths_cli.lti import Array

BYTES_PER_SAMPLE = 600  # of a result file, for the check of free space


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


def prepare_all(cases: Sequence[Case], output: Path, overrides: tuple[str, ...] = ()) -> list[Setup]:
    """Read and check everything of every case before the first one starts; raises InputError with all faults."""
    setups, faults = [], []
    for case in cases:
        try:
            setups.append(make_setup(case, overrides))
        except InputError as error:
            faults += [f"{case.path}: {fault}" if str(case.path) not in fault else fault for fault in error.faults]
    if faults:
        raise InputError(*faults)
    samples = sum(len(setup.motion.time_s) for setup in setups)
    check_writable(output, BYTES_PER_SAMPLE * samples)
    return setups


def moves_table(case: Case) -> bool:
    """Tell whether a case has a run on the table."""
    return bool({"shake_table", "exp_rths"} & set(case.runs))


def run_case(setup: Setup, path: Path, memory: Memory, command_line: str, progress: Progress) -> Ended:
    """Run one case and write its result file; raises InputError when it cannot be run or written."""
    case = setup.case
    known, identified, design = None, None, None
    if moves_table(case):
        known = memory.known(setup, progress)
        identified = known.found
        try:
            design = design_blocks(setup, identified)
        except InputError as error:
            return Ended(case.name, None, "refused", str(error), 1)
    cautions, replaced = of_case(setup, identified, design), path.exists()
    with ResultWriter(path, _attributes(setup, design, known, command_line, cautions)) as writer:
        writer.case(case.yaml_text, resolved_yaml(case))
        contents.write_record(writer, setup)
        sim, values = _simulations(setup, writer, progress)
        stop = None
        if known is not None and identified is not None and design is not None:
            contents.write_identification(writer, identified, design)
            contents.write_controller(writer, design)
            values |= contents.design_figures(setup, identified, design)
            stop = _verdict(setup, known)
            if stop is None:
                stop, measured = _experiments(setup, identified, design, sim, writer, progress)
                values |= measured
        writer.metrics(values)
        if stop is None:
            stop = _acceptance(case, values)
        writer.finish(stop.status, stop.reason)  # type: ignore[arg-type]
    return Ended(case.name, path, stop.status, stop.reason, stop.exit_code, cautions, replaced)


def _attributes(
    setup: Setup, design: Design | None, known: Known | None, command_line: str, cautions: Sequence[str]
) -> dict[str, str | int | float]:
    """Return the root attributes of the result file."""
    model = {"model_source": known.source if known else "", "warnings": "\n".join(cautions)}
    return attributes(setup, design, command_line) | model


def _verdict(setup: Setup, known: Known) -> Stop | None:
    """Refuse the table runs with a model that was rejected, then or now, unless that is overridden."""
    reasons = [*(() if known.found.accepted else known.found.reasons), *known.reasons]
    if not reasons or "model" in setup.overrides:
        return None
    advice = "improve the identification, or add --override model"
    return Stop("refused", f"identified model rejected: {'; '.join(reasons)}; {advice}", 1)


def _simulations(setup: Setup, writer: ResultWriter, progress: Progress) -> tuple[Response, dict[str, Metric]]:
    """Write SIM and SIM-DELAY; return SIM, which every error is measured against, and the figures."""
    case, dt = setup.case, setup.rig.dt_s
    ground = setup.motion.accel_m_s2
    progress("SIM")
    sim = simulate(setup.building, dt, ground)
    values: dict[str, Metric] = {}
    if "sim" in case.runs:
        contents.write_response(writer, "sim", setup, sim)
        values |= figures.solution_error("sim", sim.error_estimate)
    if "sim_delay" in case.runs:
        progress(f"SIM-DELAY, {1e3 * case.delay_s:g} ms")
        delayed = simulate_delayed(setup.building, dt, ground, case.delay_s)
        contents.write_response(writer, "sim_delay", setup, delayed)
        values |= figures.against_sim("sim_delay", sim.abs_accel_m_s2, delayed.abs_accel_m_s2, None, dt)
        values |= figures.solution_error("sim_delay", delayed.error_estimate)
        values |= figures.critical(critical_delay(setup.building))
        if delayed.diverged_at_s is not None:
            values["sim_delay.diverged_at_s"] = figures.scalar(delayed.diverged_at_s, "s", "when SIM-DELAY was cut")
    return sim, values


def _experiments(
    setup: Setup, identified: Identification, design: Design, sim: Response, writer: ResultWriter, progress: Progress
) -> tuple[Stop | None, dict[str, Metric]]:
    """Play the table runs of the case, write them, and return what stopped one first and the figures."""
    stop: Stop | None = None
    values: dict[str, Metric] = {}
    for run, source, stream, label in (
        ("shake_table", RECORD, SHAKE_TABLE, "shake-table test"),
        ("exp_rths", NUMERICAL, EXP_RTHS, "EXP-RTHS"),
    ):
        if run not in setup.case.runs or (stop is not None and setup.rig.kind != "virtual"):
            continue
        progress(f"{label}, {setup.case.table.kind} table")
        outcome = play_run(setup, design, source, stream)
        series = on_record_clock(outcome, design.blocks.lead_samples, setup.rig.dt_s, len(setup.motion.time_s))
        stopped = _why(label, outcome, setup.rig.dt_s)
        stop = stop or stopped
        hybrid = _hybrid(setup, series) if run == "exp_rths" else None
        contents.write_table_run(writer, run, setup, series, hybrid)
        if stopped is None:
            values |= _figures(setup, run, series, sim, hybrid)
        if stopped is None and hybrid is not None:
            values |= budget.of_exp_rths(setup, identified, design, series, hybrid[2], sim)
    return stop, values


def play_run(setup: Setup, design: Design, source: int, stream: int) -> Outcome:
    """Play the ground motion through the blocks and the rig: directly (RECORD) or through the numerical part."""
    motion, lead = setup.motion, design.blocks.lead_samples
    drive = np.column_stack([motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m])
    drive = np.vstack([drive, np.repeat(drive[-1:], lead, axis=0)])  # the hybrid clock ends before the table does
    rig = open_rig(setup, (stream,), setup.case.seed)
    return play(rig, setup.rig, design.blocks, source, drive, guard_limits(setup))


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
            run, sim.abs_accel_m_s2, hybrid[2], _true_accel(hybrid[2], series) if virtual else None, dt
        )
    return values | merit.of_table_run(setup, run, series, sim, hybrid)


def _true_accel(abs_accel: Array, series: Series) -> Array:
    """Return the storeys' accelerations with true ones on table and specimen in place of the measured."""
    return np.vstack([abs_accel[: len(abs_accel) - len(series.true_accel)], series.true_accel])


def _why(label: str, outcome: Outcome, dt_s: float) -> Stop | None:
    """Return why a run did not reach its end, None when it did."""
    if outcome.rig_fault:
        return Stop("failed", f"{label}: {outcome.rig_fault} at {outcome.steps * dt_s:.3f} s", 4)
    if outcome.stopped_by_limit:
        return Stop("aborted", f"{label}: {outcome.stopped_by_limit} at {outcome.stopped_at_s:.3f} s", 3)
    return None


def _acceptance(case: Case, values: dict[str, Metric]) -> Stop:
    """Return how a completed case ends: accepted, or refused by one of its own limits."""
    failed = []
    for path, limit in case.accept.items():
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
