"""Which feedback weights a case gets: those it states, or the first of a list with which its loop keeps the check's
margins.

The usual weights are right for most buildings. Where they are not, the margin is lacking in one of two places. At a
lightly damped mode below 11 Hz a changed gain of the table makes the loop unstable: a feedback with more gain there,
that is with a lower command weight and a lower band, makes the table follow in spite of it. Above, where the loop of
the whole building crosses one, a feedback amplifies: a gentler one, with a lower peak of |S|, amplifies less. Both are
tried, the nearest to the usual feedback first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rths_cli.control import feedback
from rths_cli.control.feedback import DEFAULT, Feedback, Weights
from rths_cli.errors import InputError
from rths_cli.identification.verdict import LIMITS
from rths_cli.numerics.content_key import content_key

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Model
    from rths_cli.numerics.shared_values import SharedValues

    Make = Callable[[Weights, float], Feedback]
    Faults = Callable[[Feedback], list[str]]

FIRMER = (DEFAULT, Weights((1.0, 12.0), 1e-3), Weights((0.5, 6.0), 1e-3), Weights((0.25, 3.0), 1e-3))
HALVINGS = 3  # of what a feedback amplifies at worst, max |S| - 1
DIGITS = 4  # of a chosen limit on max |S|, so that a case can state it


@dataclass(frozen=True)
class Chosen:
    """The weights and the limit on max |S| that were chosen instead of the usual ones; `usual_of_use`: with those there
    was a feedback, but a loop without the check's margins."""

    weights: Weights
    max_sensitivity: float
    usual_of_use: bool = True


def choose_feedback(
    setup: Setup, identified: Identification, model: Model, faults: Faults, shared: SharedValues
) -> tuple[Feedback, Chosen | None]:
    """Return the case's feedback, and what was chosen instead of the usual weights (None: nothing was).

    `faults` says why the loop is not safe with a feedback. A case that states weights or bandwidth gets them, and
    method `paper` and a case that runs no hybrid test, which has no loop, the usual ones. Where no
    choice is safe the usual feedback stays. Raises InputError when there is none of use.
    """
    stated = setup.case.controller

    def make(weights: Weights, max_sensitivity: float) -> Feedback:
        asked = (model, identified.frfs[0], setup.rig.dt_s, stated.feedback_bandwidth_hz, max_sensitivity, weights)
        return shared.get("feedback", content_key(*asked), lambda: feedback.design(*asked))

    if not _leaves_choice(setup):
        try:
            return make(_stated_weights(setup), stated.max_sensitivity), None
        except InputError as error:
            raise InputError(*_of_printed_model(setup, identified, error)) from None
    try:
        usual = make(DEFAULT, stated.max_sensitivity)
    except InputError:
        other = first_safe(make, faults, stated.max_sensitivity)
        if other is None:
            raise
        return other[0], replace(other[1], usual_of_use=False)
    if not faults(usual):
        return usual, None
    return first_safe(make, faults, stated.max_sensitivity) or (usual, None)


def _leaves_choice(setup: Setup) -> bool:
    stated = setup.case.controller
    fixed = (stated.disturbance_hz, stated.command_weight, stated.feedback_bandwidth_hz)
    return setup.case.method == "best" and "exp_rths" in setup.case.runs and fixed == (None, None, None)


def _of_printed_model(setup: Setup, identified: Identification, error: InputError) -> tuple[str, ...]:
    """Return why there is no feedback: with a wrong model of the printed method that says nothing of the table."""
    missed = identified.paper_error.rms
    if setup.case.method != "paper" or missed <= LIMITS.rms:
        return error.faults
    return (
        f"method paper: its model of the table, fitted up to 12 Hz, misses the measured response by {missed:.2g} (RMS, "
        f"0.7-11 Hz; at most {LIMITS.rms:g}), and no feedback can be designed from it; use method best",
    )


def _stated_weights(setup: Setup) -> Weights:
    """Return the weights that a case states, the usual ones where it states none."""
    stated = setup.case.controller
    low, high = stated.disturbance_hz or DEFAULT.disturbance_hz
    return Weights((low, high), DEFAULT.command_weight if stated.command_weight is None else stated.command_weight)


def first_safe(make: Make, faults: Faults, max_sensitivity: float) -> tuple[Feedback, Chosen] | None:
    """Return the first feedback with which the loop is safe, None where there is none.

    All FIRMER ones come first, then each so gentle that it amplifies half as much at worst, and so on.
    """
    amplifies: dict[Weights, float] = {}
    for halving in range(HALVINGS + 1):
        for weights in FIRMER:
            if halving and weights not in amplifies:
                continue
            limit = round(1.0 + amplifies[weights] / 2.0**halving, DIGITS) if halving else max_sensitivity
            try:
                found = make(weights, limit)
            except InputError:  # none of use; a gentler one is of less
                amplifies.pop(weights, None)
                continue
            if not halving:
                amplifies[weights] = max(found.sensitivity_peak, found.modelled.sensitivity_peak) - 1.0
            if not faults(found):
                return found, Chosen(weights, limit)
    return None
