"""How a served table goes on with the rate of its last command, tick by tick, against the document's own rule."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import numpy as np
import pytest
from bench import rig_info
from hybrid import open_limits

from rths_cli.compiled import entry
from rths_cli.loop import going_on, guard, serving
from rths_cli.loop.log import Log, empty_log
from rths_cli.loop.serving import LAST_TICK, TICK, TICKS_PER_INTERVAL, Door, Table, open_door
from rths_cli.lti import Array
from rths_cli.rigs.udp.wire import BRIDGED
from rths_cli.workflows.serve_table import describe, make_table

INTERVAL_NS = 2_000_000
GAIN_M_PER_V, RANGE_V, VELOCITY_M_S = 0.0079, 10.0, 1.0


@entry
def gone_on(t: Table, since: int) -> float:
    """Go on `since` ticks after a command; return what is held."""
    serving.go_on(t, since)
    return t.latched_v[0]


@entry
def kept(d: Door, t: Table, rate_v_s: float, change_v_s2: float) -> None:
    serving.go_on_with(d, t, rate_v_s, change_v_s2)


def step_of(d: Door, t: Table, rate_v_s: float, change_v_s2: float = 0.0) -> float:
    kept(d, t, rate_v_s, change_v_s2)
    return float(t.latched_v[1])


@pytest.fixture
def table() -> Table:
    return make_table(describe("aps400_virtual", "three_storey", ("sample_rate_hz=500",), 0), INTERVAL_NS)


@pytest.fixture
def door() -> Iterator[Door]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        secret = np.zeros(2, np.uint64)
        yield open_door(link, secret, secret, INTERVAL_NS, 100_000_000, np.zeros(1, np.int64))


def test_a_command_goes_on_at_each_instant_the_next_was_due_for_ten_intervals_then_holds(table: Table) -> None:
    table.latched_v[:] = 1.0, 0.125, 0.0
    held = [gone_on(table, since) for since in range(16 * TICKS_PER_INTERVAL)]
    due = np.arange(len(held)) // TICKS_PER_INTERVAL
    assert held == (1.0 + 0.125 * np.minimum(due, 10)).tolist() and BRIDGED == 10
    assert table.guard.motion[0] == pytest.approx(GAIN_M_PER_V * 2.25, rel=1e-15)  # the way to rest begins there


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_it_goes_no_farther_than_the_range_or_the_stroke(table: Table, towards: float) -> None:
    table.latched_v[:] = towards * 9.9, towards * 0.08, 0.0
    assert [gone_on(table, TICKS_PER_INTERVAL * k) for k in (1, 2, 3)] == pytest.approx(
        [towards * 9.98, towards * RANGE_V, towards * RANGE_V], rel=1e-15
    )
    short = table._replace(limits=table.limits._replace(stroke_m=5.0 * GAIN_M_PER_V))
    short.latched_v[:] = towards * 4.99, towards * 0.08, 0.0
    assert gone_on(short, TICKS_PER_INTERVAL) == pytest.approx(towards * 5.0, rel=1e-15)


def test_the_step_is_an_interval_s_worth_within_the_velocity_limit(door: Door, table: Table) -> None:
    assert step_of(door, table, 50.0) == pytest.approx(0.1, rel=1e-15)
    fastest = VELOCITY_M_S / GAIN_M_PER_V * 2e-3
    assert step_of(door, table, 1e9) == pytest.approx(fastest) and step_of(door, table, -1e9) == pytest.approx(-fastest)
    assert [step_of(door, table, rate) for rate in (np.nan, np.inf, -np.inf, 0.0)] == [0.0] * 4


def test_the_step_grows_by_the_change_of_the_rate_within_the_velocity_limit(door: Door, table: Table) -> None:
    """50 V/s that grow by 2000 V/s^2, every 2 ms: steps of 0.100, 0.108, 0.116, ... V."""
    assert step_of(door, table, 50.0, 2000.0) == pytest.approx(0.1)
    held = [gone_on(table, TICKS_PER_INTERVAL * k) for k in range(1, 5)]
    assert held == pytest.approx(np.cumsum([0.1, 0.108, 0.116, 0.124]))
    assert table.guard.motion[1] == pytest.approx(GAIN_M_PER_V * 0.124 / 2e-3)
    fastest = VELOCITY_M_S / GAIN_M_PER_V * 2e-3
    assert step_of(door, table, 50.0, 1e9) == pytest.approx(0.1) and table.latched_v[2] == pytest.approx(fastest)
    table.latched_v[0] = 0.0
    assert np.diff([gone_on(table, TICKS_PER_INTERVAL * k) for k in range(1, 5)]) == pytest.approx(fastest)
    for bad in (np.nan, np.inf):
        assert step_of(door, table, 50.0, bad) == 0.0 and table.latched_v[2] == 0.0


@pytest.mark.parametrize(("dt_s", "count"), [(1e-3, 16), (5e-4, 32), (1e-4, 32), (2e-3, 8), (2.5e-3, 0), (0.01, 0)])
def test_a_parabola_goes_on_as_a_parabola(dt_s: float, count: int) -> None:
    slopes = going_on.slopes_of(dt_s)
    assert slopes.shape == (2, count)
    if count:
        t = dt_s * np.arange(-count + 1, 11)
        path = 0.3 - 2.0 * t + 70.0 * t**2
        step, change = slopes @ path[count - 1 :: -1]
        ahead = path[count - 1] + np.cumsum(step + change * np.arange(10))
        assert ahead == pytest.approx(path[count:], abs=1e-12)
        wave = np.random.default_rng(1).standard_normal(count)
        bend, slope, _ = np.polyfit(np.arange(-count + 1.0, 1.0), wave, 2)
        assert slopes @ wave[::-1] == pytest.approx([slope + bend, 2 * bend])


@entry
def looked(
    ahead: Array, slopes: Array, limits: guard.GuardLimits, g: guard.GuardState, log: Log, k: int, command: float
) -> None:
    going_on.look_ahead(ahead, slopes, limits, g, log, k, command)


def test_what_the_rig_is_told_is_the_parabola_and_the_guard_s_rate_while_the_test_ends() -> None:
    limits = open_limits(rig_info())._replace(velocity_m_s=0.79, gain_m_per_v=0.0079, dt_s=1e-3)
    state, slopes, ahead = guard.fresh_guard(3), going_on.slopes_of(1e-3), np.zeros(3)
    log = empty_log(40, 3, 6)
    path = 1e-3 * np.arange(40.0) ** 2
    log.columns[6] = path  # three channels, three of what is desired, the commands
    state.motion[1] = 0.0079 * 5.0
    looked(ahead, slopes, limits, state, log, 30, path[29])
    assert ahead == pytest.approx([path[29], path[30] - path[29], 2e-3])
    looked(ahead, slopes, limits, state, log, 15, path[14])
    assert ahead == pytest.approx([path[14], 5e-3, 0.0])
    state.flags[0] = guard.BRAKING
    looked(ahead, slopes, limits, state, log, 30, path[29])
    assert ahead == pytest.approx([path[29], 5e-3, 0.0])
    state.flags[0] = guard.RUNNING
    log.columns[6] = 10.0 * path
    looked(ahead, slopes, limits, state, log, 30, path[29])
    assert ahead[1] == pytest.approx(0.1)  # the velocity limit


@pytest.mark.parametrize(("rate_v_s", "most"), [(np.inf, 0.1), (62.0, 0.062)])
@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_no_step_that_the_rig_makes_of_it_is_beyond_velocity_or_rate_limit(
    rate_v_s: float, most: float, towards: float
) -> None:
    limits = open_limits(rig_info())._replace(velocity_m_s=0.79, gain_m_per_v=0.0079, dt_s=1e-3)
    limits, ahead = limits._replace(command_rate_v_s=rate_v_s), np.zeros(3)
    log = empty_log(40, 3, 6)
    log.columns[6] = towards * 1e-3 * np.arange(40.0) ** 2
    for bend, steepest in ((1.0, 0.059), (5.0, most)):  # steps of 0.059, 0.061, ..., or five times that
        log.columns[6] *= bend
        looked(ahead, going_on.slopes_of(1e-3), limits, guard.fresh_guard(3), log, 30, log.columns[6, 29])
        steps = ahead[1] + ahead[2] * np.arange(BRIDGED + 1)
        assert steps[0] == pytest.approx(towards * steepest) and np.abs(steps).max() <= most * (1.0 + 1e-12)


@entry
def ticked(d: Door, t: Table, count: int) -> float:
    """Advance the physics by ticks; return what is held."""
    for _ in range(count):
        serving.tick(d, t)
    return t.latched_v[0]


def test_an_armed_table_goes_on_by_itself_and_a_resting_one_does_not(door: Door, table: Table) -> None:
    door.session[serving.STATE] = serving.wire.ARMED
    table.latched_v[:] = 0.0, 0.01, 0.0
    door.session[TICK], door.session[LAST_TICK] = 0, 0
    assert ticked(door, table, 3 * TICKS_PER_INTERVAL + 1) == pytest.approx(0.03, rel=1e-12)
    door.session[serving.STATE] = serving.wire.IDLE
    assert ticked(door, table, 3 * TICKS_PER_INTERVAL) == pytest.approx(0.03, rel=1e-12)
