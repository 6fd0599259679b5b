"""The check of cases by `rths check`, and by `rths run` before it moves a table: EXP-RTHS, shake-table test, choice
of the design, metrics `check.*`.

A feedforward of the reaction is a loop from the floors to the command, which matters only if the specimen changes.
`controller.reaction_feedforward: automatic` takes it where the check finds the test safe with it, also at both ends of
the specimen's stiffness. Otherwise the case is judged without it, so that it makes no test unsafe.

A case gets the filter that it states, or where noise and rounding of the samples would be most of the error, one that
trusts the identified specimen more, and then no feedforward of the reaction, which is for a specimen that changes. The
usual filter takes the base shear from the measured floors, so that a specimen which is not quite the identified one
costs next to nothing, and all noise of the samples is in the base shear. At small amplitudes, or with coarse
converters, that noise is most of the error. A filter with less process noise and a lower `residual_hz` takes the base
shear from the table's motion and the identified specimen instead. It pays where the specimen is known better than the
floors are measured. Each filter of a list is judged by the check's predicted error together with the error that a
specimen would cause that is off by its standard uncertainty: that of the identified stiffness, and its change between
identification and test by `uncertainty.specimen` of the rig.

The loop of a shake-table test is judged like that of the hybrid test, and so are its predicted peaks
(analysis/stability_check.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft

from rths_cli.analysis import stability_check as preflight
from rths_cli.analysis.closed_loop import (
    CriticalDelay,
    closed_loop_matrix,
    hybrid,
    loop_response,
    open_loop,
    slow_roots,
)
from rths_cli.analysis.fourier_lines import lines_for
from rths_cli.analysis.predicted_error import Errors, Prediction, PredictionInputs, predict
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.stability_check import SAFE, UNSAFE, UNSTABLE, VERDICTS
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment import result_contents
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check import (
    LONGEST_S,
    REACTION_RANGE,
    RINGS,
    Judged,
    as_identified,
    changed_specimen_error,
    faults_at_tangents,
    judge,
    noise_before_correction,
    shown_zeros,
    stated_ends,
    stiffness_uncertainty,
    tangent_verdicts,
    with_laws,
)
from rths_cli.experiment.design import (
    NOT_SHOWN,
    Design,
    design_blocks,
    loop_faults,
    loop_parts,
    loop_stability,
    required_delay_s,
    table_alone,
)
from rths_cli.experiment.late_answers import step_time_note
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.one_table_run import HYBRID_TEST, TABLE_RUNS, drive_of
from rths_cli.experiment.planned_motion import guard_figures, guard_findings, planned_motion
from rths_cli.experiment.run_metrics import lowest_reliable_hz, of_margins
from rths_cli.experiment.session import wants_session_record
from rths_cli.experiment.setup import make_setups, place_of, refuse_unstable_steps, shown
from rths_cli.experiment.unit_plausibility import before_error, keys_in_doubt, unit_doubts
from rths_cli.findings import Finding, input_first, sentences, stated, without_repeats
from rths_cli.interrupts import interruptible
from rths_cli.numerics.bands import COMPARED_HZ, TEST_BAND_HZ
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import METRICS, over_samples
from rths_cli.structure import Specimen
from rths_cli.structure.tangents import with_specimen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.stability_check import Preflight, Stability
    from rths_cli.analysis.true_error import TrueError
    from rths_cli.case.case_schema import Case
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.control.interface import OwnParts
    from rths_cli.experiment.check import Replayed, TangentVerdict, Uncertain
    from rths_cli.experiment.model_choice import IdentifiedModel
    from rths_cli.experiment.one_table_run import RunKind
    from rths_cli.experiment.planned_motion import PlannedMotion
    from rths_cli.experiment.setup import OwnSamples, Progress, Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Array, Block
    from rths_cli.quantities import Values

TRUE_ERROR = {"true_error": "median", "true_error_bound": "bound", "calibration_error": "calibration"}
LARGEST = "check.largest_scaling"
DECLARED = tuple(path for path in METRICS if path.startswith("check.limit_"))  # metrics that no identification changes

TRUSTING = ((1e-1, 4.0), (1e-2, 1.3), (1e-3, 0.4))  # q with r = 1, and residual_hz with the usual test band
WORTH = 0.02  # of SIM's RMS: noise and rounding below it leave the usual filter
KNOWN_RANGE = 0.85, 1.0  # of the specimen's stiffness: a filter that trusts the specimen must hold there
GAIN = 0.8  # of the usual filter's error: another one must have less
NO_BUILDING = CriticalDelay(math.inf, math.nan, 0.0)
NO_ERRORS = Errors(np.zeros(0), 0.0)
MOVED_BY_BASELINE = "displacement_m", "velocity_m_s", "command_v"  # by an offset or a drift of the record


def check_figures(judged: Judged) -> dict[str, ArrayLike]:
    """Return the metrics of a check by path; for an unstable loop, predicted peaks and errors are left out.

    Over several samples of the identified model, a metric that differs between them carries its range as an interval.
    A peak or error that a sample has not, because its loop is unstable or SIM-DELAY would diverge, has no upper end.
    The largest scaling is safe with every sample and has no interval.
    """
    values = _figures(judged)
    samples = []
    for sample in judged.samples:
        unlimited = {path: np.full(np.shape(value), np.inf) for path, value in values.items() if path not in DECLARED}
        samples.append({**values, **unlimited, **_figures(sample), LARGEST: values[LARGEST]})
    return over_samples(values, samples)


def table_test_figures(found: Preflight) -> dict[str, ArrayLike]:
    """Return the figures of a shake-table test's check by the last part of their paths: loop and predicted peaks."""
    loop = found.stability
    values: dict[str, ArrayLike] = {
        "spectral_radius": loop.radius,
        "tolerated_table_error": loop.tolerates,
        "required_table_error": loop.required,
        "table_error_hz": loop.at_hz,
        "delay_margin_s": loop.measured.delay_margin_s,
    }
    if loop.radius < 1.0:
        values |= {f"peak_{row.name}": row.peak for row in found.reach}
    return values


def _figures(judged: Judged) -> dict[str, ArrayLike]:
    """Return the metrics of a check of one member of the identified model, by path."""
    found = judged.preflight
    values = _stability(found) | _modes(judged) | _table_error(found)
    values |= of_margins("check", found.stability.measured, "")
    values |= of_margins("check", found.stability.modelled, "_model")
    values[LARGEST] = judged.largest_scaling
    values["check.friction_v"] = judged.friction_v
    if judged.sim_delay_rms_m_s2 is not None:
        values["check.sim_delay_rms_error_m_s2"] = judged.sim_delay_rms_m_s2
    values |= _tangents(judged.tangents)
    if judged.true_error is not None:
        values |= {f"check.{name}_m_s2": getattr(judged.true_error, field) for name, field in TRUE_ERROR.items()}
        if judged.true_error.pitch is not None:
            values["check.pitch_error_m_s2"] = judged.true_error.pitch
    if judged.expected_m_s2 is not None:
        values["check.expected_error_m_s2"] = judged.expected_m_s2
    if judged.simulated is not None:
        values |= judged.simulated.response
    if found.prediction is None:
        return values | judged.of_actuator
    return values | _reach(found) | _errors(found.prediction)


def _stability(found: Preflight) -> dict[str, ArrayLike]:
    """Return the metrics of the loop's stability and of the critical delay."""
    critical, loop = found.critical, found.stability
    return {
        "check.spectral_radius": loop.radius,
        "check.growth": loop.growth,
        "check.critical_delay_s": critical.delay_s,
        "check.critical_delay_hz": critical.frequency_hz,
        "check.gain_at_infinity": critical.gain_at_infinity,
    }


def _tangents(verdicts: Sequence[TangentVerdict]) -> dict[str, ArrayLike]:
    """Return the metrics of the verdicts at rest and at tangents; none for a linear building."""
    if not verdicts:
        return {}
    critical = np.array([one.critical.delay_s for one in verdicts])
    rows: dict[str, ArrayLike] = {
        "spectral_radius": [one.stability.radius for one in verdicts],
        "tolerated_table_error": [one.stability.tolerates for one in verdicts],
        "required_table_error": [one.stability.required for one in verdicts],
        "table_error_hz": [one.stability.at_hz for one in verdicts],
        "delay_margin_s": [one.stability.measured.delay_margin_s for one in verdicts],
        "critical_delay_s": critical,
        "faults": [float(len(one.faults)) for one in verdicts],
    }
    values = {f"check.tangent_{name}": np.asarray(row) for name, row in rows.items()}
    ends = {"check.critical_delay_least_s": critical.min(), "check.critical_delay_most_s": critical.max()}
    return {**values, **ends}


def _modes(judged: Judged) -> dict[str, ArrayLike]:
    """Return the metrics of the building's modes, on their own and in the loop."""
    (own_hz, own_ratio), (loop_hz, loop_ratio) = judged.building, judged.in_loop
    return {
        "check.building_frequency_hz": own_hz,
        "check.building_damping_ratio": own_ratio,
        "check.loop_frequency_hz": loop_hz,
        "check.loop_damping_ratio": loop_ratio,
    }


def _table_error(found: Preflight) -> dict[str, ArrayLike]:
    """Return the metrics of tolerated and required table error."""
    loop, beyond = found.stability, found.stability.feedback
    alone: dict[str, ArrayLike] = {
        "check.feedback_tolerated_error": beyond.tolerates,
        "check.feedback_required_error": beyond.required,
        "check.feedback_error_hz": beyond.at_hz,
    }
    return (alone if beyond.required > 0.0 else {}) | {
        "check.tolerated_table_error": loop.tolerates,
        "check.required_table_error": loop.required,
        "check.table_error_hz": loop.at_hz,
        "check.table_gain_change": loop.gain_change,
        "check.tolerated_table_error_in_band": loop.in_band,
        "check.table_error_in_band_hz": loop.in_band_hz,
    }


def _reach(found: Preflight) -> dict[str, ArrayLike]:
    """Return the metrics of predicted peaks and their limits."""
    values: dict[str, ArrayLike] = {}
    for row in found.reach:
        values[f"check.peak_{row.name}"] = row.peak
        values[f"check.limit_{row.name}"] = row.limit
    return values


def _errors(found: Prediction) -> dict[str, ArrayLike]:
    """Return the metrics of the predicted errors, in total and by cause."""
    parts = [("", found.total), *((f"_{cause}", errors) for cause, errors in found.causes.items())]
    storeys: dict[str, ArrayLike] = {f"check.rms_error{part}_m_s2": errors.storeys for part, errors in parts}
    return storeys | {f"check.tracking_rms{part}_m_s2": errors.tracking for part, errors in parts}


def choose_design(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues | None = None
) -> tuple[Design, Judged]:
    """Return the design that a case gets and the check of it; `design` is that of `design_blocks`.

    Raises InputError as `judge`.
    """
    shared = shared or SharedValues()
    countered: Judged | None = None
    why: Finding | None = None
    if design.plain is not None:
        countered, why = _countered(setup, identified, design, shared)
        if countered is not None and not _samples_dominate(setup, countered):
            return replace(design, plain=None), countered
    plain = design.without_reaction()
    judged = judge(setup, identified, plain, shared)
    if why and judged.preflight.verdict == SAFE:
        plain = replace(plain, reaction_left=why)
    found = choose_filter(setup, identified, plain, judged, shared)
    return found if countered is None or found[0].chosen_filter else (replace(design, plain=None), countered)


def _countered(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues
) -> tuple[Judged | None, Finding | None]:
    """Return the check of the design that counters the reaction; None, and why, if the test is not safe with it.

    Without stated ends of the specimen's stiffness the loop is judged at those of REACTION_RANGE, with every sample of
    the model.
    """
    try:
        judged = judge(setup, identified, design, shared)
        stated = stated_ends(setup.case, design.blocks.counters_reaction) is not None
        faults = [] if stated else _faults_at_ends(setup, identified, design, shared, REACTION_RANGE)
    except InputError:  # a sample of the model shows no compliance; what else it may be is raised without the reaction
        return None, NOT_SHOWN
    reasons = (*judged.preflight.faults, *faults)
    return (None, Finding("reaction.not_safe", {"reason": reasons[0]})) if reasons else (judged, None)


def _faults_at_ends(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues, ends: tuple[float, float]
) -> list[Finding]:
    """Return why the loop is not safe at one of these ends of the specimen's stiffness, with every sample of the
    model."""
    faults: list[Finding] = []
    for one in (identified, *identified.samples):
        told = setup.calibrated(one)
        building = with_laws(told, one, design)
        faults += faults_at_tangents(tangent_verdicts(told, one, design.blocks, building, shared, ends))
    return faults


def choose_filter(
    setup: Setup, identified: Identification, design: Design, judged: Judged, shared: SharedValues
) -> tuple[Design, Judged]:
    """Return the design with the filter that is expected to have the smallest error, and the check of it.

    `design` and `judged` are those of the usual filter. They are returned where the case leaves no choice, where noise
    and rounding of the samples are not most of the predicted error, and where no filter of TRUSTING is better and as
    safe, also with a specimen that has lost stiffness (KNOWN_RANGE).
    """
    if not _samples_dominate(setup, judged) or judged.known is None:
        return design, judged
    usual = judged.predicted or predict(judged.known)
    best, least = (design, judged), GAIN * _expected(setup, identified, design, judged, usual)
    for q, usual_hz in TRUSTING:
        spec = setup.case.kalman.model_copy(
            update={"q": q * setup.case.kalman.r, "residual_hz": usual_hz * setup.case.test_band_hz / TEST_BAND_HZ}
        )
        other = replace(setup, case=setup.case.model_copy(update={"kalman": spec}))
        try:
            made = replace(design_blocks(other, identified, shared).without_reaction(), chosen_filter=spec)
            found = judge(other, identified, made, shared)
        except InputError:  # this filter has no solution for the specimen, or no feedback suits it
            continue
        if found.known is None or judged.preflight.verdict == SAFE != found.preflight.verdict:
            continue
        if _faults_at_ends(other, identified, made, shared, KNOWN_RANGE):
            continue
        error = _expected(other, identified, made, found, found.predicted or predict(found.known))
        if error < least:
            best, least = (made, found), error
    return best


def _samples_dominate(setup: Setup, judged: Judged) -> bool:
    """Return whether the filter may be chosen, and noise and rounding of the samples are most of the predicted error
    and not negligible."""
    if not _leaves_choice(setup) or judged.known is None:
        return False
    usual = judged.predicted or predict(judged.known)
    by_samples = np.hypot(usual.causes["noise"].storeys, usual.causes["quantisation"].storeys)
    mostly = by_samples > np.sqrt(0.5) * usual.total.storeys
    return bool(np.any(mostly & (by_samples > WORTH * judged.sim_rms_m_s2)))


def _leaves_choice(setup: Setup) -> bool:
    """Return whether the filter may be chosen: method best with its own blocks, a linear building, a specimen whose
    stiffness has no range, and no weights stated."""
    case = setup.case
    ranged = case.controller.reaction_feedforward is True or (
        case.check is not None and case.check.specimen_range is not None
    )
    plain = case.method == "best" and not setup.building.has_laws and not setup.parts and not ranged
    return plain and case.kalman.choice == "automatic"


def _expected(
    setup: Setup, identified: Identification, design: Design, judged: Judged, prediction: Prediction
) -> float:
    """Return the predicted error over SIM's RMS at the worst storey, that of a changed specimen included."""
    assert judged.known is not None
    factor, blocks = 1.0 + stiffness_uncertainty(setup, identified), design.blocks.linearised()
    changed = changed_specimen_error(setup, identified, blocks, judged.known, prediction, factor)
    return float(np.max(np.hypot(prediction.total.storeys, changed) / judged.sim_rms_m_s2))


def judge_table_test(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues | None = None
) -> Preflight:
    """Return the check of a case's shake-table test with the designed blocks, over all samples of the model."""
    shared = shared or SharedValues()
    nominal, *samples = (_judge_one(setup, one, design, shared) for one in (identified, *identified.samples))
    return preflight.over_samples(nominal, samples) if samples else nominal


def _judge_one(setup: Setup, identified: Identification, design: Design, shared: SharedValues) -> Preflight:
    setup, blocks = setup.calibrated(identified), design.blocks
    found = loop_stability(setup, identified, blocks, shared, alone=True)
    known = _known(setup, identified, blocks, found)
    nominal = Prediction({}, NO_ERRORS, np.zeros(0), hybrid(known.loop, known.ground, np.zeros_like(known.floors)))
    masses = np.concatenate([[setup.rig.moving_mass_kg], setup.floor_masses_kg])
    rows = preflight.reach(known, nominal, setup.rig, masses, preflight.strays(known, found))
    further = _table_test_faults_at_ends(setup, identified, blocks, shared)
    feedback, least_s = setup.case.controller.kind == "FF+FB", required_delay_s(setup, identified, blocks)
    return preflight.judge(NO_BUILDING, found, rows, setup.case.scaling, None, further, feedback, least_s, alone=True)


def _table_test_faults_at_ends(
    setup: Setup, identified: Identification, blocks: Blocks, shared: SharedValues
) -> tuple[Finding, ...]:
    """Return why the loop is not safe at an end of the specimen's stiffness; the loop does not contain the specimen
    unless the feedforward counters its reaction."""
    if not blocks.counters_reaction:
        return ()
    specimen, found = _specimen(identified), []
    for factor in stated_ends(setup.case, True) or REACTION_RANGE:
        if factor != 1.0:
            there = with_specimen(as_identified(setup, specimen), factor).specimen
            faults = loop_faults(setup, identified, blocks, shared, there, alone=True)
            found += [fault.at("at.specimen", stiffness_ratio=factor) for fault in faults]
    return tuple(found)


def _specimen(identified: Identification) -> Specimen:
    assert identified.specimen is not None  # every case has experimental storeys
    return identified.specimen.specimen


def _known(setup: Setup, identified: Identification, blocks: Blocks, found: Stability) -> PredictionInputs:
    """Return what the peaks of the shake-table test follow from."""
    dt, motion, specimen = setup.rig.dt_s, setup.motion, _specimen(identified)
    rig, _ = loop_parts(setup, identified)
    linear, storey = table_alone(blocks)
    ring = RINGS * dt / -math.log(found.radius) if found.radius < 1.0 else LONGEST_S
    lines = lines_for(len(motion.time_s), dt, min(ring, LONGEST_S), lowest_reliable_hz(setup), setup.case.test_band_hz)
    ground = lines.of_motion(motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m)
    floors = np.vstack([np.ones(lines.count), specimen_state_space(specimen).response(lines.frequency_hz)[:, 0]])
    return PredictionInputs(
        loop=loop_response(rig, linear, storey, lines.z),
        lines=lines,
        model=identified.best,
        measured=identified.frfs[0],
        friction=identified.friction,
        floors=floors,
        ground=ground,
        sim=floors * ground[0],
        velocity_m_s=motion.velocity_m_s,
        noise_m_s2=noise_before_correction(identified, linear.correction, setup),
        rig=setup.rig,
        correction=linear.correction,
        shaped=linear.shaping_step_v > 0.0,
        excess=rig.excess,
        compared=setup.compared,
        specimen=specimen,
        peaks_m_s2=_peaks(setup, specimen, lines.padded),
        zero_m_s2=shown_zeros(identified, setup),
        slow_roots=slow_roots(closed_loop_matrix(rig, linear), dt, lines.padded * dt),
    )


def _peaks(setup: Setup, specimen: Specimen, padded: int) -> Array:
    """Return the peaks (c,) in m/s^2 of table and floors on a table that follows the ground exactly, at all
    frequencies."""
    accel, dt = setup.motion.accel_m_s2, setup.rig.dt_s
    response = specimen_state_space(specimen).response(np.arange(padded // 2 + 1) / (padded * dt))[:, 0]
    floors = irfft(response * rfft(accel, padded), padded)[:, : len(accel)]
    return np.abs(np.vstack([accel, floors])).max(axis=1)


@dataclass(frozen=True)
class Verdict:
    """The verdict on EXP-RTHS, with the design that was judged."""

    verdict: str  # SAFE, UNSAFE or UNSTABLE; "" if the case has no hybrid test
    findings: tuple[Finding, ...]  # why it is not safe
    design: Design | None  # None: no blocks can be designed
    figures: dict[str, ArrayLike]  # metrics `check.*` by path
    loop: PredictionInputs | None = None  # inputs of the error budget; None: the loop is unstable or was not judged
    replay: Callable[[], Replayed] | None = None  # the test of storeys with laws for the budget; None: it has none
    tangents: tuple[str, ...] = ()  # what the metrics check.tangent_* are of, in words
    bound: Finding | None = None  # of the true error; None where nothing is uncertain
    remedy: Finding | None = None  # the measurement that would lower the bound most
    true_error: TrueError | None = None  # its distribution; None: sensors and masses are exactly as declared
    uncertain: Uncertain | None = None  # for that distribution after the run; None: the loop is unstable, not judged
    # what each run on the table needs, by its name; no entry where nothing is known of it
    planned: Mapping[str, PlannedMotion] = field(default_factory=dict)
    of_guard: tuple[Finding, ...] = ()  # on the guard's limits in these runs
    table_test: Preflight | None = None  # the check of the shake-table test; None: there is none, or no design

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return why it is not safe, one sentence each."""
        return sentences(self.findings)

    @property
    def worst(self) -> str:
        """Return the worst verdict of all table runs; "" without one."""
        told = (self.verdict, self.table_test.verdict if self.table_test else "")
        return max(told, key=("", *VERDICTS).index)

    def of_run(self, run: str) -> tuple[str, tuple[Finding, ...]]:
        """Return verdict and reasons of one table run by its name, shake_table or exp_rths."""
        if run == "shake_table" and self.table_test is not None:
            return self.table_test.verdict, self.table_test.faults
        return self.verdict, self.findings

    def refuses(self, run: str) -> bool:
        """Return whether a table run is not safe."""
        return self.of_run(run)[0] in (UNSAFE, UNSTABLE)

    @property
    def remarks(self) -> dict[str, str]:
        """Return remarks on the metrics by path: what each tangent is."""
        named = "; ".join(f"{number}: {name}" for number, name in enumerate(self.tangents, 1))
        return {path: named for path in self.figures if path.startswith("check.tangent_")}

    @property
    def refused(self) -> bool:
        """Return whether there is a hybrid test and it is not safe."""
        return self.verdict in (UNSAFE, UNSTABLE)


@dataclass(frozen=True)
class Tested:
    """Description of a checked case, for the page and the document."""

    case: str  # name
    file: str  # path as a user would type it
    structure: str  # name
    damping: str  # name
    record: str  # name
    scaling: float  # factor on the record
    controller: str  # kind: none, FF or FF+FB
    method: str  # paper or best
    rig: str  # name
    rig_kind: str  # kind of the rig
    sample_rate_hz: float
    delay_s: float  # of the base shear in SIM-DELAY
    model: str  # source of the identified model, in words
    overrides: tuple[str, ...] = ()  # as given by --override
    test_band_hz: float = TEST_BAND_HZ
    compared_hz: tuple[float, float] = COMPARED_HZ  # band in which the table's model is compared with its data
    scale: dict[str, float] | None = None  # factors by quantity, prototype over model; None: the case states none
    record_s: float = 0.0  # length of the record in the laboratory
    calibration: str = ""  # day and person of the rig's calibration file; "": it has none


@dataclass(frozen=True)
class Checked:
    """The result of the check of one case."""

    about: Tested
    verdict: str  # SAFE, UNSAFE or UNSTABLE: the worst of all table runs
    refusals: tuple[Finding, ...]  # why it is not safe
    notes: tuple[Finding, ...] = ()  # what does not change the verdict
    metrics: Values = field(default_factory=dict)  # by path
    tangents: tuple[str, ...] = ()  # what the metrics check.tangent_* are of, in words
    of_guard: tuple[Finding, ...] = ()  # on the guard's limits
    runs: tuple[tuple[str, str], ...] = ()  # label and verdict of each table run
    doubted: tuple[str, ...] = ()  # keys whose numbers seem to be in another unit; the verdict holds if they are right

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return why it is not safe, one sentence each."""
        return sentences(self.refusals)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what does not change the verdict, one sentence each."""
        return sentences(self.notes)

    @property
    def exit_code(self) -> int:
        """Return 0 for a safe case, else 1."""
        return 0 if self.verdict == SAFE else 1


def verdict_on(
    setup: Setup, known: IdentifiedModel, hybrid: bool = True, design: Design | None = None,
    shared: SharedValues | None = None, table_test: bool = True,
) -> Verdict:  # fmt: skip
    """Return the verdict on a case's table runs, from the identification `known` of its rig and specimen.

    If `hybrid` is False, there is no hybrid test: the verdict is "", or UNSAFE if no blocks can be designed. `design`:
    blocks that were designed already, for example for another record; None: they are designed here. With `shared`,
    cases compute common results once. If the model is rejected and, for that reason, no controller can be designed or
    the building cannot be solved, only the reasons of the rejection are returned. The shake-table test of a case that
    has one is judged with the same design unless `table_test` is False. Doubts on units precede the reasons.
    """
    runs = tuple(kind for kind in TABLE_RUNS if kind.name in setup.case.runs and (table_test or kind is HYBRID_TEST))
    found = _with_plans(setup, known, _judged(setup, known, hybrid, design, shared), runs)
    if found.design is not None and table_test and "shake_table" in setup.case.runs:
        blocks = found.design
        of_table = interruptible(lambda: judge_table_test(setup, known.found, blocks, shared))
        of_table = _without_innocent_limits(setup, of_table)
        if faults := known.faults(setup.overrides):
            worse = UNSAFE if of_table.verdict == SAFE else of_table.verdict
            of_table = replace(of_table, verdict=worse, faults=(*faults, *of_table.faults))
        figures = {f"check.shake_table_{name}": value for name, value in table_test_figures(of_table).items()}
        found = replace(found, table_test=of_table, figures=found.figures | figures)
    return replace(found, findings=(*unit_doubts(setup), *found.findings)) if found.findings else found


def _with_plans(setup: Setup, known: IdentifiedModel, found: Verdict, runs: Sequence[RunKind]) -> Verdict:
    """Return a verdict with what each of these runs needs of the table, and with the limits of its guard."""
    if found.design is None:
        return found
    planned: dict[str, PlannedMotion] = {}
    said: list[Finding] = []
    figures = dict(found.figures)
    for kind in runs:
        one = _plan(setup, known, found.design, kind)
        if one is not None:
            planned[kind.name] = one
        figures |= guard_figures(setup, kind.name, one)
        said += guard_findings(setup, kind.label, one)
    return replace(found, planned=planned, figures=figures, of_guard=tuple(said))


def _plan(setup: Setup, known: IdentifiedModel, design: Design, kind: RunKind) -> PlannedMotion | None:
    try:
        drive = drive_of(setup, design)
        return interruptible(lambda: planned_motion(setup, known.found, design, drive, kind.source))
    except InputError:  # no model of the rig, or a building that has no SIM: the verdict says so
        return None


def _judged(
    setup: Setup, known: IdentifiedModel, hybrid: bool, design: Design | None, shared: SharedValues | None
) -> Verdict:
    """Return the verdict without doubts on units."""
    faults, shared = known.faults(setup.overrides), shared or SharedValues()
    try:
        design = design or interruptible(lambda: design_blocks(setup, known.found, shared))
    except InputError as error:
        return Verdict(UNSAFE, faults or tuple(map(stated, error.faults)), None, {})
    designed = design
    if not hybrid:
        return Verdict("", faults, designed.without_reaction(), {})
    try:
        design, judged = interruptible(lambda: choose_design(setup, known.found, designed, shared))
    except InputError as error:
        return Verdict(UNSAFE, faults or tuple(map(stated, error.faults)), designed.without_reaction(), {})
    found = _without_innocent_limits(setup, judged.preflight)
    verdict = UNSAFE if faults and found.verdict == SAFE else found.verdict
    tangents = tuple(one.name for one in judged.tangents)
    reasons, figures = (*faults, *found.faults), check_figures(judged)
    return Verdict(
        verdict, reasons, design, figures, judged.known, judged.replay, tangents, *_on_true_error(setup, judged),
        judged.true_error, judged.uncertain,
    )  # fmt: skip


def _without_innocent_limits(setup: Setup, found: Preflight) -> Preflight:
    """Return a check whose reasons tell limits that the record's baseline exceeds as what it does, and not as too small
    a table."""
    exceeded = [fault for fault in found.faults if fault.values.get("quantity") in MOVED_BY_BASELINE]
    if not setup.baseline or not exceeded:
        return found
    baseline = setup.baseline.at("at.place", place=place_of(setup.case, "record"))
    if any(fault.beyond > 1.0 + setup.baseline_share for fault in exceeded):  # without the baseline, too
        return replace(found, faults=(baseline, *found.faults))
    quantities = tuple(dict.fromkeys(str(fault.values["quantity"]) for fault in exceeded))
    moved = Finding("record.beyond_by_baseline", {"quantities": quantities})
    return replace(found, faults=(baseline, moved, *(fault for fault in found.faults if fault not in exceeded)))


def _on_true_error(setup: Setup, judged: Judged) -> tuple[Finding | None, Finding | None]:
    """Return what bounds the true error at the worst storey, and the measurement that would lower the bound most.

    Errors are over SIM-DELAY's, or over SIM's RMS where SIM-DELAY diverges.
    """
    uncertain, remedy = judged.true_error, judged.remedy
    if uncertain is None:
        return None, None
    scale, reference = judged.sim_delay_rms_m_s2, "sim_delay_error"
    if scale is None or not np.all(scale > 0.0):
        scale, reference = judged.sim_rms_m_s2, "sim_rms"
    worst = int(np.argmax(uncertain.bound / scale))
    size, pitch = float(scale[worst]), uncertain.pitch
    shares = {name: float(getattr(uncertain, name)[worst]) / size for name in ("bound", "median", "calibration")}
    storey = {"reference": reference, "storey": worst + 1}
    bound = Finding("true_error.bound", {**shares, **storey, "pitch": None if pitch is None else pitch[worst] / size})
    if remedy is None:
        return bound, None
    channels = setup.rig.channels
    of_sensor = remedy.parameter < len(channels)
    channel = channels[remedy.parameter if of_sensor else 1 + remedy.parameter - 3 * len(channels)].name
    lowered = {"to": remedy.error, "bound": shares["bound"], "lowered": float(remedy.bound[worst]) / size}
    code = "true_error.compare_sensor" if of_sensor else "true_error.weigh_floor"
    return bound, Finding(code, {**storey, **lowered, "channel": channel, "case": shown(setup.case.path)})


def check_cases(
    cases: Sequence[Case],
    overrides: tuple[str, ...],
    progress: Progress,
    memory: Memory | None = None,
    parts: OwnParts | None = None,
    samples: OwnSamples = (),
) -> list[Checked]:
    """Return the verdict on each case; all cases and model files are read before the first one is judged.

    `memory`: identifications to use; None: a new memory with the cache of virtual rigs. Raises InputError with all
    faults of the cases.
    """
    memory = memory or Memory(Cache())
    if recorded := [case for case in cases if case.recorded]:
        raise InputError(*(
            f"{place_of(case, next(iter(case.recorded)))}: is a run that was made; nothing is to be checked before it. "
            "rths run judges it; to check its controller from its state space, remove the key and name it under "
            "controller (kind: state_space)"
            for case in recorded
        ))  # fmt: skip
    setups = make_setups(cases, overrides, parts=parts, samples=samples, progress=progress)
    for setup in setups:
        refuse_unstable_steps(setup.case, setup.building)
    for setup in setups:
        memory.prepare(setup)
    return [check_case(setup, memory, progress) for setup in setups]


def loop_of(case: Case, progress: Progress) -> Block:
    """Return the open loop of a case's hybrid test, from the identified rig and the designed blocks.

    Raises InputError for a case that cannot be read, and where no blocks can be designed; RigError or LimitError if
    its virtual rig cannot be identified.
    """
    memory, setup = Memory(Cache()), make_setups([case], ())[0]
    known = memory.at_rest(setup, progress)
    design = interruptible(lambda: choose_design(setup, known.found, design_blocks(setup, known.found))[0])
    return open_loop(loop_parts(setup, known.found)[0], design.blocks)


def _step_times(setup: Setup) -> tuple[Finding, ...]:
    """Return what a program's answers take here, () without one or where it has no SIM."""
    building = setup.building
    if not building.has_program:
        return ()
    try:
        sim = reference_of(building).sim(building, setup.rig.dt_s, setup.motion.accel_m_s2)
        return step_time_note(building, sim)
    except InputError:  # the verdict says so
        return ()


def check_case(setup: Setup, memory: Memory, progress: Progress) -> Checked:
    """Return the verdict on one case; the case is unsafe if its virtual rig cannot be identified."""
    progress(f"check: {setup.case.name}")
    try:
        known = memory.at_rest(setup, progress)
    except (RigError, LimitError) as error:
        why, doubts = before_error(setup, error), unit_doubts(setup)
        return Checked(_about(setup, "none"), UNSAFE, why, doubts, doubted=keys_in_doubt(setup))
    hybrid = "exp_rths" in setup.case.runs or "shake_table" not in setup.case.runs
    found = verdict_on(setup, known, hybrid)
    figures = (
        {} if found.design is None else result_contents.design_figures(setup, known.found, found.design) | found.figures
    )
    told = () if "model" in setup.overrides else known.found.verdict.refusals
    notes = without_repeats(of_case(setup, known.found, found.design), told)
    notes = tuple(input_first((*filter(None, (found.bound, found.remedy)), *_step_times(setup), *notes)))
    runs = [("EXP-RTHS", found.verdict)] if hybrid else []
    excited = excitations(setup, known)
    reasons = (*found.findings, *(fault.at("at.run", run=label) for label, faults in excited for fault in faults))
    if found.table_test is not None:
        of_table = without_repeats(found.table_test.faults, reasons)
        reasons = (*reasons, *(fault.at("at.run", run="shake-table test") for fault in of_table))
        runs.insert(0, ("shake-table test", found.table_test.verdict))
    runs = [*((label, UNSAFE if faults else SAFE) for label, faults in excited), *runs]
    worst = max((found.worst, *(verdict for _, verdict in runs)), key=("", *VERDICTS).index)
    return Checked(
        _about(setup, known.source), worst, reasons, notes, figures, found.tangents, found.of_guard, tuple(runs),
        keys_in_doubt(setup),
    )  # fmt: skip


def excitations(setup: Setup, known: IdentifiedModel) -> list[tuple[str, tuple[Finding, ...]]]:
    """Return label and faults of the excitations that are played before the table runs of a case; () if it is safe."""
    from rths_cli.experiment.excitation_plan import excitation_faults, excitation_settings, plan
    from rths_cli.identification.low_level_probe import probe_plan

    if setup.rig.interface == "displacement":  # planned with a quarter of each limit
        return [("identification", ())] if setup.case.identification.model is None else []
    settings = excitation_settings(setup.case.identification)
    found = []
    if setup.case.identification.model is None:
        found.append(("identification", plan(setup).command_v))
    if setup.case.identification.model is not None or wants_session_record(setup):
        most_m_s2 = known.found.low_level_m_s2 or math.inf
        low = probe_plan(setup.rig, settings, setup.case.identification.seed, most_m_s2)
        found.append(("verification" if setup.case.identification.model else "record of the session", low.command_v))
    return [(label, excitation_faults(setup, command_v)) for label, command_v in found]


def _about(setup: Setup, model: str) -> Tested:
    """Return the description of a case; `model`: source of the identified model, in words."""
    case = setup.case
    return Tested(
        case=case.name,
        file=shown(case.path),
        structure=case.structure.name,
        damping=case.damping.name,
        record=case.record.name,
        scaling=case.scaling,
        controller=case.controller.kind,
        method=case.method,
        rig=setup.rig.name,
        rig_kind=setup.rig.kind,
        sample_rate_hz=case.sample_rate_hz,
        delay_s=case.delay_s,
        model=model,
        overrides=setup.overrides,
        test_band_hz=case.test_band_hz,
        compared_hz=setup.compared.hz,
        record_s=float(setup.motion.time_s[-1]),
        calibration="" if case.table.calibration is None else case.table.calibration.told,
        scale=None if setup.similitude is None else setup.similitude.factors,
    )
