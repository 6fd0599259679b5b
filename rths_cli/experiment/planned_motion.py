"""The motion that a run on the table needs, as the guard sees it, and the guard's limits that follow from it.

The run is played on the identified rig (loop/identified_rig_run.py), once as it is and once with everything that the
identification knows to disturb it: the model's error, friction, noise, rounding, and zeros that are off by as much as
the converters leave unknown. Where that says nothing (a loop that does not settle, parts of the caller's own), the
desired motion itself is used, and where nobody knows that, the limits of the rig file stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import next_fast_len

from rths_cli.analysis.predicted_error import at_once, data_ratio
from rths_cli.analysis.quantisation import zero_error
from rths_cli.analysis.references import reference_of
from rths_cli.control.interface import COMMANDED
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.control.state_space import discretise
from rths_cli.experiment import actuator
from rths_cli.experiment.design import loop_parts
from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.findings import Finding
from rths_cli.loop import guard
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.diagnosis import OF_COMMAND, OF_TABLE, Cause
from rths_cli.loop.guard import without_limits
from rths_cli.loop.identified_rig_run import Disturbed, play_identified, seen_by_model
from rths_cli.loop.step_arrays import ACCELERATION, NUMERICAL
from rths_cli.rigs.description import BRAKE_SHARE

if TYPE_CHECKING:
    from rths_cli.analysis.identified_rig_block import IdentifiedRig
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.loop.run_log import Signals
    from rths_cli.numerics.lti import Array, ComplexArray

MORE_MOTION, LEAST_M = 0.35, 0.7e-3  # a displacement may exceed the planned one by this fraction, or by this
MORE_ERROR, OF_DEMAND = 1.5, 0.5  # times the planned tracking error, and this fraction of the desired acceleration
MORE_ACCELERATION = 2.0  # times the planned acceleration of each channel
SETTLES = 3.0  # a simulated table that exceeds this many times the desired acceleration is no prediction
ZEROS = 2.0  # standard uncertainties by which a zero is off
SEED = 29  # of the simulated noise
UNSETTLED = "rths check tells why; choose another controller, more damping, or less mass on the table"
LESS = "rths check tells how far the test goes; lower scaling, or identify the rig anew"
SIMULATED = "the run simulated on the identified rig"
DESIRED = "the desired motion alone: the run cannot be predicted"
OF_SIM = "SIM's motion of the interface: the run cannot be predicted"


@dataclass(frozen=True)
class PlannedMotion:
    """The largest motions that a run needs of the table, as the guard estimates and measures them.

    Displacements follow from command and nominal gain. `tracking_error_m_s2` is None where accelerations are not what
    is commanded.
    """

    displacement_m: float
    reach_m: float  # displacement with the room to brake
    deviation_m: float  # between displacement and desired displacement
    accel_m_s2: Array  # (c,) measured at table and floors
    desired_m_s2: float  # acceleration of the table
    tracking_error_m_s2: float | None
    source: str  # what they are of, in words
    predicted: bool = True  # whether the run itself was predicted
    own_parts: bool = False  # whether the caller's own parts are the reason why it was not
    listens: bool = True  # whether samples take part in its command


def planned_motion(
    setup: Setup, identified: Identification, design: Design, drive: Array, source: int
) -> PlannedMotion | None:
    """Return the motion that a run needs; None where nothing is known of it.

    `drive` (n, 3): acceleration, velocity and displacement of the ground; `source` of the step: RECORD or NUMERICAL.
    """
    if actuator.is_of_actuator(setup):
        return _of_actuator(setup, identified, design.blocks, drive)
    demand, blocks = _demand(setup, drive, source), design.blocks
    own = bool(setup.parts) or blocks.runs_own_code
    listens = own or _listens(blocks, source)
    if demand is not None:
        demand = replace(demand, own_parts=own, listens=listens)
    if setup.parts or blocks.in_python:
        return demand
    setup = setup.calibrated(identified)
    rig, _ = loop_parts(setup, identified)
    seen = seen_by_model(rig, blocks, setup.rig, setup.removes_sensors)
    limits, still = without_limits(guard_limits(setup)), np.zeros((len(drive), len(setup.rig.channels)))
    quiet = replace(seen, shaping_step_v=0.0)
    nominal = play_identified(rig.plant, setup.rig, quiet, drive, limits, Disturbed(still), source)
    most = np.inf if demand is None else SETTLES * float(demand.accel_m_s2[0])
    if not nominal.played or not np.abs(nominal.log.corrected[0]).max() <= most:
        return demand
    step_v = setup.rig.converters.step_v
    sent_step_v = 0.0 if blocks.shaping_step_v > 0.0 else step_v  # the rig rounds what the step does not
    disturbed = Disturbed(_disturbances_v(setup, identified, rig, blocks, nominal.log), step_v, sent_step_v)
    full = play_identified(rig.plant, setup.rig, seen, drive, limits, disturbed, source)
    if not full.played:
        return demand
    both = [_peaks(setup, blocks, outcome.log) for outcome in (nominal, full)]
    return replace(_larger(*both), own_parts=own, listens=listens)


def _of_actuator(
    setup: Setup, identified: Identification, blocks: Blocks, drive: Array
) -> PlannedMotion | None:  # fmt: skip
    """Return the motion that a test with an actuator needs, whose channels are displacement and force; None for a loop
    that does not settle."""
    both = [actuator.simulated_run(setup, identified, blocks, drive, noisy) for noisy in (False, True)]
    sim = actuator.sim_as_identified(setup, identified)
    most = SETTLES * float(np.abs(sim.rel_disp_m[-1]).max()) + SETTLES * setup.rig.limits.stroke_m
    if not all(one.played and np.abs(one.log.corrected[0]).max() <= most for one in both):
        return None
    return _larger(*(_peaks(setup, blocks, one.log) for one in both))


def effective_limits(limits: GuardLimits, planned: PlannedMotion | None) -> GuardLimits:
    """Return the guard's limits for a run that needs a planned motion; no limit of the rig file is raised.

    What they leave beside the plan is for rigs that differ from what was identified. None: nothing is known of the run,
    and the limits stay as they are.
    """
    if planned is None:
        return limits
    further_m, tracking = max(MORE_MOTION * planned.displacement_m, LEAST_M), limits.tracking_error
    if planned.tracking_error_m_s2 is not None:
        by_plan = MORE_ERROR * planned.tracking_error_m_s2 + OF_DEMAND * planned.desired_m_s2
        tracking = min(tracking, by_plan)
    return limits._replace(
        reach_m=planned.reach_m + further_m,
        deviation_m=planned.deviation_m + further_m,
        tracking_error=tracking,
        abort=np.minimum(limits.abort, MORE_ACCELERATION * planned.accel_m_s2),
    )


def foreseen_causes(limits: GuardLimits, planned: PlannedMotion | None) -> dict[int, Cause]:
    """Return the causes of a stop that follow from the plan alone, by the guard's reason: whatever they are, no channel
    is to be accused of them."""
    if planned is None:
        return {}
    if not planned.predicted and not planned.own_parts:
        said = f"on the identified rig it does not settle either, or moves {SETTLES:g} times as far as desired"
        cause = Cause(said, UNSETTLED)
        return dict.fromkeys((*OF_COMMAND, *OF_TABLE, guard.ACCELERATION, guard.FORCE, guard.SATURATED), cause)
    known: dict[int, Cause] = {}
    if planned.reach_m > farthest(limits):
        far = Cause(f"this test was predicted to need {1e3 * planned.reach_m:.3g} mm of displacement", LESS)
        known |= dict.fromkeys((guard.STROKE, guard.COMMAND), far)
    if not planned.listens:
        alone = Cause("the command follows from the desired motion alone, in which no sensor takes part", LESS)
        known = dict.fromkeys(OF_COMMAND, alone) | known
    return known


def guard_figures(setup: Setup, name: str, planned: PlannedMotion | None) -> dict[str, float]:
    """Return what a run of a name needs and what its guard permits, as metrics by path."""
    if planned is None:
        return {}
    limits = effective_limits(guard_limits(setup), planned)
    needs = planned.tracking_error_m_s2
    tracking = {} if needs is None else {"tracking_m_s2": (needs, limits.tracking_error)}
    rows = {
        "displacement_m": (
            planned.reach_m,
            min(limits.reach_m, limits.stroke_m, limits.gain_m_per_v * limits.command_v),
        ),
        "deviation_m": (planned.deviation_m, limits.deviation_m),
        **tracking,
    }
    if needs is not None:
        rows["acceleration_m_s2"] = (float(planned.accel_m_s2[0]), float(limits.abort[0]))
    return {
        f"check.{name}_{what}_{leaf}": value
        for leaf, row in rows.items()
        for what, value in zip(("planned", "guard"), row, strict=True)
    }


def guard_findings(setup: Setup, label: str, planned: PlannedMotion | None) -> tuple[Finding, ...]:
    """Return what an operator must know of the guard's limits in a run: of what they are, where that is no prediction,
    and which limits of the rig file it cannot reach."""
    limits = setup.rig.limits
    if planned is None:
        return (Finding("guard.unplanned").at("at.run", run=label),)
    own = effective_limits(guard_limits(setup), planned)
    if planned.tracking_error_m_s2 is None:  # of an actuator: its force limit trips as the rig file states it
        return ()
    rows = (
        ("stroke_m", limits.stroke_m, own.reach_m, "m"),
        ("acceleration_m_s2", limits.acceleration_m_s2, float(own.abort.max()), "m/s^2"),
        ("tracking_error_m_s2", limits.tracking_error_m_s2, own.tracking_error, "m/s^2"),
        ("force_n", limits.force_n, float(np.abs(own.force_weights) @ own.abort), "N"),
    )
    idle = tuple(f"{key} {limit:g} {unit}" for key, limit, most, unit in rows if most < limit < np.inf)
    said = [] if planned.predicted else [Finding("guard.not_predicted", {"source": planned.source})]
    said += [Finding("guard.idle_limits", {"limits": idle})] if idle else []
    return tuple(one.at("at.run", run=label) for one in said)


def farthest(limits: GuardLimits) -> float:
    """Return the largest displacement in m that the rig file permits."""
    return min(limits.stroke_m, limits.gain_m_per_v * limits.command_v)


def _listens(blocks: Blocks, source: int) -> bool:
    """Return whether the samples take part in the command of a run."""
    _, forward, feedback = blocks.linear_parts()
    hears = bool(np.any(forward.B[:, 3:]) or np.any(forward.D[:, 3:]))
    return source == NUMERICAL or hears or bool(np.any(feedback.C) or np.any(feedback.D))


def _demand(setup: Setup, drive: Array, source: int) -> PlannedMotion | None:
    """Return the desired motion as a plan, all of which the table may miss; None where nobody knows it."""
    building, motion, dt_s = setup.building, setup.motion, setup.rig.dt_s
    if source == NUMERICAL:
        if not setup.knows_storeys:
            return None
        sim, interface = reference_of(building).sim(building, dt_s, motion.accel_m_s2), -len(setup.rig.channels)
        accel = sim.abs_accel_m_s2[interface:]
        place, velocity = sim.rel_disp_m[interface] + motion.displacement_m, sim.rel_vel_m_s[interface]
        velocity, told = velocity + motion.velocity_m_s, OF_SIM
    else:
        parts = specimen_state_space(building.specimen)
        table, place, velocity, told = drive[:, 0], drive[:, 2], drive[:, 1], DESIRED
        names = tuple(f"floor_{floor}" for floor in range(1, len(parts.C) + 1))
        floors = discretise(parts, dt_s, "foh", "specimen", ("table",), names)
        accel = np.vstack([table, run_block(floors, np.ascontiguousarray(table)[None])])
    most = np.abs(accel).max(axis=1)
    far_m, reach_m = float(np.abs(place).max()), _reach_m(setup, place, velocity)
    return PlannedMotion(far_m, reach_m, far_m, most, float(most[0]), float(most[0]), told, predicted=False)


def _reach_m(setup: Setup, place: Array, velocity: Array) -> float:
    """Return the largest displacement (n,) with the room to brake a velocity (n,), as the guard estimates it."""
    braked = place + velocity * np.abs(velocity) / (2.0 * BRAKE_SHARE * setup.rig.limits.acceleration_m_s2)
    return float(np.maximum(np.abs(place), np.abs(braked)).max())


def _peaks(setup: Setup, blocks: Blocks, log: Signals) -> PlannedMotion:
    """Return the largest motions of a simulated run."""
    lead, place = blocks.lead_samples, setup.rig.gain_m_per_v * log.command_v
    late = log.desired[0, : log.desired.shape[1] - lead] - log.corrected[0, lead:]
    most = np.abs(log.corrected).max(axis=1)
    of_accel = COMMANDED[blocks.interface.commanded] == ACCELERATION
    return PlannedMotion(
        displacement_m=float(np.abs(place).max()),
        reach_m=_reach_m(setup, place, np.diff(place, prepend=0.0) / setup.rig.dt_s),
        deviation_m=float(np.abs(place - log.desired[2]).max()),
        accel_m_s2=most,
        desired_m_s2=float(np.abs(log.desired[0]).max()),
        tracking_error_m_s2=float(np.abs(late).max()) if of_accel else None,
        source=SIMULATED,
    )


def _larger(one: PlannedMotion, other: PlannedMotion) -> PlannedMotion:
    """Return the larger of two motions, quantity by quantity."""
    errors = [each.tracking_error_m_s2 for each in (one, other) if each.tracking_error_m_s2 is not None]
    return replace(
        one,
        displacement_m=max(one.displacement_m, other.displacement_m),
        reach_m=max(one.reach_m, other.reach_m),
        deviation_m=max(one.deviation_m, other.deviation_m),
        accel_m_s2=np.maximum(one.accel_m_s2, other.accel_m_s2),
        desired_m_s2=max(one.desired_m_s2, other.desired_m_s2),
        tracking_error_m_s2=max(errors, default=None),
    )


def _disturbances_v(
    setup: Setup, identified: Identification, rig: IdentifiedRig, blocks: Blocks, nominal: Signals
) -> Array:
    """Return what disturbs the raw samples (n, c) in V of a run whose `nominal` signals are known: the model's error,
    friction, noise at rest, and zeros that are off by twice their standard uncertainty. A correction of the AC coupling
    integrates a zero."""
    assert identified.specimen is not None  # every case has experimental storeys
    channels, dt_s = setup.rig.channels, setup.rig.dt_s
    sizes = np.array([channel.sensitivity_v_per_unit for channel in channels])
    steps = nominal.command_v.size
    count = next_fast_len(2 * steps, real=True)  # as long again at rest, so that the end does not run into the start
    every = np.asarray(np.fft.rfftfreq(count, dt_s), dtype=float)
    known = every <= identified.best.band_hz[1]
    frequency: Array = every[known]
    lines: ComplexArray = np.zeros((len(channels), len(every)), dtype=complex)
    ratio = data_ratio(identified.best, identified.frfs[0], frequency, setup.compared) / (1.0 + rig.excess)
    of_model = rig.plant.response(frequency)[:, 0] * np.fft.rfft(nominal.command_v, count)[known]
    lines[:, known] = (ratio - 1.0) * of_model
    if identified.friction is not None:
        late = np.concatenate([np.zeros(blocks.lead_samples), nominal.desired[1]])[:steps]
        push = np.fft.rfft(identified.friction.disturbance_v(late), count)[known] * at_once(identified.best, frequency)
        floors = specimen_state_space(identified.specimen.specimen).response(frequency)[:, 0]
        lines[:, known] += sizes[:, None] * np.vstack([push, floors * push])
    found = np.fft.irfft(lines, count)[:, :steps]
    at_rest = sizes * np.array([channel.rest_rms_m_s2 or 0.0 for channel in identified.channels])
    off = np.array([zero_error(setup.rig.converters.step_v, noise) for noise in at_rest])
    corners = np.array([channel.high_pass_hz if setup.removes_sensors else 0.0 for channel in channels])
    integrated = 1.0 + 2.0 * np.pi * corners[:, None] * dt_s * np.arange(steps)
    noise = np.random.default_rng(SEED).standard_normal((steps, len(channels))) * at_rest
    return np.ascontiguousarray((found + ZEROS * off[:, None] * integrated).T + noise)
