"""The target's half of the handshake, in compiled code: answer HELLO, compute nonce and session key
(docs/reference/udp.md).

The target's nonce is computed, not drawn and stored. It is a hash of the runner's nonce, the number of sessions armed
so far, and the current period of the target's clock, under a key that the target draws when it starts. The first ARM of
a session carries the runner's nonce, from which the target computes the session key again and checks the tag. When an
ARM is accepted the number of sessions increases, so that no ARM of an earlier WELCOME is valid any more. All others
expire with their period.
"""

from __future__ import annotations

import secrets
from typing import NamedTuple

import numpy as np

from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry, part
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.packets import Bytes, Words, siphash

PERIOD_NS = 10_000_000_000  # an ARM is accepted in the period of its WELCOME and in the next one
KEY_LABEL = int.from_bytes(b"rths-key", "little")
CHANNELS, SHORTEST_NS, LONGEST_WATCHDOG_NS = range(3)  # places in Greeter.offer


class Greeter(NamedTuple):
    """State with which a target answers HELLO and recognises the first ARM of a session."""

    secret: Words  # (2,) shared with the runner
    boot: Words  # (2,) key of the nonces, drawn when the target starts and never disclosed
    armed: IntArray  # (1,) sessions armed since then
    offer: IntArray  # (3,) channels, shortest sample interval, longest watchdog
    message: Bytes  # (48,) scratch for the bytes to be hashed
    key: Words  # (2,) session key found by the last call of `opens_session`


def open_greeter(secret: Words, channels: int, shortest_ns: int, longest_watchdog_ns: int) -> Greeter:
    """Return the greeter of a target that starts; `secret` is (2,)."""
    boot = np.frombuffer(secrets.token_bytes(16), "<u8").astype(np.uint64)
    offer = np.array([channels, shortest_ns, longest_watchdog_ns], np.int64)
    return Greeter(secret, boot, np.zeros(1, np.int64), offer, np.zeros(48, np.uint8), np.zeros(2, np.uint64))


@part
def put_target_nonce(g: Greeter, runner_nonce: Bytes, period: int, to: Bytes, at: int) -> None:
    """Write to `to`, from `at` on, the target's nonce for a packet with a runner's nonce and a period of its clock."""
    for i in range(2):
        packets.put_int(g.message, 0, i)
        packets.put_int(g.message, 8, g.armed[0])
        packets.put_int(g.message, 16, period)
        for j in range(packets.NONCE_BYTES):
            g.message[24 + j] = runner_nonce[packets.WORDS + j]
        packets.put_int(to, at + 8 * i, np.int64(siphash(g.message, 40, g.boot)))  # type: ignore[arg-type]


@part
def session_key_into(nonces: Bytes, at: int, secret: Words, message: Bytes, key: Words) -> None:
    """Write the key (2,) of a session for both nonces, 32 bytes in `nonces` at `at`; `message` (48,) is scratch."""
    for i in range(2):
        packets.put_int(message, 0, KEY_LABEL)
        packets.put_int(message, 8, i)
        for j in range(2 * packets.NONCE_BYTES):
            message[16 + j] = nonces[at + j]
        key[i] = siphash(message, 48, secret)


@part
def watchdog_of(g: Greeter, wanted_ns: int) -> int:
    """Return the watchdog in ns that a target grants: the requested one, at most its longest; its longest for 0."""
    return min(wanted_ns, g.offer[LONGEST_WATCHDOG_NS]) if wanted_ns > 0 else g.offer[LONGEST_WATCHDOG_NS]


@part
def refusal(g: Greeter, packet: Bytes, faults: int, busy: bool) -> tuple[int, int]:
    """Return the reason why a HELLO is refused (0: it is not), and the detail."""
    channels, interval = packets.get_int(packet, packets.AFTER_NONCE), packets.get_int(packet, packets.AFTER_NONCE + 8)
    if packet[packets.VERSION] != packets.PROTOCOL:
        return packets.NO_VERSION, packets.PROTOCOL
    if busy:
        return packets.BUSY, 0
    if faults != 0:
        return packets.FAULTY, faults
    if channels != g.offer[CHANNELS]:
        return packets.OTHER_CHANNELS, g.offer[CHANNELS]
    return (0, 0) if interval >= g.offer[SHORTEST_NS] else (packets.TOO_FAST, g.offer[SHORTEST_NS])


@part
def answer_hello(g: Greeter, packet: Bytes, size: int, now: int, faults: int, busy: bool, out: Bytes) -> int:
    """Write the answer to a HELLO of `size` bytes to `out`; return its size, or 0 if it is no authentic HELLO.

    `faults`: faults that forbid motion; `busy`: whether the table is armed or not yet at rest; `now`: the target's
    clock in ns.
    """
    verdict = packets.verdict(packet, size, g.secret)
    if packet[packets.KIND] != packets.HELLO or (verdict != packets.GENUINE and verdict != packets.OTHER_VERSION):
        return 0
    if size < packets.AFTER_NONCE + packets.TAG_BYTES or (
        verdict == packets.GENUINE and packet[packets.COUNT] != packets.HELLO_WORDS
    ):
        return 0
    reason, detail = refusal(g, packet, faults, busy)
    if reason == 0:
        packets.begin(out, packets.WELCOME, packets.WELCOME_WORDS, 0)
    else:
        packets.begin(out, packets.REFUSAL, packets.REFUSAL_WORDS, 0)
    for i in range(packets.NONCE_BYTES):
        out[packets.WORDS + i] = packet[packets.WORDS + i]
    if reason != 0:
        packets.put_int(out, packets.AFTER_NONCE, reason)
        packets.put_int(out, packets.AFTER_NONCE + 8, detail)
        return packets.seal(out, g.secret)
    put_target_nonce(g, packet, now // PERIOD_NS, out, packets.AFTER_NONCE)
    for i in range(2):
        packets.put_int(out, packets.AFTER_NONCE + 16 + 8 * i, packets.get_int(packet, packets.AFTER_NONCE + 8 * i))
    packets.put_int(out, packets.AFTER_NONCE + 32, watchdog_of(g, packets.get_int(packet, packets.AFTER_NONCE + 16)))
    return packets.seal(out, g.secret)


@part
def opens_session(g: Greeter, packet: Bytes, size: int, now: int, out: Bytes) -> bool:
    """Return whether a packet is the first ARM of a session that may begin; if so, its key is in `g.key`.

    The number of sessions then increases, so that the same ARM is not accepted again. `out` is scratch. Call it only
    while the table is neither armed nor moving.
    """
    if packet[packets.KIND] != packets.ARM or packet[packets.COUNT] != packets.ARM_WORDS:
        return False
    for i in range(packets.NONCE_BYTES):
        out[i] = packet[packets.WORDS + i]
    for ago in range(2):
        put_target_nonce(g, packet, now // PERIOD_NS - ago, out, packets.NONCE_BYTES)
        session_key_into(out, 0, g.secret, g.message, g.key)
        if packets.is_genuine(packet, size, g.key):
            granted = refusal(g, packet, 0, False)[0] == 0
            watchdog = packets.get_int(packet, packets.AFTER_NONCE + 16)
            if granted and watchdog == watchdog_of(g, watchdog):
                g.armed[0] += 1
                return True
    return False


@entry
def answer_hello_at(g: Greeter, packet: Bytes, size: int, now: int, faults: int, busy: bool, out: Bytes) -> int:
    """Call `answer_hello` from Python."""
    g, packet, out = borrowed((g, packet, out))
    return answer_hello(g, packet, size, now, faults, busy, out)


@entry
def opens_session_at(g: Greeter, packet: Bytes, size: int, now: int, out: Bytes) -> bool:
    """Call `opens_session` from Python."""
    g, packet, out = borrowed((g, packet, out))
    return opens_session(g, packet, size, now, out)


@entry
def make_session_key(nonces: Bytes, secret: Words, message: Bytes, key: Words) -> None:
    """Call `session_key_into` from Python, for nonces at the beginning of `nonces`."""
    nonces, secret, message, key = borrowed((nonces, secret, message, key))
    session_key_into(nonces, 0, secret, message, key)
