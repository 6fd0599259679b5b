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
from test_fallback_commands import wave
from test_realtime_loop import conducted
from udp_peer import PlainTarget, virtual_table

from rths_cli.loop import guard, realtime_run
from rths_cli.loop.guard import GuardLimits, GuardState
from rths_cli.loop.realtime_loop import START_NS, Course, leave, look_ahead, pass_by
from rths_cli.loop.run_log import Log, Signals, signals, sizes_of
from rths_cli.loop.step_arrays import RECORD, Step
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp.late_command_trajectory import Way, fresh_way, place_after
from rths_cli.rigs.udp.packets import COMMAND
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
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
        realtime_run.prepare(info, blocks, RECORD, wave(1200, DT_S, RECORD), open_limits(info), ramp_s=0.1)
        for _ in "12"
    )
    realtime_run.rehearse(spent, 0.02)
    rig.open()
    faults: list[str] = []
    loop = threading.Thread(target=lambda: faults.append(realtime_run.perform(rig, run)))
    loop.start()
    for intervals in STALLS:
        time.sleep(0.3)
        run.course.marks[START_NS] -= intervals * run.course.dt_ns
    loop.join()
    rig.close()
    target.kill()
    assert faults == [""] and run.guard.flags[1] == guard.END
    log = signals(run.log, sizes_of(run.step))
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


@pytest.mark.campaign
def test_each_command_says_how_it_goes_on_and_is_the_one_noted(played: tuple[Signals, list[bytes]]) -> None:
    log, came = played
    left = np.flatnonzero(log.lost[1:] != 2)  # the command of a step leaves where the next step was not caught up
    assert len(came) == len(left) and {len(one) for one in came} == {8 * 16}
    assert [struct.unpack("<d", one[:8])[0] for one in came] == log.command_v[left].tolist()


@pytest.mark.campaign
def test_in_every_gap_the_commands_noted_are_those_of_the_way_that_was_told(
    played: tuple[Signals, list[bytes]],
) -> None:
    log, came = played
    left = np.flatnonzero(log.lost[1:] != 2)
    gaps = np.diff(left)
    assert gaps.max() > max(STALLS) and (gaps > 1).sum() >= len(STALLS) - 1
    for step, gap, content in zip(left[:-1], gaps, came[:-1], strict=True):
        assert log.command_v[step : step + gap] == pytest.approx(way(content, gap), abs=1e-12)


@entry
def sent(
    course: Course, s: Step, limits: GuardLimits, g: GuardState, drive: Array, log: Log, told: Way, waited: int,
    command: float, k: int,
) -> float:  # fmt: skip
    """Look ahead after step k - 1, then return what the rig is given for it: a command that leaves or, after `waited`
    intervals, none."""
    course, s, limits, g, drive, log, told = borrowed((course, s, limits, g, drive, log, told))
    look_ahead(course, s, limits, g, drive, log, k)
    if waited == 0:
        return leave(course, s, limits, log, told, command, k)
    pass_by(course, s, limits, log, told, waited, k)
    return place_after(told, waited)


@entry
def led_to(told: Way, intervals: int) -> float:
    return place_after(told, intervals)


@pytest.mark.campaign
def test_after_a_gap_the_next_command_is_where_the_way_would_have_led() -> None:
    """Within 1 mV; in an interval it moves by up to 50.

    In simulated time: a host that stalls by itself makes gaps longer than the way, at whose last point the rig waits.
    """
    info = replace(rig_info(dt_s=DT_S), kind="udp", limits=replace(rig_info().limits, lost_samples=400))
    blocks = replace(best_like(info), shaping_step_v=info.converters.step_v)
    run = realtime_run.prepare(info, blocks, RECORD, wave(1200, DT_S, RECORD), open_limits(info), ramp_s=0.1)
    table, told, waited, off = virtual_table(info, (1, 2)), fresh_way(), 0, []
    whole = (run.course, run.step, run.limits, run.guard, run.drive, run.log)
    command = conducted(*whole, np.array(table(None)), 0, 0)
    missed = {250 + 150 * i + j for i, length in enumerate(STALLS) for j in range(length)}
    for k in range(1, 1100):
        led, passed = led_to(told, waited + 1), waited
        waited = waited + 1 if k in missed else 0
        given = sent(*whole, told, waited, command, k)
        off += [given - led] if passed > 0 and waited == 0 else []
        run.log.done[0] = k
        command = conducted(*whole, np.array(table(given)), 2 if waited > 0 else 0, k)
    assert len(off) == len(STALLS) and np.abs(off).max() < 1e-3
    assert np.abs(np.diff(signals(run.log, sizes_of(run.step)).command_v[:1100])).max() > 0.045
