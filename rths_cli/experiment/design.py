"""Design all blocks of a run from what was identified: method `paper` as printed, method `best` with prediction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control import (
    feedback,
    feedforward,
    friction_compensation,
    kalman_filter,
    load_cell,
    reaction,
    sensor_correction,
)
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Interface
from rths_cli.control.storeys_with_laws import computed_storeys
from rths_cli.errors import InputError
from rths_cli.experiment.feedback_choice import choose_feedback
from rths_cli.experiment.loop_stability_of_case import loop_faults
from rths_cli.experiment.own_parts import NUMERICAL, made
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from rths_cli.analysis.stability_check import Fault
    from rths_cli.case.case_schema import Case, KalmanSpec
    from rths_cli.control.interface import InterfaceForce
    from rths_cli.experiment.feedback_choice import Chosen
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Block, Model
    from rths_cli.rigs.description import RigInfo
    from rths_cli.structure import Specimen


NOT_SHOWN = "the identified table does not show how the specimen's reaction moves it"


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
    reaction_left: str = ""  # why `automatic` does not counter the reaction, "" if it does or nobody need know

    def without_reaction(self, why: str = "") -> Design:
        """Return the design that does not counter the specimen's reaction where that is left to the check."""
        return self if self.plain is None else replace(self, blocks=self.plain, plain=None, reaction_left=why)


def design_blocks(setup: Setup, identified: Identification, shared: SharedValues | None = None) -> Design:
    """Return the blocks for the case's method and controller; raises InputError if no controller exists.

    They are designed from the nominal model; the check judges them on its samples too. With an automatic
    `controller.reaction_feedforward` they counter the specimen's reaction where the table shows its compliance, and
    `plain` holds those without, for which the feedback is chosen.
    With `shared`, cases with the same model and weights design the feedback once, whatever their building.
    """
    setup = setup.calibrated(identified)
    case, dt, shared = setup.case, setup.rig.dt_s, shared or SharedValues()
    best = case.method == "best"
    model = identified.best if best else identified.paper
    driven = case.controller.kind != "none"
    lead = feedforward.lead_samples(model, dt) if best and driven else 0
    shear = _shear(setup, identified, lead)
    blocks = Blocks(
        correction=sensor_correction.correction(setup.rig.channels, dt, setup.removes_sensors),
        estimator=_estimator(setup, _specimen(identified), lead),
        numerical=computed_storeys(setup.building, dt, case.integration),
        feedforward=_inverse(setup, model, lead),
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

    def faults(with_it: feedback.Feedback) -> list[Fault]:
        blocks = replace(judged, feedback=with_it.block)
        of_test = loop_faults(setup, identified, blocks, shared)
        if of_test or "shake_table" not in case.runs:
            return of_test
        return loop_faults(setup, identified, blocks, shared, alone=True)

    designed, chosen = choose_feedback(setup, identified, model, faults, shared)
    return finished(Design(replace(blocks, feedback=designed.block), model, designed, shear_now, chosen))


def is_driven(case: Case) -> bool:
    """Tell whether a case has the feedforward of method best, which may counter reaction and friction."""
    return case.method == "best" and case.controller.kind != "none"


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
        place: made(place, make, getattr(blocks, place)) for place, make in setup.parts.items() if place != NUMERICAL
    }
    own |= {NUMERICAL: setup.own_numerical} if setup.own_numerical is not None else {}
    return replace(blocks, **own)


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


def _inverse(setup: Setup, model: Model, lead: int) -> Block:
    case, dt_s = setup.case, setup.rig.dt_s
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
    return load_cell.cell_weight(setup.rig, setup.floor_masses_kg, mass, setup.case.shear_from)


def _cell(setup: Setup, estimator: Block, lead: int) -> load_cell.CellInput | None:
    """Return the load cell as an input of estimator and base shear; None where it has no part in the base shear."""
    weight, place = _cell_weight(setup), setup.rig.shear_cell
    if weight == 0.0 or place is None:
        return None
    mass, plate = setup.building.interface_experimental_mass_kg, setup.rig.further[place].plate_mass_kg
    reads = load_cell.cell_reads(setup.floor_masses_kg, mass, plate)
    if setup.case.method == "paper":
        nothing = np.zeros(len(estimator.A)), np.zeros(len(estimator.C))
        return load_cell.CellInput(place, reads, *nothing, np.array([-weight]))
    residual_hz, dt_s = setup.case.kalman.residual_hz, setup.rig.dt_s
    columns = kalman_filter.cell_in_residual(estimator, residual_hz, lead * dt_s, weight)
    return load_cell.CellInput(place, reads, *columns, np.zeros(1))
