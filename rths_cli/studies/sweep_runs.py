"""The runs of a sweep: what they share is made once, each is played with its seed and its series dropped."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.metrics import room_for_pairs
from rths_cli.analysis.sim import simulate
from rths_cli.errors import InputError, RthsError, crash_note
from rths_cli.experiment.check_cases import Verdict, verdict_on
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.lowest_frequency import lowest_reliable_hz
from rths_cli.experiment.model_registry import Memory
from rths_cli.experiment.model_store import Cache, key
from rths_cli.experiment.provenance import model_sha256
from rths_cli.experiment.rig_access import EXP_RTHS, guard_limits, open_virtual
from rths_cli.experiment.run import acceptance
from rths_cli.experiment.run_series import on_record_clock, whole_building
from rths_cli.experiment.setup import building_key, make_setup, motion_key
from rths_cli.experiment.table_runs import Stop, drive_of, true_accel, why_ended
from rths_cli.loop.counted_clock import play
from rths_cli.loop.run_log import Log, empty_log
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.rigs.virtual.virtual_rig import VirtualRig
from rths_cli.studies.sweep_table import Column, Row, error_values, flat

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.case.case_schema import Case
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.model_registry import Known
    from rths_cli.experiment.run_series import Series
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.numerics.lti import Array
    from rths_cli.rigs.virtual.plant import Plant

NO_PART = {"path", "yaml_text", "name", "notes", "seed", "runs", "accept", "reference"}  # of what a run computes
MOTION = {"record", "scaling", "record_filter", "delay_s"}  # what no block depends on


@dataclass(frozen=True)
class Keys:
    """What a grid point depends on, in all and stage by stage: points with equal keys share the stage.

    `content` is the same for any version of rths.
    """

    content: str
    model: str
    design: str
    check: str
    plant: str


@dataclass(frozen=True)
class Ready:
    """A grid point ready to be played with any seed.

    `refused` says why it is not played (empty: it is); `sim_accel` (n_storeys, n) in m/s^2, `drive` (n + lead, 3).
    """

    setup: Setup
    checked: Verdict
    refused: str
    sim_accel: Array
    drive: Array | None
    plant: Plant | None
    limits: GuardLimits | None


class Shared:
    """Make what grid points share, and keep the last of each kind."""

    def __init__(self, overrides: tuple[str, ...], progress: Progress) -> None:
        self._overrides = overrides
        self._progress = progress
        self._kept = SharedValues()

    def setup(self, case: Case) -> Setup:
        """Return the case's setup, its model file read and its excitation planned; raises InputError."""
        setup = make_setup(case, self._overrides, self._kept)
        if not setup.rig.can.counts_steps:
            raise InputError(
                f"table: rig {setup.rig.name} is of kind {setup.rig.kind}, and a sweep moves no real table; "
                "name a virtual rig"
            )
        self._memory(setup).prepare(setup)
        return setup

    def keys(self, setup: Setup) -> Keys:
        """Return what a setup depends on, stage by stage."""
        case, model = setup.case, _model_key(setup)
        table = {"name", "after_identification"}
        part = repr(case.model_dump(exclude={**dict.fromkeys(NO_PART | MOTION, True), "table": table}))
        motion = repr((motion_key(case), case.delay_s))
        plant = repr((case.table.model_dump_json(), building_key(case), case.sample_rate_hz))
        named = case.identification.model
        content = part + motion + plant + (_digest(named.read_bytes()) if named else "")
        stages = (content, model, model + part, model + part + motion, plant)
        return Keys(*(_digest(text.encode()) for text in stages))

    def ready(self, case: Case) -> Ready:
        """Return a grid point ready to be played; raises RthsError when its rig cannot be identified."""
        setup = self.setup(case)
        keys = self.keys(setup)
        known = self._kept.get("known", keys.model, lambda: self._memory(setup).known(setup, self._progress))
        checked = self._kept.get("check", (keys.check, self._overrides), lambda: self._verdict(setup, known, keys))
        refused = _refused(setup, known, checked)
        if refused or checked.design is None:
            return Ready(setup, checked, refused, np.zeros((0, 0)), None, None, None)
        motion = (motion_key(case), building_key(case))
        sim_accel = self._kept.get("sim", motion, lambda: _sim_accel(setup))
        plant = self._kept.get("plant", keys.plant, lambda: open_virtual(setup, (EXP_RTHS,), 0).plant)
        return Ready(setup, checked, "", sim_accel, drive_of(setup, checked.design), plant, guard_limits(setup))

    def _memory(self, setup: Setup) -> Memory:
        return self._kept.get("memory", _model_key(setup), lambda: Memory(Cache()))

    def _verdict(self, setup: Setup, known: Known, keys: Keys) -> Verdict:
        self._progress("check")
        kept = self._kept
        try:
            design: Design | None = kept.get("design", keys.design, lambda: design_blocks(setup, known.found, kept))
        except InputError:
            design = None  # the verdict says why
        return verdict_on(setup, known, design=design, shared=kept)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _model_key(setup: Setup) -> str:
    """Return what a model depends on; a named one is verified on the rig as it is after its identification."""
    return key(setup) + (setup.case.table.model_dump_json() if setup.case.identification.model else "")


def _refused(setup: Setup, known: Known, checked: Verdict) -> str:
    """Return why a grid point is not played, as `rths run` would refuse it; empty when it is played."""
    if checked.design is None:
        return "; ".join(checked.reasons)
    rejected = known.faults(setup.overrides)
    if rejected:
        return rejected[0]
    if checked.refused and "check" not in setup.overrides:
        return f"{checked.verdict}: {'; '.join(checked.reasons)}"
    return ""


def _sim_accel(setup: Setup) -> Array:
    return simulate(setup.building, setup.rig.dt_s, setup.motion.accel_m_s2).abs_accel_m_s2


_THREAD = threading.local()


def play_variant(ready: Ready, variant: int, seed: int, of: Sequence[Column], storeys: int) -> Row:
    """Return the row of one run of a grid point; its figures depend on the point and the seed alone.

    `storeys`: how many a row has room for. What fails is a row of status failed.
    """
    checked = ready.checked
    foretold: dict[str, ArrayLike] = dict(checked.figures)
    model = model_sha256(checked.design.model) if checked.design else ""
    row = Row(variant, "refused", ready.refused, 1, checked.verdict, model, flat(of, storeys, foretold))
    if ready.refused:
        return row
    try:
        stop, errors = _played(ready, seed, of, foretold)
    except Exception as error:
        return failed(row, error)
    figures = flat(of, storeys, foretold | errors)
    return replace(row, status=stop.status, reason=stop.reason, exit_code=stop.exit_code, figures=figures)


def failed(row: Row, error: Exception) -> Row:
    """Return the row of a run that an error ended."""
    if isinstance(error, RthsError):
        return replace(row, status="failed", reason=str(error), exit_code=error.exit_code)
    reason = f"internal error ({type(error).__name__}), {crash_note()}"
    return replace(row, status="failed", reason=reason, exit_code=5)


def _played(
    ready: Ready, seed: int, of: Sequence[Column], foretold: Mapping[str, ArrayLike]
) -> tuple[Stop, dict[str, Array]]:
    """Return how a run ended and, where it reached the end of the record, its errors by path."""
    setup, design = ready.setup, ready.checked.design
    assert design is not None and ready.drive is not None  # what is not refused is ready
    assert ready.plant is not None and ready.limits is not None
    rig = VirtualRig(setup.rig, ready.plant, (seed, EXP_RTHS))
    outcome = play(rig, setup.rig, design.blocks, NUMERICAL, ready.drive, ready.limits, _log(ready))
    stop = why_ended("EXP-RTHS", outcome, setup.rig.dt_s)
    if stop is not None:
        return stop, {}
    series = on_record_clock(outcome, design.blocks.lead_samples, setup.rig.dt_s, len(setup.motion.time_s))
    errors = _errors(ready, series)
    return _accepted(ready, of, {**foretold, **errors}), errors


def _errors(ready: Ready, series: Series) -> dict[str, Array]:
    """Return the errors of a run that reached the end of the record."""
    setup = ready.setup
    accel, dt = series.measured, setup.rig.dt_s
    if len(setup.building.numerical.masses_kg) > 1:  # else every storey is measured
        scheme = setup.case.integration
        accel = whole_building(setup.building, series, setup.motion.accel_m_s2, dt, scheme)[2]
    desired, true = series.desired[0], true_accel(accel, series)
    table = [(desired, series.measured[0]), (desired, series.true_accel[0])]
    sim = ready.sim_accel
    storeys, true_storeys = list(zip(sim, accel, strict=True)), list(zip(sim, true, strict=True))
    room, lowest_hz = _room(2 + 2 * len(sim), sim.shape[1], dt), lowest_reliable_hz(setup)
    return error_values(table, storeys, true_storeys, dt, room, lowest_hz)


def _room(pairs: int, samples: int, dt_s: float) -> Array:
    """Return this thread's memory for the errors of a run: the next run of the same size uses it again."""
    asked = (pairs, samples, dt_s)
    if getattr(_THREAD, "asked", None) != asked:
        _THREAD.asked, _THREAD.room = asked, room_for_pairs(*asked)
    room: Array = _THREAD.room
    return room


def _log(ready: Ready) -> Log:
    """Return this thread's log, lean where every storey is measured: the next run of the same size uses it again."""
    assert ready.drive is not None and ready.checked.design is not None
    channels, estimates = len(ready.setup.rig.channels), len(ready.checked.design.blocks.estimator.C)
    asked = (len(ready.drive), channels, estimates, len(ready.setup.building.numerical.masses_kg) == 1, channels)
    if getattr(_THREAD, "logged", None) != asked:
        _THREAD.logged, _THREAD.log = asked, empty_log(*asked)
    log: Log = _THREAD.log
    return log


def _accepted(ready: Ready, of: Sequence[Column], values: Mapping[str, ArrayLike]) -> Stop:
    """Return how a whole run ends, by the accept limits on figures that a sweep computes."""
    known = {column.path for column in of}
    limits = {path: limit for path, limit in ready.setup.case.accept.items() if path.partition("[")[0] in known}
    return acceptance(limits, {path: value for path, value in values.items() if path in known})
