"""The loop runs in a thread of its own: whatever arrives meanwhile, the table comes to rest first."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits
from portfolio import parametrize_first

from rths_cli.loop import guard, realtime_run
from rths_cli.loop.realtime_run import perform_watched
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.numerics.clock import REAL_TIME
from rths_cli.numerics.lti import Array

pytestmark = [
    pytest.mark.skipif(not REAL_TIME, reason="real time needs Linux"),
    pytest.mark.real_time,
]


class Sitting:
    """A rig that takes 1 ms a sample and never moves; it remembers its last command and when it was let go."""

    def __init__(self) -> None:
        self.info = rig_info(dt_s=1e-3)
        self.samples, self.commands, self.rested = np.zeros(3), [], False

    def open(self) -> None: ...

    def arm(self) -> Array:
        return self.samples

    def exchange(self, command_v: float) -> Array:
        assert not self.rested, "a command after the table was told to rest"
        time.sleep(1e-3)
        self.commands.append(command_v)
        return self.samples

    def rest(self) -> None:
        self.rested = True

    def close(self) -> None: ...


class Told(BaseException):
    """Stands for the command line's SIGTERM."""


@pytest.fixture
def handlers() -> Iterator[None]:
    def terminated(number: int, frame: object) -> None:
        raise Told

    before = signal.getsignal(signal.SIGINT), signal.signal(signal.SIGTERM, terminated)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before[0])
    signal.signal(signal.SIGTERM, before[1])


def run_of(rig: Sitting, seconds: float = 20.0) -> realtime_run.Performance:
    """Return a run that holds the table at 7.9 mm, from where the way to rest takes more than a second."""
    drive = np.column_stack([np.ones(round(1e3 * seconds)), np.zeros((round(1e3 * seconds), 2))])
    return realtime_run.prepare(rig.info, best_like(rig.info), EXCITATION, drive, open_limits(rig.info), ramp_s=0.0)


@pytest.fixture(autouse=True, scope="module")
def compiled() -> None:
    """Have the loop compiled before signals are sent to it."""
    rig = Sitting()
    realtime_run.perform(rig, run_of(rig, 0.01))


@pytest.mark.usefixtures("handlers")
@parametrize_first(
    1,
    ("numbers", "reason"),
    [
        ((signal.SIGINT,), guard.INTERRUPT),
        ((signal.SIGTERM,), guard.TERMINATION),
        ((signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGINT), guard.INTERRUPT),
    ],
    ids=["Ctrl-C", "SIGTERM", "several"],
)
def test_signals_end_in_rest_and_the_first_one_is_the_reason(numbers: tuple[int, ...], reason: int) -> None:
    rig = Sitting()

    def send() -> None:
        while len(rig.commands) < 50:
            time.sleep(0.01)
        for number in numbers:
            time.sleep(0.2)
            os.kill(os.getpid(), number)

    sender = threading.Thread(target=send)
    sender.start()
    done = perform_watched(rig, run_of(rig), lambda _: None)
    sender.join()
    assert done.outcome.reason == reason
    assert rig.rested and rig.commands[-1] == 0.0
    assert 1000 < len(rig.commands) < 3000


def test_a_watcher_that_fails_rests_the_table_and_is_told() -> None:
    rig = Sitting()

    def watch(run: realtime_run.Performance) -> None:
        raise ZeroDivisionError("a fault of the screen")

    done = perform_watched(rig, run_of(rig), watch)
    assert "ZeroDivisionError" in done.watch_fault
    assert done.outcome.reason == guard.WATCHER_FAILED
    assert rig.rested and rig.commands[-1] == 0.0
