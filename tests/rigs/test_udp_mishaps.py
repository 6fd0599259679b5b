"""Sessions over a network that loses, doubles, delays, reorders and corrupts packets either way."""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info
from packets import opened
from udp_peer import SECRET, PlainTarget
from udp_relay import Mishap, Relay

from rths_cli.errors import RigError
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget

STEPS = 250


class Counting:
    """A table whose samples tell how many intervals it was held and what its last command was."""

    def __init__(self) -> None:
        self.held = 0

    def __call__(self, command_v: float | None) -> list[float]:
        self.held = 0 if command_v is None else self.held + 1
        return [float(self.held), command_v or 0.0, 0.0]


def mishaps(seed: int, seen: Counter[str]) -> Mishap:
    """Return one way of the network: of 20 packets about one each is lost, doubled, corrupted, cut, delayed."""
    random = np.random.default_rng(seed)

    def happen(packet: bytes) -> list[tuple[float, bytes]]:
        kind = ("lost", "doubled", "corrupted", "cut", "delayed", *["well"] * 15)[random.integers(20)]
        seen[kind] += 1
        at = int(random.integers(len(packet)))
        return {
            "lost": [],
            "doubled": [(0.0, packet), (0.002, packet)],
            "corrupted": [(0.0, packet[:at] + bytes([packet[at] ^ 64]) + packet[at + 1 :])],
            "cut": [(0.0, packet[:at])],
            "delayed": [(0.03, packet)],  # beyond the answer's time, and behind later packets
            "well": [(0.0, packet)],
        }[kind]

    return happen


@pytest.fixture
def table(tmp_path: Path) -> Iterator[tuple[PlainTarget, Relay, UdpRig]]:
    key_file = tmp_path / "key"
    key_file.write_text(SECRET.hex())
    key_file.chmod(0o600)
    target = PlainTarget(SECRET, Counting())
    relay = Relay("127.0.0.1", target.port)
    reached = UdpTarget("127.0.0.1", relay.port, key_file, timeout_s=0.01, lost_samples=200, watchdog_s=0.5)
    rig = UdpRig(rig_info(dt_s=1e-3), reached)
    yield target, relay, rig
    rig.close()
    relay.close()
    target.kill()


def test_what_is_obeyed_was_sent_and_what_is_taken_is_the_answer(
    table: tuple[PlainTarget, Relay, UdpRig],
) -> None:
    target, relay, rig = table
    rig.open()
    first = rig.arm().copy()
    base = int(rig.link.status[links.BASE])
    there, back = Counter[str](), Counter[str]()
    spoil, sent = mishaps(1, there), dict[int, float]()
    key = rig.link.key.astype("<u8").tobytes()

    def note(packet: bytes) -> list[tuple[float, bytes]]:
        said = opened(packet, key)
        assert said is not None
        sent[said.sequence] = struct.unpack("<d", said.content[:8])[0]
        return spoil(packet)

    relay.to_target, relay.to_runner = note, mishaps(2, back)
    command, samples = np.arange(1.0, STEPS + 1.0) / STEPS, [first]
    for volts in command:
        samples.append(rig.exchange(float(volts)).copy())
    counts = rig.counts
    time.sleep(0.05)  # whatever is still delayed
    assert min(there.values()) >= 3 and min(back.values()) >= 3
    sequences = [sequence for sequence, _ in target.obeyed]
    assert sequences == sorted(set(sequences))
    assert list(sent.values()) == command.tolist() and list(sent) == sorted(sent)
    assert all(volts == sent[sequence] for sequence, volts in target.obeyed)
    assert counts["sent"] == STEPS == counts["answered"] + counts["lost"]
    assert min(counts["lost"], counts["late"], counts["doubled"], counts["bad"]) > 0
    assert counts["stray"] == counts["unsent"] == 0
    for before, after in pairwise(samples):
        assert np.array_equal(before, after) or after[0] > before[0]
    missed = sequences[-1] - base - len(sequences)
    assert target.lost == missed > 0
    relay.to_target = relay.to_runner = lambda packet: [(0.0, packet)]
    rig.rest()
    assert rig.at_rest


def test_a_handshake_and_arming_succeed_over_a_bad_network(table: tuple[PlainTarget, Relay, UdpRig]) -> None:
    target, relay, rig = table
    for seed in range(5):
        relay.to_target, relay.to_runner = mishaps(10 + seed, Counter()), mishaps(20 + seed, Counter())
        rig.open()
        rig.arm()
        rig.rest()
        assert rig.at_rest
        rig.close()
        target.rests = 0


def test_a_cable_pulled_out_is_told_after_the_allowed_losses(table: tuple[PlainTarget, Relay, UdpRig]) -> None:
    target, relay, rig = table
    rig.target = replace(rig.target, lost_samples=20)
    rig.open()
    rig.arm()
    rig.exchange(0.5)
    relay.to_target = relay.to_runner = lambda packet: []
    with pytest.raises(RigError, match=r"21 answers of target .* in a row were lost"):
        for _ in range(30):
            rig.exchange(0.5)
    assert len(target.obeyed) <= 1
    rig.rest()
    assert not rig.at_rest
