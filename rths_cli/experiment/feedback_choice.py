"""Which feedback weights a case gets: those it states, or the first of a list with which its loop keeps the check's
margins.

The default weights suit most buildings. For the others, a margin is too small in one of two frequency ranges. In the
compared band, at a lightly damped mode, a change of the table's gain makes the loop unstable; a feedback with more gain
there, that is with a lower command weight and a lower band, lets the table follow in spite of it. Above, where the gain
of the whole loop crosses one, a feedback amplifies; a gentler one, with a lower peak of |S|, amplifies less. Both are
tried, beginning with the weights nearest to the default.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rths_cli.control import feedback
from rths_cli.control.feedback import DEFAULT, Feedback, Weights
from rths_cli.errors import InputError
from rths_cli.experiment.loop_stability_of_case import continued_of
from rths_cli.identification.inputs import PAPER_BAND_HZ
from rths_cli.identification.verdict import LIMITS
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.numerics.content_key import content_key

if TYPE_CHECKING:
    from rths_cli.analysis.stability_check import Fault
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Model
    from rths_cli.numerics.shared_values import SharedValues

    Make = Callable[[Weights, float], Feedback]
    Faults = Callable[[Feedback], list[Fault]]

# for the usual test band; their bands keep their ratio to another one
FIRMER = (DEFAULT, Weights((1.0, 12.0), 1e-3), Weights((0.5, 6.0), 1e-3), Weights((0.25, 3.0), 1e-3))
HALVINGS = 3  # number of times that the largest amplification, max |S| - 1, is halved
DIGITS = 4  # decimal digits of a chosen limit on max |S|, so that a case can state it


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
