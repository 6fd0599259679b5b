"""A model from elsewhere: what is not stated of the sampling is taken from here, and a wrong model is not forgiven."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from made_linear import linear
from made_records import make_specimen
from portfolio import parametrize_first

from rths_cli.identification.identify import identify
from rths_cli.identification.identify_table import with_ripple
from rths_cli.numerics.lti import Model


def table(ripple: float) -> Model:
    return Model(np.zeros(2, dtype=complex), np.array([-90.0 + 0j]), 1.0, 7.5e-4, (1.0, 20.0), ripple, 1, 5e-4)


def test_ripple_is_the_fitted_models_unless_it_is_stated() -> None:
    fitted = replace(table(-1.4), band_hz=(0.5, 60.0))
    found = with_ripple(table(math.nan), fitted)
    assert (found.ripple_m_s2_per_v, found.band_hz) == (-1.4, (0.5, 60.0))
    assert with_ripple(table(3.0), fitted).ripple_m_s2_per_v == 3.0


@parametrize_first(1, "factor", [1.0, 1.05, 2.0, -1.0])
def test_given_model_is_judged_as_ours_and_changes_nothing_else(factor: float) -> None:
    made = linear(make_specimen((6000.0,), (0.04,)))
    own = identify([made.record], made.info, made.specimen.masses_kg)
    brought = replace(own.best, gain=factor * own.best.gain, ripple_m_s2_per_v=math.nan)
    found = identify([made.record], made.info, made.specimen.masses_kg, given=brought)
    assert found.accepted == (factor == 1.0)
    assert found.candidates == ()
    assert np.array_equal(found.best.poles, own.best.poles)
    assert found.best_error.rms == pytest.approx(abs(factor - 1.0), rel=0.05, abs=0.003)
    assert any("not a model of this table" in reason for reason in found.reasons) == (factor != 1.0)
    assert found.specimen is not None
    assert own.specimen is not None
    assert found.specimen.damping_ratio == pytest.approx(own.specimen.damping_ratio, rel=1e-12)
