"""`rths serve` over the loopback: the offline table's samples, and rest whatever the runner does."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from portfolio import parametrize_first
from serving_bench import RATE_HZ, WATCHDOG_S, Running, offline_in_ticks, until, wave

from rths_cli.errors import InputError, RigError
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, open_rig
from rths_cli.laboratory.serve import ServedRig, describe, socket_address
from rths_cli.loop import udp_target
from rths_cli.loop.guard import RETURNING
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.session import make_secret, sealed
from rths_cli.rigs.udp.udp_rig import UdpRig

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
AT_REST_M = 5e-4  # friction may hold the table off its centre, a thirtieth of what it moved by


@pytest.fixture(scope="module")
def served() -> ServedRig:
    settings = (f"sample_rate_hz={RATE_HZ:g}", "table.sensors.noise_rms_m_s2=0.05")  # sixteen bits: it shows
    return describe("aps400_virtual", "three_storey", settings, 0)


@pytest.fixture(scope="module")
def key_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("key") / "key"
    make_secret(path)
    return path


@pytest.fixture
def running(served: ServedRig, key_file: Path) -> Iterator[Running]:
    made = Running(served, key_file)
    yield made
    made.session[udp_target.STATE] = packets.RESTED  # no test waits for a table that it has done with
    made.end()


def play(running: Running, rig: UdpRig, commands: Array, pause: tuple[int, float] = (-1, 0.0)) -> tuple[Array, Array]:
    """Return samples, (n + 1, c), and the ticks that passed before each step; `pause`: before which step, seconds."""
    samples, ticks = [rig.arm().copy()], []
    for k, command in enumerate(commands):
        if k == pause[0]:
            time.sleep(pause[1])
        samples.append(rig.exchange(command).copy())
        ticks.append(int(running.session[udp_target.LAST_TICK]))
    return np.array(samples), np.diff(ticks, prepend=0)


@pytest.mark.campaign
def test_a_session_has_the_samples_of_the_offline_table(running: Running) -> None:
    """Up to the first stall those of the offline run, then those of a table advanced by as many ticks as passed."""
    commands, rig = wave(160), running.rig()
    rig.open()
    samples, ticks = play(running, rig, commands)
    rig.rest()
    rig.close()
    assert rig.at_rest
    setup = running.served.setup
    step_v = setup.rig.converters.step_v
    offline = open_rig(setup, (EXP_RTHS,), 0)
    wanted = np.array([offline.arm().copy(), *[offline.exchange(command).copy() for command in commands]])
    stalls = np.flatnonzero(ticks[1:] != 4)
    steps = 2 + stalls[0] if stalls.size else len(wanted)
    assert np.abs(samples[:steps] - wanted[:steps]).max() <= 1.01 * step_v
    ticked = offline_in_ticks(running.served, commands, ticks)
    assert np.abs(samples - ticked).max() <= 2.01 * step_v  # converted before the noise is added, there
    assert np.abs(wanted).max() > 1000 * step_v
    until(lambda: len(running.server.ended) == 1)
    ended = running.server.ended[0]
    assert (ended.commands, ended.forged, ended.malformed, ended.replayed) == (160, 0, 0, 0)
    assert ended.ended_by == "the runner had the table rest" and ended.rate_hz == RATE_HZ
    assert any("160 commands" in text for text in running.said)


def test_a_stall_of_the_runner_is_felt(running: Running) -> None:
    """Half the watchdog's time without a command: the table goes on holding the last one."""
    commands, rig = wave(60), running.rig()
    rig.open()
    samples, ticks = play(running, rig, commands, (40, WATCHDOG_S / 2))
    rig.close()
    assert ticks[40] >= 4 * RATE_HZ * WATCHDOG_S / 2 - 1
    ticked = offline_in_ticks(running.served, commands, ticks)
    assert np.abs(samples - ticked).max() <= 2.01 * running.served.setup.rig.converters.step_v


def test_silence_makes_the_watchdog_rest_the_table_and_end_the_session(running: Running) -> None:
    rig = running.rig()
    rig.open()
    play(running, rig, wave(60))
    session, table = running.session, running.server.table
    last = int(session[udp_target.LAST_TICK])
    until(lambda: session[udp_target.STATE] == packets.RESTED)
    took_s = (session[udp_target.TICK] - last) / (4 * RATE_HZ)
    assert WATCHDOG_S < took_s < WATCHDOG_S + 2.0  # of the table's own time
    assert session[udp_target.FAULTS] == packets.WATCHDOG
    assert table.latched_v[0] == 0.0 and abs(table.state.state[0]) < AT_REST_M
    with pytest.raises(RigError, match="watchdog"):
        rig.exchange(1.0)
    assert running.counts[udp_target.OBEYED] == 60 and table.latched_v[0] == 0.0
    until(lambda: len(running.server.ended) == 1)
    assert "watchdog" in running.server.ended[0].ended_by
    rig.rest()
    rig.close()


@pytest.mark.campaign
def test_a_killed_runner_is_waited_out_and_a_new_one_begins_at_rest(running: Running) -> None:
    first, second = running.rig(), running.rig()
    first.open()
    play(running, first, wave(40))
    assert first.door is not None
    first.door.close()  # as a killed process leaves it
    with pytest.raises(RigError, match="another session"):
        second.open()
    until(lambda: running.session[udp_target.STATE] == packets.RESTED)
    second.open()
    samples, ticks = play(running, second, wave(30))
    ticked = offline_in_ticks(running.served, wave(30), ticks)
    assert np.abs(samples - ticked).max() <= 2.01 * running.served.setup.rig.converters.step_v
    second.close()
    assert [one.commands for one in running.server.ended] == [40]


@pytest.mark.campaign
@parametrize_first(2, "bad", [np.nan, np.inf, -np.inf, 10.001, -1e300])
def test_a_command_that_is_no_number_or_out_of_range_is_not_obeyed(running: Running, bad: float) -> None:
    rig = running.rig()
    rig.open()
    play(running, rig, wave(5))
    table = running.server.table
    before = int(running.counts[udp_target.OBEYED])
    links.converse_at(rig.link, packets.COMMAND, rig.next_step, float(bad), 0, 50_000_000)
    assert running.session[udp_target.STATE] in (packets.RESTING, packets.RESTED)
    assert running.session[udp_target.FAULTS] == packets.BAD_COMMAND
    assert running.counts[udp_target.OBEYED] == before and abs(table.latched_v[0]) < 0.2
    with pytest.raises(RigError, match="not a number or out of range"):
        rig.exchange(0.0)
    rig.close()


def test_forged_replayed_mutated_and_random_packets_move_nothing(running: Running) -> None:
    """10,000 packets, some made with the secret but not with the session's key, at an armed table."""
    rig, random = running.rig(), np.random.default_rng(1)
    rig.open()
    rig.arm()
    link = rig.link
    links.converse_at(link, packets.COMMAND, rig.next_step, 0.0, 0, 500_000_000)
    genuine = link.outgoing[: packets.LEAST_BYTES + 8].tobytes()
    secret_command = sealed(packets.COMMAND, struct.pack("<d", 5.0), running.server.door.greeter.secret, 1000)
    foreign = sealed(packets.COMMAND, struct.pack("<d", 5.0), random.integers(0, 2**63, 2).astype(np.uint64), 1000)
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stranger.connect((running.host, running.port))
    counts, sent = running.counts, 0
    bad = (udp_target.FORGED, udp_target.MALFORMED, udp_target.REPLAYED)
    for _ in range(200):
        for _ in range(46):
            stranger.send(mutated(genuine, random))
        for packet in (genuine, secret_command, foreign, random.bytes(int(random.integers(0, 1400)))):
            stranger.send(packet)
        sent += 50
        links.converse_at(link, packets.COMMAND, rig.next_step, 0.0, 0, 500_000_000)  # keeps the watchdog calm
        assert link.status[links.STATE] == packets.ARMED
    table = running.server.table
    assert counts[udp_target.OBEYED] == 201 and link.counts[links.ANSWERED] == 201
    assert sum(int(counts[i]) for i in bad) == sent
    assert counts[udp_target.FORGED] > 7_500 and counts[udp_target.REPLAYED] >= 200
    assert table.latched_v[0] == 0.0 and not table.state.state[: table.plant.mechanical].any()
    stranger.setblocking(False)
    with pytest.raises(BlockingIOError):
        stranger.recv(1)  # no stranger is ever answered
    stranger.close()
    rig.close()


def mutated(packet: bytes, random: np.random.Generator) -> bytes:
    """Return a packet with one to four bits flipped."""
    made = bytearray(packet)
    for bit in random.choice(8 * len(packet), int(random.integers(1, 5)), replace=False):
        made[bit // 8] ^= 1 << bit % 8
    return bytes(made)


def test_the_table_is_led_to_rest_when_it_ran_into_its_end_stop(running: Running) -> None:
    """A step to the end of the stroke overshoots into the stop."""
    rig = running.rig()
    rig.open()
    rig.arm()
    with pytest.raises(RigError, match="end stop"):
        for _ in range(40):
            rig.exchange(9.99)
    assert (
        running.session[udp_target.STATE] == packets.RESTING and running.session[udp_target.FAULTS] == packets.END_STOP
    )
    rig.close()


@pytest.mark.campaign
@pytest.mark.parametrize("silent", [False, True])
def test_the_way_to_rest_begins_as_the_table_may_move(running: Running, silent: bool) -> None:
    """After a step of 63 mm: braked from 1 m/s, the limit, when asked at once, from a halt when it has held it."""
    rig = running.rig()
    rig.open()
    rig.arm()
    rig.exchange(0.0)
    rig.exchange(8.0)
    if not silent:
        links.converse_at(rig.link, packets.REST, rig.next_step, 0.0, 0, 500_000_000)
    farthest, guard = 0.0, running.server.table.guard
    while guard.flags[0] < RETURNING or abs(guard.motion[0]) > 0.03:
        farthest = max(farthest, abs(guard.motion[0]))
        time.sleep(0.002)
    braking_m = 0.0 if silent else 0.5 * 1.0**2 / (0.45 * 45.0)
    assert farthest < 0.0079 * 8.0 + braking_m + 0.002
    rig.close()


def test_a_closed_session_obeys_no_more_commands_and_answers_until_another_is_armed(running: Running) -> None:
    rig = running.rig()
    rig.open()
    rig.arm()
    rig.exchange(0.0)
    link = rig.link
    assert (
        links.converse_at(link, packets.CLOSE, rig.next_step, 0.0, 0, 500_000_000) == links.FAULT
    )  # at rest, not armed
    until(lambda: len(running.server.ended) == 1)
    assert running.server.ended[0].ended_by == "the runner closed it"
    for kind in (packets.COMMAND, packets.ARM, packets.REST, packets.CLOSE):
        answered = int(link.counts[links.ANSWERED])
        assert links.converse_at(link, kind, rig.next_step, 1.0, 0, 500_000_000) == links.FAULT
        assert link.counts[links.ANSWERED] == answered + 1 and link.status[links.STATE] == packets.RESTED
    assert running.counts[udp_target.OBEYED] == 1 and running.server.table.latched_v[0] == 0.0
    other = running.rig()
    other.open()
    assert links.converse_at(link, packets.CLOSE, rig.next_step, 0.0, 0, 500_000_000) == links.FAULT
    other.arm()
    lost = int(link.counts[links.UNANSWERED])
    links.converse_at(link, packets.COMMAND, rig.next_step, 0.0, 0, 30_000_000)
    assert link.counts[links.UNANSWERED] == lost + 1 and running.counts[udp_target.FORGED] == 1
    other.close()


def test_doubled_and_reordered_commands_are_not_obeyed_and_gaps_are_counted(running: Running) -> None:
    rig = running.rig()
    rig.open()
    rig.arm()
    link = rig.link
    for k in (1, 2, 2, 1, 5, 4, 6):
        links.converse_at(link, packets.COMMAND, k, 0.1 * k, 0, 30_000_000)
    counts, table = running.counts, running.server.table
    assert (counts[udp_target.OBEYED], counts[udp_target.REPLAYED], counts[udp_target.LOST]) == (4, 3, 2)
    assert table.latched_v[0] == pytest.approx(0.6)
    assert link.status[links.TARGET_LOST] == 2
    rig.close()


def test_the_end_of_the_server_rests_the_table_first(served: ServedRig, key_file: Path) -> None:
    running = Running(served, key_file)
    rig = running.rig()
    rig.open()
    play(running, rig, wave(60))
    running.end()
    assert running.session[udp_target.STATE] == packets.RESTED and abs(running.server.table.state.state[0]) < AT_REST_M
    assert running.server.ended[0].commands == 60
    rig.close()


def test_another_key_and_another_number_of_channels_begin_no_session(
    running: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_secret(tmp_path / "other")
    rig = running.rig()
    rig.target = replace(rig.target, key_file=tmp_path / "other")
    with monkeypatch.context() as hurried, pytest.raises(RigError, match="did not answer"):
        hurried.setattr("rths_cli.rigs.udp.udp_rig.GREETING_S", 0.4)
        rig.open()
    info = replace(rig.info, channels=rig.info.channels[:2])
    with pytest.raises(RigError, match="3 channels"):
        UdpRig(info, running.rig().target).open()
    assert running.session[udp_target.STATE] == packets.IDLE


def test_it_serves_ipv6(served: ServedRig, key_file: Path) -> None:
    try:
        running = Running(served, key_file, "::1")
    except RigError:
        pytest.skip("this machine has no IPv6")
    rig = running.rig()
    try:
        rig.open()
        play(running, rig, np.zeros(5))
        rig.rest()
        rig.close()
        until(lambda: len(running.server.ended) == 1)
        assert running.server.ended[0].peer.startswith("[::1]:")
    finally:
        running.end()


def test_addresses_are_spelled_as_python_does() -> None:
    four = struct.pack("<H", socket.AF_INET) + struct.pack(">H", 5400) + bytes([192, 168, 1, 7]) + bytes(20)
    assert socket_address(np.frombuffer(four, np.uint8)) == ("192.168.1.7", 5400)
    six = struct.pack("<H", socket.AF_INET6) + struct.pack(">HI", 81, 0) + bytes(15) + b"\1" + struct.pack("<I", 3)
    assert socket_address(np.frombuffer(six, np.uint8)) == ("::1", 81, 0, 3)


def test_what_cannot_be_served_is_refused() -> None:
    with pytest.raises(InputError, match="nowhere"):
        describe("nowhere", "three_storey", (), 0)
    with pytest.raises(InputError, match="no_such"):
        describe("aps400_virtual", "no_such", (), 0)
    with pytest.raises(InputError, match="coulomb_n"):
        describe("aps400_virtual", "three_storey", ("table.physics.coulomb_n=-1",), 0)
