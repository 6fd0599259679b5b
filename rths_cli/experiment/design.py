"""Design all blocks of a run from what was identified: method `paper` as printed, method `best` with prediction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rths_cli.control import feedback, feedforward, kalman_filter, numerical_substructure, sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.experiment.feedback_choice import choose_feedback
from rths_cli.experiment.loop_stability_of_case import loop_faults
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from rths_cli.control.kalman_filter import Shear
    from rths_cli.experiment.feedback_choice import Chosen
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Block, Model
    from rths_cli.rigs.description import RigInfo
    from rths_cli.structure import Specimen


@dataclass(frozen=True)
class Design:
    """The blocks of a run, the table model behind them, and the feedback's figures (None without feedback).

    `shear_now`: weights of the base shear at the instant of the samples, without prediction. `chosen`: the feedback's
    weights where the usual ones would not do (None: they do, or the case states its own).
    """

    blocks: Blocks
    model: Model
    feedback: feedback.Feedback | None
    shear_now: Shear
    chosen: Chosen | None = None


def design_blocks(setup: Setup, identified: Identification, shared: SharedValues | None = None) -> Design:
    """Return the blocks for the case's method and controller; raises InputError when no controller exists.

    With `shared`, cases of one model and the same weights share the feedback, whatever their building.
    """
    case, dt, shared = setup.case, setup.rig.dt_s, shared or SharedValues()
    best = case.method == "best"
    model = identified.best if best else identified.paper
    driven = case.controller.kind != "none"
    lead = feedforward.lead_samples(model, dt) if best and driven else 0
    shear = _shear(setup, identified, lead)
    blocks = Blocks(
        correction=sensor_correction.correction(setup.rig.channels, dt, setup.removes_sensors),
        estimator=_estimator(setup, _specimen(identified), lead),
        numerical=numerical_substructure.interface(setup.building.numerical, dt, case.integration),
        feedforward=_feedforward(model, dt, lead, best, driven),
        feedback=feedback.none(dt),
        shear_estimate=shear.estimate,
        shear_recent=shear.recent,
        shear_measured=shear.measured,
        shear_desired=shear.desired,
        shaping_step_v=setup.rig.converters.step_v if best else 0.0,
        ripple_m_s2_per_v=model.ripple_m_s2_per_v if best else 0.0,
        ripple_sum_m_s2_per_v=model.ripple_sum_m_s2_per_v if best else 0.0,
        latency_samples=setup.rig.latency_samples,
        command_limit_v=_command_limit_v(setup.rig),
        feedback_limit_v=case.controller.feedback_limit_v or math.inf,
        specimen=_specimen(identified),
        open_loop=kalman_filter.open_loop(_specimen(identified), dt),
    )
    shear_now = _shear(setup, identified, 0, residual=0.0)
    if case.controller.kind != "FF+FB":
        return Design(blocks, model, None, shear_now)

    def faults(with_it: feedback.Feedback) -> list[str]:
        return loop_faults(setup, identified, replace(blocks, feedback=with_it.block), shared)

    designed, chosen = choose_feedback(setup, identified, model, faults, shared)
    return Design(replace(blocks, feedback=designed.block), model, designed, shear_now, chosen)


def _specimen(identified: Identification) -> Specimen:
    """Return the specimen identified from noise."""
    assert identified.specimen is not None  # every case has experimental storeys
    return identified.specimen.specimen


def _feedforward(model: Model, dt_s: float, lead: int, best: bool, driven: bool) -> Block:
    if not driven:
        return feedforward.direct(model.low_frequency_gain_m_per_v, dt_s)
    return feedforward.lagged_inverse(model, dt_s, lead) if best else feedforward.leaky_inverse(model, dt_s)


def _command_limit_v(rig: RigInfo) -> float:
    """Return the largest command that a feedback may bring about: range or stroke, less a bit for rounding."""
    return min(rig.converters.range_v, rig.limits.stroke_m / rig.gain_m_per_v) - rig.converters.step_v


def _estimator(setup: Setup, specimen: Specimen, lead: int) -> Block:
    """Return the Kalman filter; method `best` knows the table's motion and what the specimen leaves unexplained."""
    kalman, dt = setup.case.kalman, setup.rig.dt_s
    if setup.case.method == "paper":
        return kalman_filter.kalman_block(specimen, kalman.q, kalman.r, dt, knows_table=False)
    informed = kalman_filter.kalman_block(specimen, kalman.q, kalman.r, dt, knows_table=True)
    return kalman_filter.with_residual(informed, specimen, kalman.residual_hz, lead * dt)


def _shear(setup: Setup, identified: Identification, lead: int, residual: float = 1.0) -> Shear:
    """Return the base shear's weights: measured now, or predicted over the lead."""
    specimen, mass = _specimen(identified), setup.building.interface_experimental_mass_kg
    now = kalman_filter.measured_shear(specimen, mass)
    shear = kalman_filter.predicted_shear(specimen, mass, lead, setup.rig.dt_s) if lead else now
    return shear if setup.case.method == "paper" else kalman_filter.plus_residual(shear, residual)
