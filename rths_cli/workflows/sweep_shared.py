"""What the runs of a sweep share, made once: model, design, check, SIM and the table's plant."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.sim import simulate
from rths_cli.errors import InputError
from rths_cli.workflows.check_cases import Verdict, verdict_on
from rths_cli.workflows.controllers import design_blocks
from rths_cli.workflows.kept import Kept
from rths_cli.workflows.known import Memory
from rths_cli.workflows.model_store import Cache, key
from rths_cli.workflows.rigs import EXP_RTHS, guard_limits, open_virtual
from rths_cli.workflows.setup import building_key, make_setup, motion_key
from rths_cli.workflows.table_runs import drive_of

if TYPE_CHECKING:
    from rths_cli.case.models import Case
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.lti import Array
    from rths_cli.rigs.virtual.plant import Plant
    from rths_cli.workflows.controllers import Design
    from rths_cli.workflows.known import Known
    from rths_cli.workflows.setup import Progress, Setup

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
        self._kept = Kept()

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
        return verdict_on(setup, known, design=design, kept=kept)


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
