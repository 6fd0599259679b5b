"""How a session begins, fails to begin, and who may begin one."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from packets import Packet, opened, plain_siphash

from rths_cli.errors import RigError
from rths_cli.rigs.udp import wire
from rths_cli.rigs.udp.session import (
    Answer,
    Offer,
    Session,
    Terms,
    answer_hello,
    greet,
    judge,
    sealed,
    session_key,
)
from rths_cli.rigs.udp.sockets import bound, connected

SECRET = bytes(range(100, 116))
WORDS = np.frombuffer(SECRET, "<u8").astype(np.uint64)
WANTED = Terms(3, 1_000_000, 100_000_000)
OFFER = Offer(3, 250_000, 50_000_000)
Reply = Callable[[bytes], list[bytes]]


@pytest.fixture
def meet() -> Iterator[Callable[[Reply], tuple[socket.socket, str]]]:
    """Return a function that starts a target which answers each packet with a list of packets."""
    doors: list[socket.socket] = []
    threads = []

    def start(reply: Reply) -> tuple[socket.socket, str]:
        door = bound("127.0.0.1", 0)
        door.settimeout(5.0)
        link, peer = connected("127.0.0.1", door.getsockname()[1])[0]
        doors.extend([door, link])

        def serve() -> None:
            while True:
                try:
                    data, address = door.recvfrom(2048)
                except OSError:
                    return
                if not data:
                    return
                for packet in reply(data):
                    door.sendto(packet, address)

        threads.append(threading.Thread(target=serve, daemon=True))
        threads[-1].start()
        return link, peer

    yield start
    for link in doors[1::2]:
        link.send(b"")
    for thread in threads:
        thread.join()
    for door in doors:
        door.close()


def hello(nonce: bytes = b"n" * 16, terms: Terms = WANTED, version: int = 2, kind: int = wire.HELLO) -> bytes:
    content = nonce + struct.pack("<3q", terms.channels, terms.interval_ns, terms.watchdog_ns)
    return Packet(kind, 0, content, version=version).sealed(SECRET)


def test_both_sides_get_the_same_key_and_the_shorter_watchdog(
    meet: Callable[[Reply], tuple[socket.socket, str]],
) -> None:
    answers: list[Answer | None] = []

    def reply(data: bytes) -> list[bytes]:
        answers.append(answer_hello(data, WORDS, OFFER))
        return [answers[-1].packet] if answers[-1] else []

    session = greet(*meet(reply), WORDS, WANTED)
    assert answers[0] is not None
    other = answers[0].session
    assert other is not None
    assert session.terms == other.terms == Terms(3, 1_000_000, 50_000_000)
    assert np.array_equal(session.key, other.key)


def test_the_session_key_is_the_documented_hash() -> None:
    runner, target = b"r" * 16, b"t" * 16
    wanted = [plain_siphash(b"rths-key" + struct.pack("<Q", i) + runner + target, SECRET) for i in (0, 1)]
    assert session_key(WORDS, runner, target).astype("<u8").tobytes() == b"".join(wanted)
    keys = [session_key(WORDS, *pair) for pair in ((runner, target), (target, runner), (runner, runner))]
    assert len({key.tobytes() for key in keys}) == 3


def test_a_lost_welcome_is_sent_again_and_is_the_same(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    answers: list[Answer] = []

    def reply(data: bytes) -> list[bytes]:
        answer = answer_hello(data, WORDS, OFFER, answers[-1] if answers else None)
        assert answer is not None
        answers.append(answer)
        return [answer.packet] if len(answers) == 3 else []

    session = greet(*meet(reply), WORDS, WANTED)
    assert len(answers) == 3
    assert answers[0].session is not None
    assert np.array_equal(session.key, answers[0].session.key)


def test_two_sessions_never_share_a_key() -> None:
    first, second = (answer_hello(hello(), WORDS, OFFER) for _ in range(2))
    assert first is not None and second is not None
    assert isinstance(first.session, Session) and isinstance(second.session, Session)
    assert not np.array_equal(first.session.key, second.session.key)
    third = answer_hello(hello(b"m" * 16), WORDS, OFFER, second)
    assert third is not None and third.session is not None
    assert not np.array_equal(second.session.key, third.session.key)


@pytest.mark.parametrize(
    ("offer", "words"),
    [
        (replace(OFFER, busy=True), "another session has its table"),
        (replace(OFFER, channels=2), "it has 2 channels; name as many in the rig file"),
        (replace(OFFER, shortest_interval_ns=2_000_000), "shortest sample interval is 2000 us; lower sample_rate_hz"),
        (replace(OFFER, faults=wire.EMERGENCY_STOP | wire.SENSOR), "emergency stop is pressed, a sensor failed; put"),
        (replace(OFFER, faults=wire.TARGET_FAULT << 3), "its own fault code 0x80000"),
    ],
)
def test_a_refusal_says_why(meet: Callable[[Reply], tuple[socket.socket, str]], offer: Offer, words: str) -> None:
    def reply(data: bytes) -> list[bytes]:
        answer = answer_hello(data, WORDS, offer)
        assert answer is not None and answer.session is None
        return [answer.packet]

    link, peer = meet(reply)
    with pytest.raises(RigError, match=f"target 127.0.0.1:.* refuses the session: .*{words}"):
        greet(link, peer, WORDS, WANTED)


def test_another_version_is_told_on_both_sides(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    answer = answer_hello(hello(version=1), WORDS, OFFER)
    assert answer is not None and answer.session is None
    told = opened(answer.packet, SECRET)
    assert told is not None
    assert told.content == b"n" * 16 + struct.pack("<2q", wire.NO_VERSION, 2)

    def reply(data: bytes) -> list[bytes]:
        return [Packet(wire.REFUSAL, 0, data[40:56], version=7).sealed(SECRET)]

    link, peer = meet(reply)
    with pytest.raises(RigError, match="speaks version 7 of the protocol, this rths version 2; bring both"):
        greet(link, peer, WORDS, WANTED)


def test_replayed_and_forged_welcomes_are_passed_over(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    old = answer_hello(hello(b"o" * 16), WORDS, OFFER)
    assert old is not None
    keys = []

    def reply(data: bytes) -> list[bytes]:
        forged = answer_hello(hello(data[40:56]), WORDS, OFFER)
        real = answer_hello(data, WORDS, OFFER)
        assert real is not None and real.session is not None and forged is not None
        keys.append(real.session.key)
        return [old.packet, forged.packet[:-1] + b"x", data, b"", bytes(2000), real.packet]

    session = greet(*meet(reply), WORDS, WANTED)
    assert any(np.array_equal(session.key, key) for key in keys)


def test_answers_under_another_key_are_named(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    link, peer = meet(lambda data: [Packet(wire.WELCOME, 0, data[40:56] + bytes(40)).sealed(bytes(16))])
    with pytest.raises(RigError, match=r"sent \d+ answers made with another key; give both sides the same key file"):
        greet(link, peer, WORDS, WANTED, timeout_s=0.15)


def test_silence_and_a_closed_port_name_address_and_what_to_look_at(
    meet: Callable[[Reply], tuple[socket.socket, str]],
) -> None:
    link, peer = meet(lambda data: [])
    with pytest.raises(RigError, match=rf"target {peer} did not answer within 0.15 s: check that it runs, .*key file"):
        greet(link, peer, WORDS, WANTED, timeout_s=0.15)
    door = bound("127.0.0.1", 0)
    link, peer = connected("127.0.0.1", door.getsockname()[1])[0]
    door.close()
    with link, pytest.raises(RigError, match="did not answer"):
        greet(link, peer, WORDS, WANTED, timeout_s=0.15)


def test_a_target_answers_nothing_but_genuine_hellos() -> None:
    good = hello()
    bad = [
        b"",
        good[:-1],
        good + b"\0",
        good[:60] + b"\xff" + good[61:],
        Packet(wire.HELLO, 0, bytes(40)).sealed(bytes(16)),
        Packet(wire.HELLO, 0, bytes(32)).sealed(SECRET),
        *(hello(kind=kind) for kind in range(256) if kind != wire.HELLO),
    ]
    assert [data for data in bad if answer_hello(data, WORDS, OFFER) is not None] == []
    assert answer_hello(good, WORDS, OFFER) is not None


def test_terms_out_of_sense_are_refused_or_set_right() -> None:
    for interval in (0, -1, 249_999):
        answer = answer_hello(hello(terms=Terms(3, interval, 0)), WORDS, OFFER)
        assert answer is not None and answer.session is None
    for watchdog in (0, -5, 10**18):
        answer = answer_hello(hello(terms=Terms(3, 250_000, watchdog)), WORDS, OFFER)
        assert answer is not None and answer.session is not None
        assert answer.session.terms.watchdog_ns == 50_000_000


def test_packets_made_in_python_are_judged_in_python() -> None:
    data = sealed(wire.CLOSE, b"", WORDS, 5)
    assert data == Packet(wire.CLOSE, 5).sealed(SECRET)
    assert judge(data, WORDS) == wire.GENUINE
    assert judge(data, WORDS + np.uint64(1)) == wire.FORGED
    assert judge(data * 40, WORDS) == wire.MALFORMED
