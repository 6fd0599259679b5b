"""The target for Simulink, played in Octave tick by tick, against a target written from the page alone."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import plain_peer
import pytest
from plain_peer import ASK, BEGIN, COMMAND, FRAME, REST, RUNNING, OwnTarget

OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
FOLDER = Path(__file__).parents[2] / "examples" / "plain_link"
TICK_S, TICKS, WATCHDOG_S, RANGE_V = 2.5e-4, 4, 0.05, 10.0
PROGRAM = """
own = struct('range_v', 10, 'fastest_v_s', 1e9, 'rest_v_s', 1e3, 'watchdog_s', 0.05, 'coasts', 50);
t = plain_target_start();
tick = 0;
while ischar(line = fgetl(stdin))
    bytes = uint8(sscanf(line, '%2x'));
    [arrived, head, reals] = plain_unpack(bytes);
    is_instant = mod(tick, 4) == 0;
    [t, head, reals] = plain_target_step(t, arrived, head, reals, is_instant, tick * 2.5e-4, 2.5e-4, own);
    if is_instant
        printf('%s\\n', sprintf('%02x', plain_pack(head, reals, [0.5; -0.25])));
    end
    tick = tick + 1;
end
"""


def frame(session: int, number: int, order: int, volts: float = 0.0, magic: bytes = b"RPC1") -> bytes:
    return FRAME.pack(magic, session, number, 0, order, 0, 1.0, volts)


def script() -> list[bytes]:
    """Return what comes in each tick: two sessions, with frames that do not count, a bad command and two silences."""
    ticks: list[bytes] = []

    def silent(count: int) -> None:
        ticks.extend([b""] * count)

    silent(5)
    ticks.extend([frame(2, 0, BEGIN), frame(0, 0, ASK), frame(1, 0, BEGIN), frame(1, 0, BEGIN)])
    for k in range(1, 60):
        ticks.extend([frame(1, k, COMMAND, 0.1 * k), frame(2, k + 1, COMMAND, 9.0), frame(1, k, COMMAND, 8.0), b""])
    ticks.extend([frame(1, 90, COMMAND, 3.0, b"RPS1"), frame(1, 90, COMMAND, 3.0)[:39], frame(1, 91, 4, 3.0), b""])
    silent(1700)  # the watchdog, and the way to rest
    ticks.extend([frame(1, 200, COMMAND, 1.0), frame(2, 0, BEGIN)])
    for k in range(1, 9):
        ticks.extend([frame(2, k, COMMAND, 1.0), *[b""] * 3])
    ticks.append(frame(2, 20, COMMAND, np.nan))
    silent(1400)
    ticks.append(frame(3, 0, BEGIN))
    silent(3)
    ticks.extend([frame(3, 1, COMMAND, 2.0), *[b""] * 3, frame(3, 2, REST), *[b""] * 40])
    return ticks


def of_the_page(ticks: list[bytes], monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Return the frames that the target of the page sends, in counted time."""
    now = [0.0]
    monkeypatch.setattr(plain_peer, "time", SimpleNamespace(monotonic=lambda: now[0]))
    target = OwnTarget(lambda volts: [0.5, -0.25], 2, TICK_S * TICKS, WATCHDOG_S, RANGE_V)
    target.samples, sent = [0.5, -0.25], list[bytes]()
    target.door.close()
    target.door = SimpleNamespace(sendto=lambda data, peer: sent.append(data))  # type: ignore[assignment]
    for i, data in enumerate(ticks):
        now[0] = i * TICK_S
        if data:
            target.take(data)
        target.watch()
        if i % TICKS == 0:
            target.at_instant()
    return sent


@pytest.mark.skipif(OCTAVE is None, reason="Octave is not installed here")
def test_the_simulink_target_follows_the_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ticks = script()
    program = tmp_path / "play.m"
    program.write_text(PROGRAM)
    done = subprocess.run(
        [str(OCTAVE), "--quiet", "--path", FOLDER, program], input="\n".join(data.hex() for data in ticks) + "\n",
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    shown = [bytes.fromhex(line) for line in done.stdout.split()]
    must = of_the_page(ticks, monkeypatch)
    assert len(shown) == len(must) > 150
    states = set()
    for k, (one, other) in enumerate(zip(shown, must, strict=True)):
        assert len(one) == 56 and one[40:] == struct.pack("<2d", 0.5, -0.25)
        mine, page = FRAME.unpack_from(one), FRAME.unpack_from(other)
        states.add(page[4])
        same = (0, 1, 2, 3, 5, 6) if 2 in (mine[4], page[4]) else (0, 1, 2, 3, 4, 5, 6)  # each rests at its own speed
        assert [mine[i] for i in same] == [page[i] for i in same], k
        if page[4] == mine[4] == RUNNING:
            assert mine[7] == page[7], k
    assert states == {1, 2, 3}
