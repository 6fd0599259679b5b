"""Waiting for deadlines: never too early, all of them waited for, a signal does not wake it up."""

from __future__ import annotations

import signal
import sys
import time

import numpy as np
import pytest

from rths_cli.loop.scheduling import wait_periodically, wake_up_delays
from rths_cli.numerics.clock import IntArray, monotonic_ns, sleep_until, spin_of
from rths_cli.numerics.compiled import entry

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only")
MS = 1_000_000


@entry
def wait_for(deadline_ns: int, spin_ns: int, ended: IntArray) -> int:
    late = sleep_until(deadline_ns, spin_ns, ended)
    ended[2] = monotonic_ns(ended)
    return late


@pytest.mark.parametrize("spin_ns", [0, 60_000, 10 * MS])
def test_a_wait_ends_at_its_deadline_or_later_and_says_how_late(spin_ns: int) -> None:
    ended = np.zeros(3, dtype=np.int64)
    deadline = time.monotonic_ns() + 5 * MS
    late = wait_for(deadline, spin_ns, ended)
    assert late >= 0
    assert deadline + late <= ended[2] <= time.monotonic_ns()


def test_a_deadline_that_has_passed_is_not_waited_for() -> None:
    passed = time.monotonic_ns() - 7 * MS
    assert wait_for(passed, 60_000, np.zeros(3, dtype=np.int64)) >= 7 * MS


def test_it_sleeps_and_does_not_only_spin() -> None:
    """Used processor time tells sleep from spinning: 0.3 s of waiting take far less than half of it."""
    ended = np.zeros(3, dtype=np.int64)
    wait_for(0, 0, ended)
    before = time.thread_time_ns()
    wait_for(time.monotonic_ns() + 300 * MS, 60_000, ended)
    assert time.thread_time_ns() - before < 100 * MS


def test_a_signal_does_not_end_the_wait() -> None:
    arrived: list[int] = []
    wait_for(0, 0, np.zeros(3, dtype=np.int64))
    handler = signal.signal(signal.SIGALRM, lambda number, _: arrived.append(number))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.005, 0.005)
        deadline, before = time.monotonic_ns() + 200 * MS, time.thread_time_ns()
        assert wait_for(deadline, 0, np.zeros(3, dtype=np.int64)) >= 0
        assert time.monotonic_ns() >= deadline
        assert time.thread_time_ns() - before < 15 * MS  # it goes back to sleep
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)
    assert arrived


def test_a_periodic_loop_waits_for_every_deadline_it_has_not_missed() -> None:
    late_ns = np.full(50, -1, dtype=np.int64)
    before = time.monotonic_ns()
    wait_periodically(2 * MS, 0, late_ns, np.zeros(2, dtype=np.int64))
    took = time.monotonic_ns() - before
    missed = int((late_ns // (2 * MS)).sum())
    assert (late_ns >= 0).all()
    # from the first reading of the clock to the last deadline: one interval per step and per deadline left out
    assert took >= 2 * MS * (50 + missed - late_ns[-1] // (2 * MS)) + late_ns[-1] % (2 * MS)


def test_delays_are_measured_for_the_whole_time_asked_for() -> None:
    before = time.monotonic_ns()
    delays = wake_up_delays(1000.0, 0.3)
    assert delays.shape == (300,) and (delays >= 0).all()
    assert time.monotonic_ns() - before >= 300 * MS


@pytest.mark.parametrize(("rate_hz", "spin_us"), [(250, 250), (500, 250), (1000, 125), (2000, 62.5), (4000, 60)])
def test_before_a_deadline_it_looks_at_the_clock_for_an_eighth_of_an_interval(rate_hz: int, spin_us: float) -> None:
    assert spin_of(1_000_000_000 // rate_hz) == 1000 * spin_us
