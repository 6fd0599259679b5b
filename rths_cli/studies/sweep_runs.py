"""Play one run of a sweep by the pipeline of experiment/, keep only its errors; what runs share is computed once."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.metrics import room_for_pairs
from rths_cli.errors import InputError, RthsError, crash_note, out_of_memory
from rths_cli.experiment import run_metrics, true_reference
from rths_cli.experiment.check_command import Verdict, verdict_on
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache, key
from rths_cli.experiment.one_table_run import (
    HYBRID_TEST,
    errors_of,
    plan_run,
    play_run,
    run_of,
    true_accelerations,
)
from rths_cli.experiment.provenance import model_sha256
from rths_cli.experiment.run_case import (
    acceptance,
    change_of_residual_drift,
    measures_of,
    response_metrics,
    sim_of,
    truth_of,
    why_none,
    why_unsafe,
)
from rths_cli.experiment.session import session_key, wants_session_record
from rths_cli.experiment.setup import building_key, make_setup, motion_key
from rths_cli.findings import sentences
from rths_cli.loop.run_log import Log, Sizes, empty_log
from rths_cli.numerics.compiled import processor
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.rigs.from_case import laboratory_number
from rths_cli.studies.sweep_table import RESPONSES, RUN, Column, Row, columns, flat, width

if TYPE_CHECKING:
    from rths_cli.analysis.sim import Response
    from rths_cli.case.case_schema import Case
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.model_choice import IdentifiedModel
    from rths_cli.experiment.one_table_run import RunPlan, Stop
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.experiment.true_reference import TrueReference
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values

# of what a run computes
NO_PART = {
    "path", "yaml_text", "name", "notes", "seed", "runs", "accept", "reference", "report_in",
}  # fmt: skip
RESPONSE = {f"{RUN}.{name}" for name in RESPONSES}  # what needs the motion of the whole building
MOTION = {"record", "scaling", "scale", "record_filter", "delay_s"}  # what no block depends on


@dataclass(frozen=True)
class Keys:
    """What a grid point depends on, in all and stage by stage: points with equal keys share the stage.

    `content` is the same for any version of rths.
    """

    content: str
    model: str
    design: str
    check: str


@dataclass(frozen=True)
class Ready:
    """A grid point ready to be played with any seed: its run of EXP-RTHS and the SIM that its errors are measured
    against, None where `refused` says why it is not played; `truth` where the specimen is another than declared,
    `drift_change_m` (n_storeys,) what 1 % of base shear makes of SIM's residual drift where storeys have laws."""

    setup: Setup
    checked: Verdict
    refused: str
    plan: RunPlan | None = None
    sim: Response | None = None
    truth: TrueReference | None = None
    drift_change_m: Array | None = None
    figures: Values = field(default_factory=dict)  # of the check, and of SIM where they are asked for
    sim_alone: bool = False  # whether no run is played


class Shared:
    """Make what grid points share, and keep the last of each kind."""

    def __init__(
        self, overrides: tuple[str, ...], progress: Progress, metrics: Sequence[str] = (), sim_alone: bool = False
    ) -> None:
        """`metrics`: paths that are asked for beside those of every table; `sim_alone`: no run is played."""
        self._overrides, self._progress = overrides, progress
        self._of_sim, self._of_ground = (any(path.startswith(f"{of}.") for path in metrics) for of in ("sim", "ground"))
        self._sim_alone = sim_alone
        self._values = SharedValues()

    def setup(self, case: Case) -> Setup:
        """Return the case's setup, its model file read and its excitation planned; raises InputError."""
        setup = make_setup(case, self._overrides, self._values)
        if case.recorded:
            raise InputError(
                f"{next(iter(case.recorded))}: is a recorded run, which no sweep can vary; judge each recording by "
                "rths evaluate, rths report compares their results"
            )
        if not setup.rig.can.counts_steps:
            raise InputError(
                f"table: rig {setup.rig.name} is of kind {setup.rig.kind}, and a sweep moves no real table; "
                "name a virtual rig"
            )
        self._memory(setup).prepare(setup)
        return setup

    def keys(self, setup: Setup) -> Keys:
        """Return what a setup depends on, stage by stage."""
        case, model = setup.case, _model_key(setup) + (session_key(setup) if wants_session_record(setup) else "")
        table = {"name", "after_identification"}
        part = repr(case.model_dump(exclude={**dict.fromkeys(NO_PART | MOTION, True), "table": table}))
        motion = repr((motion_key(case), case.delay_s))
        plant = repr((case.table.model_dump_json(), building_key(case), case.sample_rate_hz))
        named = case.identification.model
        content = part + motion + plant + (_digest(named.read_bytes()) if named else "")
        stages = (content, model, model + part, model + part + motion)
        return Keys(*(_digest(text.encode()) for text in stages))

    def identify(self, case: Case) -> None:
        """Identify the rig of a case unless its model is known; the cache keeps it for other processes."""
        setup = self.setup(case)
        self._memory(setup).known(setup, self._progress)

    def ready(self, case: Case) -> Ready:
        """Return a grid point ready to be played; raises RthsError when its rig cannot be identified."""
        setup, values = self.setup(case), self._values
        keys = self.keys(setup)
        known = values.get("known", keys.model, lambda: self._memory(setup).known(setup, self._progress))
        checked = values.get("check", (keys.check, self._overrides), lambda: self._verdict(setup, known, keys))
        figures = dict(checked.figures)
        if self._of_sim:
            figures |= response_metrics("sim", setup.building, sim_of(setup, values))
        if self._of_ground:
            figures |= measures_of(setup, values)
        if self._sim_alone:
            return Ready(setup, checked, "", figures=figures, sim_alone=True)
        unsafe = why_unsafe(setup, checked)
        why = why_none(setup, known, checked) or ((unsafe,) if unsafe else ())
        refused = "; ".join(sentences(why))
        if refused or checked.design is None:
            return Ready(setup, checked, refused, figures=figures)
        sim = sim_of(setup, values)
        truth = truth_of(setup, sim, values, self._progress) if true_reference.is_another(setup) else None
        change_m = None if setup.building.linear else change_of_residual_drift(setup, sim, values)
        drifting = known.found if laboratory_number(setup.case) is not None else None
        plan = plan_run(setup, checked.design, HYBRID_TEST, drifting, checked.planned.get(HYBRID_TEST.name))
        return Ready(setup, checked, "", plan, sim, truth, change_m, figures)

    def _memory(self, setup: Setup) -> Memory:
        return self._values.get("memory", _model_key(setup), lambda: Memory(Cache()))

    def _verdict(self, setup: Setup, known: IdentifiedModel, keys: Keys) -> Verdict:
        self._progress("check")
        values = self._values
        try:
            design: Design | None = values.get("design", keys.design, lambda: design_blocks(setup, known.found, values))
        except InputError:
            design = None  # the verdict says why
        return verdict_on(setup, known, design=design, shared=values, table_test=False)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _model_key(setup: Setup) -> str:
    """Return what a model depends on; a named one is verified on the rig as it is after its identification."""
    return key(setup) + (setup.case.table.model_dump_json() if setup.case.identification.model else "")


_THREAD = threading.local()


def play_variant(ready: Ready, variant: int, seed: int, of: Sequence[Column], storeys: int) -> Row:
    """Return the row of one run of a grid point; its figures depend on the point and the seed alone.

    `storeys`: how many a row has room for. What fails is a row of status failed.
    """
    checked = ready.checked
    model = model_sha256(checked.design.model) if checked.design else ""
    figures = flat(of, storeys, ready.figures)
    row = Row(variant, "refused", ready.refused, 1, checked.verdict, model, processor_name(), figures)
    if ready.sim_alone:
        return replace(row, status="complete", exit_code=0)
    if ready.plan is None or ready.sim is None:
        return row
    try:
        stop, errors = _played(ready, ready.plan, ready.sim, seed, any(column.path in RESPONSE for column in of))
    except Exception as error:
        return failed(row, error)
    values = {**ready.figures, **errors}
    stop = stop or _accepted(ready, values)
    figures = flat(of, storeys, values)
    return replace(row, status=stop.status, reason=stop.reason, exit_code=stop.exit_code, figures=figures)


def not_ready(variant: int, of: Sequence[Column], storeys: int, error: Exception) -> Row:
    """Return the row of a run whose grid point an error kept from being made ready."""
    return failed(Row(variant, "", "", 0, "", "", processor_name(), np.full(width(of, storeys), np.nan)), error)


@cache
def processor_name() -> str:
    """Return the name of this processor, with a hash of the instructions and settings that code is compiled for.

    Rows of processors with equal texts are equal to the last bit.
    """
    told = processor()
    return f"{told.split(' ', 1)[0]} {_digest(told.encode())[:12]}"


def failed(row: Row, error: Exception) -> Row:
    """Return the row of a run that an error ended."""
    if isinstance(error, RthsError):
        return replace(row, status="failed", reason=str(error), exit_code=error.exit_code)
    if told := out_of_memory(error):
        return replace(row, status="failed", reason=told, exit_code=2)
    reason = f"internal error ({type(error).__name__}), {crash_note()}"
    return replace(row, status="failed", reason=reason, exit_code=5)


def _played(ready: Ready, plan: RunPlan, sim: Response, seed: int, response: bool) -> tuple[Stop | None, Values]:
    """Return why a run ended early and no figures, or None, its errors and the response of its laws by path; with
    `response` the building's too."""
    setup, design = plan.setup, plan.design
    outcome = play_run(plan, seed, _log(plan, response) if plan.expected is None else None)
    only = setup.building.linear and not response
    run = run_of(outcome, setup, plan.kind, design.blocks.lead_samples, plan.expected, only_accelerations=only)
    if run.stopped is not None:
        return run.stopped, {}
    room = _room(2 + 2 * len(sim.abs_accel_m_s2), sim.abs_accel_m_s2.shape[1])
    values = dict(errors_of(run, setup, sim, room))
    if run.building is not None and response:
        motion = run.building
        values |= run_metrics.of_building(RUN, setup.building, motion.rel_disp_m, motion.abs_accel_m_s2)
    if run.building is not None and run.series.law_force_n is not None:
        values |= run_metrics.of_laws(RUN, setup.building, run.building.rel_disp_m, run.series.law_force_n)
        if ready.drift_change_m is not None:
            values |= true_reference.residual_drift_metrics(setup, sim, ready.drift_change_m, values)
    if ready.truth is not None and (accel := true_accelerations(run, setup)) is not None:
        values |= true_reference.true_reference_metrics(setup, ready.truth, accel, values)
    return None, values


def _room(pairs: int, samples: int) -> Array:
    """Return this thread's memory for the errors of a run: the next run of the same size uses it again."""
    asked = (pairs, samples)
    if getattr(_THREAD, "asked", None) != asked:
        _THREAD.asked, _THREAD.room = asked, room_for_pairs(*asked)
    room: Array = _THREAD.room
    return room


def _log(plan: RunPlan, response: bool) -> Log:
    """Return this thread's log, lean where every storey is measured and no `response` is asked for: the next run of
    the same size uses it again."""
    blocks, building, info = plan.design.blocks, plan.setup.building, plan.setup.rig
    channels, estimates = len(info.channels), len(blocks.estimator.C)
    lean = len(building.numerical.masses_kg) == 1 and building.linear and not response
    asked = (len(plan.drive), Sizes(channels, estimates, len(blocks.logs), further=len(info.further)), lean, channels)
    if getattr(_THREAD, "logged", None) != asked:
        _THREAD.logged, _THREAD.log = asked, empty_log(*asked)
    log: Log = _THREAD.log
    return log


def _accepted(ready: Ready, values: Values) -> Stop:
    """Return how a whole run ends, by the accept limits on figures that a sweep computes, kept or not."""
    known = {column.path for column in columns()}
    limits = {path: limit for path, limit in ready.setup.case.accept.items() if path.partition("[")[0] in known}
    return acceptance(limits, {path: value for path, value in values.items() if path in known})
