"""A whole session of the UDP rig against a target in plain Python."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import udp_peer
from bench import rig_info, specimen
from udp_peer import PATIENT_S, SECRET, PlainTarget, virtual_table

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import InputError, RigError
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

MakeTarget = Callable[..., PlainTarget]


def echo(command_v: float | None) -> list[float]:
    """Return what a table without inertia gives: 1, 2 and 3 times the command that was held."""
    return [c * (command_v or 0.0) for c in (1.0, 2.0, 3.0)]


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    path = tmp_path / "key"
    path.write_text(SECRET.hex())
    path.chmod(0o600)
    return path


@pytest.fixture
def start() -> Iterator[MakeTarget]:
    targets: list[PlainTarget] = []

    def make(table: Callable[[float | None], list[float]] = echo, port: int = 0) -> PlainTarget:
        targets.append(PlainTarget(SECRET, table, port=port))
        return targets[-1]

    yield make
    for target in targets:
        if target.door.fileno() >= 0:
            target.kill()


def rig_to(target: PlainTarget, key_file: Path, info: RigInfo | None = None, timeout_s: float = PATIENT_S) -> UdpRig:
    return UdpRig(info or rig_info(dt_s=1e-3), UdpTarget("127.0.0.1", target.port, key_file, timeout_s))


def play(rig: UdpRig, command_v: Array) -> Array:
    rig.open()
    samples = [rig.arm().copy()]
    samples += [rig.exchange(float(command)).copy() for command in command_v]
    rig.rest()
    assert rig.at_rest
    rig.close()
    rig.close()
    return np.array(samples)


def test_a_session_obeys_every_command_in_order_one_interval_each(start: MakeTarget, key_file: Path) -> None:
    target = start()
    command = np.array([1.0, -2.0, 3.5, 0.25])
    samples = play(rig_to(target, key_file), command)
    assert [volts for _, volts in target.obeyed] == command.tolist()
    sequences = [sequence for sequence, _ in target.obeyed]
    assert sequences == sorted(set(sequences)) and sequences[0] >= 1
    assert target.lost == sequences[-1] - 4  # the instants at which this machine came too late to send
    assert samples.tolist() == [echo(None), echo(None), echo(1.0), echo(-2.0), echo(3.5)]  # latency of one sample
    assert target.rests == 4  # three times REST, until the table rested, then CLOSE
    assert [packet.kind for packet in target.received[-4:]] == [packets.REST] * 3 + [packets.CLOSE]


def test_commands_leave_at_their_instants_and_never_before(start: MakeTarget, key_file: Path) -> None:
    target, info = start(), rig_info(dt_s=2e-3)
    play(rig_to(target, key_file, info), np.zeros(40))
    sent = np.array([packet.sent_ns for packet in target.received if packet.kind == packets.COMMAND])
    assert np.all(sent[1:] > sent[:-1])
    assert sent[-1] - sent[0] > 39 * 1.9e6


@pytest.mark.parametrize("latency", [1, 2, 4])
def test_over_the_wire_the_virtual_table_gives_the_same_samples(
    start: MakeTarget, key_file: Path, latency: int
) -> None:
    info = rig_info(dt_s=5e-4, latency_samples=latency)
    command = 3.0 * np.sin(0.05 * np.arange(150))
    direct = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), (7,))
    wanted = [direct.arm().copy(), *(direct.exchange(float(volts)).copy() for volts in command)]
    samples = play(rig_to(start(virtual_table(info, (7,))), key_file, info), command)
    assert np.array_equal(samples, wanted)
    assert np.ptp(samples[:, 0]) > 0.05


def test_a_watchdog_that_bites_before_the_losses_borne_is_refused(start: MakeTarget, key_file: Path) -> None:
    rig = rig_to(start(), key_file)
    rig.target = replace(rig.target, watchdog_s=0.006)
    with pytest.raises(
        RigError, match=r"waits 0\.006 s, it must wait more than 0\.006 s \(lost_samples of the rig file"
    ):
        rig.open()
    rig.target = replace(rig.target, watchdog_s=0.007)
    rig.open()
    rig.close()


def test_lost_answers_keep_samples_and_too_many_in_a_row_are_a_fault(start: MakeTarget, key_file: Path) -> None:
    target = start()
    rig = rig_to(target, key_file, timeout_s=0.08)
    rig.open()
    rig.arm()
    target.spoil = lambda _, sent: [] if len(target.obeyed) in (3, 4, 5, 6, 7) or len(target.obeyed) > 8 else [sent]
    for k in range(1, 9):
        samples = rig.exchange(float(k)).copy()
        if 3 <= k <= 7:
            assert samples.tolist() == echo(1.0)
    for k in range(9, 14):
        rig.exchange(float(k))
    with pytest.raises(
        RigError,
        match=r"6 answers of target 127\.0\.0\.1:\d+ in a row were lost, limits\.lost_samples is 5 .*check the target",
    ):
        rig.exchange(14.0)
    assert len(target.obeyed) == 14  # answers were lost, not commands
    rig.close()


def test_a_target_that_says_why_it_stopped_is_quoted(start: MakeTarget, key_file: Path) -> None:
    target = start()
    rig = rig_to(target, key_file)
    rig.open()
    rig.arm()
    rig.exchange(1.0)
    target.faults = packets.END_STOP | packets.ACTUATOR
    with pytest.raises(RigError, match="stopped: the table is at its end stop, the actuator or its amplifier failed"):
        rig.exchange(1.0)
    target.faults, target.state = 0, udp_peer.RESTING
    with pytest.raises(RigError, match="stopped: it has left the test and leads its table to rest"):
        rig.exchange(1.0)
    rig.close()


def test_a_target_that_cannot_be_armed_says_so(start: MakeTarget, key_file: Path) -> None:
    target = start()
    rig = rig_to(target, key_file)
    rig.open()
    target.faults = packets.EMERGENCY_STOP
    with pytest.raises(RigError, match="does not arm: the emergency stop is pressed"):
        rig.arm()
    rig.close()


def test_steps_count_from_the_last_arm_when_an_answer_to_arm_was_lost(start: MakeTarget, key_file: Path) -> None:
    target = start()
    target.spoil = lambda sequence, sent: [] if sequence < 2 else [sent]
    rig = rig_to(target, key_file)
    rig.open()
    rig.arm()
    assert rig.link.status[links.BASE] == rig.link.status[links.LAST] >= 2
    rig.exchange(1.0)
    step = rig.next_step - 1  # 1, or more where a busy machine was late by whole intervals
    assert step >= 1 and [packet.sequence for packet in target.received][-1] == rig.link.status[links.BASE] + step
    assert rig.counts["sent"] == 1
    rig.close()


def test_rest_and_close_with_a_dead_peer_end_and_say_so(start: MakeTarget, key_file: Path) -> None:
    target = start()
    rig = rig_to(target, key_file, timeout_s=0.01)
    rig.open()
    rig.arm()
    rig.exchange(1.0)
    target.kill()
    rig.exchange(2.0)
    rig.rest()
    assert not rig.at_rest
    assert rig.counts["unreachable"] > 0
    assert rig.counts["sent"] < 100  # it was asked every 20 ms, and not for 6 s
    rig.close()
    rig.close()
    assert not rig.at_rest


def test_rest_is_safe_before_open_after_close_and_twice(start: MakeTarget, key_file: Path) -> None:
    target = start()
    rig = rig_to(target, key_file)
    rig.rest()
    rig.close()
    rig.open()
    rig.rest()
    assert target.rests == 0
    rig.arm()
    rig.rest()
    rig.rest()
    assert target.rests == 3
    rig.close()
    rig.rest()


def test_a_restarted_target_does_not_know_the_session_and_a_new_one_is_made(start: MakeTarget, key_file: Path) -> None:
    target = start()
    rig = rig_to(target, key_file, timeout_s=0.01)
    rig.open()
    rig.arm()
    rig.exchange(1.0)
    target.kill()
    again = start(port=target.port)
    with pytest.raises(RigError, match="in a row were lost"):
        for _ in range(10):
            rig.exchange(1.0)
    assert again.received == []
    assert play(rig, np.ones(3)).shape == (4, 3)
    assert len(again.obeyed) == 3


def test_a_runner_that_comes_late_sends_at_once_and_counts_it(start: MakeTarget, key_file: Path) -> None:
    target = start()
    rig = rig_to(target, key_file, rig_info(dt_s=1e-4))  # plain Python cannot answer within 0.1 ms
    samples = play(rig, np.ones(30))
    assert rig.overruns > 0
    assert samples[-1].tolist() == echo(1.0)
    assert len(target.obeyed) == 30


@pytest.mark.parametrize("command", [np.nan, np.inf])
def test_what_is_no_number_is_not_sent(start: MakeTarget, key_file: Path, command: float) -> None:
    target = start()
    rig = rig_to(target, key_file)
    rig.open()
    rig.arm()
    with pytest.raises(RigError, match="the command is not a number; it was not sent"):
        rig.exchange(command)
    assert target.obeyed == []
    rig.close()


def test_what_is_asked_of_a_closed_link_or_in_vain_is_a_sentence(key_file: Path, tmp_path: Path) -> None:
    rig = UdpRig(rig_info(), UdpTarget("127.0.0.1", 9, key_file))
    for ask in (rig.arm, lambda: rig.exchange(0.0)):
        with pytest.raises(RigError, match=r"rig bench: the link to 127\.0\.0\.1:9 is not open"):
            ask()
    with pytest.raises(RigError, match="latency_samples must be at least 1 over UDP, got 0"):
        UdpRig(rig_info(latency_samples=0), UdpTarget("127.0.0.1", 9))
    with pytest.raises(InputError, match="cannot be read"):
        UdpRig(rig_info(), UdpTarget("127.0.0.1", 9, tmp_path / "none")).open()


def test_a_host_of_two_addresses_is_tried_at_both(
    start: MakeTarget, key_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import socket

    target = start()
    found = [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", (host, target.port)) for host in ("127.0.0.9", "127.0.0.1")]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    monkeypatch.setattr("rths_cli.rigs.udp.udp_rig.GREETING_S", 1.0)
    rig = UdpRig(rig_info(), UdpTarget("shaker", target.port, key_file))
    rig.open()
    assert rig.peer == f"127.0.0.1:{target.port}"
    rig.close()


def test_a_session_that_the_watchdog_ended_before_its_answer_came_is_begun_once_more(
    start: MakeTarget, key_file: Path
) -> None:
    """The first ARM's answer is lost, and the runner was held up before its second one."""
    target = start()
    rig = rig_to(target, key_file)
    rig.open()

    def spoil(sequence: int, sent: bytes) -> list[bytes]:
        if target.armed > 1:
            return [sent]
        target.state, target.faults = udp_peer.RESTED, packets.WATCHDOG
        return [] if sequence == 0 else [sent]

    target.spoil = spoil
    rig.arm()
    assert target.armed == 2 and target.state == udp_peer.ARMED
    rig.close()


def test_a_session_that_began_although_no_answer_came_is_waited_for(
    start: MakeTarget, key_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All answers to ARM are lost; the target's watchdog bites while the runner greets it again."""
    monkeypatch.setattr("rths_cli.rigs.udp.udp_rig.ARMING_TRIES", 3)
    target = start()
    rig = rig_to(target, key_file)
    rig.open()
    refusals: list[bytes] = []
    target.spoil = lambda _, sent: [sent] if target.armed > 1 else []
    welcome = target.welcome

    def answer(hello: udp_peer.Packet) -> bytes:
        target.state = udp_peer.RESTED if len(refusals) == 3 else target.state
        refusals.append(welcome(hello))
        return refusals[-1]

    target.welcome = answer  # type: ignore[method-assign]
    rig.arm()
    assert [data[packets.KIND] for data in refusals] == [packets.REFUSAL] * 3 + [packets.WELCOME]
    assert target.armed == 2 and rig.exchange(1.0).size == 3
    rig.close()
