"""The loop itself, over a socket, its clock set on while it runs: the rig went where the command before told it to."""

from __future__ import annotations

import struct
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits
from smooth_way import smooth_way
from test_foresight import wave
from udp_peer import PlainTarget, virtual_table

from rths_cli.loop import guard, performance
from rths_cli.loop.blocks import RECORD
from rths_cli.loop.log import Signals, signals
from rths_cli.loop.realtime import START_NS
from rths_cli.lti import Array
from rths_cli.rigs.udp.rig import UdpRig, UdpTarget
from rths_cli.rigs.udp.wire import COMMAND

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only")
DT_S, SECRET, STALLS = 2e-3, bytes(range(16)), (1, 7, 20, 40, 1)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Signals, list[bytes]]]:
    """Play a record whose clock is set on by some intervals every 0.3 s; yield its log and the commands that came."""
    key_file: Path = tmp_path_factory.mktemp("key") / "key"
    key_file.write_text(SECRET.hex())
    key_file.chmod(0o600)
    info = replace(rig_info(dt_s=DT_S), kind="udp", limits=replace(rig_info().limits, lost_samples=400))
    table = virtual_table(info, (1, 2))
    table(None), table(0.0)  # compiled before the loop's clock runs, and the loop too
    target = PlainTarget(SECRET, table)
    rig = UdpRig(info, UdpTarget("127.0.0.1", target.port, key_file, watchdog_s=1.0, lost_samples=400))
    blocks = replace(best_like(info), shaping_step_v=info.converters.step_v)
    spent, run = (
        performance.prepare(info, blocks, RECORD, wave(1200, DT_S, RECORD), open_limits(info), ramp_s=0.1) for _ in "12"
    )
    performance.rehearse(spent, 0.02)
    rig.open()
    faults: list[str] = []
    loop = threading.Thread(target=lambda: faults.append(performance.perform(rig, run)))
    loop.start()
    for intervals in STALLS:
        time.sleep(0.3)
        run.course.marks[START_NS] -= intervals * run.course.dt_ns
    loop.join()
    rig.close()
    target.kill()
    assert faults == [""] and run.guard.flags[1] == guard.END
    log = signals(run.log, 3, run.step.estimated.size)
    assert run.log.done[0] > 1200
    left = np.flatnonzero(log.lost[1 : run.log.done[0]] != 2)  # steps of which the command left
    numbers = [one.sequence for one in target.received if one.kind == COMMAND]
    assert np.array_equal(numbers, numbers[0] + left - left[0])  # a number for each instant, also for those missed
    assert target.lost >= max(STALLS)
    yield (
        replace(log, lost=log.lost[: run.log.done[0]]),
        [one.content for one in target.received if one.kind == COMMAND],
    )


def way(content: bytes, count: int) -> Array:
    """Return where a command that came is in each of `count` intervals from its own on."""
    command, spacing, *points = struct.unpack(f"<dq{len(content) // 8 - 2}d", content)
    return smooth_way((command, *points), spacing, count)


def test_each_command_says_how_it_goes_on_and_is_the_one_noted(played: tuple[Signals, list[bytes]]) -> None:
    log, came = played
    left = np.flatnonzero(log.lost[1:] != 2)  # the command of a step leaves where the next step was not caught up
    assert len(came) == len(left) and {len(one) for one in came} == {8 * 16}
    assert [struct.unpack("<d", one[:8])[0] for one in came] == log.command_v[left].tolist()


def test_in_every_gap_the_commands_noted_are_those_of_the_way_that_was_told(
    played: tuple[Signals, list[bytes]],
) -> None:
    log, came = played
    left = np.flatnonzero(log.lost[1:] != 2)
    gaps = np.diff(left)
    assert gaps.max() > max(STALLS) and (gaps > 1).sum() >= len(STALLS) - 1
    for step, gap, content in zip(left[:-1], gaps, came[:-1], strict=True):
        assert log.command_v[step : step + gap] == pytest.approx(way(content, gap), abs=1e-12)


def test_after_a_gap_the_next_command_is_where_the_way_would_have_led(played: tuple[Signals, list[bytes]]) -> None:
    """Within 10 mV; in an interval it moves by up to 50."""
    log, came = played
    left = np.flatnonzero(log.lost[1:] != 2)
    for step, following, content in zip(left[:-1], left[1:], came[:-1], strict=True):
        if following < 1100:
            led = way(content, following - step + 1)[-1]
            assert log.command_v[following] == pytest.approx(led, abs=0.01)
    assert np.abs(np.diff(log.command_v[:1100])).max() > 0.045
