"""The runner's half of the handshake: HELLO, WELCOME or REFUSAL, session key, agreed terms (docs/reference/udp.md)."""

from __future__ import annotations

import secrets
import select
import socket
import struct
import time
from dataclasses import dataclass

import numpy as np

from rths_cli.errors import RigError
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.fault_sentences import refused, silence
from rths_cli.rigs.udp.handshake import make_session_key
from rths_cli.rigs.udp.packets import NONCE_BYTES
from rths_cli.rigs.udp.siphash import Words

GREETING_S = 5.0
RESEND_S = 0.1
HELLO_WORDS, WELCOME_WORDS, REFUSAL_WORDS, ARM_WORDS = "<16s3q16x", "<16s16s3q", "<16s2Q", "<16s3q"


@dataclass(frozen=True)
class Terms:
    """Terms of a session on which both sides agree; the watchdog is the longest time without a command."""

    channels: int
    interval_ns: int
    watchdog_ns: int


@dataclass(frozen=True)
class Session:
    """A session offered by a target."""

    key: Words  # (2,) key of this session's packets
    terms: Terms
    arming: bytes  # words of its ARM


def session_key(secret: Words, runner_nonce: bytes, target_nonce: bytes) -> Words:
    """Return the key (2,) of a session; a word is SipHash, under the secret, of label, word number and both nonces."""
    key, nonces = np.zeros(2, np.uint64), np.frombuffer(bytearray(runner_nonce + target_nonce), np.uint8)
    make_session_key(nonces, secret, np.zeros(48, np.uint8), key)
    return key


def prepare() -> None:
    """Load or compile the code of a handshake in advance, so that no peer has to wait for it."""
    secret = np.zeros(2, np.uint64)
    judge(sealed(packets.HELLO, b"", secret), secret)
    session_key(secret, bytes(NONCE_BYTES), bytes(NONCE_BYTES))


def greet(
    link: socket.socket,
    peer: str,
    secret: Words,
    wanted: Terms,
    timeout_s: float = GREETING_S,
    patience_s: float = 0.0,
) -> Session:
    """Send HELLO on a connected socket until the target answers; return the session.

    `peer` names the target in messages. `timeout_s`: longest wait for a silent target; `patience_s`: longest wait for a
    table that is armed or not yet at rest. Raises RigError if the target refuses or stays silent.
    """
    prepare()
    nonce = secrets.token_bytes(NONCE_BYTES)
    content = struct.pack(HELLO_WORDS, nonce, wanted.channels, wanted.interval_ns, wanted.watchdog_ns)
    hello = sealed(packets.HELLO, content, secret)
    begun = time.monotonic()
    end, strangers = begun + timeout_s, 0
    while (now := time.monotonic()) < end:
        _send(link, hello)
        again = min(now + RESEND_S, end)
        while (data := _receive(link, again - time.monotonic())) is not None:
            if _is_busy(data, secret, nonce) and time.monotonic() < begun + patience_s:
                end = max(end, begun + patience_s + timeout_s)
                continue
            if (session := _welcomed(data, secret, nonce, peer)) is not None:
                return session
            strangers += judge(data, secret) == packets.FORGED
    raise RigError(silence(peer, end - begun, strangers))


def sealed(kind: int, content: bytes, key: Words, sequence: int = 0) -> bytes:
    """Return a packet without times as bytes; `content` holds its words, the key is (2,)."""
    packet = np.zeros(packets.MOST_BYTES, np.uint8)
    packet[packets.WORDS : packets.WORDS + len(content)] = np.frombuffer(content, np.uint8)
    size = packets.seal_packet(packet, kind, len(content) // 8, sequence, key)
    return packet[:size].tobytes()


def judge(data: bytes, key: Words) -> int:
    """Return the result of packets.verdict for received bytes under a key (2,)."""
    packet = np.zeros(packets.MOST_BYTES, np.uint8)
    kept = data[: packets.MOST_BYTES]
    packet[: len(kept)] = np.frombuffer(kept, np.uint8)
    return int(packets.judge_packet(packet, len(data), key))


def _is_busy(data: bytes, secret: Words, nonce: bytes) -> bool:
    """Return whether a packet refuses this nonce because the table is armed or not yet at rest."""
    words = data[packets.WORDS : packets.AFTER_NONCE + 8]
    return (
        judge(data, secret) == packets.GENUINE
        and data[packets.KIND] == packets.REFUSAL
        and words == nonce + struct.pack("<Q", packets.BUSY)
    )


def _welcomed(data: bytes, secret: Words, nonce: bytes, peer: str) -> Session | None:
    """Return the session of a WELCOME for this nonce, None for any other packet; raises RigError for a REFUSAL."""
    judged = judge(data, secret)
    if (
        judged not in (packets.GENUINE, packets.OTHER_VERSION)
        or data[packets.WORDS : packets.WORDS + NONCE_BYTES] != nonce
    ):
        return None
    if judged == packets.OTHER_VERSION:
        raise RigError(refused(peer, packets.NO_VERSION, data[packets.VERSION]))
    if (data[packets.KIND], 8 * data[packets.COUNT]) == (packets.REFUSAL, struct.calcsize(REFUSAL_WORDS)):
        raise RigError(refused(peer, *struct.unpack_from(REFUSAL_WORDS, data, packets.WORDS)[1:]))
    if (data[packets.KIND], 8 * data[packets.COUNT]) != (packets.WELCOME, struct.calcsize(WELCOME_WORDS)):
        return None
    _, target_nonce, *terms = struct.unpack_from(WELCOME_WORDS, data, packets.WORDS)
    key = session_key(secret, nonce, target_nonce)
    return Session(key, Terms(*terms), struct.pack(ARM_WORDS, nonce, *terms))


def _send(link: socket.socket, packet: bytes) -> None:
    """Send a packet; network errors, also of an earlier packet, are ignored and appear as a silent target."""
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
            return link.recv(packets.MOST_BYTES + 1)
        except OSError:  # the peer's port was closed when an earlier packet came
            time.sleep(min(0.001, left))
    return None
