"""How a session begins: HELLO and WELCOME or REFUSAL, and the key that both sides then share (docs/udp.md)."""

from __future__ import annotations

import secrets
import select
import socket
import struct
import time
from dataclasses import dataclass

import numpy as np

from rths_cli.errors import RigError
from rths_cli.rigs.udp import wire
from rths_cli.rigs.udp.sentences import refused, silence
from rths_cli.rigs.udp.siphash import Words, siphash_into

NONCE_BYTES = 16
GREETING_S = 5.0
RESEND_S = 0.1
HELLO_WORDS, WELCOME_WORDS, REFUSAL_WORDS = "<16s3q", "<16s16s3q", "<16s2Q"
KEY_LABEL = b"rths-key"


@dataclass(frozen=True)
class Terms:
    """What both sides agree on: channels, sample interval, and after how long without a command the table rests."""

    channels: int
    interval_ns: int
    watchdog_ns: int


@dataclass(frozen=True)
class Session:
    """A key (2,) words that only this session's packets are made with, and its terms."""

    key: Words
    terms: Terms


@dataclass(frozen=True)
class Offer:
    """What a target can do; `busy` while its table is armed or not yet at rest, `faults` that forbid motion."""

    channels: int
    shortest_interval_ns: int
    longest_watchdog_ns: int
    busy: bool = False
    faults: int = 0


@dataclass(frozen=True)
class Answer:
    """A target's answer to a HELLO: the packet to send back, and the session unless it is a refusal."""

    runner_nonce: bytes
    packet: bytes
    session: Session | None


def session_key(secret: Words, runner_nonce: bytes, target_nonce: bytes) -> Words:
    """Return the key (2,) of a session: SipHash under the secret of label, number of the word, and both nonces."""
    nonces = runner_nonce + target_nonce
    return np.array([_hash(KEY_LABEL + struct.pack("<Q", i) + nonces, secret) for i in range(2)], np.uint64)


def prepare() -> None:
    """Load, or compile, what a handshake needs, so that no peer waits for that."""
    secret = np.zeros(2, np.uint64)
    judge(sealed(wire.HELLO, b"", secret), secret)
    session_key(secret, bytes(NONCE_BYTES), bytes(NONCE_BYTES))


def greet(link: socket.socket, peer: str, secret: Words, wanted: Terms, timeout_s: float = GREETING_S) -> Session:
    """Send HELLO on a connected socket until the target answers; return the session.

    `peer` names the target in messages. Raises RigError when it refuses or stays silent.
    """
    prepare()
    nonce = secrets.token_bytes(NONCE_BYTES)
    content = struct.pack(HELLO_WORDS, nonce, wanted.channels, wanted.interval_ns, wanted.watchdog_ns)
    hello = sealed(wire.HELLO, content, secret)
    end, strangers = time.monotonic() + timeout_s, 0
    while (now := time.monotonic()) < end:
        _send(link, hello)
        again = min(now + RESEND_S, end)
        while (data := _receive(link, again - time.monotonic())) is not None:
            if (session := _welcomed(data, secret, nonce, peer)) is not None:
                return session
            strangers += 1
    raise RigError(silence(peer, timeout_s, strangers))


def answer_hello(data: bytes, secret: Words, offer: Offer, before: Answer | None = None) -> Answer | None:
    """Return a target's answer to a packet; None where it is no genuine HELLO, which is answered by nothing.

    `before`: the last answer; a HELLO that came twice is given the same again, so that a lost WELCOME does no harm.
    """
    judged = judge(data, secret)
    if judged not in (wire.GENUINE, wire.OTHER_VERSION) or data[wire.KIND] != wire.HELLO:
        return None
    nonce = data[wire.WORDS : wire.WORDS + NONCE_BYTES]
    if judged == wire.OTHER_VERSION:
        return _refusal(nonce, wire.NO_VERSION, wire.PROTOCOL, secret)
    if data[wire.COUNT] != struct.calcsize(HELLO_WORDS) // 8:
        return None
    if before is not None and before.session is not None and before.runner_nonce == nonce:
        return before
    wanted = Terms(*struct.unpack_from(HELLO_WORDS, data, wire.WORDS)[1:])
    if offer.busy:
        return _refusal(nonce, wire.BUSY, 0, secret)
    if offer.faults:
        return _refusal(nonce, wire.FAULTY, offer.faults, secret)
    if wanted.channels != offer.channels:
        return _refusal(nonce, wire.OTHER_CHANNELS, offer.channels, secret)
    if wanted.interval_ns < offer.shortest_interval_ns:
        return _refusal(nonce, wire.TOO_FAST, offer.shortest_interval_ns, secret)
    return _welcome(nonce, Terms(wanted.channels, wanted.interval_ns, _watchdog(wanted, offer)), secret)


def sealed(kind: int, content: bytes, key: Words, sequence: int = 0) -> bytes:
    """Return a packet without times, made in Python; `content` holds its words, the key is (2,)."""
    packet = np.zeros(wire.MOST_BYTES, np.uint8)
    packet[wire.WORDS : wire.WORDS + len(content)] = np.frombuffer(content, np.uint8)
    size = wire.seal_packet(packet, kind, len(content) // 8, sequence, key)
    return packet[:size].tobytes()


def judge(data: bytes, key: Words) -> int:
    """Return what wire.verdict says of received bytes under a key (2,)."""
    packet = np.zeros(wire.MOST_BYTES, np.uint8)
    kept = data[: wire.MOST_BYTES]
    packet[: len(kept)] = np.frombuffer(kept, np.uint8)
    return int(wire.judge_packet(packet, len(data), key))


def _watchdog(wanted: Terms, offer: Offer) -> int:
    """Return the shorter of two watchdog times; 0 in a HELLO leaves it to the target."""
    return min(wanted.watchdog_ns, offer.longest_watchdog_ns) if wanted.watchdog_ns > 0 else offer.longest_watchdog_ns


def _welcome(nonce: bytes, terms: Terms, secret: Words) -> Answer:
    own = secrets.token_bytes(NONCE_BYTES)
    content = struct.pack(WELCOME_WORDS, nonce, own, terms.channels, terms.interval_ns, terms.watchdog_ns)
    return Answer(nonce, sealed(wire.WELCOME, content, secret), Session(session_key(secret, nonce, own), terms))


def _refusal(nonce: bytes, reason: int, detail: int, secret: Words) -> Answer:
    return Answer(nonce, sealed(wire.REFUSAL, struct.pack(REFUSAL_WORDS, nonce, reason, detail), secret), None)


def _welcomed(data: bytes, secret: Words, nonce: bytes, peer: str) -> Session | None:
    """Return the session of a WELCOME to this nonce, None for any other packet; a refusal raises RigError."""
    judged = judge(data, secret)
    if judged not in (wire.GENUINE, wire.OTHER_VERSION) or data[wire.WORDS : wire.WORDS + NONCE_BYTES] != nonce:
        return None
    if judged == wire.OTHER_VERSION:
        raise RigError(refused(peer, wire.NO_VERSION, data[wire.VERSION]))
    if (data[wire.KIND], 8 * data[wire.COUNT]) == (wire.REFUSAL, struct.calcsize(REFUSAL_WORDS)):
        raise RigError(refused(peer, *struct.unpack_from(REFUSAL_WORDS, data, wire.WORDS)[1:]))
    if (data[wire.KIND], 8 * data[wire.COUNT]) != (wire.WELCOME, struct.calcsize(WELCOME_WORDS)):
        return None
    _, target_nonce, *terms = struct.unpack_from(WELCOME_WORDS, data, wire.WORDS)
    return Session(session_key(secret, nonce, target_nonce), Terms(*terms))


def _hash(message: bytes, secret: Words) -> np.uint64:
    result = np.zeros(1, np.uint64)
    siphash_into(np.frombuffer(bytearray(message), np.uint8), len(message), secret, result)
    return np.uint64(result[0])


def _send(link: socket.socket, packet: bytes) -> None:
    """Send a packet; what the network says against it now or of an earlier one shows as silence."""
    try:
        link.send(packet)
    except OSError:
        return


def _receive(link: socket.socket, timeout_s: float) -> bytes | None:
    """Return the next packet within a time, None when there is none."""
    end = time.monotonic() + timeout_s
    while (left := end - time.monotonic()) > 0.0:
        if not select.select([link], [], [], left)[0]:
            return None
        try:
            return link.recv(wire.MOST_BYTES + 1)
        except OSError:  # the peer's port was closed when an earlier packet came
            time.sleep(min(0.001, left))
    return None
