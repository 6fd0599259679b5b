"""Packets and their hash written down again, in plain Python from the paper and docs/reference/udp.md, for tests."""

from __future__ import annotations

import struct
from dataclasses import dataclass

MASK = 2**64 - 1
HEAD = struct.Struct("<4s4B2I3q")


def rotated(word: int, by: int) -> int:
    return (word << by | word >> 64 - by) & MASK


def sip_round(v: list[int]) -> None:
    """Figure 2.1 of Aumasson and Bernstein (2012), from top to bottom."""
    v[0] = (v[0] + v[1]) & MASK
    v[1] = rotated(v[1], 13)
    v[1] ^= v[0]
    v[0] = rotated(v[0], 32)
    v[2] = (v[2] + v[3]) & MASK
    v[3] = rotated(v[3], 16)
    v[3] ^= v[2]
    v[2] = (v[2] + v[1]) & MASK
    v[1] = rotated(v[1], 17)
    v[1] ^= v[2]
    v[2] = rotated(v[2], 32)
    v[0] = (v[0] + v[3]) & MASK
    v[3] = rotated(v[3], 21)
    v[3] ^= v[0]


def plain_siphash(message: bytes, key: bytes) -> bytes:
    """Return SipHash-2-4 of a message under a key of 16 bytes."""
    k0, k1 = struct.unpack("<2Q", key)
    v = [k0, k1, k0, k1]
    for i, constant in enumerate((b"somepseu", b"dorandom", b"lygenera", b"tedbytes")):
        v[i] ^= int.from_bytes(constant, "big")
    padded = message + bytes(7 - len(message) % 8) + bytes([len(message) % 256])
    for (word,) in struct.iter_unpack("<Q", padded):
        v[3] ^= word
        sip_round(v)
        sip_round(v)
        v[0] ^= word
    v[2] ^= 0xFF
    for _ in range(4):
        sip_round(v)
    return struct.pack("<Q", v[0] ^ v[1] ^ v[2] ^ v[3])


@dataclass(frozen=True)
class Packet:
    """What a packet says; `content` holds its words as bytes."""

    kind: int
    sequence: int
    content: bytes = b""
    state: int = 0
    faults: int = 0
    lost: int = 0
    sent_ns: int = 0
    instant_ns: int = 0
    version: int = 3

    def sealed(self, key: bytes) -> bytes:
        """Return the packet's bytes under a key of 16 bytes."""
        count = len(self.content) // 8
        head = HEAD.pack(
            b"RTHS", self.version, self.kind, count, self.state, self.faults, self.lost,
            self.sequence, self.sent_ns, self.instant_ns,
        )  # fmt: skip
        return head + self.content + plain_siphash(head + self.content, key)


def opened(data: bytes, key: bytes) -> Packet | None:
    """Return what a genuine packet says, None for any other."""
    if len(data) < 48 or plain_siphash(data[:-8], key) != data[-8:]:
        return None
    magic, version, kind, count, state, faults, lost, sequence, sent_ns, instant_ns = HEAD.unpack(data[:40])
    if magic != b"RTHS" or len(data) != 48 + 8 * count:
        return None
    return Packet(kind, sequence, data[40:-8], state, faults, lost, sent_ns, instant_ns, version)
