"""A table model that was identified elsewhere, made comparable with what is measured here."""

from __future__ import annotations

import math
from dataclasses import replace

from rths_cli.lti import Model


def with_ripple(model: Model, fitted: Model) -> Model:
    """Return the model for the band of one fitted here, with that one's share of the hold's staircase where none (NaN)
    is stated: it belongs to the sampling, not to the table."""
    stated = not math.isnan(model.ripple_m_s2_per_v)
    ripple = model.ripple_m_s2_per_v if stated else fitted.ripple_m_s2_per_v
    return replace(model, band_hz=fitted.band_hz, ripple_m_s2_per_v=ripple)
