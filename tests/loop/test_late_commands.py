"""How a served table goes on while a command is late, tick by tick, against a spline of scipy."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import numpy as np
import pytest
from smooth_way import smooth_way

from rths_cli.laboratory.serve import describe, make_table
from rths_cli.loop import udp_target
from rths_cli.loop.udp_target import LAST_TICK, MOVED_TICK, STATE, TICK, TICKS_PER_INTERVAL, Door, Table, open_door
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.handshake import open_greeter

INTERVAL_NS = 2_000_000
GAIN_M_PER_V, RANGE_V, VELOCITY_M_S = 0.0079, 10.0, 1.0
CLOSING_V = 45.0 / (4.0 * np.pi * 14.0) / GAIN_M_PER_V * 2e-3  # in an interval
FASTEST_V = VELOCITY_M_S / GAIN_M_PER_V * 2e-3  # in an interval


@entry
def ticked(d: Door, t: Table, held: Array) -> None:
    """Advance the physics by as many ticks as there are places; note what is held after each."""
    d, t, held = borrowed((d, t, held))
    for i in range(held.size):
        udp_target.tick(d, t)
        held[i] = t.latched_v[0]


@entry
def obeyed(d: Door, t: Table) -> None:
    """Obey the command that stands at the beginning of the table's way, now."""
    d, t = borrowed((d, t))
    udp_target.obey(d, t, d.session[udp_target.STARTED_NS] + d.session[TICK] * d.interval_ns // TICKS_PER_INTERVAL)


@entry
def armed(d: Door, t: Table) -> None:
    d, t = borrowed((d, t))
    udp_target.arm(d, t, 0)


@pytest.fixture
def table() -> Table:
    return make_table(describe("aps400_virtual", "three_storey", ("sample_rate_hz=500",), 0), INTERVAL_NS)


@pytest.fixture
def door(table: Table) -> Iterator[Door]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        secret = np.zeros(2, np.uint64)
        made = open_door(
            link, open_greeter(secret, 3, 1, 10**9), secret, INTERVAL_NS, 100_000_000, np.zeros(1, np.int64)
        )
        armed(made, table)
        yield made


def command(door: Door, table: Table, volts: float, points: tuple[float, ...] = (), spacing: int = 1) -> None:
    table.way.volts[: 1 + len(points)] = volts, *points
    table.way.marks[:] = len(points), spacing
    obeyed(door, table)


def in_time(door: Door) -> None:
    """Let the next command be one that comes in time."""
    door.session[LAST_TICK], door.session[udp_target.CATCHES_UP] = door.session[TICK], 0


def held(door: Door, table: Table, intervals: int) -> Array:
    """Return what is held in each of the intervals from now on."""
    each = np.zeros(intervals * TICKS_PER_INTERVAL)
    ticked(door, table, each)
    intervals_of = each.reshape(intervals, TICKS_PER_INTERVAL)
    assert (intervals_of == intervals_of[:, :1]).all()  # it moves where a command was due, and nowhere else
    return intervals_of[:, 0]


@pytest.mark.campaign
@pytest.mark.parametrize("spacing", [1, 3])
def test_it_goes_smoothly_from_point_to_point_then_holds(door: Door, table: Table, spacing: int) -> None:
    points = (1.05, 1.15, 1.1, 0.9)
    command(door, table, 1.0, points, spacing)
    assert held(door, table, 20) == pytest.approx(smooth_way((1.0, *points), spacing, 20), rel=1e-14)
    assert table.guard.motion[0] == pytest.approx(GAIN_M_PER_V * 0.9, rel=1e-14) and table.guard.motion[1] == 0.0


@pytest.mark.campaign
def test_the_way_to_rest_begins_with_the_velocity_it_has(door: Door, table: Table) -> None:
    command(door, table, 1.0, (1.1, 1.3), 1)
    held(door, table, 2)
    assert table.guard.motion[1] == pytest.approx(GAIN_M_PER_V * 0.1 / 2e-3)
    held(door, table, 1)
    assert table.guard.motion[1] == pytest.approx(GAIN_M_PER_V * 0.2 / 2e-3)


@pytest.mark.campaign
def test_the_next_command_s_velocity_is_taken_from_where_and_when_it_moved_last(door: Door, table: Table) -> None:
    command(door, table, 1.0, (1.1, 1.2), 1)
    held(door, table, 5)  # two intervals on the way, then held for two more
    assert door.session[TICK] - door.session[MOVED_TICK] == 3 * TICKS_PER_INTERVAL
    command(door, table, 1.26)
    assert table.guard.motion[1] == pytest.approx(GAIN_M_PER_V * 0.06 / (3 * 2e-3))
    held(door, table, 1)
    command(door, table, 1.3)
    assert table.guard.motion[1] == pytest.approx(GAIN_M_PER_V * 0.04 / 2e-3)


def test_a_command_alone_is_held(door: Door, table: Table) -> None:
    command(door, table, 1.0, (2.0, 3.0), 10)
    held(door, table, 1)
    command(door, table, 0.5)
    assert (held(door, table, 30) == 0.5).all() and table.guard.motion[1] == 0.0


@pytest.mark.parametrize("moves", [0.0, 0.02])
def test_a_late_command_is_approached_no_faster_than_a_distance_is_closed(
    door: Door, table: Table, moves: float
) -> None:
    """It moves in an interval as far as the commands do and CLOSING_V farther, until it is there; then it follows."""
    command(door, table, 1.0)
    held(door, table, 20)
    commands = 2.0 + moves * np.arange(40)
    places = []
    for volts in commands:
        command(door, table, volts)
        places.append(held(door, table, 1)[0])
    moved = np.abs(np.diff([1.0, *places]))
    first = abs(commands[0] - 1.0) / 20 + CLOSING_V  # the commands moved by so much in each interval that was missed
    assert moved[0] == pytest.approx(first, rel=1e-12) and (moved[1:] <= moves + CLOSING_V + 1e-12).all()
    there = np.flatnonzero(np.array(places) == commands)
    assert 5 < there[0] < 20 and (there == np.arange(there[0], 40)).all()


def test_late_commands_that_come_together_move_it_no_farther_than_one(door: Door, table: Table) -> None:
    command(door, table, 1.0)
    held(door, table, 20)
    for volts in np.linspace(1.01, 3.0, 20):  # the first of them is reached at once
        command(door, table, volts)
    assert table.latched_v[0] == 1.01
    assert np.abs(np.diff(held(door, table, 40))).max() <= CLOSING_V + 1e-12
    assert table.latched_v[0] == 3.0


def test_a_table_that_goes_on_as_told_takes_a_late_command_at_once(door: Door, table: Table) -> None:
    """At 0.9 m/s: what it would have done in this interval anyway, and less than CLOSING_V more."""
    step = 0.9 * FASTEST_V
    command(door, table, 0.0, (10 * step,), 10)
    before = held(door, table, 5)[-1]
    late = before + (before - smooth_way((0.0, 10 * step), 10, 5)[-2])
    command(door, table, late)
    assert table.latched_v[0] == late


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_it_goes_no_farther_than_the_range_or_the_stroke_and_no_faster_than_the_limit(
    door: Door, table: Table, towards: float
) -> None:
    command(door, table, towards * 9.9, (towards * 9.98, towards * 10.06, towards * 10.14))
    assert held(door, table, 4) == pytest.approx(towards * np.array([9.9, 9.98, RANGE_V, RANGE_V]), rel=1e-15)
    short = table._replace(limits=table.limits._replace(stroke_m=5.0 * GAIN_M_PER_V))
    in_time(door)
    command(door, short, towards * 4.9, (towards * 9.0,))
    assert held(door, short, 3) == pytest.approx(towards * np.array([4.9, 5.0, 5.0]), rel=1e-15)
    in_time(door)
    command(door, table, 0.0, (towards * 2.0,) * 14, 1)
    steps = np.minimum(FASTEST_V * np.arange(12), 2.0)
    assert held(door, table, 12) == pytest.approx(towards * steps, rel=1e-14)


def test_a_resting_table_and_a_new_session_know_nothing_of_the_way(door: Door, table: Table) -> None:
    command(door, table, 0.0, (0.1, 0.2), 1)
    door.session[STATE] = packets.IDLE
    assert (held(door, table, 3) == 0.0).all()
    door.session[TICK], door.session[LAST_TICK] = 0, 0
    armed(door, table)
    assert (held(door, table, 5) == 0.0).all()
