"""Steps without samples, counted in series made up of what is known."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.experiment.lost_samples import longest_run, losses_of, lost_sample_metrics, of_live

DT_S = 1e-3


def test_lost_and_overrun_steps_are_counted_apart_and_the_longest_gap_holds_both() -> None:
    lost, late = np.zeros(50), np.full(50, 1e-5)
    late[0] = np.nan  # the first samples were there before the clock began
    lost[[3, 20]] = 1.0
    lost[21:24] = 2.0
    found = losses_of(lost, late, DT_S)
    assert (found.lost, found.overrun, found.any) == (2, 3, True)
    assert found.longest_gap_s == pytest.approx(4 * DT_S)
    lost[24:33] = 3.0  # samples that came, in a mix: nothing is lost, and the gap is over
    found = losses_of(lost, late, DT_S)
    assert (found.lost, found.overrun, found.mixed) == (2, 3, 9)
    assert found.longest_gap_s == pytest.approx(4 * DT_S)
    late[40] = 7e-3  # where the record waits nothing is caught up
    found = losses_of(lost, late, DT_S)
    assert (found.overrun, found.longest_gap_s) == (4, pytest.approx(7e-3))
    assert lost_sample_metrics("exp_rths", found)["exp_rths.overrun_steps"] == 4


def test_nothing_lost_and_no_log_of_it() -> None:
    assert not losses_of(np.zeros(5), np.zeros(5), DT_S).any
    assert of_live({}, DT_S) is None
    assert longest_run(np.array([True, True, False, True])) == 2
