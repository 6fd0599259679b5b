"""The packets byte by byte: every field, its place and type, and the tag (docs/reference/udp.md).

A head of 40 bytes, up to 16 words of 8 bytes, a tag of 8 bytes over all before it. Compiled code reads and writes them
in preallocated arrays; nothing here depends on the byte order of the machine.
"""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.compiled import entry, part
from rths_cli.rigs.udp.siphash import Bytes, Words, get_word, siphash

# where a field starts in the head
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
PROTOCOL = 3  # what stands at VERSION
MOST_WORDS = 16
TAG_BYTES = 8
LEAST_BYTES = WORDS + TAG_BYTES
MOST_BYTES = (
    WORDS + 8 * MOST_WORDS + TAG_BYTES
)  # 176: never in fragments (the smallest MTU of IPv4 is 576, of IPv6 1280)

# kinds: to the target HELLO, ARM, COMMAND, REST, CLOSE; from it WELCOME, REFUSAL, SAMPLES
HELLO, WELCOME, REFUSAL, ARM, COMMAND, SAMPLES, REST, CLOSE = range(1, 9)

# the words of HELLO, WELCOME, REFUSAL and ARM: a nonce of 16 bytes first. HELLO is as long as WELCOME, its last two
# words are 0, so that nobody gets more bytes out of a target than he sent
HELLO_WORDS, WELCOME_WORDS, REFUSAL_WORDS, ARM_WORDS = 7, 7, 4, 5
NONCE_BYTES = 16
AFTER_NONCE = WORDS + NONCE_BYTES  # HELLO and ARM: channels, interval, watchdog; WELCOME: the target's nonce

# the words of a COMMAND: alone, or with how many sample intervals lie between the points it goes on to, and these
COMMAND_V, SPACING, FIRST_POINT = WORDS, WORDS + 8, WORDS + 16
MOST_POINTS = MOST_WORDS - 2
LONGEST_SPACING = 1000

# states of the target: commands are obeyed in ARMED alone; RESTING leads the table to rest, RESTED ends the session
IDLE, ARMED, RESTING, RESTED = range(4)

# faults, a bit each; a target's own ones from TARGET_FAULT on
WATCHDOG, END_STOP, EMERGENCY_STOP, BAD_COMMAND, SENSOR, ACTUATOR, OVERRUN = (1 << bit for bit in range(7))
TARGET_FAULT = 1 << 16

# why a target refuses a session
NO_VERSION, BUSY, OTHER_CHANNELS, TOO_FAST, FAULTY = range(1, 6)

# what `verdict` says of a packet
GENUINE, MALFORMED, OTHER_VERSION, FORGED = range(4)


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
    """Return the whole number of 8 bytes at a place; beyond 2^63 - 1 it comes out negative."""
    return np.int64(get_word(packet, at))  # type: ignore[return-value]


@part
def get_small(packet: Bytes, at: int) -> int:
    """Return the unsigned number of 4 bytes at a place."""
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
    """Return the float64 at a place."""
    return np.uint64(get_word(packet, at)).view(np.float64)  # type: ignore[return-value]


@part
def begin(packet: Bytes, kind: int, count: int, sequence: int) -> None:
    """Write the head of a packet with `count` words; state, faults, lost and times are 0 until put there."""
    for i in range(WORDS):
        packet[i] = 0
    put_bytes(packet, MAGIC, MAGIC_NUMBER, 4)
    packet[VERSION], packet[KIND], packet[COUNT] = PROTOCOL, kind, count
    put_int(packet, SEQUENCE, sequence)


@part
def seal(packet: Bytes, key: Words) -> int:
    """Close a packet with its tag under the key (2,); return its size in bytes."""
    end = WORDS + 8 * int(packet[COUNT])
    put_int(packet, end, np.int64(siphash(packet, end, key)))  # type: ignore[arg-type]
    return end + TAG_BYTES


@part
def verdict(packet: Bytes, size: int, key: Words) -> int:
    """Return GENUINE, MALFORMED, FORGED (the tag is wrong) or OTHER_VERSION (the tag is right) for received bytes.

    `size` may be more than the array holds, as recv says of a packet cut off.
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
    """Return whether the kind of a packet of a session, sent by a runner, may have as many words as it says."""
    kind, count = int(packet[KIND]), int(packet[COUNT])
    if kind == COMMAND:
        return count != 0 and count != 2
    return count == ARM_WORDS if kind == ARM else count == 0 and kind in (REST, CLOSE)


@part
def is_genuine(packet: Bytes, size: int, key: Words) -> bool:
    """Return whether received bytes are a whole packet of this version, made by who knows the key (2,)."""
    return verdict(packet, size, key) == GENUINE


@entry
def seal_packet(packet: Bytes, kind: int, count: int, sequence: int, key: Words) -> int:
    """Write head and tag around the words of a packet that carries no times; return its size in bytes."""
    begin(packet, kind, count, sequence)
    return seal(packet, key)


@entry
def judge_packet(packet: Bytes, size: int, key: Words) -> int:
    """Do what `verdict` does, called from Python."""
    return verdict(packet, size, key)
