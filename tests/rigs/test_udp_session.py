"""How a session begins, fails to begin, and who may begin one."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from packets import Packet, opened, plain_siphash

from rths_cli.errors import RigError
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.handshake import PERIOD_NS, Greeter, answer_hello_at, open_greeter, opens_session_at
from rths_cli.rigs.udp.session import Session, Terms, bound, connected, greet, judge, sealed, session_key

SECRET = bytes(range(100, 116))
WORDS = np.frombuffer(SECRET, "<u8").astype(np.uint64)
WANTED = Terms(3, 1_000_000, 100_000_000)
NOW = 7 * PERIOD_NS + PERIOD_NS // 2
Reply = Callable[[bytes], list[bytes]]


class Target:
    """A target's side of the handshake: what it answers to a HELLO, and which ARM begins a session."""

    def __init__(self, channels: int = 3, busy: bool = False, faults: int = 0) -> None:
        self.greeter: Greeter = open_greeter(WORDS, channels, 250_000, 50_000_000)
        self.busy, self.faults = busy, faults
        self.answer(b"")  # compiled before anyone waits for an answer

    def answer(self, data: bytes, now: int = NOW) -> bytes | None:
        """Return the answer to a packet, None for none."""
        packet, out = buffer(data), np.zeros(packets.MOST_BYTES, np.uint8)
        before = self.greeter.armed[0], self.greeter.offer.copy(), self.greeter.boot.copy()
        size = answer_hello_at(self.greeter, packet, len(data), now, self.faults, self.busy, out)
        assert before[0] == self.greeter.armed[0]  # no HELLO changes anything
        assert np.array_equal(before[1], self.greeter.offer) and np.array_equal(before[2], self.greeter.boot)
        return out[:size].tobytes() if size else None

    def begins(self, data: bytes, now: int = NOW) -> bool:
        """Tell whether a packet begins a session."""
        scratch = np.zeros(packets.MOST_BYTES, np.uint8)
        return bool(opens_session_at(self.greeter, buffer(data), len(data), now, scratch))

    def key(self) -> bytes:
        """Return the key of the session that began last."""
        return self.greeter.key.astype("<u8").tobytes()


def buffer(data: bytes) -> np.ndarray:
    packet = np.zeros(packets.MOST_BYTES, np.uint8)
    packet[: len(data)] = np.frombuffer(data[: packets.MOST_BYTES], np.uint8)
    return packet


def key_of(welcome: bytes) -> bytes:
    """Return the session key that a WELCOME gives, by the page's words."""
    said = opened(welcome, SECRET)
    assert said is not None and said.kind == packets.WELCOME
    label = (b"rths-key" + struct.pack("<Q", i) for i in (0, 1))
    return b"".join(plain_siphash(head + said.content[:32], SECRET) for head in label)


def arm_of(welcome: bytes, sequence: int = 0, terms: bytes | None = None) -> bytes:
    """Return the ARM of a runner that was welcomed."""
    said = opened(welcome, SECRET)
    assert said is not None
    return Packet(packets.ARM, sequence, said.content[:16] + (terms or said.content[32:])).sealed(key_of(welcome))


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


def hello(nonce: bytes = b"n" * 16, terms: Terms = WANTED, version: int = 3, kind: int = packets.HELLO) -> bytes:
    content = nonce + struct.pack("<3q", terms.channels, terms.interval_ns, terms.watchdog_ns) + bytes(16)
    return Packet(kind, 0, content, version=version).sealed(SECRET)


def welcomed(target: Target, nonce: bytes = b"n" * 16, now: int = NOW) -> bytes:
    answer = target.answer(hello(nonce), now)
    assert answer is not None and answer[packets.KIND] == packets.WELCOME
    return answer


def test_both_sides_get_the_same_key_and_the_shorter_watchdog(
    meet: Callable[[Reply], tuple[socket.socket, str]],
) -> None:
    target = Target()
    session = greet(*meet(lambda data: [target.answer(data) or b""]), WORDS, WANTED)
    assert session.terms == Terms(3, 1_000_000, 50_000_000)
    arm = sealed(packets.ARM, session.arming, session.key)
    assert target.begins(arm)
    assert target.key() == session.key.astype("<u8").tobytes()


def test_the_session_key_is_the_documented_hash() -> None:
    runner, target = b"r" * 16, b"t" * 16
    wanted = [plain_siphash(b"rths-key" + struct.pack("<Q", i) + runner + target, SECRET) for i in (0, 1)]
    assert session_key(WORDS, runner, target).astype("<u8").tobytes() == b"".join(wanted)
    keys = [session_key(WORDS, *pair) for pair in ((runner, target), (target, runner), (runner, runner))]
    assert len({key.tobytes() for key in keys}) == 3


def test_a_lost_welcome_is_sent_again_and_is_the_same(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    target, answers = Target(), list[bytes]()

    def reply(data: bytes) -> list[bytes]:
        answers.append(target.answer(data) or b"")
        return [answers[-1]] if len(answers) == 3 else []

    session = greet(*meet(reply), WORDS, WANTED)
    assert len(answers) == 3 and len(set(answers)) == 1
    assert target.begins(sealed(packets.ARM, session.arming, session.key))


def test_two_sessions_never_share_a_key() -> None:
    """Not of two nonces, of two targets or starts, of two periods, nor before and after a session was armed."""
    target = Target()
    answers = [welcomed(target), welcomed(target, b"m" * 16), welcomed(Target()), welcomed(target, now=NOW + PERIOD_NS)]
    assert target.begins(arm_of(answers[0]))
    answers.append(welcomed(target))
    assert len({key_of(answer) for answer in answers}) == len(answers)
    assert len({answer[56:64] for answer in answers} | {answer[64:72] for answer in answers}) == 2 * len(answers)


def test_an_arm_begins_one_session_and_never_another() -> None:
    """Each of three runners was welcomed; the first ARM that comes makes the others and itself worthless."""
    target = Target()
    arms = [arm_of(welcomed(target, nonce)) for nonce in (b"a" * 16, b"b" * 16, b"c" * 16)]
    again = [arm_of(welcomed(target, nonce), sequence=1) for nonce in (b"a" * 16, b"b" * 16)]
    assert target.begins(arms[1])
    assert not any(target.begins(arm) for arm in (*arms, *again))
    assert target.greeter.armed[0] == 1
    assert target.begins(arm_of(welcomed(target, b"a" * 16), sequence=3))
    assert not any(target.begins(arm) for arm in (*arms, *again))


def test_an_arm_of_before_the_target_s_start_begins_no_session() -> None:
    arm = arm_of(welcomed(Target()))
    assert not Target().begins(arm)


@pytest.mark.parametrize(
    ("later", "taken"), [(0, True), (PERIOD_NS, True), (2 * PERIOD_NS, False), (-PERIOD_NS, False)]
)
def test_an_arm_is_worth_something_in_the_period_of_its_welcome_and_the_next(later: int, taken: bool) -> None:
    target = Target()
    arm = arm_of(welcomed(target))
    assert target.begins(arm, NOW + later) == taken


@pytest.mark.parametrize("terms", [(2, 1_000_000, 50_000_000), (3, 249_999, 50_000_000), (3, 1_000_000, 50_000_001),
                                   (3, 1_000_000, 0), (3, 1_000_000, -5), (3, -1, 50_000_000)])  # fmt: skip
def test_an_arm_of_terms_that_no_welcome_grants_begins_no_session(terms: tuple[int, int, int]) -> None:
    target = Target()
    assert not target.begins(arm_of(welcomed(target), terms=struct.pack("<3q", *terms)))
    assert target.begins(arm_of(welcomed(target)))


def test_nothing_but_an_arm_begins_a_session() -> None:
    target = Target()
    welcome = welcomed(target)
    arm, key = arm_of(welcome), key_of(welcome)
    content = arm[40:80]
    bad = [
        *(Packet(kind, 0, content).sealed(key) for kind in range(256) if kind != packets.ARM),
        *(Packet(packets.ARM, 0, content[: 8 * n]).sealed(key) for n in range(5)),
        Packet(packets.ARM, 0, content + bytes(8)).sealed(key),
        Packet(packets.ARM, 0, content, version=2).sealed(key),
        Packet(packets.ARM, 0, content).sealed(SECRET),
        Packet(packets.ARM, 0, bytes(16) + content[16:]).sealed(key),
        arm[:-1],
        arm + b"\0",
        *(arm[:at] + bytes([arm[at] ^ 1]) + arm[at + 1 :] for at in range(len(arm))),
    ]
    assert not any(target.begins(data) for data in bad)
    assert target.begins(arm)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (Target(busy=True), "another session has its table"),
        (Target(channels=2), "it has 2 channels; name as many in the rig file"),
        (Target(faults=packets.EMERGENCY_STOP | packets.SENSOR), "emergency stop is pressed, a sensor failed; put"),
        (Target(faults=packets.TARGET_FAULT << 3), "its own fault code 0x80000"),
    ],
)
def test_a_refusal_says_why(meet: Callable[[Reply], tuple[socket.socket, str]], target: Target, words: str) -> None:
    link, peer = meet(lambda data: [target.answer(data) or b""])
    with pytest.raises(RigError, match=f"target 127.0.0.1:.* refuses the session: .*{words}"):
        greet(link, peer, WORDS, WANTED)


def test_too_short_an_interval_is_refused(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    link, peer = meet(lambda data: [Target().answer(data) or b""])
    with pytest.raises(RigError, match="shortest sample interval is 250 us; lower sample_rate_hz"):
        greet(link, peer, WORDS, Terms(3, 249_999, 0))


def version_2(nonce: bytes = b"n" * 16) -> bytes:
    """Return the HELLO of a runner of version 2."""
    return Packet(packets.HELLO, 0, nonce + struct.pack("<3q", 3, 10**6, 10**8), version=2).sealed(SECRET)


def test_a_runner_of_version_2_is_answered_by_a_refusal_that_it_understands() -> None:
    """It asks for its nonce and a genuine tag, and names the version in the head of what it gets."""
    answer = Target().answer(version_2())
    assert answer is not None and answer[packets.VERSION] == 3 and len(answer) == 80 <= len(version_2())
    told = opened(answer, SECRET)
    assert told is not None and told.kind == packets.REFUSAL
    assert told.content == b"n" * 16 + struct.pack("<2q", packets.NO_VERSION, 3)


def test_a_target_of_version_2_is_refused_in_one_sentence(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    """Version 2 answered a HELLO of another version by its own REFUSAL (its examples/udp_target.c)."""

    def reply(data: bytes) -> list[bytes]:
        words = data[40:56] + struct.pack("<2Q", packets.NO_VERSION, 2)
        return [Packet(packets.REFUSAL, 0, words, version=2).sealed(SECRET)]

    link, peer = meet(reply)
    with pytest.raises(RigError, match="speaks version 2 of the protocol, this rths version 3; bring both") as raised:
        greet(link, peer, WORDS, WANTED)
    assert "\n" not in str(raised.value)


def test_replayed_and_forged_welcomes_are_passed_over(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    target = Target()
    old = welcomed(target, b"o" * 16)

    def reply(data: bytes) -> list[bytes]:
        real = target.answer(data)
        assert real is not None
        return [old, real[:-1] + bytes([real[-1] ^ 1]), data, b"", bytes(2000), real]

    session = greet(*meet(reply), WORDS, WANTED)
    assert isinstance(session, Session) and target.begins(sealed(packets.ARM, session.arming, session.key))


def test_answers_under_another_key_are_named(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    link, peer = meet(lambda data: [Packet(packets.WELCOME, 0, data[40:56] + bytes(40)).sealed(bytes(16))])
    with pytest.raises(RigError, match=r"sent \d+ answers made with another key; give both sides the same key file"):
        greet(link, peer, WORDS, WANTED, timeout_s=0.15)


def test_replayed_welcomes_are_not_taken_for_another_key(meet: Callable[[Reply], tuple[socket.socket, str]]) -> None:
    old = welcomed(Target(), b"o" * 16)
    link, peer = meet(lambda data: [old] * 3)
    with pytest.raises(RigError, match=r"did not answer within 0\.15 s"):
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


def test_a_target_answers_nothing_but_genuine_hellos_and_nothing_longer() -> None:
    good, target = hello(), Target()
    bad = [
        b"",
        good[:-1],
        good + b"\0",
        good[:60] + b"\xff" + good[61:],
        Packet(packets.HELLO, 0, bytes(56)).sealed(bytes(16)),
        *(Packet(packets.HELLO, 0, bytes(8 * n)).sealed(SECRET) for n in range(17) if n != 7),
        *(Packet(packets.HELLO, 0, bytes(8 * n), version=2).sealed(SECRET) for n in range(2)),
        *(hello(kind=kind) for kind in range(256) if kind != packets.HELLO),
    ]
    assert [data for data in bad if target.answer(data) is not None] == []
    for asked in (good, hello(version=9), hello(terms=Terms(9, 0, 0))):
        answer = target.answer(asked)
        assert answer is not None and len(answer) <= len(asked)


def test_terms_out_of_sense_are_refused_or_set_right() -> None:
    for interval in (0, -1, 249_999):
        answer = Target().answer(hello(terms=Terms(3, interval, 0)))
        assert answer is not None and answer[packets.KIND] == packets.REFUSAL
    for watchdog in (0, -5, 10**18, 50_000_001):
        answer = Target().answer(hello(terms=Terms(3, 250_000, watchdog)))
        assert answer is not None and struct.unpack("<3q", answer[72:96]) == (3, 250_000, 50_000_000)


def test_packets_made_in_python_are_judged_in_python() -> None:
    data = sealed(packets.CLOSE, b"", WORDS, 5)
    assert data == Packet(packets.CLOSE, 5).sealed(SECRET)
    assert judge(data, WORDS) == packets.GENUINE
    assert judge(data, WORDS + np.uint64(1)) == packets.FORGED
    assert judge(data * 40, WORDS) == packets.MALFORMED
