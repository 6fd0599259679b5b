"""How a command goes on, as words of a packet and as a place after so many intervals."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from packets import HEAD, Packet
from smooth_way import smooth_way

from rths_cli.numerics.compiled import entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.late_command_trajectory import Way, coast, fresh_way, place_after, put_way, take_way, words_of
from rths_cli.rigs.udp.packets import Bytes

POINTS = (1.5, -2.25, 0.125)


@entry
def places(way: Way, made: Array) -> None:
    for intervals in range(made.size):
        made[intervals] = place_after(way, intervals)


@entry
def coasting(way: Way, step_v: float, intervals: int) -> int:
    coast(way, step_v, intervals)
    return intervals


@entry
def put(packet: Bytes, way: Way) -> int:
    put_way(packet, way)
    return words_of(way)


@entry
def taken(packet: Bytes, way: Way) -> None:
    take_way(packet, way)


def read(content: bytes) -> Way:
    """Return the way that a packet with this content tells, taken over another one."""
    way = fresh_way()
    way.volts[:], way.marks[:] = 7.0, (14, 3)
    packet = np.zeros(packets.MOST_BYTES, np.uint8)
    sealed = Packet(packets.COMMAND, 1, content).sealed(bytes(16))
    packet[: len(sealed)] = np.frombuffer(sealed, np.uint8)
    taken(packet, way)
    return way


def places_of(way: Way, count: int) -> Array:
    made = np.zeros(count)
    places(way, made)
    return made


@pytest.mark.parametrize("spacing", [1, 2, 7])
@pytest.mark.parametrize("points", [POINTS[:1], POINTS[:2], POINTS, tuple(np.sin(np.arange(14.0)))])
def test_it_goes_smoothly_from_point_to_point_and_holds_the_last(points: tuple[float, ...], spacing: int) -> None:
    way = read(struct.pack(f"<dq{len(points)}d", 1.0, spacing, *points))
    assert places_of(way, 120) == pytest.approx(smooth_way((1.0, *points), spacing, 120), abs=1e-14)


def test_a_parabola_and_the_middle_of_a_sine_are_gone_through_between_the_points() -> None:
    """A sine of 1 Hz and 1 V, points 8 intervals of 1 ms apart: to 2 uV where four points are near."""
    t = 1e-3 * np.arange(113)
    for path in (0.3 - 2.0 * t + 70.0 * t**2, np.sin(2.0 * np.pi * t)):
        way = read(struct.pack("<dq14d", path[0], 8, *path[8::8]))
        assert places_of(way, 105) == pytest.approx(path[:105], abs=1e-5)
        assert places_of(way, 105)[8:] == pytest.approx(path[8:105], abs=2e-6)


@pytest.mark.parametrize("seed", range(20))
def test_it_is_nowhere_more_than_twice_as_steep_as_the_straight_lines(seed: int) -> None:
    lines = np.random.default_rng(seed).uniform(-1.0, 1.0, 14)
    lines[:2] = (1.0, -1.0) if seed == 0 else lines[:2]  # the steepest beginning there is
    way = read(struct.pack("<dq14d", 0.0, 1000, *np.cumsum(lines)))
    steepest = 1000 * np.abs(np.diff(places_of(way, 14_001))).max()
    assert steepest <= 2.0 * np.abs(lines).max()
    assert seed != 0 or steepest > 1.99


def test_a_command_alone_is_held() -> None:
    assert (places_of(read(struct.pack("<d", 0.75)), 20) == 0.75).all()


@pytest.mark.parametrize("points", [0, 1, 14])
def test_what_is_put_is_laid_out_as_documented_and_taken_again(points: int) -> None:
    way, packet = fresh_way(), np.zeros(packets.MOST_BYTES, np.uint8)
    way.volts[:], way.marks[:] = np.arange(15.0) + 0.5, (points, 5)
    words = put(packet, way)
    plain = struct.pack("<d", 0.5) + (struct.pack("<q", 5) if points else b"") + way.volts[1 : 1 + points].tobytes()
    assert words == len(plain) // 8
    assert packet[HEAD.size : HEAD.size + len(plain)].tobytes() == plain
    assert not packet[HEAD.size + len(plain) :].any()
    assert places_of(read(plain), 90) == pytest.approx(places_of(way, 90))


@pytest.mark.parametrize("spacing", [0, -1, 1001, 2**62, -(2**63)])
def test_a_bad_spacing_makes_it_hold(spacing: int) -> None:
    assert (places_of(read(struct.pack("<dq3d", 1.0, spacing, *POINTS)), 20) == 1.0).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308, -1.1e6])
@pytest.mark.parametrize("place", range(3))
def test_a_point_that_is_no_number_makes_it_hold(bad: float, place: int) -> None:
    points = np.array(POINTS)
    points[place] = bad
    assert (places_of(read(struct.pack("<dq3d", 1.0, 2, *points)), 20) == 1.0).all()


def test_a_rig_without_preview_goes_on_by_its_last_step_and_is_braked_evenly() -> None:
    """As a body does that is braked evenly: s j - s j^2 / (2 n) until it stands (docs/reference/plain_link.md)."""
    way, made = fresh_way(), np.zeros(70)
    way.volts[0] = 1.25
    coasting(way, -0.02, 50)
    places(way, made)
    j = np.minimum(np.arange(70), 50)
    assert made == pytest.approx(1.25 - 0.02 * (j - j**2 / 100.0), abs=1e-14)
