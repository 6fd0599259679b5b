"""The critical delay against the published figures, the response in time and a search of the frequency axis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from portfolio import parametrize_first
from test_sim import paper_building, random_building

from rths_cli.analysis.closed_loop import critical_delay, open_loop_of_building, unit_gain_rad_s
from rths_cli.analysis.sim_delay import simulate_delayed


@pytest.mark.parametrize(
    ("ratio", "share", "published_ms"),
    [(0.026, 0.0, 7.94), (0.036, 0.0, 9.12), (0.026, 0.25, 11.97), (0.036, 0.25, 13.74)],
)
def test_published_delays(ratio: float, share: float, published_ms: float) -> None:
    found = critical_delay(paper_building(ratio, 6.93 * share))
    assert 1e3 * found.delay_s == pytest.approx(published_ms, abs=0.005)
    assert found.gain_at_infinity == pytest.approx(share / (1.0 - share))
    assert 8.5 < found.frequency_hz < 10.0


def test_half_the_interface_mass_on_the_table_leaves_no_delay() -> None:
    assert critical_delay(paper_building(interface_mass_kg=0.5 * 6.93)).delay_s == 0.0
    assert critical_delay(paper_building(interface_mass_kg=0.49 * 6.93)).delay_s > 0.0


@pytest.mark.parametrize("seed", range(20))
def test_unit_gains_are_those_a_fine_grid_shows(seed: int) -> None:
    loop = open_loop_of_building(random_building(seed))
    omega = np.geomspace(0.1, 1e4, 12_000)
    size = np.abs(loop.response(omega / (2.0 * np.pi))[0, 0]) - 1.0
    seen = omega[np.flatnonzero(np.diff(np.sign(size)) != 0)]
    assert unit_gain_rad_s(loop) == pytest.approx(seen, rel=1.1e-3)  # the grid's step


def growth(seed: int, delay_s: float, period_s: float) -> float:
    """Return the ratio of a late to an early stretch of the response to an impulse."""
    record = np.zeros(120_000)
    record[1] = 1.0
    step = min(0.001, period_s / 40.0)
    accel = np.abs(simulate_delayed(random_building(seed), step, record, delay_s).abs_accel_m_s2)
    if np.isnan(accel).any():
        return math.inf
    return float(accel[:, 100_000:].max() / accel[:, 60_000:80_000].max())


@pytest.mark.campaign
@parametrize_first(2, "seed", [0, 3, 5, 8, 11, 14])
def test_response_in_time_decays_below_and_grows_above(seed: int) -> None:
    found = critical_delay(random_building(seed))
    period = 1.0 / found.frequency_hz
    assert growth(seed, 0.995 * found.delay_s, period) < 1.0 < growth(seed, 1.005 * found.delay_s, period)
