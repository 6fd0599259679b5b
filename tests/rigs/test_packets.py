"""Packets as compiled code makes and judges them, against plain Python and the published vectors."""

from __future__ import annotations

import math
import re
import struct

import numpy as np
import pytest
from packets import Packet, opened, plain_siphash

from rths_cli.numerics.compiled import entry
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.packets import Bytes, Words, siphash_into

KEY = bytes(range(16))
# SipHash-2-4 of 00 01 02 ... (0 to 63 bytes) under the key 00..0f: the authors' 64 vectors, one after the other
VECTORS = (
    "310e0edd47db6f72fd67dc93c539f8745a4fa9d909806c0d2d7efbd796666785b7877127e09427cf8da699cd64557618cee3fe586e46c9cb"
    "37d1018bf50002ab6224939a79f5f593b0e4a90bdf82009ef3b9dd94c5bb5d7aa7ad6b22462fb3f4fbe50e86bc8f1e75903d84c02756ea14"
    "eef27a8e90ca23f7e545be4961ca29a1db9bc2577fcc2a3f9447be2cf5e99a699cd38d96f0b3c14bbd6179a71dc96dbb98eea21af25cd6be"
    "c7673b2eb0cbf2d0883ea3e395675393c8ce5ccd8c030ca894af49f6c650adb8eab8858ade92e1bcf315bb5bb835d817adcf6b0763612e2f"
    "a5c91da7acaa4dde716595876650a2a628ef495c53a387ad42c341d8fa92d832ce7cf2722f512771e37859f94623f3a7381205bb1ab0e012"
    "ae97a10fd434e015b4a31508beff4d3181396229f09079024d0cf49ee5d4dcca5c73336a76d8bf9ad0a704536ba93e0e925958fcd6420cad"
    "a915c29bc8067318952b79f3bc0aa6d4f21df2e41d4535f987577519048f53a910a56cf5dfcd9adbeb75095ccd986cd051a9cb9ecba312e6"
    "96afadfc2ce666c772fe52975a4364ee5a1645b276d592a1b274cb8ebf87870a6f9bb4203de7b381eaecb2a30b22a87f9924a43cc1315724"
    "bd838d3aafbf8db70b1a2a3265d51aea135079a3231ce660932b2846e4d70666e1915f5cb1eca46cf325965ca16d629f575ff28e60381be5"
    "724506eb4c328a95"
)
SPECIAL = [0.0, -0.0, 1.0, -math.pi, 5e-324, -2.2250738585072014e-308, 1.7976931348623157e308, math.inf, -math.inf]


def words(data: bytes) -> Words:
    return np.frombuffer(data, "<u8").astype(np.uint64)


def array(data: bytes) -> Bytes:
    """Return a packet in the memory it is received in."""
    memory = np.zeros(packets.MOST_BYTES, np.uint8)
    memory[: len(data)] = np.frombuffer(data[: packets.MOST_BYTES], np.uint8)
    return memory


def hashed(data: bytes, key: bytes) -> bytes:
    result = np.zeros(1, np.uint64)
    siphash_into(np.frombuffer(bytearray(data + b"\xff"), np.uint8), len(data), words(key), result)
    return struct.pack("<Q", int(result[0]))


def judged(data: bytes, key: bytes = KEY) -> int:
    return int(packets.judge_packet(array(data), len(data), words(key)))


@entry
def write_all(packet: Bytes, kind: int, sequence: int, numbers: Words, values: np.ndarray, key: Words) -> int:
    """Write a packet with every field, and return its size; numbers: state, faults, lost, sent, instant."""
    packets.begin(packet, kind, values.size, sequence)
    packet[packets.STATE] = numbers[0]
    packets.put_bytes(packet, packets.FAULTS, np.int64(numbers[1]), 4)
    packets.put_bytes(packet, packets.LOST, np.int64(numbers[2]), 4)
    packets.put_int(packet, packets.SENT_NS, np.int64(numbers[3]))
    packets.put_int(packet, packets.INSTANT_NS, np.int64(numbers[4]))
    for i in range(values.size):
        packets.put_real(packet, packets.WORDS + 8 * i, values[i])
    return packets.seal(packet, key)


@entry
def read_all(packet: Bytes, numbers: np.ndarray, values: np.ndarray) -> None:
    """Read faults, lost, sequence, sent, instant and the values of a packet."""
    numbers[0], numbers[1] = packets.get_small(packet, packets.FAULTS), packets.get_small(packet, packets.LOST)
    numbers[2], numbers[3] = packets.get_int(packet, packets.SEQUENCE), packets.get_int(packet, packets.SENT_NS)
    numbers[4] = packets.get_int(packet, packets.INSTANT_NS)
    for i in range(values.size):
        values[i] = packets.get_real(packet, packets.WORDS + 8 * i)


def test_the_hash_gives_the_published_vectors() -> None:
    published = [bytes.fromhex(vector) for vector in re.findall("." * 16, VECTORS)]
    assert len(published) == 64
    assert int.from_bytes(published[15], "little") == 0xA129CA6149BE45E5  # the one of the paper, appendix A
    for size, vector in enumerate(published):
        assert hashed(bytes(range(size)), KEY) == vector == plain_siphash(bytes(range(size)), KEY)


def test_the_hash_agrees_with_plain_python_for_other_keys_and_lengths() -> None:
    random = np.random.default_rng(5)
    for size in (*range(64, 180, 5), 255, 256, 300):
        data, key = random.bytes(size), random.bytes(16)
        assert hashed(data, key) == plain_siphash(data, key)


@pytest.mark.parametrize("count", [0, 1, 3, 16])
def test_a_packet_has_the_documented_bytes_and_reads_back(count: int) -> None:
    values = np.array((SPECIAL * 2)[:count])
    packet, numbers = np.full(packets.MOST_BYTES, 170, np.uint8), [2, 0xFFFF0001, 70_000, 2**62 + 5, -7]
    unsigned = np.array([n % 2**64 for n in numbers], np.uint64)
    size = write_all(packet, packets.SAMPLES, 2**40 + 3, unsigned, values, words(KEY))
    wanted = Packet(packets.SAMPLES, 2**40 + 3, values.astype("<f8").tobytes(), *numbers)
    assert bytes(packet[:size]) == wanted.sealed(KEY)
    assert opened(bytes(packet[:size]), KEY) == wanted
    read, back = np.zeros(5, np.int64), np.zeros(count)
    read_all(packet, read, back)
    assert read.tolist() == [*numbers[1:3], 2**40 + 3, *numbers[3:]]
    assert back.tobytes() == values.tobytes()
    assert judged(bytes(packet[:size])) == packets.GENUINE


def test_not_a_number_passes_bit_by_bit() -> None:
    packet, back = np.zeros(packets.MOST_BYTES, np.uint8), np.zeros(1)
    strange = np.array([0x7FF8_0000_0000_1234], np.uint64).view(float)
    write_all(packet, packets.COMMAND, 1, np.zeros(5, np.uint64), strange, words(KEY))
    read_all(packet, np.zeros(5, np.int64), back)
    assert back.tobytes() == strange.tobytes()


def test_a_sequence_number_beyond_63_bits_reads_negative() -> None:
    packet, read = array(Packet(packets.COMMAND, -1).sealed(KEY)), np.zeros(5, np.int64)
    read_all(packet, read, np.zeros(0))
    assert read[2] == -1


def test_no_changed_bit_and_no_other_size_is_genuine() -> None:
    data = Packet(packets.COMMAND, 7, struct.pack("<d", 1.5), sent_ns=12345).sealed(KEY)
    assert judged(data) == packets.GENUINE
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        assert judged(bytes(changed)) in (packets.FORGED, packets.MALFORMED)
    for size in range(200):
        if size != len(data):
            assert judged((data * 4)[:size]) in (packets.FORGED, packets.MALFORMED)


def test_a_packet_under_another_key_is_forged() -> None:
    data = Packet(packets.REST, 9).sealed(KEY)
    assert judged(data, KEY[:8] + bytes(8)) == judged(data, bytes(8) + KEY[8:]) == packets.FORGED


def test_a_size_beyond_the_memory_is_malformed() -> None:
    """MSG_TRUNC tells the size sent; only what fits stands in memory."""
    data = Packet(packets.SAMPLES, 1, bytes(8 * (packets.MOST_WORDS + 1))).sealed(KEY)
    assert len(data) == packets.MOST_BYTES + 8
    assert judged(data) == packets.MALFORMED
    assert judged(bytes(65_507)) == packets.MALFORMED


def test_the_count_must_be_that_of_the_size_even_with_a_right_tag() -> None:
    head = bytearray(Packet(packets.SAMPLES, 1, bytes(16)).sealed(KEY)[:-8])
    for count in (0, 1, 3, 17, 255):
        head[6] = count
        assert judged(bytes(head) + plain_siphash(bytes(head), KEY)) == packets.MALFORMED


def test_the_magic_must_be_right_even_with_a_right_tag() -> None:
    head = b"RTHX" + Packet(packets.REST, 1).sealed(KEY)[4:-8]
    assert judged(head + plain_siphash(head, KEY)) == packets.MALFORMED


def test_another_version_is_told_from_a_forged_one() -> None:
    """A later version may count its words otherwise; its tag still closes the packet."""
    assert judged(Packet(packets.HELLO, 0, bytes(24), version=4).sealed(KEY)) == packets.OTHER_VERSION
    assert judged(Packet(packets.HELLO, 0, bytes(24), version=4).sealed(bytes(16))) == packets.FORGED


def test_python_seals_words_it_has_put_in_place() -> None:
    packet = np.zeros(packets.MOST_BYTES, np.uint8)
    content = struct.pack("<3Q", 1, 2**64 - 1, 3)
    packet[packets.WORDS : packets.WORDS + 24] = np.frombuffer(content, np.uint8)
    size = packets.seal_packet(packet, packets.HELLO, 3, 0, words(KEY))
    assert bytes(packet[:size]) == Packet(packets.HELLO, 0, content).sealed(KEY)
