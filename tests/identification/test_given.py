"""A model from elsewhere: its ripple is found by least squares, and a wrong gain is not forgiven."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from made_linear import linear
from made_records import make_specimen

from rths_cli.identification.evaluate import identify
from rths_cli.identification.given import with_ripple
from rths_cli.lti import Frf, Model, staircase

BAND_HZ = (0.5, 60.0)


def table(ripple: float, latency: int = 1) -> Model:
    poles = 2.0 * np.pi * np.concatenate([14.0 * np.roots([1.0, 1.2, 1.0]), [-100.0]]).astype(complex)
    gain = 0.0079 * float(np.real(np.prod(-poles)))
    return Model(np.zeros(2, dtype=complex), poles, gain, 7.5e-4, (1.0, 20.0), ripple, latency, 5e-4)


def measured(truth: Model, noise: float) -> Frf:
    f = np.arange(0.5, 60.05, 0.1)
    random = np.random.default_rng(0)
    error = noise * (random.standard_normal(len(f)) + 1j * random.standard_normal(len(f)))
    return Frf(f, truth.sampled_response(f) * (1.0 + error), np.ones(len(f)), np.full(len(f), max(noise, 1e-6)), 20)


@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("ripple", [-1.4, 0.0, 2.5])
def test_ripple_is_the_true_one(ripple: float, latency: int) -> None:
    truth = table(ripple, latency)
    unknown = replace(truth, ripple_m_s2_per_v=math.nan)
    assert with_ripple(unknown, measured(truth, 0.0), BAND_HZ).ripple_m_s2_per_v == pytest.approx(ripple, abs=1e-9)
    noisy = measured(truth, 0.01)
    per_share = staircase(noisy.frequency_hz, latency, truth.dt_s) / noisy.response
    error = 0.01 / float(np.linalg.norm(per_share))  # of a least-squares factor under relative noise of 0.01
    assert with_ripple(unknown, noisy, BAND_HZ).ripple_m_s2_per_v == pytest.approx(ripple, abs=3.0 * error)
    assert error < 0.2


def test_stated_ripple_is_kept() -> None:
    truth = table(-1.4)
    found = with_ripple(truth, measured(table(3.0), 0.0), BAND_HZ)
    assert found == replace(truth, band_hz=BAND_HZ)


@pytest.mark.parametrize(("factor", "accepted"), [(1.0, True), (1.05, False)])
def test_given_model_is_judged_as_ours(factor: float, accepted: bool) -> None:
    made = linear(make_specimen((6000.0,), (0.04,)))
    best = identify([made.record], made.info, made.specimen.masses_kg).best
    brought = replace(best, gain=factor * best.gain, ripple_m_s2_per_v=math.nan)
    found = identify([made.record], made.info, made.specimen.masses_kg, given=brought)
    assert found.accepted == accepted
    assert found.candidates == ()
    assert np.array_equal(found.best.poles, best.poles)
    assert found.best_error.rms == pytest.approx(factor - 1.0, abs=0.003)
    assert any("rms in 0.7-11 Hz" in reason for reason in found.reasons) == (not accepted)
