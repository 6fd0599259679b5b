"""The packets byte by byte: every field, its place and type, and the tag (docs/reference/udp.md).

A packet has a header of 40 bytes, up to 62 words of 8 bytes, and a tag of 8 bytes over all preceding bytes. Compiled
code reads and writes packets in preallocated arrays; nothing here depends on the byte order of the machine.

SipHash-2-4, the keyed hash that closes every packet (Aumasson and Bernstein, INDOCRYPT 2012).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rths_cli.numerics.compiled import borrowed, entry, part

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint64]

# offsets of the fields in the header
MAGIC, VERSION, KIND, COUNT, STATE, FAULTS, LOST, SEQUENCE, SENT_NS, INSTANT_NS, WORDS = (
    0,
    4,
    5,
    6,
    7,
    8,
    12,
    16,
    24,
    32,
    40,
)
MAGIC_BYTES = b"RTHS"
MAGIC_NUMBER = int.from_bytes(MAGIC_BYTES, "little")
PROTOCOL = 3  # value of the field VERSION
MOST_WORDS = 62
TAG_BYTES = 8
LEAST_BYTES = WORDS + TAG_BYTES
MOST_BYTES = (
    WORDS + 8 * MOST_WORDS + TAG_BYTES
)  # 544: never in fragments (the smallest MTU of IPv4 is 576, less 28 for its headers, of IPv6 1280)
# kinds: to the target HELLO, ARM, COMMAND, REST, CLOSE; from it WELCOME, REFUSAL, SAMPLES
HELLO, WELCOME, REFUSAL, ARM, COMMAND, SAMPLES, REST, CLOSE = range(1, 9)
# number of words of HELLO, WELCOME, REFUSAL and ARM; each begins with a nonce of 16 bytes. HELLO is as long as WELCOME,
# with two words of 0 at its end, so that a target never answers with more bytes than it received
HELLO_WORDS, WELCOME_WORDS, REFUSAL_WORDS, ARM_WORDS = 7, 7, 4, 5
NONCE_BYTES = 16
AFTER_NONCE = WORDS + NONCE_BYTES  # HELLO and ARM: channels, interval, watchdog; WELCOME: the target's nonce
# the words of a COMMAND: the command alone, or with the spacing of its preview in sample intervals, and its points
COMMAND_V, SPACING, FIRST_POINT = WORDS, WORDS + 8, WORDS + 16
MOST_POINTS = 14
LONGEST_SPACING = 1000
# states of the target: commands are obeyed only in ARMED; RESTING brings the table to rest, RESTED ends the session
IDLE, ARMED, RESTING, RESTED = range(4)
# faults, one bit each; a target's own ones from TARGET_FAULT on
WATCHDOG, END_STOP, EMERGENCY_STOP, BAD_COMMAND, SENSOR, ACTUATOR, OVERRUN = (1 << bit for bit in range(7))
TARGET_FAULT = 1 << 16
# reasons of a REFUSAL
NO_VERSION, BUSY, OTHER_CHANNELS, TOO_FAST, FAULTY = range(1, 6)
# results of `verdict`
GENUINE, MALFORMED, OTHER_VERSION, FORGED = range(4)


@part
def get_word(data: Bytes, at: int) -> np.uint64:
    """Return the 8 bytes of `data` from `at` on as an unsigned number, the least significant byte first."""
    word = np.uint64(0)
    for i in range(8):
        word |= np.uint64(data[at + i]) << np.uint64(8 * i)
    return word


@part
def rotated(word: np.uint64, by: int) -> np.uint64:
    """Return the word rotated left."""
    return (word << np.uint64(by)) | (word >> np.uint64(64 - by))


@part
def sip_round(
    a: np.uint64, b: np.uint64, c: np.uint64, d: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return the four words of state after one round (figure 2.1 of the paper)."""
    a, c = a + b, c + d
    b, d = rotated(b, 13) ^ a, rotated(d, 16) ^ c
    a = rotated(a, 32)
    c, a = c + b, a + d
    b, d = rotated(b, 17) ^ c, rotated(d, 21) ^ a
    return a, b, rotated(c, 32), d


@part
def siphash(data: Bytes, size: int, key: Words) -> np.uint64:
    """Return SipHash-2-4 of the first `size` bytes of `data` under the key (2,)."""
    a, b = key[0] ^ np.uint64(0x736F6D6570736575), key[1] ^ np.uint64(0x646F72616E646F6D)
    c, d = key[0] ^ np.uint64(0x6C7967656E657261), key[1] ^ np.uint64(0x7465646279746573)
    whole = size // 8
    for i in range(whole + 1):
        if i < whole:
            word = get_word(data, 8 * i)
        else:
            word = np.uint64(size & 255) << np.uint64(56)
            for j in range(size - 8 * whole):
                word |= np.uint64(data[8 * whole + j]) << np.uint64(8 * j)
        d ^= word
        a, b, c, d = sip_round(a, b, c, d)
        a, b, c, d = sip_round(a, b, c, d)
        a ^= word
    c ^= np.uint64(255)
    for _ in range(4):
        a, b, c, d = sip_round(a, b, c, d)
    return a ^ b ^ c ^ d


@entry
def siphash_into(data: Bytes, size: int, key: Words, result: Words) -> None:
    """Write SipHash-2-4 of the first `size` bytes of `data` under the key (2,) into result[0]."""
    data, key, result = borrowed((data, key, result))
    result[0] = siphash(data, size, key)


@part
def put_bytes(packet: Bytes, at: int, value: int, count: int) -> None:
    """Write the low `count` bytes of a whole number; negative ones as two's complement."""
    for i in range(count):
        packet[at + i] = (value >> (8 * i)) & 255


@part
def put_int(packet: Bytes, at: int, value: int) -> None:
    """Write a whole number of 8 bytes."""
    put_bytes(packet, at, value, 8)


@part
def get_int(packet: Bytes, at: int) -> int:
    """Return the whole number of 8 bytes at an offset; a value beyond 2^63 - 1 becomes negative."""
    return np.int64(get_word(packet, at))  # type: ignore[return-value]


@part
def get_small(packet: Bytes, at: int) -> int:
    """Return the unsigned number of 4 bytes at an offset."""
    value = 0
    for i in range(4):
        value |= int(packet[at + i]) << (8 * i)
    return value


@part
def put_real(packet: Bytes, at: int, value: float) -> None:
    """Write a float64 (IEEE 754 binary64)."""
    put_bytes(packet, at, np.float64(value).view(np.int64), 8)  # type: ignore[arg-type]


@part
def get_real(packet: Bytes, at: int) -> float:
    """Return the float64 at an offset."""
    return np.uint64(get_word(packet, at)).view(np.float64)  # type: ignore[return-value]


@part
def begin(packet: Bytes, kind: int, count: int, sequence: int) -> None:
    """Write the header of a packet with `count` words; state, faults, lost and times are set to 0."""
    for i in range(WORDS):
        packet[i] = 0
    put_bytes(packet, MAGIC, MAGIC_NUMBER, 4)
    packet[VERSION], packet[KIND], packet[COUNT] = PROTOCOL, kind, count
    put_int(packet, SEQUENCE, sequence)


@part
def seal(packet: Bytes, key: Words) -> int:
    """Write the tag of a packet under the key (2,); return the packet's size in bytes."""
    end = WORDS + 8 * int(packet[COUNT])
    put_int(packet, end, np.int64(siphash(packet, end, key)))  # type: ignore[arg-type]
    return end + TAG_BYTES


@part
def verdict(packet: Bytes, size: int, key: Words) -> int:
    """Return GENUINE, MALFORMED, FORGED (the tag is wrong) or OTHER_VERSION (the tag is right) for received bytes.

    `size` may exceed the length of the array, because recv returns the full size of a truncated packet.
    """
    if size < LEAST_BYTES or size > MOST_BYTES or get_small(packet, MAGIC) != MAGIC_NUMBER:
        return MALFORMED
    end = size - TAG_BYTES
    if packet[VERSION] == PROTOCOL and end != WORDS + 8 * int(packet[COUNT]):
        return MALFORMED
    if get_word(packet, end) != siphash(packet, end, key):
        return FORGED
    return GENUINE if packet[VERSION] == PROTOCOL else OTHER_VERSION


@part
def is_whole(packet: Bytes) -> bool:
    """Return whether a runner's packet of a session has a number of words that its kind permits."""
    kind, count = int(packet[KIND]), int(packet[COUNT])
    if kind == COMMAND:
        return count != 0 and count != 2
    return count == ARM_WORDS if kind == ARM else count == 0 and kind in (REST, CLOSE)


@part
def is_genuine(packet: Bytes, size: int, key: Words) -> bool:
    """Return whether received bytes are a complete packet of this version with a valid tag under the key (2,)."""
    return verdict(packet, size, key) == GENUINE


@entry
def seal_packet(packet: Bytes, kind: int, count: int, sequence: int, key: Words) -> int:
    """Write header and tag of a packet without times, whose words are written already; return its size in bytes."""
    packet, key = borrowed((packet, key))
    begin(packet, kind, count, sequence)
    return seal(packet, key)


@entry
def judge_packet(packet: Bytes, size: int, key: Words) -> int:
    """Call `verdict` from Python."""
    packet, key = borrowed((packet, key))
    return verdict(packet, size, key)
