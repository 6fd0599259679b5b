"""A recorded session over UDP, replayed: the same answers at the same times bring about the same packets."""

from __future__ import annotations

import gzip
import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from packets import Packet, opened
from recorded_exchange import COMMAND, HELLO, LOST, SECRET, arithmetic, session_key

HERE = Path(__file__).parent
RECORDING = HERE / "recorded_exchange.json.gz"  # made by recorded_exchange.py
STEP_V = 20.0 / 2**16  # of the command converter

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]


@pytest.fixture(scope="module")
def recorded() -> dict[str, list[str]]:
    found: dict[str, list[str]] = json.loads(gzip.decompress(RECORDING.read_bytes()))
    return found


@pytest.fixture(scope="module")
def replayed() -> list[str]:
    program = [sys.executable, str(HERE.parent / "helpers" / "recorded_exchange.py"), "replay", str(RECORDING)]
    ended = subprocess.run(program, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    sent: list[str] = json.loads(ended.stdout)["sent"]
    return sent


def read(packet: str) -> Packet:
    """Return a packet that the runner sent, whose tag must be right."""
    data = bytes.fromhex(packet)
    found = opened(data, SECRET if data[5] == HELLO else session_key())
    assert found is not None
    return found


def test_the_recording_holds_a_session_with_losses(recorded: dict[str, list[str]]) -> None:
    sent = [read(packet) for packet in recorded["sent"]]
    commands = [packet for packet in sent if packet.kind == COMMAND]
    assert [packet.kind for packet in sent[:2]] == [1, 4] and [packet.kind for packet in sent[-4:]] == [7, 7, 7, 8]
    assert len(commands) == 942 and len(recorded["answers"]) == len(sent) - 1
    assert all(not recorded["answers"][number] for number in LOST)
    volts = np.array([struct.unpack_from("<d", packet.content)[0] for packet in commands])
    assert np.ptp(volts) > 100 * STEP_V  # the table moves


@pytest.mark.campaign
def test_the_same_answers_bring_about_the_same_packets(recorded: dict[str, list[str]], replayed: list[str]) -> None:
    """Byte for byte where the arithmetic is that of the recording, clock and tags included. Another processor rounds
    otherwise: there the volts may differ by two steps of the converter, and with them the tag, but nothing else."""
    if recorded["arithmetic"] == arithmetic():
        assert replayed == recorded["sent"]
        return
    assert len(replayed) == len(recorded["sent"])
    for one, other in zip(map(read, replayed), map(read, recorded["sent"]), strict=True):
        told, known = (packet.content if packet.kind == COMMAND else b"" for packet in (one, other))
        assert Packet(**vars(one) | {"content": b""}) == Packet(**vars(other) | {"content": b""})
        assert len(one.content) == len(other.content) and (told or one.content == other.content)
        if told:
            assert told[8:16] == known[8:16]  # the spacing of the points
            volts = [np.frombuffer(content[:8] + content[16:]) for content in (told, known)]
            np.testing.assert_allclose(*volts, rtol=0.0, atol=2 * STEP_V)
