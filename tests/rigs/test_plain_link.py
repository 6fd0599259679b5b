"""The plain link: page and codec against each other, sessions with a target written from the page, what is refused."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info
from plain_peer import AT_REST, RUNNING, OwnTarget

from rths_cli.errors import RigError
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp import plain_frames
from rths_cli.rigs.udp.packets import Bytes
from rths_cli.rigs.udp.plain_frames import BEGIN, COMMAND, OF_TARGET, Frame, packed, unpacked
from rths_cli.rigs.udp.plain_rig import ECHOES, PlainRig

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "plain_link.md").read_text()
MakeTarget = Callable[..., OwnTarget]
pytestmark = pytest.mark.real_time


def echo(volts: float | None) -> list[float]:
    return [0.0 if volts is None else volts] * 3


@pytest.fixture
def start() -> Iterator[MakeTarget]:
    targets: list[OwnTarget] = []

    def make(clock_s: float | None = None, **options: float) -> OwnTarget:
        targets.append(OwnTarget(echo, 3, clock_s, **options))
        return targets[-1]

    yield make
    for target in targets:
        target.kill()


def info(dt_s: float = 5e-3, lost_samples: int = 100) -> RigInfo:
    bench = rig_info(dt_s=dt_s)
    return replace(bench, kind="udp_plain", limits=replace(bench.limits, lost_samples=lost_samples))


def examples() -> list[bytes]:
    """Return the frames that the page shows; each line's offset must be true."""
    frames = []
    for block in re.findall(r"^```hex\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE):
        frame = b""
        for line in block.splitlines():
            assert int(line[:2]) == len(frame)
            frame += bytes.fromhex(line[4:21])
        frames.append(frame)
    return frames


@entry
def write_command(frame: Bytes) -> int:
    """Write COMMAND of the page with the part that the loop uses."""
    frame = borrowed(frame)
    return plain_frames.put_command(frame, 1, 7, 6, plain_frames.COMMAND, 100_625_000_000, 1.25)


def test_the_frames_of_the_page_are_those_of_the_code() -> None:
    begin, command, answer = examples()
    assert begin == packed(Frame(1, 0, 0, BEGIN, 100.5, 0.0))
    assert command == packed(Frame(1, 7, 6, COMMAND, 100.625, 1.25))
    shown = Frame(1, 7, 6, RUNNING, 4.0, 1.0, 0, (0.5, -0.25))
    assert answer == packed(shown, OF_TARGET) and unpacked(answer, 2) == shown
    frame = np.full(64, 255, np.uint8)
    size = write_command(frame)
    assert frame[:size].tobytes() == command


def test_the_tables_of_the_page_state_the_places_of_the_code() -> None:
    rows = re.findall(r"^\| (\d+) \| (\S+)(?: n)? \| (\w+) \| (\w+) \|", PAGE, re.MULTILINE)
    places = {name: int(offset) for offset, _, _, name in rows}
    assert len(rows) == 8 + 9
    for name in ("magic", "session", "number", "echo", "order", "state", "faults", "time_s", "command_v", "samples_v"):
        assert places[name] == getattr(plain_frames, name.upper())
    for magic in (plain_frames.OF_RUNNER, plain_frames.OF_TARGET):
        assert f"`{magic.decode()}`, {magic.hex(' ')}; as a number {struct.unpack('<I', magic)[0]}" in PAGE


@pytest.mark.parametrize("clock_s", [None, 5e-3])
def test_a_session_obeys_each_command_once_in_order(start: MakeTarget, clock_s: float | None) -> None:
    """The own target of the page alone: samples of instant k show what was held from k - 1 on."""
    target = start(clock_s)
    rig = target.rig(info(), timeout_s=0.5)
    rig.open()
    assert rig.arm().tolist() == [0.0] * 3
    volts = 0.5 + 0.01 * np.arange(120)
    shown = np.array([rig.exchange(float(one)).copy() for one in volts])
    rig.rest()
    assert rig.at_rest and target.state == AT_REST and target.output_v == 0.0
    numbers = [number for _, number, _ in target.obeyed]
    assert numbers == sorted(set(numbers)) and {session for session, _, _ in target.obeyed} == {1}
    assert [volt for _, _, volt in target.obeyed] == volts.tolist()
    agree = shown[1:, 0] == volts[:-1]
    assert agree.mean() > (0.9 if clock_s is None else 0.5)  # a busy machine holds one of the two now and then
    assert rig.latency_samples == pytest.approx(1.0, abs=0.2) or clock_s is not None  # never in step on a busy machine
    rig.close()
    rig.open()
    rig.arm()
    rig.exchange(0.1)
    assert target.session == 2
    rig.close()


def test_frames_of_an_earlier_session_are_not_obeyed(start: MakeTarget) -> None:
    target = start()
    rig = target.rig(info())
    for _ in range(2):
        rig.open()
        rig.arm()
        rig.exchange(0.25)
        rig.rest()
    rig.arm()
    assert target.session == 3 and rig.door is not None
    for number in range(1, 50):
        rig.door.send(packed(Frame(2, number, 0, COMMAND, 0.0, 5.0)))
    rig.exchange(0.5)
    assert [volts for session, _, volts in target.obeyed if session == 3] == [0.5]
    assert 5.0 not in [volts for _, _, volts in target.obeyed]
    rig.close()


def test_answers_of_another_session_or_number_give_no_samples(start: MakeTarget) -> None:
    """Beside each answer come one of the session before, one of a command not sent yet, a short and a doubled one."""
    target = start()
    rig = target.rig(info())
    rig.open()
    rig.arm()

    def spoil(number: int, frame: bytes) -> list[bytes]:
        wrong = struct.pack("<d", 9.0) * 3
        other = frame[:4] + struct.pack("<2I", 7, number) + frame[12:40] + wrong
        ahead = frame[:8] + struct.pack("<I", number + 1) + frame[12:40] + wrong
        stateless = frame[:16] + struct.pack("<I", 0) + frame[20:40] + wrong
        return [other, ahead, stateless, frame[:-8], frame, frame[:40] + wrong]

    target.spoil = spoil
    shown = [rig.exchange(1.0)[0] for _ in range(10)]
    assert shown == [0.0] + [1.0] * 9
    counts = rig.counts
    assert (counts["answered"], counts["stray"], counts["bad"]) == (10, 20, 20)
    assert counts["doubled"] == 9
    target.spoil = lambda number, frame: [frame]
    rig.close()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rig: replace(rig.info, dt_s=4e-3), r"counts an instant every 0\.00[45]\d* s .* asks for 0\.004 s"),
        (lambda rig: replace(rig.info, channels=rig.info.channels[:2]), r"have 64 bytes \(3 channels\), 2 channels"),
    ],
)
def test_a_target_of_another_rate_or_list_is_refused(
    start: MakeTarget, change: Callable[[PlainRig], RigInfo], said: str
) -> None:
    rig = start(5e-3).rig(info())
    rig.info = change(rig)
    with pytest.raises(RigError, match=said):
        rig.open()
    rig.close()


def test_a_silent_target_and_one_that_runs_are_told_apart(start: MakeTarget, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rths_cli.rigs.udp.plain_rig.GREETING_S", 0.3)
    target = start()
    rig = target.rig(info(), watchdog_s=0.01)
    target.state, target.watchdog_s = RUNNING, 1e3
    monkeypatch.setattr("rths_cli.rigs.udp.plain_rig.AT_REST_S", 0.1)
    with pytest.raises(RigError, match="running or not yet at rest: another runner has it, or its watchdog"):
        rig.open()
    target.kill()
    with pytest.raises(RigError, match=r"was silent for 0\.3 s: check that it runs and answers \(clock: runner\)"):
        rig.open()
    rig.close()


def test_a_target_that_buffers_longer_than_declared_is_refused(start: MakeTarget) -> None:
    target = start()
    rig = target.rig(info())
    rig.open()
    rig.arm()

    def buffered(number: int, frame: bytes) -> list[bytes]:
        return [frame[:12] + struct.pack("<I", max(number - 2, 0)) + frame[16:]]

    target.spoil = buffered
    with pytest.raises(RigError, match=r"echo the command of 2 intervals before, converters\.latency_samples is 1"):
        for _ in range(6 * ECHOES):
            rig.exchange(0.0)
    rig.close()


def test_the_targets_watchdog_ends_a_run_by_its_name(start: MakeTarget) -> None:
    target = start(5e-3)
    rig = target.rig(info())
    rig.open()
    rig.arm()
    rig.exchange(1.0)
    while target.state == RUNNING:
        rig.asked(0.1)
    with pytest.raises(RigError, match="stopped: its watchdog missed commands"):
        rig.exchange(1.0)
    rig.close()
