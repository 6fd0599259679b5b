"""docs/reference/udp.md against the code: the worked example byte by byte, and every number in its tables."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
from packets import HEAD, Packet

from rths_cli.numerics.compiled import entry
from rths_cli.rigs.udp import packets as wire
from rths_cli.rigs.udp import session
from rths_cli.rigs.udp.packets import Bytes, Words
from rths_cli.rigs.udp.session import as_words

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "udp.md").read_text()
SECRET, RUNNER, TARGET = bytes(range(16)), bytes(range(16, 32)), bytes(range(32, 48))
TERMS = struct.pack("<3q", 3, 1_000_000, 100_000_000)


def examples() -> list[bytes]:
    """Return the packets the page shows; each line's offset must be true."""
    packets = []
    for block in re.findall(r"^```hex\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE):
        packet = b""
        for line in block.splitlines():
            offset, data = int(line[:2]), bytes.fromhex(line[4:21])
            assert offset == len(packet)
            packet += data
        packets.append(packet)
    return packets


def rows(first: str) -> list[list[str]]:
    """Return the cells of the table whose head begins with these words."""
    table = re.search(rf"^\| {first}.*?\n\|[-|]+\n(.*?)\n\n", PAGE, re.DOTALL | re.MULTILINE)
    assert table is not None
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table[1].splitlines()]


@entry
def write_pair(command: Bytes, samples: Bytes, key: Words) -> None:
    """Write COMMAND and SAMPLES of the page with the parts that the loop uses."""
    wire.begin(command, wire.COMMAND, 1, 1)
    wire.put_int(command, wire.SENT_NS, 123_456_789)
    wire.put_real(command, wire.WORDS, 1.25)
    wire.seal(command, key)
    wire.begin(samples, wire.SAMPLES, 3, 3)
    wire.put_bytes(samples, wire.LOST, 1, 4)
    samples[wire.STATE] = wire.ARMED
    wire.put_int(samples, wire.SENT_NS, 987_654_321)
    wire.put_int(samples, wire.INSTANT_NS, 987_650_000)
    wire.put_real(samples, wire.WORDS, 0.5)
    wire.put_real(samples, wire.WORDS + 8, -0.25)
    wire.put_real(samples, wire.WORDS + 16, 0.0)
    wire.seal(samples, key)


def test_the_session_key_shown_is_computed() -> None:
    shown = re.search("The session key is `([0-9a-f]{32})`", PAGE)
    assert shown is not None
    key = session.session_key(as_words(SECRET), RUNNER, TARGET)
    assert key.astype("<u8").tobytes() == bytes.fromhex(shown[1])


def test_the_packets_shown_are_the_compiled_ones_and_those_of_plain_python() -> None:
    hello, welcome, arm, command, going_on, samples = examples()
    secret = as_words(SECRET)
    assert hello == session.sealed(wire.HELLO, RUNNER + TERMS + bytes(16), secret)
    assert welcome == session.sealed(wire.WELCOME, RUNNER + TARGET + TERMS, secret)
    key = session.session_key(secret, RUNNER, TARGET)
    assert arm == session.sealed(wire.ARM, RUNNER + TERMS, key)
    made = np.zeros((2, wire.MOST_BYTES), np.uint8)
    write_pair(made[0], made[1], key)
    assert made[0].tobytes().startswith(command) and len(command) == 56
    assert made[1].tobytes().startswith(samples) and len(samples) == 72
    plain = key.astype("<u8").tobytes()
    assert hello == Packet(wire.HELLO, 0, RUNNER + TERMS + bytes(16)).sealed(SECRET)
    assert arm == Packet(wire.ARM, 0, RUNNER + TERMS).sealed(plain)
    assert command == Packet(wire.COMMAND, 1, struct.pack("<d", 1.25), sent_ns=123_456_789).sealed(plain)
    words = struct.pack("<dqdd", 1.25, 4, 1.5, 1.625)
    assert going_on == Packet(wire.COMMAND, 3, words, sent_ns=125_456_789).sealed(plain)
    values = struct.pack("<3d", 0.5, -0.25, 0.0)
    assert samples == Packet(wire.SAMPLES, 3, values, 1, 0, 1, 987_654_321, 987_650_000).sealed(plain)


def test_the_table_of_fields_has_the_offsets_of_the_code() -> None:
    names = (
        "magic",
        "version",
        "kind",
        "count",
        "state",
        "faults",
        "lost",
        "sequence",
        "sent_ns",
        "instant_ns",
        "words",
    )
    shown = {row[3]: (int(row[0]), row[1]) for row in rows("offset") if row[3] != "tag"}
    assert tuple(shown) == names
    for name, (offset, size) in shown.items():
        assert offset == getattr(wire, name.upper())
        following = min((other for other, _ in shown.values() if other > offset), default=None)
        assert name == "words" or offset + int(size) == following
    assert HEAD.size == wire.WORDS
    assert f"{wire.LEAST_BYTES} to {wire.MOST_BYTES} bytes" in PAGE


def test_kinds_states_faults_and_reasons_have_the_numbers_of_the_code() -> None:
    for row in rows("kind"):
        assert getattr(wire, row[1]) == int(row[0])
    assert len(rows("kind")) == wire.CLOSE
    for row in rows("state"):
        assert getattr(wire, row[1].partition(":")[0]) == int(row[0])
    words = ("WATCHDOG", "END_STOP", "EMERGENCY_STOP", "BAD_COMMAND", "SENSOR", "ACTUATOR", "OVERRUN", "TARGET_FAULT")
    shown = rows("fault bit")
    assert [1 << int(row[0].partition("-")[0]) for row in shown] == [getattr(wire, word) for word in words]
    reasons = (wire.NO_VERSION, wire.BUSY, wire.OTHER_CHANNELS, wire.TOO_FAST, wire.FAULTY)
    assert tuple(int(row[3]) for row in shown if row[3]) == reasons


def test_the_example_in_c_has_the_numbers_of_the_code() -> None:
    """Its enums name the same kinds, states, faults and reasons."""
    source = (ROOT / "examples" / "udp_target.c").read_text()
    values: dict[str, int] = {}
    for body in re.findall(r"^enum \{ (.*) \};", source, re.MULTILINE):
        following = 0
        for item in body.split(", "):
            name, _, given = item.partition(" = ")
            values[name] = int(given) if given else following
            following = values[name] + 1
    common = {name: getattr(wire, name) for name in values if hasattr(wire, name) and name != "VERSION"}
    assert len(common) >= 18
    assert common == {name: values[name] for name in common}
    assert (values["VERSION"], values["HEAD"], values["MOST"]) == (wire.PROTOCOL, wire.WORDS, wire.MOST_BYTES)
