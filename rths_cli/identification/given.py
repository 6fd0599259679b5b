"""A table model that was identified elsewhere, made comparable with what is measured here."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rths_cli.identification.fit_table import within
from rths_cli.lti import Frf, Model, staircase


def with_ripple(model: Model, frf: Frf, band_hz: tuple[float, float]) -> Model:
    """Return the model with the share of the hold's staircase in a sample: stated, or (NaN) the one parameter left to
    find, by linear least squares of the relative error."""
    model = replace(model, band_hz=band_hz)
    if not math.isnan(model.ripple_m_s2_per_v):
        return model
    inside = within(frf.frequency_hz, band_hz)
    f, measured = frf.frequency_hz[inside], frf.response[inside]
    weight = 1.0 / np.hypot(frf.relative_error[inside], 1e-3)
    column = weight * staircase(f, model.latency_samples, model.dt_s) / measured
    wanted = weight * (1.0 - model.response(f) / measured)
    share = float(np.real(np.vdot(column, wanted)) / np.real(np.vdot(column, column)))
    return replace(model, ripple_m_s2_per_v=share)
