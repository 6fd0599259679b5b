"""Which filter of the floors a case gets: the one that it states, or where noise and rounding of the samples would be
most of the error, one that trusts the identified specimen more.

The usual filter takes the base shear from the measured floors, so that a specimen which is not quite the identified one
costs next to nothing, and all noise of the samples is in the base shear. At small amplitudes, or with coarse
converters, that noise is most of the error. A filter with less process noise and a lower `residual_hz` takes the base
shear from the table's motion and the identified specimen instead. It pays where the specimen is known better than the
floors are measured. Each filter of a list is judged by the check's predicted error together with the error that a
specimen would cause which changes between identification and test by `uncertainty.specimen` of the rig.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.predicted_error import predict
from rths_cli.analysis.stability_check import SAFE
from rths_cli.errors import InputError
from rths_cli.experiment.check import Judged, changed_specimen_error, judge
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.numerics.bands import TEST_BAND_HZ

if TYPE_CHECKING:
    from rths_cli.analysis.predicted_error import Prediction
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.shared_values import SharedValues

TRUSTING = ((1e-1, 4.0), (1e-2, 1.3), (1e-3, 0.4))  # q with r = 1, and residual_hz with the usual test band
WORTH = 0.02  # of SIM's RMS: noise and rounding below it leave the usual filter
GAIN = 0.8  # of the usual filter's error: another one must have less


def choose_filter(
    setup: Setup, identified: Identification, design: Design, judged: Judged, shared: SharedValues
) -> tuple[Design, Judged]:
    """Return the design with the filter that is expected to have the smallest error, and the check of it.

    `design` and `judged` are those of the usual filter. They are returned where the case leaves no choice, where noise
    and rounding of the samples are not most of the predicted error, and where no filter of TRUSTING is better and as
    safe.
    """
    if not _leaves_choice(setup) or judged.known is None:
        return design, judged
    usual = predict(judged.known)
    by_samples = np.hypot(usual.causes["noise"].storeys, usual.causes["quantisation"].storeys)
    mostly = by_samples > np.sqrt(0.5) * usual.total.storeys
    if not np.any(mostly & (by_samples > WORTH * judged.sim_rms_m_s2)):
        return design, judged
    best, least = (design, judged), GAIN * _expected(setup, identified, judged, usual)
    for q, usual_hz in TRUSTING:
        spec = setup.case.kalman.model_copy(
            update={"q": q * setup.case.kalman.r, "residual_hz": usual_hz * setup.case.test_band_hz / TEST_BAND_HZ}
        )
        other = replace(setup, case=setup.case.model_copy(update={"kalman": spec}))
        try:
            made = replace(design_blocks(other, identified, shared), chosen_filter=spec)
            found = judge(other, identified, made, shared)
        except InputError:  # this filter has no solution for the specimen, or no feedback suits it
            continue
        if found.known is None or judged.preflight.verdict == SAFE != found.preflight.verdict:
            continue
        error = _expected(other, identified, found, predict(found.known))
        if error < least:
            best, least = (made, found), error
    return best


def _leaves_choice(setup: Setup) -> bool:
    """Return whether the filter may be chosen: method best with its own blocks, a linear building, a specimen whose
    stiffness has no range, and no weights stated."""
    case = setup.case
    ranged = case.controller.reaction_feedforward or (case.check is not None and case.check.specimen_range is not None)
    plain = case.method == "best" and not setup.building.has_laws and not setup.parts and not ranged
    return plain and case.kalman.choice == "automatic"


def _expected(setup: Setup, identified: Identification, judged: Judged, prediction: Prediction) -> float:
    """Return the predicted error over SIM's RMS at the worst storey, that of a changed specimen included."""
    assert judged.known is not None
    changed = changed_specimen_error(setup, identified, judged.known, prediction)
    return float(np.max(np.hypot(prediction.total.storeys, changed) / judged.sim_rms_m_s2))
