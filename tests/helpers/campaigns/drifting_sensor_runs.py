"""Play EXP-RTHS on drifting sensors, and judge what the run says of its errors and its channels against the truth.

The truth is known from `drifting_rig.py`, which adds offset, drift and jumps behind the coupling of the virtual rig.
A run is wrong where a floor's RMS error differs from the true one by more than 5 % and 0.1 mm/s^2, a drifting channel
is not named, a jump is dated wrongly by more than 50 ms, a jump or a drift is found that is not there, or its size is
wrong by more than 10 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from campaigns.drifting_rig import DriftingRig
from rths_cli.analysis.metrics import error_figures
from rths_cli.analysis.sim import simulate
from rths_cli.experiment import run_metrics as budget
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.design import Design
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import AFTER_S, BEFORE_S, drive_of
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, guard_limits, open_virtual
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.run_signals import (
    SensorDrift,
    drift_of,
    expected_of,
    findings_of,
    on_record_clock,
    sensitivities,
    stands_out,
    whole_building,
    without_drift,
)
from rths_cli.experiment.setup import Setup
from rths_cli.findings import sentences
from rths_cli.loop.realtime_run import way_to_rest_s
from rths_cli.loop.simulated_time_run import Outcome, Stillness, play
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array
from rths_cli.quantities import Values
from rths_cli.rigs.virtual.virtual_rig import VirtualRig

WITHIN, WITHIN_M_S2, WITHIN_S, WITHIN_SIZE = 0.05, 1e-4, 0.05, 0.1


@dataclass(frozen=True)
class Added:
    """What a run adds to the channels (c,): offset in V, drift in V/s, jumps (channel, s of the record, V)."""

    offset_v: Array
    drift_v_per_s: Array
    jumps: tuple[tuple[int, float, float], ...]


@dataclass(frozen=True)
class Played:
    """RMS errors (n_floors,) in m/s^2 of a run to SIM: in the file, true above the lowest reliable frequency, all of
    the true one, and as the loop's samples have it (NaN of a run that a limit stopped); what was found of the sensors;
    why it was stopped, how much of the record was played, and the error budget."""

    reported: Array
    true: Array
    true_all: Array
    raw: Array
    found: SensorDrift
    lead_samples: int
    stopped_by: str
    played_s: float
    budget: Values

    def said(self, setup: Setup) -> list[str]:
        """Return what a user is told of the sensors."""
        return list(sentences(findings_of("EXP-RTHS", self.found, setup, self.lead_samples)))


def nothing(channels: int) -> Added:
    """Return healthy sensors."""
    return Added(np.zeros(channels), np.zeros(channels), ())


def played(setup: Setup, memory: Memory, added: Added, seed: int = 0) -> Played:
    """Play EXP-RTHS of a case on its virtual rig with drifting sensors."""
    known = memory.known(setup, lambda _: None)
    identified, checked = known.found, verdict_on(setup, known)
    design = checked.design
    if design is None:
        raise RuntimeError(f"{setup.case.name}: {'; '.join(checked.reasons)}")
    outcome, truth = outcome_of(setup, design, added, seed)
    dt, lead, building = setup.rig.dt_s, design.blocks.lead_samples, setup.building
    samples = len(setup.motion.time_s)
    found = drift_of(setup, expected_of(setup, identified, design.blocks), outcome)
    if found is None:
        raise RuntimeError(outcome.rig_fault)
    if stopped := outcome.stopped_by_limit or outcome.rig_fault:  # a drift can lead the table to its end stop
        not_known = np.full(len(truth) - 1, np.nan)
        return Played(*(not_known,) * 4, found, lead, stopped, dt * outcome.steps, {})
    raw = on_record_clock(outcome, lead, dt, samples)
    series = without_drift(raw, found.removed, lead, design.blocks.estimator) if found.any else raw
    response = simulate(building, dt, setup.motion.accel_m_s2)
    sim = response.abs_accel_m_s2
    floors = len(truth) - 1
    scheme, ground = setup.case.integration, setup.motion.accel_m_s2
    lowest = lowest_reliable_hz(setup)

    def rms(accel: Array, high_pass_hz: float) -> Array:
        return error_figures(sim[-floors:], accel[-floors:], dt, high_pass_hz).rms

    reported = whole_building(building, series, ground, dt, scheme)[2]
    as_loop = whole_building(building, raw, ground, dt, scheme)[2]
    true = truth[:, lead : lead + samples]
    return Played(
        rms(reported, lowest), rms(true, lowest), rms(true, 0.0), rms(as_loop, 0.0), found, lead,
        "", dt * samples, budget.of_exp_rths(checked.loop, series, reported, response)[0],
    )  # fmt: skip


def outcome_of(setup: Setup, design: Design, added: Added, seed: int) -> tuple[Outcome, Array]:
    """Play the rig alone; return how a run went, and the true mean accelerations (c, n) around each of its samples."""
    dt, limits = setup.rig.dt_s, guard_limits(setup)
    still = Stillness(*(round(each / dt) for each in (BEFORE_S, way_to_rest_s(limits), AFTER_S)))
    virtual = open_virtual(setup, (EXP_RTHS,), seed)
    lead = design.blocks.lead_samples
    jumps = [(channel, still.before + lead + round(at / dt), size) for channel, at, size in added.jumps]
    rig = DriftingRig(
        VirtualRig(setup.rig, virtual.plant, (seed, EXP_RTHS)), added.offset_v, added.drift_v_per_s, jumps
    )
    outcome = play(rig, setup.rig, design.blocks, NUMERICAL, drive_of(setup, design), limits, still=still)
    middle = np.array(rig.true_velocity_m_s)[still.before - 1 :].T
    return outcome, np.diff(middle, axis=1) / dt


def faults(setup: Setup, added: Added, run: Played) -> list[str]:
    """Return what is wrong with a run, one sentence each."""
    said = []
    for name, true in (("true", run.true), ("all of the true", run.true_all)):
        off = np.abs(run.reported - true)
        if np.any(off > np.maximum(WITHIN * true, WITHIN_M_S2)):
            said.append(f"errors {in_mm_s2(run.reported)} instead of {in_mm_s2(true)} mm/s^2 ({name})")
    start, dt = run.found.first + run.lead_samples, setup.rig.dt_s
    for channel, (each, size) in enumerate(zip(run.found.channels, sensitivities(setup.rig), strict=True)):
        wanted = [(at, by) for place, at, by in added.jumps if place == channel and at < run.played_s]
        if each.unusable_from is not None:
            if not wanted or dt * (each.unusable_from - start) > wanted[0][0]:
                said.append(f"channel {channel}: not usable from {dt * (each.unusable_from - start):.2f} s")
            continue
        found = [(dt * (jump.at - start), size * jump.size) for jump in each.jumps]
        if len(found) != len(wanted):
            said.append(f"channel {channel}: jumps {found} instead of {wanted}")
            continue
        said += [
            f"channel {channel}: jump {is_} instead of {be}"
            for is_, be in zip(found, wanted, strict=True)
            if abs(is_[0] - be[0]) > WITHIN_S or abs(is_[1] - be[1]) > WITHIN_SIZE * abs(be[1])
        ]
        rate = added.drift_v_per_s[channel]
        off = abs(size * each.rate - rate)
        if bool(rate) and (not stands_out(each) or off > WITHIN_SIZE * abs(rate) + 3.0 * size * each.rate_uncertainty):
            said.append(f"channel {channel}: drift {6e4 * size * each.rate:.3g} instead of {6e4 * rate:.3g} mV/min")
        if not added.offset_v[channel] and each.drifts:
            said.append(f"channel {channel}: healthy, but {each}")
    return said


def in_mm_s2(values: Array) -> str:
    """Return accelerations (n,) in m/s^2 as text in mm/s^2."""
    return " ".join(f"{1e3 * value:.3f}" for value in values)
