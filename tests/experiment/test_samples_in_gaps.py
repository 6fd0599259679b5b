"""Samples that the step mixed with others after a gap are those of the rig, with sign and zero of each channel."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rths_cli.experiment.error_after_run import samples_in_gaps
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.lost_samples import MIXED, NO_ANSWER
from rths_cli.numerics.lti import Block

DT, COUNT = 1e-3, 2000
GAP, AFTER = slice(800, 810), slice(810, 840)


@pytest.mark.parametrize(("signs", "zeros_v"), [((1.0, 1.0), (0.0, 0.0)), ((1.0, -1.0), (0.3, -0.2))])
def test_mixed_samples_are_those_of_the_rig(signs: tuple[float, float], zeros_v: tuple[float, float]) -> None:
    time_s = DT * np.arange(COUNT)
    shown = np.array([np.sin(2.0 * np.pi * 3.0 * time_s), 2.0 * np.sin(2.0 * np.pi * 4.0 * time_s + 1.0)])
    rate, names = 2.0 * np.pi * 2.0, ("table", "floor")  # an AC coupling of 2 Hz, taken out: a zero becomes a ramp
    each = rate * DT * np.eye(2)
    correction = Block("correction", np.eye(2), each, np.eye(2), np.eye(2) + 0.5 * each, DT, names, names)
    true = run_block(correction, shown)
    sign, zero = np.array(signs)[:, None], np.array(zeros_v)[:, None]
    lost = np.zeros(COUNT)
    lost[GAP], lost[AFTER] = NO_ANSWER, MIXED
    measured = true.copy()
    measured[:, GAP] = 0.0
    measured[:, AFTER] *= np.linspace(0.0, 1.0, 30)
    series: Any = SimpleNamespace(
        live={"lost": lost}, measured=measured, command_v=np.zeros(COUNT), samples_v=sign * shown + zero
    )
    known = SimpleNamespace(
        rig=SimpleNamespace(channels=[SimpleNamespace(sign=one) for one in signs]),
        correction=correction,
        lines=SimpleNamespace(of=np.fft.rfft, padded=COUNT, samples=COUNT),
        loop=SimpleNamespace(rig=np.zeros((2, COUNT // 2 + 1))),
        model=SimpleNamespace(ripple_m_s2_per_v=0.0, latency_samples=1, coupling_hz=0.0, dt_s=DT),
    )
    uncertain: Any = SimpleNamespace(known=known)
    found = samples_in_gaps(uncertain, series)
    assert np.abs((found - true)[:, AFTER]).max() < 0.02
    assert np.array_equal(np.delete(found, np.r_[GAP, AFTER], axis=1), np.delete(true, np.r_[GAP, AFTER], axis=1))
