"""What the fault bench says of a stream of commands: within the limits, or by how much beyond."""

from __future__ import annotations

import struct

import pytest
from campaigns.fault_bench import COMMAND, FASTEST_V, GAIN_M_PER_V, RATE_HZ, STROKE_M, used
from packets import Packet

INTERVAL_NS = 1_000_000_000 // RATE_HZ


def command(number: int, interval: int, volts: float, *points: float) -> Packet:
    """Return a command of an interval, which goes on to points of the intervals after it, in V."""
    content = struct.pack("<d", volts) + (struct.pack(f"<q{len(points)}d", 1, *points) if points else b"")
    return Packet(COMMAND, number, content, sent_ns=interval * INTERVAL_NS)


def velocity(*commands: Packet) -> float:
    return used(list(commands))["velocity"]


def test_a_run_at_the_limit_uses_it_up_and_one_beyond_is_seen() -> None:
    assert velocity(*(command(k, k, (k + 1) * FASTEST_V) for k in range(5))) == pytest.approx(1.0)
    assert velocity(command(0, 0, 0.0), command(1, 1, 1.3 * FASTEST_V)) == pytest.approx(1.3)


def test_after_a_stall_it_counts_from_where_the_table_has_gone_on_to() -> None:
    """Steps of 0.2, 0.3 and 0.4 in three intervals without a command, which is 0.9 in all."""
    told = command(0, 0, 0.0, 0.2 * FASTEST_V, 0.5 * FASTEST_V, 0.9 * FASTEST_V)
    assert velocity(told, command(1, 4, 1.9 * FASTEST_V)) == pytest.approx(1.0)
    assert velocity(told, command(1, 4, 2.4 * FASTEST_V)) == pytest.approx(1.5)
    assert velocity(told, command(1, 4, -0.4 * FASTEST_V)) == pytest.approx(1.3)


def test_it_goes_on_to_the_last_point_no_faster_and_no_farther_than_the_limits() -> None:
    still = command(0, 0, 0.0, *(0.1 * FASTEST_V * k for k in range(1, 11)))
    assert velocity(still, command(1, 30, 1.5 * FASTEST_V)) == pytest.approx(0.5)
    fast = command(0, 0, 0.0, 0.9 * FASTEST_V, 2.7 * FASTEST_V, 3.0 * FASTEST_V)  # it goes to 0.9, 1.9, 2.9
    assert velocity(fast, command(1, 4, 3.8 * FASTEST_V)) == pytest.approx(1.8)  # what it is told is too fast
    end = STROKE_M / GAIN_M_PER_V
    near = [command(k, k, (k + 1) * end / 200) for k in range(200)]
    near[-1] = command(199, 199, end, end + 0.3 * FASTEST_V)
    assert velocity(*near, command(200, 205, end - 0.4 * FASTEST_V)) == pytest.approx(0.4)


def test_between_points_that_lie_apart_it_goes_the_curve_of_the_document() -> None:
    """To 4 steps in 4 intervals and to rest there: 1.75, 1.25, 0.75 and 0.25 of the limit by the parabola."""
    told = Packet(COMMAND, 0, struct.pack("<dqd", 0.0, 4, 0.5 * 4 * FASTEST_V))
    assert velocity(told) == pytest.approx(0.5 * 1.75)
    assert velocity(told, command(1, 3, 0.5 * 3.0 * FASTEST_V)) == pytest.approx(0.5 * 1.75)


def test_commands_lost_on_the_way_hide_nothing() -> None:
    """Four steps of 1.3 times the limit, three of them lost on the way to a target that goes on at the limit."""
    told = command(0, 0, 0.0, *(FASTEST_V * k for k in range(1, 5)))
    assert velocity(told, command(4, 4, 4 * 1.3 * FASTEST_V)) == pytest.approx(1.3)
    assert velocity(told, command(4, 4, 4 * FASTEST_V)) == pytest.approx(1.0)


def test_what_is_no_number_is_beyond_every_limit() -> None:
    assert used([command(0, 0, float("nan"))])["stroke"] == float("inf")
    assert used([])["velocity"] == 0.0
