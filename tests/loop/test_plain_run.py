"""Runs in real time over the plain link, the virtual table served at its other end, with both clocks."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hybrid import best_like
from serving_bench import Running, until

from rths_cli.laboratory.serve import PlainServer, ServedRig, Server, ServeRequest, describe, serve
from rths_cli.loop import realtime_run, udp_target
from rths_cli.loop.guard import END, GuardLimits
from rths_cli.loop.realtime_loop import OVERRUNS
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.rigs.interface import LinkedRig
from rths_cli.rigs.udp.plain_frames import AT_REST
from rths_cli.rigs.udp.plain_rig import Cable, PlainRig
from rths_cli.rigs.udp.session import bound, make_secret

pytestmark = pytest.mark.real_time
RATE_HZ, RECORD_STEPS = 250.0, 300
WATCHDOG_S = 0.5
Serve = Callable[..., tuple[Server, PlainRig]]


@pytest.fixture(scope="module")
def served() -> ServedRig:
    return describe("aps400_virtual", "three_storey", (f"sample_rate_hz={RATE_HZ:g}",), 0)


@pytest.fixture
def serving(served: ServedRig) -> Iterator[Serve]:
    """Return what serves the table in a thread, and gives the runner's rig at the other end."""
    ends: list[Callable[[], Any]] = []

    def start(of_target: bool, watchdog_s: float = WATCHDOG_S) -> tuple[Server, PlainRig]:
        here, there = bound("127.0.0.1", 0), bound("127.0.0.1", 0)
        port, own_port = here.getsockname()[1], there.getsockname()[1]
        here.connect(("127.0.0.1", own_port))
        there.close()
        server = PlainServer(here, of_target, served, round(1e9 * watchdog_s), lambda told: None)
        server.start()
        thread = threading.Thread(target=server.run_for, args=(None,))
        thread.start()
        ends.extend((server.end, lambda: thread.join(10), here.close))
        info = served.setup.rig
        info = replace(info, kind="udp_plain", limits=replace(info.limits, lost_samples=100))
        return server, PlainRig(info, Cable("127.0.0.1", own_port, "127.0.0.1", port, of_target), watchdog_s)

    yield start
    for end in ends:
        end()


def played(rig: LinkedRig, limits: GuardLimits) -> realtime_run.Performance:
    """Play a hybrid test of a second on an open rig."""
    info = rig.info
    blocks = replace(best_like(info), shaping_step_v=info.converters.step_v)
    time_s = info.dt_s * np.arange(RECORD_STEPS)
    drive = np.column_stack([np.sin(12.0 * time_s), -np.cos(12.0 * time_s) / 12.0, -np.sin(12.0 * time_s) / 144.0])
    run = realtime_run.prepare(info, blocks, NUMERICAL, 0.2 * drive, limits, ramp_s=0.04)
    assert realtime_run.perform(rig, run) == ""
    return run


def limits_of(served: ServedRig) -> GuardLimits:
    from rths_cli.experiment.real_rig_readiness import guard_limits

    return guard_limits(served.setup)


@pytest.mark.campaign
def test_the_same_run_over_both_links_and_with_both_clocks(served: ServedRig, serving: Serve, tmp_path: Path) -> None:
    """It ends by its record, with as many steps and the same motion, whoever has the clock."""
    make_secret(tmp_path / "key")
    keyed = Running(served, tmp_path / "key", watchdog_s=WATCHDOG_S)
    runs: list[realtime_run.Performance] = []
    try:
        rig = keyed.rig()
        rig.info = replace(rig.info, kind="udp", limits=replace(rig.info.limits, lost_samples=100))
        rig.open()
        runs.append(played(rig, limits_of(served)))
        rig.close()
    finally:
        keyed.end()
    for of_target in (False, True):
        server, plain = serving(of_target)
        plain.open()
        runs.append(played(plain, limits_of(served)))
        assert plain.at_rest and plain.latency_samples == pytest.approx(1.0, abs=0.3)
        plain.close()
        until(lambda server=server: bool(server.ended))  # type: ignore[misc]
        assert server.ended[0].ended_by == "the runner had the table rest"
    ends = {(int(run.guard.flags[0]), int(run.guard.flags[1])) for run in runs}
    assert len(ends) == 1 and {end for _, end in ends} == {END}
    assert len({int(run.guard.flags[3]) for run in runs}) == 1  # the step at which the record ended
    commands = [realtime_run.signals(run.log, realtime_run.sizes_of(run.step)).command_v[:RECORD_STEPS] for run in runs]
    size = np.abs(commands[0]).max()
    for run, command in zip(runs[1:], commands[1:], strict=True):
        if not run.course.marks[OVERRUNS] and not runs[0].course.marks[OVERRUNS]:
            assert np.abs(command - commands[0]).max() < 0.05 * size
    assert size > 0.05


@pytest.mark.campaign
@pytest.mark.parametrize("of_target", [False, True])
def test_a_runner_that_falls_silent_is_rested_by_the_watchdog(serving: Serve, of_target: bool) -> None:
    server, rig = serving(of_target, 0.3)
    rig.open()
    rig.arm()
    for volts in 0.004 * np.arange(100):
        rig.exchange(float(volts))
    last = time.monotonic()
    frame = None
    while frame is None or frame.order != AT_REST:
        frame = rig.asked(0.1) or frame
        assert time.monotonic() - last < 10.0
    assert frame.faults == 1 and frame.command_v == 0.0
    assert server.door.session[udp_target.FAULTS] == 1
    rig.close()


def test_serve_says_what_may_not_be_one_end_of_a_cable(tmp_path: Path) -> None:
    request = ServeRequest(
        "aps400_virtual", "three_storey", "0.0.0.0", 0, tmp_path / "key", 0.15, 0.1, 0, (), "8.8.8.8:0", True,
    )  # fmt: skip
    from rths_cli.errors import InputError

    with pytest.raises(InputError) as refused:
        serve(request, lambda told: None)
    assert [fault.partition(":")[0] for fault in refused.value.faults] == ["--host", "--peer", "--peer", "--key-file"]
    assert "which is every interface" in refused.value.faults[0] and "got 8.8.8.8" in refused.value.faults[1]
