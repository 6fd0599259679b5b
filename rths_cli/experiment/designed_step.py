"""The designed step of a case's EXP-RTHS with all that it needs to run somewhere else: blocks, limits of its guard,
ground motion, times of the states, checksums."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.stability_check import SAFE
from rths_cli.case.load import resolved_yaml
from rths_cli.control.designed_blocks import Blocks, cell_reads
from rths_cli.errors import InputError
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.design import loop_parts
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.one_table_run import BEFORE_S, HYBRID_TEST, plan_run
from rths_cli.experiment.provenance import model_sha256
from rths_cli.experiment.real_rig_readiness import LISTENING_S, NOISE_SHARE, ZERO_SHARE, guard_limits
from rths_cli.experiment.setup import Progress, Setup, make_setups, placed, refuse_unstable_steps, shown
from rths_cli.experiment.unit_plausibility import doubts
from rths_cli.loop.guard import GuardLimits, without_limits
from rths_cli.loop.identified_rig_run import Disturbed, play_identified, seen_by_model
from rths_cli.loop.realtime_run import RAMP_UP_S
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.identification.results import Identification


NUMBER_DIGITS = 12  # hexadecimal digits of a checksum that a double holds
REHEARSED = 1000  # instants of each rehearsal
GROWS = 600  # instants over which the strongest part of the record begins


@dataclass(frozen=True)
class Rehearsal:
    """A short ground motion, and what the channels show when the step plays it on the identified rig."""

    ground: Array  # (m, 3)
    shown_v: Array  # (m, c + f) without zeros, noise and sensors' dynamics


@dataclass(frozen=True)
class DesignedStep:
    """A step and its guard, ready to be run by another computer."""

    name: str  # of the case
    info: RigInfo
    blocks: Blocks
    limits: GuardLimits  # of this run, without zeros taken off
    drive: Array  # (n, 3) acceleration, velocity and displacement of the ground at k + n_p
    rehearsals: tuple[Rehearsal, Rehearsal]  # of the begin of the record, and of its strongest part
    zero_steps: int  # instants over which zeros are measured
    still_steps: int  # instants at rest before the ramp-up
    ramp_steps: int
    case_sha256: str = 64 * "0"
    model_sha256: str = 64 * "0"
    model: str = ""  # where the identified model is from, in words

    @property
    def rest_limits_v(self) -> tuple[Array, Array]:
        """Return the largest mean and noise (c + f,) of each channel at rest, as before a run on a real rig."""
        ranges = np.array([min(one.range_v, self.info.converters.range_v) for one in self.info.all_channels])
        zeros, noise = ZERO_SHARE * ranges, NOISE_SHARE * ranges
        for c, one in enumerate(self.info.all_channels):
            if "guard" in one.uses and one.kind == "displacement" and one.position == "table":
                centred = ZERO_SHARE * self.info.limits.stroke_m * one.sensitivity_v_per_unit
                zeros[c], noise[c] = min(zeros[c], centred), np.inf
        return zeros, noise


def designed_step(case: Case, progress: Progress) -> DesignedStep:
    """Return the step of a case's EXP-RTHS as `rths run` would play it; nothing moves.

    Raises InputError with every reason for which `rths run` would not play it on a real rig.
    """
    memory, setup = Memory(Cache()), make_setups([case])[0]
    if setup.rig.interface == "displacement":
        raise InputError(
            f"{shown(case.path)}: rig {setup.rig.name} commands a displacement, and the step in C is that of a table "
            "with accelerometers; name the case of a shake table"
        )
    refuse_unstable_steps(case, setup.building)
    _refuse_other_runs(setup)
    known = memory.at_rest(setup, progress)
    progress(f"check: {case.name}")
    found = verdict_on(setup, known, table_test=False)
    if found.verdict != SAFE or found.design is None:
        where = shown(case.path)
        raise InputError(*(f"{where}: {found.verdict}, its step is not written: {one}" for one in found.reasons))
    plan = plan_run(setup, found.design, HYBRID_TEST, planned=found.planned.get(HYBRID_TEST.name))
    blocks, dt_s = found.design.blocks, setup.rig.dt_s
    motions = plan.drive[:REHEARSED], strongest(plan.drive, dt_s)
    begin, strong = (Rehearsal(one, _shown_v(setup, known.found, blocks, one)) for one in motions)
    return DesignedStep(
        case.name, setup.rig, blocks, plan.limits, plan.drive, (begin, strong),
        round(LISTENING_S / dt_s), round(BEFORE_S / dt_s), round(RAMP_UP_S / dt_s),
        case_sha256(case), model_sha256(found.design.model), known.source,
    )  # fmt: skip


def case_sha256(case: Case) -> str:
    """Return the checksum of all that a case states, by which a target knows it."""
    return hashlib.sha256(resolved_yaml(case).encode()).hexdigest()


def checksum_number(sha256: str) -> float:
    """Return the first 48 bits of a checksum as a number that a double holds."""
    return float(int(sha256[:NUMBER_DIGITS], 16))


def _refuse_other_runs(setup: Setup) -> None:
    """Raise InputError for a case without EXP-RTHS, and for a real rig with numbers that are doubted."""
    if "exp_rths" not in setup.case.runs:
        raise InputError(placed(setup.case, "runs: has no exp_rths, whose step could be written; add it"))
    found = doubts(setup) if setup.rig.can.moves_hardware else ()
    if found:
        keys = ", ".join(dict.fromkeys(one.key for one in found))
        raise InputError(
            *dict.fromkeys(placed(setup.case, one.sentence) for one in found),
            f"rig {setup.rig.name} is real; correct these, or state plausible: [{keys}] in the case",
        )


def strongest(drive: Array, dt_s: float) -> Array:
    """Return the strongest REHEARSED rows of a ground motion (n, 3), whose displacement grows from zero to its size
    over GROWS rows; velocity and acceleration are its derivatives."""
    first = int(np.argmax(np.abs(drive[:, 0]))) - REHEARSED // 2
    accel, velocity, place = drive[max(min(first, len(drive) - REHEARSED), 0) :][:REHEARSED].T
    x, per_s = np.clip(np.arange(len(place)) / GROWS, 0.0, 1.0), 1.0 / (GROWS * dt_s)
    grown, rate, bend = x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) * per_s, np.where(x < 1.0, 6.0 - 12.0 * x, 0.0)
    bend = bend * per_s**2
    moved = grown * accel + 2.0 * rate * velocity + bend * place, grown * velocity + rate * place, grown * place
    return np.ascontiguousarray(np.column_stack(moved))


def _shown_v(setup: Setup, identified: Identification, blocks: Blocks, drive: Array) -> Array:
    """Return the samples (m, c + f) of a rehearsal; a channel that nothing is known of shows zero."""
    setup = setup.calibrated(identified)
    rig, seen = loop_parts(setup, identified)[0], setup.rig
    limits, still = without_limits(guard_limits(setup)), np.zeros((len(drive), len(seen.channels)))
    model = seen_by_model(rig, blocks, seen, setup.removes_sensors)
    log = play_identified(rig.plant, seen, model, drive, limits, Disturbed(still)).log
    rows = [one.sensitivity_v_per_unit * row for one, row in zip(seen.channels, log.corrected, strict=True)]
    for one in seen.further:
        value = np.zeros(len(drive))
        if one.kind == "displacement" and one.position == "table":
            value = seen.gain_m_per_v * log.command_v
        elif one.kind == "force" and one.position == "table":
            mass = setup.building.interface_experimental_mass_kg
            value = cell_reads(setup.floor_masses_kg, mass, one.plate_mass_kg) @ log.corrected
        rows.append(one.sensitivity_v_per_unit * value)
    return np.ascontiguousarray(np.nan_to_num(np.array(rows)).T)
