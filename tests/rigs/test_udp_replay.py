"""Captured packets sent again, to a target and to its runner, between all that happens in a session.

Nothing here depends on time: whatever is replayed lies in the socket before the next genuine packet is sent.
benchmarks/udp_replay.py sends 100,000 of each kind at full speed.
"""

from __future__ import annotations

import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info
from udp_peer import SECRET, PlainTarget
from udp_relay import Relay

from rths_cli.errors import RigError
from rths_cli.laboratory.serve import Server, describe
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.session import bound, read_secret
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget

EXAMPLES = Path(__file__).parents[2] / "examples"
COMPILER = shutil.which("cc") or shutil.which("gcc")
AGAIN = 60  # packets between two steps of a session


class Line:
    """A relay that keeps all packets of both sides, and somebody who sends them again."""

    def __init__(self, port: int, seed: int) -> None:
        self.relay, self.random = Relay("127.0.0.1", port), np.random.default_rng(seed)
        self.forth: list[bytes] = []
        self.back: list[bytes] = []
        self.relay.to_target, self.relay.to_runner = self._keep(self.forth), self._keep(self.back)
        self.stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stranger.connect(("127.0.0.1", port))

    @staticmethod
    def _keep(kept: list[bytes]) -> Callable[[bytes], list[tuple[float, bytes]]]:
        def mishap(packet: bytes) -> list[tuple[float, bytes]]:
            kept.append(packet)
            return [(0.0, packet)]

        return mishap

    def replay(self, rig: UdpRig | None = None) -> None:
        """Send some of all packets to the target, the newest the most often, and some of its own to the runner."""
        for share in (1.0, 0.05):
            kept = self.forth[-max(int(share * len(self.forth)), 4) :] + self.back[-4:]
            for i in self.random.integers(len(kept), size=AGAIN // 2):
                self.stranger.send(kept[i])
        if rig is not None and rig.door is not None:
            for i in self.random.integers(len(self.back), size=AGAIN // 2):
                self.relay.send_to(rig.door.getsockname(), self.back[i])

    def close(self) -> None:
        self.relay.close()
        self.stranger.close()


def in_python(key_file: Path) -> Iterator[int]:
    """Start the target in plain Python; its table shows the command."""
    target = PlainTarget(SECRET, lambda command_v: [command_v or 0.0] * 3)
    yield target.port
    target.kill()


def in_c(key_file: Path) -> Iterator[int]:
    """Start the example in C; its table follows the command with a lag of 20 ms."""
    if COMPILER is None:
        pytest.skip("no C compiler here")
    program = key_file.parent / "udp_target"
    subprocess.run([COMPILER, "-std=c99", "-O1", "-o", program, EXAMPLES / "udp_target_pc.c"], check=True)
    process = subprocess.Popen([program, "0", key_file], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    yield int(process.stdout.readline().rpartition(":")[2])
    process.kill()
    process.communicate()


def by_rths_serve(key_file: Path) -> Iterator[int]:
    """Start what `rths serve` runs, in a thread."""
    served = describe("aps400_virtual", "three_storey", ("sample_rate_hz=500",), 0)
    with bound("127.0.0.1", 0) as link:
        server = Server(link, read_secret(key_file), served, 10**9, lambda _: None)
        server.start()
        yield link.getsockname()[1]
        server.run_for(0.0)
    assert [session.commands for session in server.ended] in ([20, 20, 20, *[10] * 5], [1], [2])


@pytest.fixture(params=[in_python, in_c, by_rths_serve])
def line(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Line, UdpRig]]:
    key_file = tmp_path / "key"
    key_file.write_text(SECRET.hex())
    key_file.chmod(0o600)
    started = request.param(key_file)
    line = Line(next(started), 5)
    target = UdpTarget("127.0.0.1", line.relay.port, key_file, timeout_s=2.0, watchdog_s=1.0)
    rig = UdpRig(rig_info(dt_s=2e-3), target)
    yield line, rig
    rig.close()
    line.close()
    assert next(started, None) is None


@pytest.mark.campaign
def test_replays_at_the_start_in_motion_and_at_the_end_change_nothing(line: tuple[Line, UdpRig]) -> None:
    """Three sessions at 1 V first; then five at 0 V, each of which begins at once, stays at rest, and is confirmed."""
    wire_tap, rig = line
    for _ in range(3):
        rig.open()
        rig.arm()
        shown = [float(np.abs(rig.exchange(1.0)).max()) for _ in range(20)]
        assert max(shown) > 0.1
        rig.rest()
        assert rig.at_rest
        rig.close()
    for _ in range(5):
        wire_tap.replay()
        rig.open()
        wire_tap.replay(rig)
        rig.arm()
        shown = []
        for _ in range(10):
            wire_tap.replay(rig)
            shown.append(float(np.abs(rig.exchange(0.0)).max()))
        assert max(shown) <= max(1.001 * shown[0], 0.01) and rig.link.status[links.STATE] == packets.ARMED
        assert rig.counts["lost"] == 0
        wire_tap.replay(rig)
        rig.rest()
        assert rig.at_rest
        wire_tap.replay(rig)
        assert links.converse_at(rig.link, packets.REST, rig.next_step, 0.0, 0, 2_000_000_000) == links.FAULT
        assert rig.link.status[links.STATE] == packets.RESTED and rig.link.status[links.FAULTS] == 0
        wire_tap.replay(rig)
        rig.close()
        wire_tap.replay()
    nonces = {
        packet[packets.WORDS : packets.AFTER_NONCE]
        for packet in wire_tap.forth
        if packet[packets.KIND] == packets.HELLO
    }
    assert len(nonces) == 8  # no session was begun twice


def test_a_runner_whose_welcome_is_worthless_begins_once_more(
    line: tuple[Line, UdpRig], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another one armed, and rested, between its WELCOME and its ARM."""
    _, rig = line
    monkeypatch.setattr("rths_cli.rigs.udp.udp_rig.ARMING_TRIES", 3)
    rig.open()
    other = UdpRig(rig.info, rig.target)
    other.open()
    other.arm()
    other.rest()
    other.close()
    rig.arm()
    assert rig.exchange(0.0).size == 3
    rig.rest()
    assert rig.at_rest


def test_an_arm_does_not_take_a_table_that_another_runner_has(
    line: tuple[Line, UdpRig], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was welcomed while the table was at rest; its ARM comes while the other one's table is armed."""
    wire_tap, rig = line
    monkeypatch.setattr("rths_cli.rigs.udp.udp_rig.ARMING_TRIES", 3)
    monkeypatch.setattr("rths_cli.rigs.udp.udp_rig.AT_REST_S", -rig.target.watchdog_s)  # it waits for no watchdog
    late = UdpRig(rig.info, rig.target)
    late.open()
    rig.open()
    rig.arm()
    rig.exchange(0.0)
    with pytest.raises(RigError, match="another session has its table"):
        late.arm()
    arms = [packet for packet in wire_tap.forth if packet[packets.KIND] == packets.ARM]
    assert len({packet[packets.WORDS : packets.AFTER_NONCE] for packet in arms}) == 2
    rig.exchange(0.0)
    assert rig.link.status[links.STATE] == packets.ARMED
    rig.rest()
    assert rig.at_rest
    assert late.door is not None
    late.door.close()
