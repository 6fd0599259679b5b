"""Which design a case gets: whether the command counters the specimen's reaction, and which filter of the floors.

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
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.predicted_error import predict
from rths_cli.analysis.stability_check import SAFE
from rths_cli.errors import InputError
from rths_cli.experiment.check import Judged, changed_specimen_error, judge, stiffness_uncertainty, with_laws
from rths_cli.experiment.design import NOT_SHOWN, Design, design_blocks
from rths_cli.experiment.tangent_verdicts import REACTION_RANGE, faults_at_tangents, stated_ends, tangent_verdicts
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from rths_cli.analysis.predicted_error import Prediction
    from rths_cli.analysis.stability_check import Fault
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification

TRUSTING = ((1e-1, 4.0), (1e-2, 1.3), (1e-3, 0.4))  # q with r = 1, and residual_hz with the usual test band
WORTH = 0.02  # of SIM's RMS: noise and rounding below it leave the usual filter
NOT_SAFE = "the test would not be safe with it"
KNOWN_RANGE = 0.85, 1.0  # of the specimen's stiffness: a filter that trusts the specimen must hold there
GAIN = 0.8  # of the usual filter's error: another one must have less


def choose_design(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues | None = None
) -> tuple[Design, Judged]:
    """Return the design that a case gets and the check of it; `design` is that of `design_blocks`.

    Raises InputError as `judge`.
    """
    shared, why = shared or SharedValues(), ""
    countered: Judged | None = None
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
) -> tuple[Judged | None, str]:
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
    reasons = (*judged.preflight.reasons, *(fault.text for fault in faults))
    return (None, f"{NOT_SAFE}: {reasons[0]}") if reasons else (judged, "")


def _faults_at_ends(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues, ends: tuple[float, float]
) -> list[Fault]:
    """Return why the loop is not safe at one of these ends of the specimen's stiffness, with every sample of the
    model."""
    faults: list[Fault] = []
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
    usual = predict(judged.known)
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
        error = _expected(other, identified, made, found, predict(found.known))
        if error < least:
            best, least = (made, found), error
    return best


def _samples_dominate(setup: Setup, judged: Judged) -> bool:
    """Return whether the filter may be chosen, and noise and rounding of the samples are most of the predicted error
    and not negligible."""
    if not _leaves_choice(setup) or judged.known is None:
        return False
    usual = predict(judged.known)
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
