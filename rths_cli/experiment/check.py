"""The check of one case, computed: building as identified, predicted error, verdict, tangents of laws.

Verdicts at tangents are indications: a loop that is stable at every frozen tangent may still diverge, and one that is
not may end in a bounded vibration. The simulated test (experiment/simulated_test.py) is the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis import stability_check as preflight
from rths_cli.analysis.closed_loop import (
    closed_loop_matrix,
    critical_delay,
    loop_response,
    loop_roots,
    modes_in_loop,
    slow_roots,
)
from rths_cli.analysis.fourier_lines import delayed_rms, lines_for, sim_lines
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import (
    Errors,
    PredictionInputs,
    error_if_changed,
    predict,
    weight_of_few_bits,
)
from rths_cli.analysis.program_stability import modes_in_transition
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.stability_check import Strays
from rths_cli.analysis.true_error import OwnError, best_remedy, sensitivities, true_error
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.control.numerical_substructure import interface
from rths_cli.control.program_storeys import ProgramStoreys
from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.errors import InputError
from rths_cli.experiment import actuator, run_metrics
from rths_cli.experiment.adaptive_check import adaptive_faults, adaptive_verdict
from rths_cli.experiment.design import loop_faults, loop_parts, loop_stability, required_delay_s
from rths_cli.experiment.one_table_run import drive_of
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.setup import motion_key
from rths_cli.experiment.simulated_test import Replayed, Simulated, played_rounding, simulated_test
from rths_cli.findings import Finding
from rths_cli.numerics.content_key import content_key
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.structure import Building, Specimen, assemble, modal_damping_matrix, modes, storey_matrix
from rths_cli.structure.storey_laws import stacked
from rths_cli.structure.tangents import Tangent, at_rest, at_tangents, on_specimen, with_specimen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.closed_loop import CriticalDelay
    from rths_cli.analysis.identified_rig_block import IdentifiedRig
    from rths_cli.analysis.predicted_error import Prediction
    from rths_cli.analysis.sim import Response
    from rths_cli.analysis.true_error import Remedy, TrueError
    from rths_cli.case.case_schema import Case
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Calibration, Identification
    from rths_cli.numerics.lti import Array, Block

SOFTEST = 0.01  # of a storey's stiffness at rest: a softer building does not return within a record
AT_REST = "at rest"
DAMPING_LEFT = 0.5  # of a mode's damping, that the rate transition of a program must leave
REACTION_RANGE = 0.5, 1.0  # judged with a feedforward of the reaction if the case states no specimen_range

MOST_ERROR = 0.5  # times SIM's RMS: a storey that is farther off does not do the test
SEED = 19  # of the simulated noise
SMALL = 1e-3  # rms of a small disturbance over that of the motion
RINGS = 7.0  # time constants after which a motion has decayed
LONGEST_S = 300.0  # longest padding after the record
NOISE_FROM_HZ, NOISE_POINTS = 1.0, 400  # to half the sample rate: where noise at rest is taken as white; points
NEAR = 0.97  # fraction of the critical delay from which SIM-DELAY rings too long to be computed on lines


@dataclass(frozen=True)
class TangentVerdict:
    """The verdict on the loop at one tangent."""

    name: str  # in words
    stability: preflight.Stability
    critical: CriticalDelay
    faults: tuple[Finding, ...]  # why it is not safe


def range_assumption(case: Case, counters_reaction: bool) -> list[Finding]:
    """Return how a specimen with a range of stiffness is judged, [] without a range."""
    ends = stated_ends(case, counters_reaction)
    if ends is None:
        return []
    if not counters_reaction:
        return [Finding("assumption.specimen_range")]
    return [Finding("assumption.reaction_range", {"least": ends[0], "most": ends[1]})]


def tangent_verdicts(
    setup: Setup,
    identified: Identification,
    blocks: Blocks,
    building: Building,
    shared: SharedValues,
    ends: tuple[float, ...] | None = None,
) -> tuple[TangentVerdict, ...]:
    """Return the verdicts at rest and at all tangents, () for a linear building whose specimen has no range.

    `blocks` are as designed; `building` is as identified, with its laws; `ends` those of the specimen's stiffness, over
    the identified one. The table's response and the blocks of the control stay as identified
    and designed.
    """
    frozen = _frozen(building, ends)
    if len(frozen) < 2:
        return ()
    return tuple(_verdict(setup, identified, blocks, one, shared) for one in frozen)


def faults_at_tangents(verdicts: tuple[TangentVerdict, ...]) -> tuple[Finding, ...]:
    """Return why loops at tangents are not safe: each cause once, with the tangent at which it is worst."""
    found: dict[tuple[object, ...], list[tuple[str, Finding]]] = {}
    for one in verdicts:
        if one.name != AT_REST:
            for fault in one.faults:
                found.setdefault(fault.kind, []).append((one.name, fault))
    told = []
    for same in found.values():
        name, worst = max(same, key=lambda each: each[1].beyond)
        told.append(worst.at("at.tangent", tangent=name, more=len(same) - 1 or None))
    return tuple(told)


def transition_faults(building: Building, blocks: Blocks) -> tuple[Finding, ...]:
    """Return why the rate transition of a program is refused: the mode that it damps least for its own damping, at rest
    or at a tangent met in SIM, where more than half of that damping is gone; () for other buildings."""
    storeys = blocks.numerical
    if not isinstance(storeys, ProgramStoreys) or storeys.plan is None:
        return ()
    found = []
    for one in (Tangent(AT_REST, at_rest(building)), *at_tangents(building, SOFTEST)):
        for mode in modes_in_transition(one.building, storeys.plan, storeys.plan.block.dt_s):
            if mode.ratio > 0.0 and mode.ratio + mode.added < DAMPING_LEFT * mode.ratio:
                found.append(((mode.ratio + mode.added) / mode.ratio, one.name, mode))
    if not found:
        return ()
    _, where, worst = min(found, key=lambda each: each[0])
    values = {"mode_hz": worst.hz, "left": worst.ratio + worst.added, "own": worst.ratio, "where": where}
    return (Finding("loop.transition", values),)


def _frozen(building: Building, ends: tuple[float, ...] | None) -> list[Tangent]:
    """Return the linear buildings to judge, the one at rest first."""
    rest = Tangent(AT_REST, at_rest(building))
    frozen = [rest, *at_tangents(building, SOFTEST)]
    if ends is None:
        return frozen
    together = [one for one in frozen if one.name.startswith("all")] or frozen[1:]
    found = list(frozen)
    for factor in ends:
        if factor != 1.0:
            for one in (rest, *together):
                name = f"specimen at {100.0 * factor:.3g} % of its stiffness, {one.name}"
                found.append(Tangent(name, with_specimen(one.building, factor)))
    return found


def stated_ends(case: Case, counters_reaction: bool) -> tuple[float, ...] | None:
    """Return the stated ends of the specimen's stiffness, or those of a case that asks for its reaction to be
    countered. Where that is automatic, `design_choice` judges them."""
    stated = case.check.specimen_range if case.check is not None else None
    asked = counters_reaction and case.controller.reaction_feedforward is True
    return REACTION_RANGE if stated is None and asked else stated


def _verdict(
    setup: Setup, identified: Identification, blocks: Blocks, at: Tangent, shared: SharedValues
) -> TangentVerdict:
    """Return the verdict at one tangent: that of the linear building, by the way of every linear building."""
    assert identified.specimen is not None  # every case has experimental storeys
    if at.building.numerical is not setup.building.numerical:
        setup = replace(setup, building=replace(setup.building, numerical=at.building.numerical))
        numerical = interface(at.building.numerical, setup.rig.dt_s, setup.case.integration)
        blocks = replace(blocks, numerical=numerical)
    specimen = at.building.specimen
    there = None if specimen is identified.specimen.specimen else specimen
    found = loop_stability(setup, identified, blocks, shared, there)
    faults = tuple(loop_faults(setup, identified, blocks, shared, there))
    return TangentVerdict(at.name, found, critical_delay(at.building), faults)


@dataclass(frozen=True)
class Uncertain:
    """What is not certain of a hybrid test before it runs, and what its loop is predicted to do."""

    setup: Setup  # with the sensors as identified
    identified: Identification
    known: PredictionInputs
    prediction: Prediction
    building: Building  # as identified, with the laws of its computed storeys
    at_level: Building  # the same with a specimen that holds at every level, where that was identified
    covariance: Array  # of the calibration's parameters, as in Calibration; zeros where nothing is uncertain
    corners_hz: Array  # (c,) of the AC couplings
    pitch: Array | None  # as in OwnError
    pitch_error: float
    stiffness_error: float  # relative standard uncertainty of the specimen's stiffness in the test


@dataclass(frozen=True)
class Judged:
    """The check of a case, with the values that its page and metrics need."""

    preflight: preflight.Preflight
    building: tuple[Array, Array]  # frequencies in Hz and damping ratios (n,) of the building with identified specimen
    in_loop: tuple[Array, Array]  # the same of the nearest modes of the loop
    sim_delay_rms_m_s2: Array | None  # (n_storeys,) RMS errors of SIM-DELAY; None if it would diverge
    sim_rms_m_s2: Array  # (n_storeys,) RMS of SIM of the building as identified, in the test band
    friction_v: float  # friction of the table as a command, as used in the prediction
    largest_scaling: float  # up to which the test is safe; 0 if no scaling makes it safe
    known: PredictionInputs | None  # inputs of the prediction; None for an unstable loop
    predicted: Prediction | None = None  # what `predict` makes of them
    samples: tuple[Judged, ...] = ()  # the same of each sample of the identified model
    tangents: tuple[TangentVerdict, ...] = ()  # at rest and at the tangents of laws; none for a linear building
    simulated: Simulated | None = None  # the test of a building with laws; None: linear, or the loop is unstable
    true_error: TrueError | None = None  # None: sensors and masses are exactly as declared, or the loop is unstable
    remedy: Remedy | None = None  # what would lower the bound of the true error most
    expected_m_s2: Array | None = None  # (n_storeys,) RMS error that the sensors will show, against SIM as declared
    replay: Callable[[], Replayed] | None = None  # the test of storeys with laws, for the budget after the run
    uncertain: Uncertain | None = None  # for the true error after the run; None: the loop is unstable
    of_actuator: dict[str, ArrayLike] = field(
        default_factory=dict
    )  # further metrics of a test with an actuator, by path


def preflight_of(setup: Setup, identified: Identification, design: Design) -> preflight.Preflight:
    """Return the result of the check of a case's hybrid test, from the identified rig and the designed blocks."""
    return judge(setup, identified, design).preflight


def judge(setup: Setup, identified: Identification, design: Design, shared: SharedValues | None = None) -> Judged:
    """Check a case's hybrid test, from the identified rig and the designed blocks.

    Where the identified model has samples, the same blocks are judged on each of them: the verdict is the worst one,
    the largest scaling is safe with all, everything else is the nominal model's. With `shared`, cases with the same
    record and building compute SIM once, and cases with the same blocks compute the stability of the loop once. Raises
    InputError if an identified building has no SIM.
    """
    shared = shared or SharedValues()
    if actuator.is_of_actuator(setup):
        return _judge_actuator(setup, identified, design, shared)
    nominal = _judge_one(setup, identified, design, shared)
    if not identified.samples:
        return nominal
    samples = tuple(
        _judge_sample(setup, sample, design, shared, number) for number, sample in enumerate(identified.samples, 1)
    )
    return replace(
        nominal,
        preflight=preflight.over_samples(nominal.preflight, [one.preflight for one in samples]),
        largest_scaling=min(one.largest_scaling for one in (nominal, *samples)),
        samples=samples,
    )


def _judge_actuator(setup: Setup, identified: Identification, design: Design, shared: SharedValues) -> Judged:
    """Check a test with an actuator: its loop as that of a table, its peaks in the test simulated on the identified
    rig, once as it is and once with noise and rounding of its channels."""
    blocks, lead = design.blocks, design.blocks.lead_samples
    found = loop_stability(setup, identified, blocks, shared)
    rows: tuple[preflight.Reach, ...] = ()
    sim = actuator.sim_as_identified(setup, identified)
    values: dict[str, ArrayLike] = {}
    if found.radius < 1.0:
        drive = drive_of(setup, design)
        quiet, noisy = (actuator.simulated_run(setup, identified, blocks, drive, each) for each in (False, True))
        rows = actuator.reach(setup, quiet, noisy)
        values |= {f"check.peak_{row.name}": row.peak for row in rows}
        values |= {f"check.limit_{row.name}": row.limit for row in rows}
        values |= actuator.predicted_storeys(setup, identified, noisy, sim, lead)
    least_s = required_delay_s(setup, identified, blocks)
    critical = actuator.critical(setup, identified)
    verdict = preflight.judge(critical, found, rows, setup.case.scaling, None, least_delay_s=least_s)
    fragile = preflight.faults_of_loop(found, False, least_s)
    largest = 0.0 if fragile else preflight.rounded_down(verdict.largest_scaling)
    modes_of = actuator.modes_of(setup, identified, blocks)
    return Judged(verdict, *modes_of, None, rms(sim.abs_accel_m_s2), 0.0, largest, None, of_actuator=values)


def _judge_sample(setup: Setup, sample: Identification, design: Design, shared: SharedValues, number: int) -> Judged:
    try:
        return _judge_one(setup, sample, design, shared, nominal=False)
    except InputError as error:
        faults = (f"sample {number} of the identified model: {fault}" for fault in error.faults)
        raise InputError(*faults) from error


def _judge_one(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues, nominal: bool = True
) -> Judged:
    """Check a case's hybrid test on one member of the identified model, without its samples; the true error is that of
    the `nominal` one."""
    setup = setup.calibrated(identified)
    dt, whole, as_designed = setup.rig.dt_s, with_laws(setup, identified, design), design
    design = replace(design, blocks=design.blocks.linearised())
    building = at_rest(whole)
    rig, storeys = loop_parts(setup, identified)
    found = loop_stability(setup, identified, as_designed.blocks, shared)
    matrix = closed_loop_matrix(rig, design.blocks)
    known = known_of(setup, identified, design, rig, storeys, found.radius, shared)
    counters = as_designed.blocks.friction_compensation
    law = counters is None and not as_designed.blocks.feedforward.linear
    slow = slow_roots(matrix, dt, known.lines.padded * dt)
    known = replace(known, slow_roots=slow, compensation=counters, law=law)
    prediction = predict(known)
    if nominal and found.radius < 1.0 and (weight := weight_of_few_bits(known, prediction)) > 0.0:
        known = replace(known, few_bits=played_rounding(setup, building, design, rig, known, prediction, weight))
        prediction = predict(known)
    masses = np.concatenate([[setup.rig.moving_mass_kg], setup.floor_masses_kg])
    strays = preflight.strays(known, found)
    rows = preflight.reach(known, prediction, setup.rig, masses, strays)
    stable = prediction if found.radius < 1.0 else None
    ends = stated_ends(setup.case, design.blocks.counters_reaction)
    tangents = tangent_verdicts(setup, identified, as_designed.blocks, whole, shared, ends)
    further = (*preflight.unseen(known), *faults_at_tangents(tangents), *transition_faults(whole, as_designed.blocks))
    further += adaptive_faults(adaptive_verdict(setup, identified, as_designed)) if nominal else ()
    simulated, replay = None, None
    if stable is not None and whole.has_laws:
        played = replace(as_designed, blocks=as_designed.blocks.without_compensation())  # beside what it leaves
        simulated = _simulated(setup, whole, played, rig, known, stable, strays, shared)
        if not whole.has_program:  # a program would be asked for hours: its budget is that of the linear part
            replay = partial(Replayed, setup, whole, played, rig, known, _sim_with_laws(setup, whole, shared))
        rows, further = simulated.reach, (*further, *simulated.faults)
        total = simulated.total
        stable = None if total is None else _with_laws(stable, simulated.causes, total)
    critical = critical_delay(building)
    feedback = setup.case.controller.kind == "FF+FB"
    least_s = required_delay_s(setup, identified, design.blocks)
    verdict = preflight.judge(critical, found, rows, setup.case.scaling, stable, further, feedback, least_s)
    own = modes(building.M, building.C, building.K)
    looped = modes_in_loop(loop_roots(matrix, dt), *own)
    fragile = preflight.faults_of_loop(found, feedback, least_s)
    largest = 0.0 if fragile else preflight.rounded_down(verdict.largest_scaling)
    if any(one.faults for one in tangents):
        largest = 0.0
    elif whole.has_laws:  # its response does not grow with the record: only this scaling was simulated
        largest = min(largest, 0.0 if simulated is None or simulated.faults else setup.case.scaling)
    true, remedy, shown = (
        (None, None, 0.0)
        if stable is None or not nominal
        else _true_error(setup, identified, design.blocks, known, stable)
    )
    friction = identified.friction.command_v if identified.friction else 0.0
    delayed = (
        _delayed_with_laws(setup, whole, shared) if whole.has_laws else _sim_delay(setup, building, known, critical)
    )
    expected = None
    if stable is not None:
        wrong = _declared_wrong_at_level(setup, whole, identified, known, shared)
        expected = np.hypot(np.hypot(stable.total.storeys, wrong), shown)
    seen = known if found.radius < 1.0 else None
    uncertain = None if stable is None or not nominal else uncertain_of(setup, identified, known, stable, whole)
    sim_rms = rms(known.lines.evaluated(known.sim))
    return Judged(
        verdict, own, looped, delayed, sim_rms, friction, largest, seen,
        None if seen is None else prediction, (), tangents, simulated,
        true, remedy, expected, replay, uncertain,
    )  # fmt: skip


def _with_laws(at_rest: Prediction, causes: Mapping[str, Errors], total: Errors) -> Prediction:
    """Return a prediction whose errors are those of a simulated test. What sensors add to the motions that they report
    is that of the storeys at rest, and no larger share."""
    added = at_rest.total.storeys**2 - at_rest.true**2
    share = np.minimum(at_rest.true / np.maximum(at_rest.total.storeys, np.finfo(float).tiny), 1.0)
    true = np.sqrt(np.maximum(total.storeys**2 - added, (share * total.storeys) ** 2))
    return replace(at_rest, causes=causes, total=total, true=true)


def _true_error(
    setup: Setup, identified: Identification, blocks: Blocks, known: PredictionInputs, prediction: Prediction
) -> tuple[TrueError | None, Remedy | None, Array | float]:
    """Return the distribution of the true error, the best remedy, and the root mean square (n_storeys,) in m/s^2 of
    what the sensors will show of it; None, None and 0 where nothing is uncertain.

    Sensors show what changed after the identification only: what it has taken for gains and masses is in the building
    as identified, to which they are compared.
    """
    calibration = identified.calibration
    if calibration is None:
        return None, None, 0.0
    building = at_rest(as_identified(setup, _specimen(identified)))
    corners = _corners_hz(setup)
    by_calibration = sensitivities(building, known.lines, known.sim, corners, known.model, known.measured)
    factor = 1.0 + stiffness_uncertainty(setup, identified)
    changed = changed_specimen_error(setup, identified, blocks, known, prediction, factor)
    own = OwnError(prediction.true, changed, *_pitch_error(identified, building, known))
    calibration, since = _with_drift(setup, identified, calibration)
    shown = by_calibration.measured_rms(since)
    return true_error(by_calibration, calibration, own), best_remedy(by_calibration, calibration, own), shown


def _corners_hz(setup: Setup) -> Array:
    return np.array([channel.high_pass_hz if setup.removes_sensors else 0.0 for channel in setup.rig.channels])


def _with_drift(setup: Setup, identified: Identification, calibration: Calibration) -> tuple[Calibration, Array]:
    """Return a calibration with the drift of gains until the test in its covariance, and that drift's covariance."""
    since, c = np.zeros_like(calibration.covariance), len(calibration.gain)
    if identified.session is None:
        since[:c, :c] = setup.rig.uncertainty.drift**2 * np.eye(c)
        return replace(calibration, covariance=calibration.covariance + since), since
    places = np.array([*range(c), *range(2 * c, 3 * c)])  # its covariance is in that of the calibration
    since[np.ix_(places, places)] = identified.session.covariance[: 2 * c, : 2 * c]
    return calibration, since


def uncertain_of(
    setup: Setup, identified: Identification, known: PredictionInputs, prediction: Prediction, whole: Building
) -> Uncertain:
    """Return what is uncertain of a test on the `whole` building as identified."""
    building, calibration = at_rest(as_identified(setup, _specimen(identified))), identified.calibration
    channels, floors = len(setup.rig.channels), len(setup.floor_masses_kg)
    covariance = np.zeros((3 * channels + floors,) * 2)
    if calibration is not None:
        covariance = _with_drift(setup, identified, calibration)[0].covariance
    return Uncertain(
        setup, identified, known, prediction, whole, _at_every_level(whole, identified), covariance, _corners_hz(setup),
        *_pitch_error(identified, building, known), stiffness_uncertainty(setup, identified),
    )  # fmt: skip


def _pitch_error(identified: Identification, building: Building, known: PredictionInputs) -> tuple[Array | None, float]:
    """Return the RMS error (n_storeys,) in m/s^2 against a reference on a rigid base, by pitch of the specimen's base,
    and its relative standard uncertainty; None and 0 where none is seen."""
    pitch, fit = identified.pitch, identified.specimen
    if pitch is None or not pitch.seen or fit is None:
        return None, 0.0
    masses, stiffness = fit.specimen.masses_kg, storey_matrix(fit.stiffness_n_per_m * pitch.stiffness_ratio)
    rigid = Specimen(masses, stiffness, modal_damping_matrix(masses, stiffness, fit.damping_ratio))
    of_rigid = sim_lines(on_specimen(building, rigid), known.lines, known.ground[0])
    return rms(known.lines.evaluated(known.sim - of_rigid)), pitch.error_m_per_n / pitch.flexibility_m_per_n


def stiffness_uncertainty(setup: Setup, identified: Identification) -> float:
    """Return the relative standard uncertainty of the specimen's stiffness in the test: that of the identified one
    together with that of its change until then.

    The identified frequencies are as uncertain as their dependence on the level makes them. During a record the level
    is now above and now below that of the identification.
    """
    fit = identified.specimen
    assert fit is not None  # every case has experimental storeys
    of_storeys = float(np.max(fit.stiffness_error_n_per_m / fit.stiffness_n_per_m))
    of_modes = 2.0 * float(np.max(fit.frequency_error_hz / fit.natural_frequency_hz))
    return float(np.hypot(setup.rig.uncertainty.specimen, max(of_storeys, of_modes)))


def changed_specimen_error(
    setup: Setup,
    identified: Identification,
    blocks: Blocks,
    known: PredictionInputs,
    prediction: Prediction,
    factor: float,
) -> Array:
    """Return the RMS error (n_storeys,) in m/s^2 if all storeys of the specimen have `factor` times the identified
    stiffness.

    `blocks` are linear. The table moves as the other reaction makes it, whether or not they counter it; where the
    identified table does not show how, its response stays as identified.
    """
    changed = with_specimen(at_rest(as_identified(setup, _specimen(identified))), factor)
    try:
        rig, storeys = loop_parts(setup, identified, changed.specimen, True)
    except InputError:
        rig, storeys = loop_parts(setup, identified, changed.specimen)
    loop = loop_response(rig, blocks, storeys, known.lines.z)
    return error_if_changed(known, prediction.nominal, changed, loop)


def _declared_wrong(setup: Setup, whole: Building, known: PredictionInputs, shared: SharedValues) -> Array:
    """Return the RMS (n_storeys,) of SIM of the building as identified less SIM of the declared one."""
    declared, motion = setup.building, setup.motion.accel_m_s2
    if not whole.has_laws:
        return rms(known.lines.evaluated(known.sim - sim_lines(declared, known.lines, known.ground[0])))
    asked, reference = (motion_key(setup.case), content_key(declared)), reference_of(declared)
    stated = shared.get("sim as identified", asked, lambda: reference.sim(declared, setup.rig.dt_s, motion))
    storeys = (stated.abs_accel_m_s2, _sim_with_laws(setup, whole, shared).abs_accel_m_s2, None)
    found = run_metrics.errors(
        "sim_delay", None, storeys, setup.rig.dt_s, lowest_reliable_hz(setup), None, setup.case.test_band_hz
    )
    return np.asarray(found["sim_delay.rms_error_m_s2"])


def with_laws(setup: Setup, identified: Identification, design: Design) -> Building:
    """Return the building as identified, with the laws of its computed storeys where the step has them."""
    building = as_identified(setup, _specimen(identified))
    known = isinstance(design.blocks.numerical, StoreysWithLaws | ProgramStoreys)
    return replace(building, laws=setup.building.laws, program=setup.building.program) if known else building


def _declared_wrong_at_level(
    setup: Setup, whole: Building, identified: Identification, known: PredictionInputs, shared: SharedValues
) -> Array:
    """Return `_declared_wrong` of the specimen as it is at the test's level; where SIM cannot follow the specimen's
    laws, of its linear equivalent. The verdict does not depend on it."""
    bent = _at_every_level(whole, identified)
    try:
        return _declared_wrong(setup, bent, known, shared)
    except InputError:
        if bent is whole:
            raise
        return _declared_wrong(setup, whole, known, shared)


def _at_every_level(whole: Building, identified: Identification) -> Building:
    """Return a building as identified whose specimen is not linear where the identification shows that: a test moves it
    at another level than that at which its linear equivalent was identified."""
    found = identified.nonlinear
    if found is None:
        return whole
    numerical, mass = whole.numerical, whole.interface_experimental_mass_kg
    specimen = found.specimen(whole.specimen.masses_kg)
    M, C, K = assemble(numerical, specimen, mass)
    laws = stacked(whole.laws, found.laws, len(numerical.masses_kg))
    return replace(whole, specimen=specimen, M=M, C=C, K=K, laws=laws)


def _simulated(
    setup: Setup, building: Building, design: Design, rig: IdentifiedRig, known: PredictionInputs,
    prediction: Prediction, strays: Strays, shared: SharedValues,
) -> Simulated:  # fmt: skip
    """Return the simulated test; with `shared`, equal tests of several cases are simulated once."""
    sim = _sim_with_laws(setup, building, shared)
    if setup.parts or design.blocks.runs_own_code:  # another part of the caller's may have the same linear block
        shared = SharedValues()
    asked = content_key(
        building,
        design.blocks.linearised(),
        rig,
        known.model,
        known.measured,
        known.friction,
        known.noise_m_s2,
        known.compensation,
        strays,
    )
    return shared.get(
        "simulated test", (motion_key(setup.case), asked, lowest_reliable_hz(setup), setup.case.test_band_hz),
        lambda: simulated_test(setup, building, design, rig, known, prediction, sim, strays),
    )  # fmt: skip


def _delayed_with_laws(setup: Setup, building: Building, shared: SharedValues) -> Array | None:
    """Return the RMS errors (n_storeys,) of SIM-DELAY of a building with laws, None if it diverges.

    Of a program it is that of the declared building, which the run asks for too: SIM-DELAY asks it at every step.
    """
    building = setup.building if building.has_program else building
    dt, accel, case = setup.rig.dt_s, setup.motion.accel_m_s2, setup.case
    sim = _sim_with_laws(setup, building, shared)
    asked = motion_key(case), content_key(building), case.delay_s
    delayed = shared.get(
        "sim_delay as identified", asked,
        lambda: reference_of(building).sim_delay(building, dt, accel, case.delay_s, sim),
    )  # fmt: skip
    if delayed.diverged_at_s is not None:
        return None
    storeys = (sim.abs_accel_m_s2, delayed.abs_accel_m_s2, None)
    found = run_metrics.errors("sim_delay", None, storeys, dt, lowest_reliable_hz(setup), None, case.test_band_hz)
    return np.asarray(found["sim_delay.rms_error_m_s2"])


def _sim_with_laws(setup: Setup, building: Building, shared: SharedValues) -> Response:
    """Return SIM of a building as identified, with its laws."""
    asked, reference = (motion_key(setup.case), content_key(building)), reference_of(building)
    return shared.get(
        "sim as identified", asked, lambda: reference.sim(building, setup.rig.dt_s, setup.motion.accel_m_s2)
    )


def _sim_delay(setup: Setup, building: Building, known: PredictionInputs, critical: CriticalDelay) -> Array | None:
    if setup.case.delay_s >= NEAR * critical.delay_s:
        return None
    return delayed_rms(known.lines, building, known.floors, known.ground[0], known.sim, setup.case.delay_s)


def _specimen(identified: Identification) -> Specimen:
    assert identified.specimen is not None  # every case has experimental storeys
    return identified.specimen.specimen


def as_identified(setup: Setup, specimen: Specimen) -> Building:
    """Return the building that consists of the numerical substructure and the identified specimen."""
    numerical, mass = setup.building.numerical, setup.building.interface_experimental_mass_kg
    return Building(numerical, specimen, mass, *assemble(numerical, specimen, mass), ())


def known_of(
    setup: Setup, identified: Identification, design: Design, rig: IdentifiedRig, storeys: Block, radius: float,
    shared: SharedValues | None = None,
) -> PredictionInputs:  # fmt: skip
    """Return the inputs of the error prediction; raises InputError if the identified building has no SIM."""
    dt, motion, specimen = setup.rig.dt_s, setup.motion, _specimen(identified)
    building, shared = as_identified(setup, specimen), shared or SharedValues()
    ring = RINGS * dt / -math.log(radius) if radius < 1.0 else LONGEST_S
    lines = lines_for(len(motion.time_s), dt, min(ring, LONGEST_S), lowest_reliable_hz(setup), setup.case.test_band_hz)
    asked = (motion_key(setup.case), content_key(building))
    try:
        sim = shared.get(
            "sim as identified", asked, lambda: reference_of(building).sim(building, dt, motion.accel_m_s2)
        )
    except InputError as error:
        raise InputError(*(f"the building as identified: {fault}" for fault in error.faults)) from error
    ground = lines.of_motion(motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m)
    floors = specimen_state_space(specimen).response(lines.frequency_hz)[:, 0]
    interface = len(building.numerical.masses_kg) - 1
    loop = shared.get(  # of every record of this length
        "loop response",
        content_key(rig, design.blocks, storeys, lines.z),
        lambda: loop_response(rig, design.blocks, storeys, lines.z),
    )
    return PredictionInputs(
        loop=loop,
        lines=lines,
        model=identified.best,
        measured=identified.frfs[0],
        friction=identified.friction,
        floors=np.vstack([np.ones((1, lines.count)), floors]),
        ground=ground,
        sim=sim_lines(building, lines, ground[0]),
        velocity_m_s=sim.rel_vel_m_s[interface] + motion.velocity_m_s,
        noise_m_s2=noise_before_correction(identified, design.blocks.correction, setup),
        rig=setup.rig,
        correction=design.blocks.correction,
        shaped=design.blocks.shaping_step_v > 0.0,
        excess=rig.excess,
        compared=setup.compared,
        specimen=specimen,
        peaks_m_s2=np.abs(sim.abs_accel_m_s2[interface:]).max(axis=1),
        zero_m_s2=shown_zeros(identified, setup),
    )


def shown_zeros(identified: Identification, setup: Setup) -> Array | None:
    """Return what the channels' zeros at rest (c,) in m/s^2 are off by, as the identification showed; None: not known.

    On a real rig amplifiers move their zeros by more than that until the test.
    """
    shown = [channel.zero_m_s2 for channel in identified.channels]
    if setup.rig.can.moves_hardware or not setup.removes_sensors or None in shown:
        return None
    return np.array(shown)


def noise_before_correction(identified: Identification, correction: Block, setup: Setup) -> Array:
    """Return the channels' noise (c,) at rest in m/s^2 before the sensor correction, which amplifies white noise.

    A mains hum above the test band is left out: it is no part of the noise in the band.
    """
    rig, band_hz = setup.rig, setup.case.test_band_hz
    frequency = np.linspace(NOISE_FROM_HZ, 0.5 / rig.dt_s, NOISE_POINTS)
    sizes = np.array([channel.sensitivity_v_per_unit for channel in rig.channels])
    louder = np.abs(np.einsum("ccf->cf", correction.response(frequency)) * sizes[:, None])
    at_rest = np.array([channel.rest_rms_m_s2 or 0.0 for channel in identified.channels])
    hum = np.array([channel.hum_m_s2 if channel.hum_hz > band_hz else 0.0 for channel in identified.channels])
    at_rest = np.sqrt(np.maximum(at_rest**2 - 0.5 * hum**2, 0.0))
    return at_rest / np.sqrt(np.mean(louder**2, axis=1))
