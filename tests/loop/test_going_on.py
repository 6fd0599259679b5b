"""How a served table goes on with the rate of its last command, tick by tick, against the document's own rule."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import numpy as np
import pytest

from rths_cli.compiled import entry
from rths_cli.loop import serving
from rths_cli.loop.serving import LAST_TICK, TICK, TICKS_PER_INTERVAL, Door, Table, open_door
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
def step_of(d: Door, t: Table, rate_v_s: float) -> float:
    return serving.going_on(d, t, rate_v_s)


@pytest.fixture
def table() -> Table:
    return make_table(describe("aps400_virtual", "three_storey", ("sample_rate_hz=500",), 0), INTERVAL_NS)


@pytest.fixture
def door() -> Iterator[Door]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        secret = np.zeros(2, np.uint64)
        yield open_door(link, secret, secret, INTERVAL_NS, 100_000_000, np.zeros(1, np.int64))


def test_a_command_goes_on_at_each_instant_the_next_was_due_for_ten_intervals_then_holds(table: Table) -> None:
    table.latched_v[:] = 1.0, 0.125
    held = [gone_on(table, since) for since in range(16 * TICKS_PER_INTERVAL)]
    due = np.arange(len(held)) // TICKS_PER_INTERVAL
    assert held == (1.0 + 0.125 * np.minimum(due, 10)).tolist() and BRIDGED == 10
    assert table.guard.motion[0] == pytest.approx(GAIN_M_PER_V * 2.25, rel=1e-15)  # the way to rest begins there


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_it_goes_no_farther_than_the_range_or_the_stroke(table: Table, towards: float) -> None:
    table.latched_v[:] = towards * 9.9, towards * 0.08
    assert [gone_on(table, TICKS_PER_INTERVAL * k) for k in (1, 2, 3)] == pytest.approx(
        [towards * 9.98, towards * RANGE_V, towards * RANGE_V], rel=1e-15
    )
    short = table._replace(limits=table.limits._replace(stroke_m=5.0 * GAIN_M_PER_V))
    short.latched_v[:] = towards * 4.99, towards * 0.08
    assert gone_on(short, TICKS_PER_INTERVAL) == pytest.approx(towards * 5.0, rel=1e-15)


def test_the_step_is_an_interval_s_worth_within_the_velocity_limit(door: Door, table: Table) -> None:
    assert step_of(door, table, 50.0) == pytest.approx(0.1, rel=1e-15)
    fastest = VELOCITY_M_S / GAIN_M_PER_V * 2e-3
    assert step_of(door, table, 1e9) == pytest.approx(fastest) and step_of(door, table, -1e9) == pytest.approx(-fastest)
    assert [step_of(door, table, rate) for rate in (np.nan, np.inf, -np.inf, 0.0)] == [0.0] * 4


@entry
def ticked(d: Door, t: Table, count: int) -> float:
    """Advance the physics by ticks; return what is held."""
    for _ in range(count):
        serving.tick(d, t)
    return t.latched_v[0]


def test_an_armed_table_goes_on_by_itself_and_a_resting_one_does_not(door: Door, table: Table) -> None:
    door.session[serving.STATE] = serving.wire.ARMED
    table.latched_v[:] = 0.0, 0.01
    door.session[TICK], door.session[LAST_TICK] = 0, 0
    assert ticked(door, table, 3 * TICKS_PER_INTERVAL + 1) == pytest.approx(0.03, rel=1e-12)
    door.session[serving.STATE] = serving.wire.IDLE
    assert ticked(door, table, 3 * TICKS_PER_INTERVAL) == pytest.approx(0.03, rel=1e-12)
