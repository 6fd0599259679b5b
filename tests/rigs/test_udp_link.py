"""One exchange in compiled code: which packet is an answer, and what becomes of all others."""

from __future__ import annotations

import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from packets import Packet, opened

from rths_cli.numerics.compiled import entry
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets as wire
from rths_cli.rigs.udp.link import FAULT, LOST, OK, Link, converse_at, fresh_link
from rths_cli.rigs.udp.session import bound, connected

KEY = bytes(range(40, 56))
FOR_EVER_NS = 1 << 62
WORDS = np.frombuffer(KEY, "<u8").astype(np.uint64)
ANSWER_NS = 2_000_000_000  # more than any preloaded answer needs
SHORT_NS = 3_000_000


@entry
def exchange_for_ever(link: Link, command_v: float, k: int) -> int:
    """Exchange as a compiled loop does, with a deadline that never comes."""
    return links.exchange(link, command_v, k, FOR_EVER_NS)


def answer(sequence: int, *volts: float, key: bytes = KEY, state: int = wire.ARMED, faults: int = 0) -> bytes:
    content = np.array(volts or (0.5, -1.5, 2.5)).astype("<f8").tobytes()
    return Packet(wire.SAMPLES, sequence, content, state, faults, 4, 1234, 5678).sealed(key)


@dataclass
class Ends:
    """A link and the target's socket; what the target sends before an exchange is there when it looks."""

    link: Link
    target: socket.socket
    runner: socket.socket

    def send(self, *packets: bytes) -> None:
        for packet in packets:
            self.target.sendto(packet, self.runner.getsockname())

    def exchange(self, k: int, *packets: bytes, volts: float = 1.25, timeout_ns: int = ANSWER_NS) -> int:
        self.send(*packets)
        return int(converse_at(self.link, wire.COMMAND, k, volts, 0, timeout_ns))

    def received(self) -> Packet:
        packet = opened(self.target.recv(300), KEY)
        assert packet is not None
        return packet

    def counted(self) -> dict[str, int]:
        """Return what was counted, without zeros."""
        return {name: int(n) for name, n in zip(links.COUNTS, self.link.counts, strict=True) if n}


@pytest.fixture
def ends() -> Iterator[Ends]:
    target = bound("127.0.0.1", 0)
    runner, _ = connected("127.0.0.1", target.getsockname()[1])[0]
    target.settimeout(2.0)
    link = fresh_link(runner, WORDS, 3)
    link.status[links.STATE] = wire.ARMED
    yield Ends(link, target, runner)
    target.close()
    runner.close()


def test_a_command_leaves_as_documented_and_its_answer_is_taken(ends: Ends) -> None:
    ends.link.status[links.BASE] = 100
    before = time.monotonic_ns()
    assert ends.exchange(7, answer(107, 1.0, -2.0, 3.0)) == OK
    sent = ends.received()
    assert sent == Packet(wire.COMMAND, 107, struct.pack("<d", 1.25), sent_ns=sent.sent_ns)
    assert before < sent.sent_ns < time.monotonic_ns()
    assert ends.link.samples_v.tolist() == [1.0, -2.0, 3.0]
    status = ends.link.status
    told = [status[i] for i in (links.STATE, links.FAULTS, links.TARGET_LOST, links.SAMPLED_NS, links.ANSWERED_NS)]
    assert told == [wire.ARMED, 0, 4, 5678, 1234]
    assert sent.sent_ns == status[links.SENT_NS] < status[links.RECEIVED_NS] < time.monotonic_ns()
    assert ends.counted() == {"sent": 1, "answered": 1}


@pytest.mark.parametrize("kind", [wire.REST, wire.CLOSE])
def test_other_kinds_carry_no_words(ends: Ends, kind: int) -> None:
    ends.send(answer(3))
    assert converse_at(ends.link, kind, 3, 9.9, 0, ANSWER_NS) == OK
    sent = ends.received()
    assert (sent.kind, sent.sequence, sent.content) == (kind, 3, b"")


def test_arm_carries_the_words_of_its_session(ends: Ends) -> None:
    """And nothing of an earlier session stays: sequence, state, counts."""
    ends.exchange(7, answer(7, faults=wire.SENSOR))
    ends.received()
    words, key = bytes(range(40)), bytes(range(60, 76))
    links.begin_session(ends.link, np.frombuffer(key, "<u8").astype(np.uint64), words)
    assert not ends.counted() and ends.link.status.tolist() == [0, -1, -1, *[0] * 7]
    ends.send(answer(0, key=key))
    assert converse_at(ends.link, wire.ARM, 0, 9.9, 0, ANSWER_NS) == OK
    sent = opened(ends.target.recv(300), key)
    assert sent is not None and (sent.kind, sent.sequence, sent.content) == (wire.ARM, 0, words)


def test_a_lost_answer_keeps_the_last_samples_and_is_counted_until_one_comes(ends: Ends) -> None:
    assert ends.exchange(1, answer(1, 1.0, 2.0, 3.0)) == OK
    before = time.monotonic_ns()
    assert [ends.exchange(k, timeout_ns=SHORT_NS) for k in (2, 3)] == [LOST, LOST]
    assert time.monotonic_ns() - before >= 2 * SHORT_NS
    assert ends.link.samples_v.tolist() == [1.0, 2.0, 3.0]
    assert ends.counted() == {"sent": 3, "answered": 1, "lost": 2, "lost_in_a_row": 2}
    assert ends.exchange(4, answer(4)) == OK
    assert ends.counted() == {"sent": 4, "answered": 2, "lost": 2}


def test_late_doubled_and_reordered_answers_give_no_samples(ends: Ends) -> None:
    assert ends.exchange(1, answer(1, 1.0, 1.0, 1.0)) == OK
    assert ends.exchange(5, answer(3, 9.0, 9.0, 9.0), timeout_ns=SHORT_NS) == LOST
    assert ends.link.samples_v.tolist() == [1.0, 1.0, 1.0]
    packets = [answer(1, 9.0, 9.0, 9.0), answer(4, 8.0, 8.0, 8.0), answer(2, 7.0, 7.0, 7.0), answer(6, 6.0, 6.0, 6.0)]
    assert ends.exchange(6, *packets, answer(6, 5.0, 5.0, 5.0)) == OK
    assert ends.link.samples_v.tolist() == [6.0, 6.0, 6.0]
    assert ends.counted() == {"sent": 3, "answered": 2, "lost": 1, "late": 2, "doubled": 2}
    assert ends.exchange(7, answer(7)) == OK
    assert ends.counted()["doubled"] == 3


def test_packets_of_strangers_are_counted_and_never_taken(ends: Ends) -> None:
    good = answer(2, 9.0, 9.0, 9.0)
    bad = [
        b"",
        b"RTHS",
        good[:-1],
        good + b"\0",
        good * 20,
        good[:44] + bytes([good[44] ^ 1]) + good[45:],
        answer(2, 9.0, 9.0, 9.0, key=bytes(16)),
        replace(opened(good, KEY) or Packet(0, 0), version=1).sealed(KEY),
    ]
    stray = [
        answer(3, 9.0, 9.0, 9.0),
        answer(-3, 9.0, 9.0, 9.0),
        answer(2, 9.0, 9.0),
        answer(2, 9.0, 9.0, 9.0, 9.0),
        Packet(wire.COMMAND, 2, struct.pack("<d", 1.25)).sealed(KEY),
        replace(opened(good, KEY) or Packet(0, 0), kind=wire.WELCOME).sealed(KEY),
    ]
    assert ends.exchange(2, *bad, *stray, timeout_ns=300_000_000) == LOST
    assert not ends.link.samples_v.any()
    assert ends.link.status[links.SEEN] == -1
    assert ends.counted() == {"sent": 1, "lost": 1, "lost_in_a_row": 1, "bad": len(bad), "stray": len(stray)}
    assert ends.exchange(3, answer(3, 1.0, 2.0, 3.0)) == OK


def test_a_packet_that_goes_on_beyond_the_memory_is_not_taken_for_its_beginning(ends: Ends) -> None:
    wide = ends.link._replace(samples_v=np.zeros(wire.MOST_WORDS))
    whole = answer(1, *range(wire.MOST_WORDS))
    assert len(whole) == wire.MOST_BYTES
    ends.send(whole + b"x")
    assert converse_at(wide, wire.COMMAND, 1, 0.0, 0, SHORT_NS) == LOST
    assert ends.counted()["bad"] == 1
    ends.send(whole)
    assert converse_at(wide, wire.COMMAND, 1, 0.0, 0, ANSWER_NS) == OK
    assert wide.samples_v.tolist() == list(range(wire.MOST_WORDS))


@pytest.mark.parametrize(
    ("state", "faults"), [(wire.ARMED, wire.SENSOR), (wire.ARMED, 1 << 31), (wire.RESTING, 0), (wire.RESTED, 0)]
)
def test_a_fault_or_a_table_that_rests_is_reported_with_its_samples(ends: Ends, state: int, faults: int) -> None:
    assert ends.exchange(1, answer(1, 1.0, 2.0, 3.0, state=state, faults=faults)) == FAULT
    assert ends.link.samples_v.tolist() == [1.0, 2.0, 3.0]
    assert (ends.link.status[links.STATE], ends.link.status[links.FAULTS]) == (state, faults)


def test_a_fault_told_by_a_late_answer_counts_at_once(ends: Ends) -> None:
    assert ends.exchange(1, answer(1)) == OK
    late = answer(2, faults=wire.END_STOP)
    assert ends.exchange(3, late, timeout_ns=SHORT_NS) == FAULT
    assert ends.counted()["late"] == ends.counted()["lost"] == 1


def test_a_target_that_never_armed_obeys_nothing(ends: Ends) -> None:
    ends.link.status[links.STATE] = wire.IDLE
    assert ends.exchange(1, timeout_ns=SHORT_NS) == FAULT
    assert ends.exchange(2, answer(2, state=wire.IDLE)) == FAULT
    assert ends.exchange(3, answer(3)) == OK


def test_samples_that_are_not_numbers_are_left_to_the_guard(ends: Ends) -> None:
    assert ends.exchange(1, answer(1, np.nan, np.inf, -0.0)) == OK
    assert np.isnan(ends.link.samples_v[0]) and np.isinf(ends.link.samples_v[1])


def test_a_closed_port_is_a_lost_answer_and_a_target_that_comes_back_is_heard(ends: Ends) -> None:
    address = ends.target.getsockname()
    ends.target.close()
    assert [ends.exchange(k, timeout_ns=SHORT_NS) for k in (1, 2, 3)] == [LOST] * 3
    counted = ends.counted()
    assert counted["lost"] == 3
    assert counted["unreachable"] >= 1
    ends.target = bound("127.0.0.1", address[1])
    ends.target.settimeout(2.0)
    assert ends.exchange(4, answer(4)) == OK
    assert ends.received().sequence == 4
    assert "unsent" not in ends.counted()


def test_an_error_of_an_earlier_packet_does_not_swallow_a_command(ends: Ends) -> None:
    """The kernel reports a port closed at the next call, which then sends nothing."""
    address = ends.target.getsockname()
    ends.target.close()
    ends.runner.send(b"into the void")
    ends.target = bound("127.0.0.1", address[1])
    ends.target.settimeout(2.0)
    ends.exchange(1, timeout_ns=SHORT_NS)
    assert ends.received().sequence == 1
    assert "unsent" not in ends.counted()


def test_a_send_that_fails_twice_is_counted(ends: Ends) -> None:
    ends.runner.shutdown(socket.SHUT_WR)
    received = signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    assert ends.exchange(1, timeout_ns=SHORT_NS) == LOST
    signal.signal(signal.SIGPIPE, received)
    assert ends.counted()["unsent"] == 1


def test_signals_neither_end_the_wait_nor_the_process(ends: Ends) -> None:
    rung = []
    old = signal.signal(signal.SIGALRM, lambda *_: rung.append(1))
    signal.setitimer(signal.ITIMER_REAL, 0.002, 0.002)
    try:
        before = time.monotonic_ns()
        assert ends.exchange(1, timeout_ns=30_000_000) == LOST
        assert time.monotonic_ns() - before >= 30_000_000
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)
    assert rung
    assert "unreachable" not in ends.counted()


def test_nothing_is_sent_before_the_instant(ends: Ends) -> None:
    ends.send(answer(1))
    instant = time.monotonic_ns() + 20_000_000
    assert converse_at(ends.link, wire.COMMAND, 1, 0.0, instant, ANSWER_NS) == OK
    assert ends.received().sent_ns >= instant


def test_random_and_mutated_packets_are_never_answers(ends: Ends) -> None:
    """3,000 of them through the socket; benchmarks/udp_fuzz.py sends 100,000."""
    random = np.random.default_rng(11)
    good = np.frombuffer(answer(10**6, 9.0, 9.0, 9.0), np.uint8)
    ends.link.status[links.BASE] = 10**6
    for turn in range(150):
        for _ in range(20):
            packet = good.copy()
            packet[random.integers(len(good), size=random.integers(1, 4))] ^= random.integers(1, 256, dtype=np.uint8)
            same = np.array_equal(packet, good)  # the same byte hit twice by the same change
            ends.send(random.bytes(int(random.integers(0, 200))) if turn % 2 or same else packet.tobytes())
        assert ends.exchange(0, timeout_ns=100_000) == LOST
    assert ends.exchange(0, timeout_ns=100_000_000) == LOST  # whatever is still there
    assert ends.counted()["bad"] == 3000
    assert not ends.link.samples_v.any()
    assert set(ends.counted()) == {"sent", "lost", "lost_in_a_row", "bad"}


def test_a_loop_waits_for_an_answer_no_longer_than_its_link_allows(ends: Ends) -> None:
    link, outcomes = ends.link._replace(timeout_ns=SHORT_NS), []
    loop = threading.Thread(target=lambda: outcomes.append(exchange_for_ever(link, 1.25, 1)), daemon=True)
    loop.start()
    loop.join(60.0)  # a bound for a broken link, which never returns
    assert outcomes == [LOST]
    ends.send(answer(2, 0.25, 0.5, 0.75))
    assert exchange_for_ever(link._replace(timeout_ns=ANSWER_NS), 1.25, 2) == OK
    assert ends.counted() == {"sent": 2, "answered": 1, "lost": 1}
