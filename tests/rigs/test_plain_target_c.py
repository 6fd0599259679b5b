"""The example target of the plain link in C, compiled with all warnings as errors, over loopback."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits

from rths_cli.errors import RigError
from rths_cli.loop import realtime_run
from rths_cli.loop.guard import END
from rths_cli.loop.lost_samples import CAUGHT_UP, NO_ANSWER
from rths_cli.loop.realtime_loop import OVERRUNS
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step_arrays import RECORD
from rths_cli.rigs.udp.plain_frames import AT_REST, COMMAND, Frame, packed
from rths_cli.rigs.udp.plain_rig import Cable, PlainRig

EXAMPLE = Path(__file__).parents[2] / "examples" / "plain_target.c"
STRICT = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic")
COMPILER = shutil.which("cc") or shutil.which("gcc")
pytestmark = [pytest.mark.skipif(COMPILER is None, reason="no C compiler here"), pytest.mark.real_time]
DT_S = 4e-3
Start = Callable[[bool], PlainRig]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("c") / "plain_target"
    subprocess.run([str(COMPILER), *STRICT, "-o", path, EXAMPLE], check=True)
    return path


@pytest.fixture
def start(program: Path) -> Iterator[Start]:
    processes: list[subprocess.Popen[str]] = []

    def make(of_target: bool) -> PlainRig:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            own_port = free.getsockname()[1]
        words = [str(program), "127.0.0.1:0", f"127.0.0.1:{own_port}", str(DT_S) if of_target else "runner"]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        processes.append(process)
        assert process.stdout is not None
        port = int(process.stdout.readline().split()[-1])
        info = rig_info(dt_s=DT_S)
        info = replace(info, kind="udp_plain", limits=replace(info.limits, lost_samples=100))
        return PlainRig(info, Cable("127.0.0.1", own_port, "127.0.0.1", port, of_target), 0.15, timeout_s=0.1)

    yield make
    for process in processes:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.parametrize("of_target", [False, True])
def test_a_session_moves_its_table_and_its_watchdog_rests_it(start: Start, of_target: bool) -> None:
    """Held at 2 V the table follows with its lag of 20 ms: after 0.4 s it is there, and the channels are 1:2:3."""
    rig = start(of_target)
    rig.open()
    rig.arm()
    shown = np.array([rig.exchange(min(0.1 * k, 2.0)).copy() for k in range(120)])
    assert shown[-1] == pytest.approx([2.0, 4.0, 6.0], rel=1e-2)
    assert rig.link.acted_v[0] == 2.0 and rig.latency_samples == pytest.approx(1.0, abs=0.3)
    last, frame = time.monotonic(), None
    while frame is None or frame.order != AT_REST:
        frame = rig.asked(0.1) or frame
        assert time.monotonic() - last < 5.0
    assert frame.faults == 1 and frame.command_v == 0.0 and time.monotonic() - last > 0.15
    with pytest.raises(RigError, match="its watchdog missed commands"):
        for _ in range(3):  # a busy machine may lose the first answer
            rig.exchange(2.0)
    rig.close()
    rig.open()
    assert np.abs(rig.arm()).max() < 1.0
    rig.exchange(0.0)
    rig.rest()
    assert rig.at_rest
    rig.close()


@pytest.mark.parametrize("volts", [np.nan, np.inf, 10.5, -10.5])
def test_a_command_that_is_no_number_or_out_of_range_rests_it(start: Start, volts: float) -> None:
    rig = start(False)
    rig.open()
    rig.arm()
    rig.exchange(1.0)
    rig.post_command(volts)
    with pytest.raises(RigError, match="it was sent a command that is not a number or out of range"):
        for _ in range(3):
            rig.exchange(1.0)
    frame = rig.asked(1.0)
    assert frame is not None and abs(frame.command_v) <= 1.0
    rig.close()


def test_frames_of_another_session_do_not_move_it(start: Start) -> None:
    rig = start(False)
    for _ in range(2):
        rig.open()
        rig.arm()
        rig.exchange(0.5)
        rig.rest()
        rig.close()
    rig.open()
    rig.arm()
    assert rig.door is not None
    for session in (0, 1, 2, 4, 2**32 - 1):
        for number in (1, 2, 3, 2**31 - 1):
            rig.door.send(packed(Frame(session, number, 0, COMMAND, 0.0, 5.0)))
    rig.discard()
    frame = rig.asked(1.0)
    assert frame is not None and (frame.session, frame.number, frame.command_v) == (3, 0, 0.0)
    rig.exchange(0.0)
    assert rig.counts["answered"] == 1 and rig.link.acted_v[0] == 0.0
    rig.close()


def test_its_ends_must_be_one_address_each(program: Path) -> None:
    for ends in (("127.0.0.1", "127.0.0.1:1"), ("0.0.0.0:0", "127.0.0.1:1"), ("table:1", "127.0.0.1:1")):
        done = subprocess.run([program, *ends, "runner"], capture_output=True, text=True)
        assert done.returncode == 2 and done.stderr.startswith("plain_target: an end of the cable is")


def test_a_runner_that_stalls_loses_no_sample_of_a_target_with_its_own_clock(start: Start) -> None:
    """The process is stopped three times for 25 intervals: the frames wait for it, and each step gets its own."""
    rig = start(True)
    info = replace(rig.info, limits=replace(rig.info.limits, lost_samples=200))
    rig.info, steps = info, 400
    blocks = replace(best_like(info), shaping_step_v=info.converters.step_v)
    time_s = DT_S * np.arange(steps)
    drive = np.column_stack([np.sin(12.0 * time_s), -np.cos(12.0 * time_s) / 12.0, -np.sin(12.0 * time_s) / 144.0])
    run, spent = (realtime_run.prepare(info, blocks, RECORD, drive, open_limits(info), ramp_s=0.1) for _ in "12")
    realtime_run.rehearse(spent, 0.02)  # compiled before the loop's clock runs
    rig.open()
    stops = "for i in 1 2 3; do sleep 0.3; kill -STOP {0}; sleep 0.1; kill -CONT {0}; done"
    stopper = subprocess.Popen(["sh", "-c", stops.format(os.getpid())])
    faults = realtime_run.perform(rig, run)
    stopper.wait()
    lost = signals(run.log, sizes_of(run.step)).lost[: run.log.done[0]]
    assert faults == "" and run.guard.flags[1] == END and run.course.marks[OVERRUNS] > 50
    assert not (lost == CAUGHT_UP).any() and (lost == NO_ANSWER).sum() < 0.3 * run.course.marks[OVERRUNS]
    rig.close()
