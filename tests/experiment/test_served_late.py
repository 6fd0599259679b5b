"""A server that was held up: each command counts from when it arrived, whenever it is read."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pytest
from serving_bench import RATE_HZ, offline_in_ticks, wave

from rths_cli.laboratory.serve import ServedRig, describe, make_table
from rths_cli.loop import udp_target
from rths_cli.loop.udp_target import CONTROL_SIZE, STAMP_KIND, STAMP_NS, STAMP_S
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.handshake import open_greeter
from rths_cli.rigs.udp.packets import Words
from rths_cli.rigs.udp.session import bound, sealed

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
INTERVAL_NS = round(1e9 / RATE_HZ)
SECRET, KEY = np.array([1, 2], np.uint64), np.array([3, 4], np.uint64)
HOUR_NS = 3_600_000_000_000


@entry
def look(d: udp_target.Door, t: udp_target.Table) -> int:
    """Serve one packet, as `serve_packets` does many."""
    d, t = borrowed((d, t))
    return udp_target.look(d, t)


@pytest.fixture(scope="module")
def served() -> ServedRig:
    return describe(
        "aps400_virtual", "three_storey", (f"sample_rate_hz={RATE_HZ:g}", "table.sensors.noise_rms_m_s2=0.05"), 0
    )


@dataclass
class Late:
    """A door and a table that nobody serves until `serve` is called, and a runner's end of the line."""

    door: udp_target.Door
    table: udp_target.Table
    runner: socket.socket
    answers: list[tuple[int, Array]]  # when each step was sampled, and its samples

    def send(self, kind: int, sequence: int, content: bytes = b"", key: Words = KEY) -> tuple[int, int]:
        """Send a packet; return the times before and after."""
        before = time.monotonic_ns()
        self.runner.send(sealed(kind, content, key, sequence))
        return before, time.monotonic_ns()

    def serve(self) -> None:
        """Read the next packet, and take its answer where there is one."""
        look(self.door, self.table)
        try:
            packet = self.runner.recv(packets.MOST_BYTES)
        except BlockingIOError:
            return
        instant = int.from_bytes(packet[packets.INSTANT_NS : packets.WORDS], "little")
        self.answers.append((instant, np.frombuffer(packet[packets.WORDS : -packets.TAG_BYTES])))


@pytest.fixture
def late(served: ServedRig) -> Iterator[Late]:
    with bound("127.0.0.1", 0) as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as runner:
        runner.connect(link.getsockname())
        runner.setblocking(False)
        door = udp_target.open_door(
            link, open_greeter(SECRET, 3, 1, 10**9), KEY, INTERVAL_NS, 300_000_000, np.zeros(1, np.int64)
        )
        table = make_table(served, INTERVAL_NS)
        look.bind(door, table)  # compiled before the clock runs
        yield Late(door, table, runner, [])


def commanded(late: Late, command_v: float, sequence: int) -> tuple[int, int]:
    """Send a command; return the times before and after it."""
    return late.send(packets.COMMAND, sequence, struct.pack("<d", command_v))


@pytest.mark.campaign
def test_a_server_held_up_gives_the_samples_of_each_command_s_own_instant(late: Late, served: ServedRig) -> None:
    """Commands wait for longer than the watchdog bears; table and answers are as if they had been read at once."""
    commands = wave(80)
    late.send(packets.ARM, 0, bytes(40))
    late.serve()
    sent = []
    for k, command in enumerate(commands):
        sent.append(commanded(late, command, 1 + k))
        time.sleep(1e-9 * INTERVAL_NS)
    ticks = []
    for _ in commands:
        late.serve()
        ticks.append(int(late.door.session[udp_target.LAST_TICK]))
    assert late.door.session[udp_target.STATE] == packets.ARMED and late.door.counts[udp_target.OBEYED] == len(commands)
    times = np.array(sent) - sent[0][0]
    instants = np.array([instant for instant, _ in late.answers[1:]]) - sent[0][0]
    assert np.all(instants >= times[:, 0] - INTERVAL_NS / 10) and np.all(instants <= times[:, 1] + INTERVAL_NS / 10)
    assert np.abs(np.array(ticks) * INTERVAL_NS / 4 - instants).max() <= INTERVAL_NS / 4
    offline = offline_in_ticks(served, commands, np.diff(ticks, prepend=0))
    assert late.door.session[udp_target.REACHED_NS] >= late.answers[-1][0] > 0
    samples = np.array([shown for _, shown in late.answers])
    assert np.abs(samples - offline).max() <= 2.01 * served.setup.rig.converters.step_v
    assert np.ptp(samples) > 1000 * served.setup.rig.converters.step_v


@pytest.mark.campaign
def test_without_any_command_the_watchdog_still_bites(late: Late) -> None:
    late.send(packets.ARM, 0, bytes(40))
    commanded(late, 0.5, 1)
    late.serve()
    late.serve()
    time.sleep(0.35)
    commanded(late, 0.6, 2)
    late.serve()
    assert late.door.session[udp_target.FAULTS] == packets.WATCHDOG and late.door.counts[udp_target.OBEYED] == 1


def hello(nonce: int) -> bytes:
    return struct.pack("<2Q3q16x", nonce, 0, 3, INTERVAL_NS, 0)


def answers(late: Late) -> list[int]:
    """Return the kinds of the answers that came."""
    kinds = []
    with suppress(BlockingIOError):
        while True:
            kinds.append(late.runner.recv(packets.MOST_BYTES)[packets.KIND])
    return kinds


@pytest.mark.campaign
def test_at_rest_each_hello_is_answered_and_nothing_of_it_is_kept(late: Late) -> None:
    before = [late.door.session[i] for i in (udp_target.STATE, udp_target.SEQUENCE)], late.door.key.copy()
    for i in range(100):
        late.send(packets.HELLO, 0, hello(i), SECRET)
        assert look(late.door, late.table) == 0
    assert answers(late) == [packets.WELCOME] * 100
    assert late.door.counts[udp_target.GREETED] == 100 and late.door.greeter.armed[0] == 0
    assert before[0] == [late.door.session[i] for i in (udp_target.STATE, udp_target.SEQUENCE)]
    assert np.array_equal(before[1], late.door.key)


@pytest.mark.campaign
def test_in_motion_each_hello_is_refused(late: Late) -> None:
    late.send(packets.ARM, 0, bytes(40))
    late.serve()
    for i in range(20):
        late.send(packets.HELLO, 0, hello(i), SECRET)
        look(late.door, late.table)
    assert answers(late) == [packets.REFUSAL] * 20 and late.door.counts[udp_target.GREETED] == 20


@entry
def arrived(message: IntArray, now: int, wall: int, earliest: int) -> int:
    """Call `arrival`."""
    return udp_target.arrival(message, now, wall, earliest)


@pytest.mark.parametrize(
    ("ago_ns", "came_ns"),
    [(7_000_000, 993_000_000), (0, 1_000_000_000), (-HOUR_NS, 1_000_000_000), (HOUR_NS, 900_000_000)],
    ids=["stamped 7 ms ago", "stamped now", "wall clock set back by an hour", "wall clock set on by an hour"],
)
def test_arrival_is_the_stamp_s_between_what_is_known_and_now(ago_ns: int, came_ns: int) -> None:
    message, wall = np.zeros(udp_target.WORDS, np.int64), 1_700_000_000_123_456_789
    message[CONTROL_SIZE], message[STAMP_KIND] = 32, 1 | 35 << 32  # SOL_SOCKET, SCM_TIMESTAMPNS
    message[STAMP_S], message[STAMP_NS] = divmod(wall - ago_ns, 1_000_000_000)
    assert arrived(message, 1_000_000_000, wall, 900_000_000) == came_ns


@pytest.mark.parametrize(("size", "kind"), [(0, 1 | 35 << 32), (32, 1 | 29 << 32)], ids=["nothing told", "not a stamp"])
def test_where_no_stamp_came_a_packet_arrived_now(size: int, kind: int) -> None:
    message = np.zeros(udp_target.WORDS, np.int64)
    message[CONTROL_SIZE], message[STAMP_KIND] = size, kind
    assert arrived(message, 1_000_000_000, 1_700_000_000_000_000_000, 900_000_000) == 1_000_000_000
