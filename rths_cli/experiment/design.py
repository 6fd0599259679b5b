"""Design all blocks of a run from what was identified; choose feedback weights with which the loop keeps the
check's margins.

The default weights suit most buildings. For the others, a margin is too small in one of two frequency ranges. In the
compared band, at a lightly damped mode, a change of the table's gain makes the loop unstable; a feedback with more gain
there, that is with a lower command weight and a lower band, lets the table follow in spite of it. Above, where the gain
of the whole loop crosses one, a feedback amplifies; a gentler one, with a lower peak of |S|, amplifies less. Both are
tried, beginning with the weights nearest to the default.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.analysis import stability_check as preflight
from rths_cli.analysis.identified_rig_block import identified_rig, with_another_specimen
from rths_cli.control import (
    designed_blocks,
    feedback,
    feedforward,
    friction_compensation,
    kalman_filter,
    reaction,
    sensor_correction,
)
from rths_cli.control.block_files import placed_block
from rths_cli.control.compensator import Plant
from rths_cli.control.continued_table import ContinuedTable, continued_table
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.displacement_interface import measured_force
from rths_cli.control.feedback import DEFAULT, Feedback, Weights, none
from rths_cli.control.interface import Interface, force_of_one
from rths_cli.control.numerical_substructure import INPUTS, INTERFACE, all_storeys
from rths_cli.control.program_storeys import ProgramStoreys
from rths_cli.control.python_control import from_control
from rths_cli.control.reaction import compliance
from rths_cli.control.state_space import static
from rths_cli.control.storeys_with_laws import computed_storeys
from rths_cli.errors import InputError
from rths_cli.experiment import actuator
from rths_cli.experiment.setup import NUMERICAL, made, placed
from rths_cli.findings import Finding
from rths_cli.identification.inputs import PAPER_BAND_HZ
from rths_cli.identification.verdict import LIMITS
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.numerics.content_key import content_key
from rths_cli.numerics.lti import Block
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from rths_cli.analysis.identified_rig_block import IdentifiedRig
    from rths_cli.case.case_schema import Case, KalmanSpec
    from rths_cli.control.interface import InterfaceForce, PartDesign
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification, LevelBand
    from rths_cli.numerics.bands import ComparedBand
    from rths_cli.numerics.lti import Model
    from rths_cli.rigs.description import RigInfo
    from rths_cli.structure import Specimen

    Faults = Callable[[Feedback], list[Finding]]
    Make = Callable[[Weights, float], Feedback]

# for the usual test band; their bands keep their ratio to another one
FIRMER = (DEFAULT, Weights((1.0, 12.0), 1e-3), Weights((0.5, 6.0), 1e-3), Weights((0.25, 3.0), 1e-3))
HALVINGS = 3  # number of times that the largest amplification, max |S| - 1, is halved
DIGITS = 4  # decimal digits of a chosen limit on max |S|, so that a case can state it
NOT_SHOWN = Finding("reaction.not_shown")


def loop_parts(
    setup: Setup, identified: Identification, there: Specimen | None = None, counters_reaction: bool = False
) -> tuple[IdentifiedRig, Block]:
    """Return the parts of a case's loop that are not designed: the identified rig, and all numerical storeys.

    `there`: the specimen that stands on the table instead of the identified one. If the feedforward `counters_reaction`
    the table moves as the other reaction makes it; otherwise its response stays as identified.
    """
    if actuator.is_of_actuator(setup):
        return actuator.rig_of(setup, identified)
    assert identified.specimen is not None  # every case has experimental storeys
    setup = setup.calibrated(identified)
    specimen, model, compared = identified.specimen.specimen, identified.best, setup.compared
    judged = specimen if there is None or counters_reaction else there
    rig = identified_rig(model, judged, setup.rig, setup.removes_sensors, compared)
    if there is not None and judged is specimen:
        table = compliance(model, specimen)
        rig = with_another_specimen(rig, model, specimen, there, table, setup.rig, setup.removes_sensors)
    return rig, all_storeys(setup.building.numerical, setup.rig.dt_s, setup.case.integration)


def continued_of(setup: Setup, identified: Identification, there: Specimen | None = None) -> ContinuedTable:
    """Return the identified table of a case continued beyond its band by masses, specimen and drive.

    `there`: the specimen that stands on it instead of the identified one.
    """
    fit, model, measured = identified.specimen, identified.best, identified.frfs[0]
    assert fit is not None  # every case has experimental storeys
    end_hz = max(min(model.band_hz[1], float(measured.frequency_hz[-1])), setup.compared.high_hz)
    of_modes = float(np.max(fit.frequency_error_hz / fit.natural_frequency_hz))
    shift = preflight.SIGMA * float(np.hypot(0.5 * setup.rig.uncertainty.specimen, of_modes))
    moved_kg = setup.rig.moving_mass_kg + setup.building.interface_experimental_mass_kg
    found = continued_table(model, measured, fit.specimen, moved_kg, end_hz, shift)
    return found if there is None else found.with_specimen(there)


def table_alone(blocks: Blocks) -> tuple[Blocks, Block]:
    """Return linear blocks of a shake-table test, which desires the ground's motion, and its one "storey", the table.

    Feedforward and feedback are around the table; there is no numerical substructure and no base shear.
    """
    blocks = blocks.linearised()
    dt_s, c = blocks.correction.dt_s, len(blocks.correction.C)
    ground = static(np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]]), dt_s, "ground", INPUTS, INTERFACE)
    storey = static(np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]]), dt_s, "table", INPUTS, INTERFACE)
    no_shear = force_of_one(np.zeros(len(blocks.estimator.C)), np.zeros(blocks.lead_samples), np.zeros(c), 0.0)
    return replace(blocks, numerical=ground, interface=Interface(no_shear)), storey


def loop_stability(
    setup: Setup,
    identified: Identification,
    blocks: Blocks,
    shared: SharedValues | None = None,
    there: Specimen | None = None,
    alone: bool = False,
) -> preflight.Stability:
    """Return the stability of a case's loop with these blocks; with `shared`, equal loops are evaluated once.

    `there` as in `loop_parts`; `alone`: the loop of the shake-table test (`table_alone`). A friction compensation among
    the blocks adds nothing to the linear loop, but makes the table differ less with the level.
    """
    rig, storeys = loop_parts(setup, identified, there, blocks.counters_reaction)
    identified = replace(identified, levels=_levels_left(identified.levels, blocks))
    blocks, samples = blocks.linearised(), len(setup.motion.time_s)
    if alone:
        blocks, storeys = table_alone(blocks)
    gain = setup.rig.uncertainty.table_gain
    continued = None if actuator.is_of_actuator(setup) else continued_of(setup, identified, there)
    data = identified.best, identified.frfs[0], identified.levels
    found = (shared or SharedValues()).get(
        "stability",
        content_key(rig, blocks, storeys, *data, setup.compared, gain, continued),
        lambda: _stability(rig, blocks, storeys, identified, samples, setup.compared, gain, continued),
    )
    return replace(found, growth=preflight.growth(found.radius, samples))


def loop_faults(
    setup: Setup,
    identified: Identification,
    blocks: Blocks,
    shared: SharedValues | None = None,
    there: Specimen | None = None,
    alone: bool = False,
) -> list[Finding]:
    """Return the reasons why a case's loop with these blocks is not safe with any record; empty if it is safe.

    `there` and `alone` as in `loop_stability`.
    """
    found = loop_stability(setup, identified, blocks, shared, there, alone)
    feedback = setup.case.controller.kind == "FF+FB"
    return preflight.faults_of_loop(found, feedback, required_delay_s(setup, identified, blocks), alone)


def required_delay_s(setup: Setup, identified: Identification, blocks: Blocks) -> float:
    """Return the further delay in s that a case's loop must tolerate."""
    bridged = setup.rig.can.bridges_lost_samples and blocks.lead_samples > 0
    error_s = identified.latency.error_s if identified.latency else None
    return preflight.required_delay_s(setup.rig.dt_s, bridged, error_s, bool(identified.levels), setup.compared)


def _levels_left(levels: tuple[LevelBand, ...], blocks: Blocks) -> tuple[LevelBand, ...]:
    """Return the table's response at low level over that at full level with the blocks' friction compensation, which
    leaves the share of the difference that the low-level record has shown."""
    counters = blocks.friction_compensation
    left = 1.0 if counters is None else counters.left
    return tuple(replace(band, ratio=1.0 + left * (band.ratio - 1.0)) for band in levels)


def _stability(
    rig: IdentifiedRig,
    blocks: Blocks,
    storeys: Block,
    identified: Identification,
    samples: int,
    compared: ComparedBand,
    gain: float,
    continued: ContinuedTable | None,
) -> preflight.Stability:
    """Return the stability of the loop; `gain`: relative standard uncertainty of the table's gain.

    For a feedback with a limit it is the worse of the loops with and without feedback, because a feedback at its limit
    has no effect.
    """
    best, measured, levels = identified.best, identified.frfs[0], identified.levels
    found = preflight.stability(rig, blocks, storeys, best, measured, samples, levels, compared, gain, continued)
    if not math.isfinite(blocks.feedback_limit_v):
        return found
    alone = replace(blocks, feedback=none(rig.plant.dt_s))
    without = preflight.stability(rig, alone, storeys, best, measured, samples, levels, compared, gain, continued)
    worse = min(found, without, key=lambda each: (each.radius < 1.0, each.tolerates / each.required))
    late = min(found.measured, without.measured, key=lambda each: each.delay_margin_s)
    apart, same_side = max(found.apart, without.apart), found.same_side and without.same_side
    return replace(worse, apart=apart, measured=late, feedback=found.feedback, same_side=same_side)


@dataclass(frozen=True)
class Chosen:
    """Weights that were chosen instead of the default ones."""

    weights: Weights
    max_sensitivity: float  # limit on max |S|
    # True: the default weights gave a feedback, but the loop lacked the check's margins; False: they gave none
    usual_of_use: bool = True


def choose_feedback(
    setup: Setup, identified: Identification, model: Model, faults: Faults, shared: SharedValues
) -> tuple[Feedback, Chosen | None]:
    """Return the case's feedback, and the weights chosen instead of the default ones (None: no choice was made).

    `faults` returns the reasons why the loop is not safe with a feedback. A case that states weights or bandwidth gets
    them. Method `paper`, and a case without hybrid test, which has no loop, get the default weights. If no choice is
    safe, the default feedback is kept. Beyond the identified band the feedbacks of method `best` are as quiet as the
    continued table asks for; method `paper` keeps its feedback as printed, for the check to judge. Raises InputError if
    no useful feedback exists.
    """
    stated, band_hz = setup.case.controller, setup.case.test_band_hz

    continued = continued_of(setup, identified) if setup.case.method == "best" else None

    def make(weights: Weights, max_sensitivity: float) -> Feedback:
        asked = (
            model, identified.frfs[0], setup.rig.dt_s, stated.feedback_bandwidth_hz, max_sensitivity, weights,
            continued,
        )  # fmt: skip
        return shared.get("feedback", content_key(*asked), lambda: feedback.design(*asked))

    if not _leaves_choice(setup):
        try:
            return make(_stated_weights(setup), stated.max_sensitivity), None
        except InputError as error:
            raise InputError(*_of_printed_model(setup, identified, error)) from None
    try:
        usual = make(DEFAULT.for_test_band(band_hz), stated.max_sensitivity)
    except InputError:
        other = first_safe(make, faults, stated.max_sensitivity, band_hz)
        if other is None:
            raise
        return other[0], replace(other[1], usual_of_use=False)
    if not faults(usual):
        return usual, None
    return first_safe(make, faults, stated.max_sensitivity, band_hz) or (usual, None)


def _leaves_choice(setup: Setup) -> bool:
    """Return whether the weights may be chosen: method best, a hybrid test, no stated weights or bandwidth."""
    stated = setup.case.controller
    fixed = (stated.disturbance_hz, stated.command_weight, stated.feedback_bandwidth_hz)
    return setup.case.method == "best" and "exp_rths" in setup.case.runs and fixed == (None, None, None)


def _of_printed_model(setup: Setup, identified: Identification, error: InputError) -> tuple[str, ...]:
    """Return the faults for which there is no feedback; for method `paper` with a poor model, that is the cause."""
    missed, band = identified.paper_error.rms, setup.compared
    if setup.case.method != "paper" or missed <= LIMITS.rms:
        return error.faults
    return (
        f"method paper: its model of the table, fitted up to {band.with_high(PAPER_BAND_HZ[1]):g} Hz, misses the "
        f"measured response by {missed:.2g} (RMS, {band}; at most {LIMITS.rms:g}), and no feedback can be designed "
        "from it; use method best",
    )


def _stated_weights(setup: Setup) -> Weights:
    """Return the weights that a case states, default ones where it states none; method `paper` has no high pass."""
    stated = setup.case.controller
    usual = DEFAULT.for_test_band(setup.case.test_band_hz)
    corner = 0.0 if setup.case.method == "paper" else usual.high_pass_hz
    weight = usual.command_weight if stated.command_weight is None else stated.command_weight
    low, high = stated.disturbance_hz or usual.disturbance_hz
    return replace(usual, disturbance_hz=(low, high), command_weight=weight, high_pass_hz=corner)


def first_safe(
    make: Make, faults: Faults, max_sensitivity: float, test_band_hz: float = TEST_BAND_HZ
) -> tuple[Feedback, Chosen] | None:
    """Return the first feedback with which the loop is safe and its weights, None if there is none.

    The weights of FIRMER are tried first with the limit `max_sensitivity` on max |S|, then with half the largest
    amplification max |S| - 1 that each of them had, and so on, HALVINGS times.
    """
    amplifies: dict[Weights, float] = {}
    for halving in range(HALVINGS + 1):
        for weights in (each.for_test_band(test_band_hz) for each in FIRMER):
            if halving and weights not in amplifies:
                continue
            limit = round(1.0 + amplifies[weights] / 2.0**halving, DIGITS) if halving else max_sensitivity
            try:
                found = make(weights, limit)
            except InputError:  # no useful feedback; with a lower limit neither
                amplifies.pop(weights, None)
                continue
            if not halving:
                amplifies[weights] = max(found.sensitivity_peak, found.modelled.sensitivity_peak) - 1.0
            if not faults(found):
                return found, Chosen(weights, limit)
    return None


@dataclass(frozen=True)
class Design:
    """The designed blocks of a run."""

    blocks: Blocks
    model: Model  # of the table, from which they were designed
    feedback: feedback.Feedback | None  # with its margins; None without feedback
    shear_now: InterfaceForce  # weights of the base shear at the instant of the samples, without prediction
    chosen: Chosen | None = None  # weights chosen instead of the default ones; None: default or stated weights
    chosen_filter: KalmanSpec | None = None  # chosen instead of the usual filter; None: usual or stated
    # blocks that do not counter the specimen's reaction, for the check to choose (design_choice.py); None: no choice
    plain: Blocks | None = None
    reaction_left: Finding | None = None  # why `automatic` does not counter the reaction; None: nobody need know

    def without_reaction(self, why: Finding | None = None) -> Design:
        """Return the design that does not counter the specimen's reaction where that is left to the check."""
        return self if self.plain is None else replace(self, blocks=self.plain, plain=None, reaction_left=why)


def design_blocks(setup: Setup, identified: Identification, shared: SharedValues | None = None) -> Design:
    """Return the blocks for the case's method and controller; raises InputError if no controller exists.

    They are designed from the nominal model; the check judges them on its samples too. With an automatic
    `controller.reaction_feedforward` they counter the specimen's reaction where the table shows its compliance, and
    `plain` holds those without, for which the feedback is chosen.
    With `shared`, cases with the same model and weights design the feedback once, whatever their building.
    """
    if actuator.is_of_actuator(setup):
        blocks = actuator.design_blocks(setup, identified)
        return Design(blocks, identified.best, None, measured_force(0).force)
    setup = setup.calibrated(identified)
    case, dt, shared = setup.case, setup.rig.dt_s, shared or SharedValues()
    best = case.method == "best"
    model = identified.best if best else identified.paper
    storeys = computed_storeys(setup.building, dt, case.integration)
    if isinstance(storeys, ProgramStoreys):
        storeys = storeys.knowing(setup.motion.accel_m_s2)
    lead = feedforward.lead_samples(model, dt) if best and case.controller.inverts else 0
    lead = lead if setup.compensator is None else setup.compensator.lead_samples
    shear = _shear(setup, identified, lead)
    blocks = Blocks(
        correction=sensor_correction.correction(setup.rig.channels, dt, setup.removes_sensors),
        estimator=_estimator(setup, _specimen(identified), lead),
        numerical=storeys,
        feedforward=_feedforward(setup, identified, model, lead),
        feedback=feedback.none(dt),
        interface=Interface(shear),
        shaping_step_v=setup.rig.converters.step_v if best else 0.0,
        ripple_m_s2_per_v=model.ripple_m_s2_per_v if best else 0.0,
        ripple_sum_m_s2_per_v=model.ripple_sum_m_s2_per_v if best else 0.0,
        latency_samples=setup.rig.latency_samples,
        command_limit_v=_command_limit_v(setup.rig),
        feedback_limit_v=case.controller.feedback_limit_v or math.inf,
        specimen=_specimen(identified),
        open_loop=kalman_filter.open_loop(_specimen(identified), dt),
        further=sensor_correction.further_correction(setup.rig.further, dt, setup.removes_sensors),
    )
    blocks = replace(blocks, cell=_cell(setup, blocks.estimator, lead))
    shear_now = _shear(setup, identified, 0, residual=0.0)
    asked = is_driven(case) and case.controller.reaction_feedforward is True
    if asked:
        blocks = _with_reaction(blocks, setup, identified, model)

    def finished(design: Design) -> Design:
        """Return the design with what its feedforward counters and with the caller's parts."""
        plain = _exchanged(_with_friction(design.blocks, setup, identified, model, lead), setup)
        automatic = is_driven(case) and case.controller.reaction_feedforward == "automatic"
        if not automatic or "feedforward" in setup.parts:
            return replace(design, blocks=plain)
        try:
            both = _with_reaction(design.blocks, setup, identified, model)
        except InputError:
            return replace(design, blocks=plain, reaction_left=NOT_SHOWN)
        counters = _with_friction(both, setup, identified, model, lead).feedforward
        return replace(design, blocks=replace(plain, feedforward=counters, counters_reaction=True), plain=plain)

    if case.controller.kind != "FF+FB":
        return finished(Design(blocks, model, None, shear_now))

    judged = _with_friction(blocks, setup, identified, model, lead)

    def faults(with_it: feedback.Feedback) -> list[Finding]:
        blocks = replace(judged, feedback=with_it.block)
        of_test = loop_faults(setup, identified, blocks, shared)
        if of_test or "shake_table" not in case.runs:
            return of_test
        return loop_faults(setup, identified, blocks, shared, alone=True)

    designed, chosen = choose_feedback(setup, identified, model, faults, shared)
    return finished(Design(replace(blocks, feedback=designed.block), model, designed, shear_now, chosen))


def is_driven(case: Case) -> bool:
    """Tell whether a case has the feedforward of method best, which may counter reaction and friction."""
    return case.method == "best" and case.controller.inverts


def _exchanged(blocks: Blocks, setup: Setup) -> Blocks:
    """Return the blocks with the parts that the caller puts in the place of designed ones."""
    asked = setup.case.controller if is_driven(setup.case) and "feedforward" in setup.parts else None
    if asked is not None and asked.reaction_feedforward is True:
        raise InputError(
            "controller.reaction_feedforward: it belongs to the designed feedforward, and parts has another; remove "
            "the key"
        )
    if asked is not None and asked.friction_compensation is True:
        raise InputError(
            "controller.friction_compensation: it belongs to the designed feedforward, and parts has another; remove "
            "the key"
        )
    own: dict[str, Any] = {
        place: made(place, _without_control(place, make, setup), getattr(blocks, place))
        for place, make in setup.parts.items()
        if place != NUMERICAL
    }
    own |= {NUMERICAL: setup.own_numerical} if setup.own_numerical is not None else {}
    return replace(blocks, **own)


def _without_control(place: str, make: Callable[[Any], Any], setup: Setup) -> Callable[[Any], Any]:
    """Return what makes the caller's part, as our block where it is a system of python-control for the feedforward."""

    def converted(designed: Any) -> Any:
        part = make(designed)
        if place != "feedforward" or type(part).__module__.partition(".")[0] != "control":
            return part
        found = from_control(part)
        if not isinstance(found, Block):
            raise InputError("parts: a compensator must be discrete; give the system its dt in s")
        return placed_block("parts", found, setup.rig.dt_s, len(setup.rig.channels))

    return converted


def _specimen(identified: Identification) -> Specimen:
    """Return the specimen identified from the excitation."""
    assert identified.specimen is not None  # every case has experimental storeys
    return identified.specimen.specimen


def _with_friction(blocks: Blocks, setup: Setup, identified: Identification, model: Model, lead: int) -> Blocks:
    """Return blocks whose feedforward counters friction where the case lets it and the identification shows it helps.

    `automatic` leaves it off where the rig is sent a preview of the commands: that needs a linear step.
    """
    asked, friction = setup.case.controller.friction_compensation, identified.friction
    if not asked or not is_driven(setup.case) or friction is None or not friction.shown:
        return blocks
    if asked is not True and ("feedforward" in setup.parts or setup.rig.previews):
        return blocks
    delay_s, dt_s = model.delay_s, setup.rig.dt_s
    lag_s = reaction.force_lag_s(model, _specimen(identified))
    lead_s = friction_compensation.compensation_lead_s(delay_s, lag_s, lead, dt_s)
    counters = friction_compensation.FrictionFeedforward(
        blocks.feedforward.linearised(), friction.command_v, friction.scale_m_s, friction.linear_s_per_m, lead_s,
        friction.left,
    )  # fmt: skip
    return replace(blocks, feedforward=counters)


def _with_reaction(blocks: Blocks, setup: Setup, identified: Identification, model: Model) -> Blocks:
    """Return blocks whose feedforward counters the specimen's reaction; raises InputError if the table does not show
    its compliance."""
    specimen = _specimen(identified)
    table = reaction.compliance(model, specimen)
    counter = reaction.reaction_block(specimen, table, model.delay_s, setup.case.kalman.residual_hz, setup.rig.dt_s)
    both = reaction.with_reaction(blocks.feedforward.linearised(), counter)
    return replace(blocks, feedforward=both, counters_reaction=True)


def _feedforward(setup: Setup, identified: Identification, model: Model, lead: int) -> PartDesign:
    """Return what makes the command from the desired motion: the case's compensator, or the inverse of the table."""
    case, dt_s = setup.case, setup.rig.dt_s
    if setup.compensator is not None:
        specimen, channels = _specimen(identified), len(setup.rig.channels)
        plant = Plant(model, specimen, dt_s, setup.compared.hz, lead, channels)
        try:
            return setup.compensator.designed(plant)
        except InputError as error:
            raise InputError(*(placed(case, fault) for fault in error.faults)) from error
    if case.controller.kind == "none":
        return feedforward.direct(model.low_frequency_gain_m_per_v, dt_s)
    if case.method == "paper":
        return feedforward.leaky_inverse(model, dt_s)
    return feedforward.lagged_inverse(model, dt_s, lead)


def _command_limit_v(rig: RigInfo) -> float:
    """Return the limit in V to which the feedback's part is clipped: range or stroke, minus one bit for rounding."""
    return min(rig.converters.range_v, rig.limits.stroke_m / rig.gain_m_per_v) - rig.converters.step_v


def _estimator(setup: Setup, specimen: Specimen, lead: int) -> Block:
    """Return the Kalman filter; in method `best` the table's motion is an input, and the residual shear is added."""
    kalman, dt = setup.case.kalman, setup.rig.dt_s
    if setup.case.method == "paper":
        return kalman_filter.kalman_block(specimen, kalman.q, kalman.r, dt, knows_table=False)
    informed = kalman_filter.kalman_block(specimen, kalman.q, kalman.r, dt, knows_table=True)
    carried = kalman_filter.carried_by_correction(specimen, kalman.q, kalman.r, lead * dt)
    return kalman_filter.with_residual(informed, specimen, kalman.residual_hz, lead * dt, carried)


def _shear(setup: Setup, identified: Identification, lead: int, residual: float = 1.0) -> InterfaceForce:
    """Return the weights of the base shear: at the instant of the samples, or predicted `lead` samples ahead."""
    specimen, mass = _specimen(identified), setup.building.interface_experimental_mass_kg
    now = kalman_filter.measured_shear(specimen, mass)
    shear = kalman_filter.predicted_shear(specimen, mass, lead, setup.rig.dt_s) if lead else now
    if setup.case.method == "paper":
        weight = _cell_weight(setup)
        return kalman_filter.shear_with_cell(shear, specimen, mass, weight) if weight else shear
    return kalman_filter.plus_residual(shear, residual)


def _cell_weight(setup: Setup) -> float:
    """Return the weight of the load cell in the base shear, 0 without one."""
    mass = setup.building.interface_experimental_mass_kg
    return designed_blocks.cell_weight(setup.rig, setup.floor_masses_kg, mass, setup.case.shear_from)


def _cell(setup: Setup, estimator: Block, lead: int) -> designed_blocks.CellInput | None:
    """Return the load cell as an input of estimator and base shear; None where it has no part in the base shear."""
    weight, place = _cell_weight(setup), setup.rig.shear_cell
    if weight == 0.0 or place is None:
        return None
    mass, plate = setup.building.interface_experimental_mass_kg, setup.rig.further[place].plate_mass_kg
    reads = designed_blocks.cell_reads(setup.floor_masses_kg, mass, plate)
    if setup.case.method == "paper":
        nothing = np.zeros(len(estimator.A)), np.zeros(len(estimator.C))
        return designed_blocks.CellInput(place, reads, *nothing, np.array([-weight]))
    residual_hz, dt_s = setup.case.kalman.residual_hz, setup.rig.dt_s
    columns = kalman_filter.cell_in_residual(estimator, residual_hz, lead * dt_s, weight)
    return designed_blocks.CellInput(place, reads, *columns, np.zeros(1))
