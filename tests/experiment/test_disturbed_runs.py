"""The true error that is stated after a run beside the truth, calm and with held commands (short form of
benchmarks/disturbed_runs.py)."""

from __future__ import annotations

import numpy as np
import pytest
from disturbed_runs import Disturbed
from freezing import HOLDS, freezing_of
from stalling import MEMORY

pytestmark = pytest.mark.campaign

RATE_HZ, RECORD_S = 500, 30.0


@pytest.fixture(scope="module")
def laboratory() -> Disturbed:
    return Disturbed(freezing_of(round(RECORD_S * RATE_HZ), RATE_HZ, "el_centro_high_ff"), MEMORY)


def test_the_median_after_a_calm_run_is_the_true_error(laboratory: Disturbed) -> None:
    """At 500 Hz noise and rounding of the floors' samples, of which the computed storeys' residual shows nothing, are a
    seventh of the squared error of the interface."""
    told = laboratory.told(np.zeros(0, dtype=int), 1, HOLDS)
    assert told is not None and told.after.why_none == ""
    assert told.median == pytest.approx(told.true, rel=0.05)
    assert np.all(told.true <= told.bound)


def test_held_commands_are_in_the_bound(laboratory: Disturbed) -> None:
    """A target that holds for 10 ms: by the samples that the step took instead, the bound would be a third of the
    error; without what the target held, none could be stated."""
    calm = laboratory.told(np.zeros(0, dtype=int), 1, HOLDS)
    at = np.sort(np.random.default_rng(5).uniform(2.0, 11.0, (2, 3))[1])
    held = laboratory.told(np.round(at * RATE_HZ).astype(int), 5, HOLDS)
    assert calm is not None and held is not None and held.after.why_none == ""
    assert held.true.max() > 3.0 * calm.true.max()
    assert np.all(held.true <= held.bound)
