"""The example target in C, compiled with all warnings as errors, through the rig and against hostile packets."""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info
from packets import Packet, opened

from rths_cli.errors import RigError
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets as wire
from rths_cli.rigs.udp.link import FAULT, OK, converse_at
from rths_cli.rigs.udp.session import make_secret
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget

EXAMPLES = Path(__file__).parents[2] / "examples"
STRICT = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic")
COMPILER = shutil.which("cc") or shutil.which("gcc")
PATIENT_NS = 5_000_000_000
pytestmark = [
    pytest.mark.skipif(COMPILER is None, reason="no C compiler here"),
    pytest.mark.real_time,
]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("c") / "udp_target"
    subprocess.run([str(COMPILER), *STRICT, "-o", path, EXAMPLES / "udp_target_pc.c"], check=True)
    return path


@pytest.fixture
def rig(program: Path, tmp_path: Path) -> Iterator[UdpRig]:
    key_file = tmp_path / "key"
    make_secret(key_file)
    process = subprocess.Popen([program, "0", key_file], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    port = int(process.stdout.readline().rpartition(":")[2])
    rig = UdpRig(rig_info(dt_s=2e-3), UdpTarget("127.0.0.1", port, key_file, timeout_s=5.0, watchdog_s=1.0))
    yield rig
    rig.close()
    process.kill()
    process.wait()
    process.stdout.close()


def send(rig: UdpRig, *packets: bytes) -> None:
    """Send packets to the target from another socket, as a stranger would."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for packet in packets:
            stranger.sendto(packet, ("127.0.0.1", rig.target.port))


def command(rig: UdpRig, volts: float) -> int:
    """Send a command that no check of the runner has seen; return the outcome."""
    k = int(rig.link.status[links.LAST] - rig.link.status[links.BASE]) + 1
    return int(converse_at(rig.link, wire.COMMAND, k, volts, 0, PATIENT_NS))


def session_key(rig: UdpRig) -> bytes:
    return bytes(rig.link.key.astype("<u8").tobytes())


def test_the_portable_part_compiles_alone(tmp_path: Path) -> None:
    """Without the parts for a PC nothing of an operating system is asked for but memory functions."""
    made = tmp_path / "target.o"
    subprocess.run([str(COMPILER), *STRICT, "-c", "-o", made, EXAMPLES / "udp_target.c"], check=True)
    if (names := shutil.which("nm")) is not None:
        listed = subprocess.run([names, "-u", made], capture_output=True, text=True, check=True).stdout.split()
        wanted = {name.lstrip("_") for name in listed if len(name) > 1}
        hooks = {"read_samples", "write_command", "random_bytes", "clock_ns"}
        assert wanted - {"GLOBAL_OFFSET_TABLE_", "stack_chk_fail"} <= hooks | {"memcpy", "memset", "memcmp", "bcmp"}


def test_a_session_moves_the_simulated_table_and_rests_it(rig: UdpRig) -> None:
    """Held at 2 V the table follows with its lag of 20 ms: after 0.2 s it is there, and the channels are 1:2:3."""
    rig.open()
    assert rig.link.samples_v.size == 3
    assert not rig.arm().any()
    samples = np.array([rig.exchange(2.0).copy() for _ in range(150)])
    assert samples[-1] == pytest.approx([2.0, 4.0, 6.0], rel=1e-3)
    assert np.all(np.diff(samples[:, 0]) >= 0.0)
    assert samples[0, 0] == 0.0
    assert rig.counts["answered"] == 150
    rig.rest()
    assert rig.at_rest
    assert rig.link.samples_v[0] < 2.0
    rig.close()
    rig.open()
    assert rig.arm().size == 3
    assert rig.exchange(0.0).size == 3


def test_its_clock_stamps_rise_and_lost_commands_are_counted_there(rig: UdpRig) -> None:
    rig.open()
    rig.arm()
    assert converse_at(rig.link, wire.COMMAND, 1, 0.0, 0, PATIENT_NS) == OK
    first = rig.link.status.copy()
    assert converse_at(rig.link, wire.COMMAND, 5, 0.0, 0, PATIENT_NS) == OK
    second = rig.link.status
    assert (first[links.TARGET_LOST], second[links.TARGET_LOST]) == (0, 3)
    assert first[links.SAMPLED_NS] <= first[links.ANSWERED_NS] < second[links.SAMPLED_NS]


@pytest.mark.parametrize("volts", [np.nan, np.inf, 10.5, -10.5])
def test_a_command_that_is_no_number_or_out_of_range_is_not_obeyed_and_rests_the_table(
    rig: UdpRig, volts: float
) -> None:
    rig.open()
    rig.arm()
    assert command(rig, 1.0) == OK
    assert command(rig, volts) == FAULT
    assert rig.link.status[links.FAULTS] == wire.BAD_COMMAND
    with pytest.raises(RigError, match="stopped: it was sent a command that is not a number or out of range"):
        rig.exchange(0.0)
    rig.rest()
    assert rig.at_rest
    assert np.abs(rig.link.samples_v).max() < 3.0


def test_its_watchdog_rests_the_table_and_refuses_further_commands(rig: UdpRig) -> None:
    rig.target = replace(rig.target, watchdog_s=0.3)
    rig.open()
    rig.arm()
    for _ in range(30):
        rig.exchange(1.0)
    time.sleep(0.31)
    assert command(rig, 5.0) == FAULT
    assert rig.link.status[links.FAULTS] == wire.WATCHDOG
    end = time.monotonic() + 5.0
    while rig.link.status[links.STATE] != wire.RESTED or rig.link.samples_v[0] > 0.001:
        assert command(rig, 5.0) == FAULT
        assert time.monotonic() < end
    with pytest.raises(RigError, match="its watchdog missed commands"):
        rig.arm()
    rig.close()
    rig.open()
    rig.arm()


def test_a_moving_table_is_not_given_to_another_session(rig: UdpRig) -> None:
    rig.open()
    rig.arm()
    other = UdpRig(rig.info, rig.target)
    with pytest.raises(RigError, match="refuses the session: another session has its table"):
        other.open()
    assert command(rig, 0.0) in (OK, FAULT)


def test_replayed_doubled_and_forged_packets_move_nothing(rig: UdpRig) -> None:
    """5 V for a stranger: every packet of an old session, of this one again, and 2,000 mutations of a fresh one."""
    rig.open()
    old_key = session_key(rig)
    rig.arm()
    rig.close()
    time.sleep(0.01)
    rig.open()
    rig.arm()
    key, base, random = session_key(rig), int(rig.link.status[links.LAST]), np.random.default_rng(3)
    assert command(rig, 0.0) == OK
    volts = struct.pack("<d", 5.0)
    old = [Packet(wire.COMMAND, sequence, volts).sealed(old_key) for sequence in range(10)]
    again = [Packet(wire.COMMAND, sequence, volts).sealed(key) for sequence in range(base + 2)]
    odd = [Packet(kind, base + 2, volts * n).sealed(key) for kind, n in ((wire.COMMAND, 0), (wire.COMMAND, 2), (9, 1))]
    odd.append(Packet(wire.COMMAND, base + 2, volts, version=1).sealed(key))
    fresh = np.frombuffer(Packet(wire.COMMAND, base + 3, volts).sealed(key), np.uint8)
    for _ in range(20):
        spoilt = np.repeat(fresh[None], 100, axis=0)
        spoilt[np.arange(100), random.integers(len(fresh), size=100)] ^= random.integers(1, 256, 100, np.uint8)
        send(rig, *old, *again, *odd, *(packet.tobytes() for packet in spoilt))
        assert command(rig, 0.0) == OK
        assert not rig.link.samples_v.any()
    assert rig.link.status[links.TARGET_LOST] == 0


def test_bad_packets_get_no_answer(rig: UdpRig) -> None:
    rig.open()
    rig.arm()
    key = session_key(rig)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(("127.0.0.1", rig.target.port))
        stranger.settimeout(0.1)
        for packet in (b"RTHS", bytes(48), Packet(wire.REST, 99).sealed(bytes(16)), bytes(1400)):
            stranger.send(packet)
        with pytest.raises(TimeoutError):
            stranger.recv(300)
        stranger.settimeout(5.0)
        stranger.send(Packet(wire.REST, 99).sealed(key))
        answer = opened(stranger.recv(300), key)
    assert answer is not None and answer.state == wire.RESTING
