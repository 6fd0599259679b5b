"""Signals and a failing live view while a table moves: the loop leads it to rest, whoever asks and however often."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import faulty
import numpy as np
import pytest
from faulty import FaultyRig, bench_info
from portfolio import parametrize_first

from rths_cli.loop import guard as g
from rths_cli.loop import realtime_run as performance
from rths_cli.loop.realtime_run import Performance, Performed, perform_watched, rehearse_watched
from rths_cli.loop.step_arrays import NUMERICAL

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]


def slow_run(record: int = 1200) -> tuple[FaultyRig, Performance]:
    """Return a rig whose exchange takes a while, as those of hardware do, so that there is time for a signal."""
    rig = FaultyRig(bench_info())
    rig.event = lambda k: time.sleep(2e-4)
    drive = faulty.shaken()[:record].copy()
    orders = np.zeros(1, dtype=np.int64)
    run = performance.prepare(
        bench_info(), faulty.blocks(), NUMERICAL, drive, faulty.guard_of(rig.info), None, orders, 0.1
    )
    return rig, run


@contextmanager
def taken_before(*numbers: int) -> Iterator[list[int]]:
    """Take signals as the command line does: note them and raise."""
    noted: list[int] = []

    def take(number: int, frame: object) -> None:
        noted.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, take) for number in numbers}
    try:
        yield noted
        assert all(signal.getsignal(number) is take for number in numbers)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def performed_with_signals(*numbers: int) -> tuple[FaultyRig, Performance, Performed]:
    """Send signals to this process, one with every 50th step from the 300th on."""
    rig, run = slow_run()

    def event(k: int) -> None:
        time.sleep(2e-4)
        if k >= 300 and k % 50 == 0 and (k - 300) // 50 < len(numbers):
            os.kill(os.getpid(), numbers[(k - 300) // 50])

    rig.event = event
    return rig, run, perform_watched(rig, run, lambda _: None)


@parametrize_first(
    2,
    ("numbers", "reason"),
    [
        ((signal.SIGINT,), g.INTERRUPT),
        ((signal.SIGTERM,), g.TERMINATION),
        ((signal.SIGHUP,), g.TERMINATION),
        ((signal.SIGINT,) * 6, g.INTERRUPT),
        ((signal.SIGTERM, signal.SIGINT, signal.SIGTERM), g.TERMINATION),
    ],
)
def test_signals_lead_to_rest_and_the_outcome_is_that_of_a_table_at_rest(numbers: tuple[int, ...], reason: int) -> None:
    with taken_before(*set(numbers)) as noted:
        rig, run, performed = performed_with_signals(*numbers)
    assert noted == list(numbers)
    assert performed.outcome.reason == reason
    assert run.guard.flags[0] == g.STOPPED
    assert rig.commands[-1] == 0.0 and rig.rested == 1
    assert not [thread for thread in threading.enumerate() if thread.name == "rths-loop"]
    assert 300 <= run.guard.flags[3] < 600
    assert faulty.beyond_limits(rig.info, np.array(rig.commands)) == []


def test_a_failing_live_view_stops_the_test_and_its_samples_are_kept(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    rig, run = slow_run()

    def watch(performance: Performance) -> None:
        if performance.log.done[0] > 200:
            raise BrokenPipeError("the terminal is gone")

    performed = perform_watched(rig, run, watch)
    assert performed.outcome.reason == g.WATCHER_FAILED
    assert performed.watch_fault.startswith("BrokenPipeError, details in ")
    assert "the terminal is gone" in next(tmp_path.glob("rths-crash-*")).read_text()
    assert rig.commands[-1] == 0.0 and run.guard.flags[0] == g.STOPPED
    assert np.isfinite(performed.outcome.log.command_v[:100]).all()


def test_a_signal_that_a_watcher_raises_is_an_order() -> None:
    rig, run = slow_run()
    raised = []

    def watch(performance: Performance) -> None:
        if not raised:
            raised.append(True)
            raise KeyboardInterrupt

    assert perform_watched(rig, run, watch).outcome.reason == g.INTERRUPT
    assert rig.commands[-1] == 0.0


@pytest.mark.campaign
def test_a_signal_ends_a_rehearsal_at_once() -> None:
    """Nothing moves yet: there is nothing to be led to rest."""
    info, still = bench_info(), np.zeros((20_000, 3))
    first, run = (performance.prepare(info, faulty.blocks(), NUMERICAL, still, faulty.guard_of(info)) for _ in range(2))
    performance.rehearse(first, 0.01)  # compiled before the signal comes
    number = signal.SIGTERM
    with taken_before(number) as noted:
        threading.Timer(0.3, os.kill, (os.getpid(), number)).start()
        with pytest.raises(KeyboardInterrupt):
            rehearse_watched(run, 20.0)
    assert noted == [number]
    for thread in [thread for thread in threading.enumerate() if thread.name == "rths-loop"]:
        thread.join(20.0)
        assert not thread.is_alive()
    assert run.guard.flags[0] == g.STOPPED and 0 < run.log.done[0] < 20_000  # the process would wait for it
