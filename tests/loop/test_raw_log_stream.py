"""The thread that keeps what a loop notes: nothing is lost, and a failing disk stops the loop without holding it up."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rths_cli.files import raw_log
from rths_cli.files.raw_log import RawHeader, RawLogWriter, read_raw_log
from rths_cli.loop import run_log
from rths_cli.loop.run_log import CTRL_C, GO_ON, LOG_LOST, LogStream

STEPS = 400
HEADER = RawHeader(
    ("command_v", "base_shear_n"),
    ("V", "N"),
    0.001,
    STEPS,
    2,
    "exp_rths",
    "a.h5",
    "a.yaml",
    "a: 1",
    "a: 1",
    {"seed": 0},
)


def log_threads() -> list[threading.Thread]:
    """Return the threads of this process that write a raw log."""
    return [thread for thread in threading.enumerate() if thread.name == "rths-log"]


class Loop:
    """Columns, counter and orders of a loop that notes value `step + column / 8`."""

    def __init__(self) -> None:
        self.columns = np.full((2, STEPS), np.nan)
        self.done = np.zeros(1, dtype=np.int64)
        self.orders = np.zeros(1, dtype=np.int64)

    def advance(self, steps: int) -> None:
        for k in range(self.done[0], self.done[0] + steps):
            self.columns[:, k] = k + np.arange(2) / 8
            self.done[0] = k + 1


@pytest.fixture
def log(tmp_path: Path) -> Iterator[RawLogWriter]:
    with RawLogWriter(tmp_path / "a.rthslog", HEADER) as opened:
        yield opened


def in_file(log: RawLogWriter) -> np.ndarray:
    """Return what would be read if this process were killed now: a copy is not locked."""
    copy = log.path.with_suffix(".copy")
    copy.write_bytes(log.path.read_bytes())
    return read_raw_log(copy).columns


def wait_for(what: object) -> None:
    """Wait until a condition holds, for at most 20 s."""
    assert callable(what)
    deadline = time.monotonic() + 20.0
    while not what() and time.monotonic() < deadline:
        time.sleep(0.005)
    assert what()


def expected(steps: int) -> np.ndarray:
    return np.arange(steps) + np.arange(2)[:, None] / 8


def test_what_is_noted_stands_in_the_file_while_the_loop_runs_and_all_of_it_afterwards(log: RawLogWriter) -> None:
    loop = Loop()
    with LogStream(log, loop.columns, loop.done, loop.orders) as streamed:
        for done in (1, 70, 250):
            loop.advance(done - int(loop.done[0]))
            wait_for(lambda done=done: streamed.written == done)
            np.testing.assert_array_equal(in_file(log), expected(done))
        loop.advance(37)
    assert (streamed.fault, loop.orders[0], streamed.written) == ("", GO_ON, 287)
    assert streamed.worst_lag_s == pytest.approx(0.180)  # of the frame from step 70 to step 250
    np.testing.assert_array_equal(in_file(log), expected(287))
    streamed.finish()


def test_a_loop_that_raises_ends_the_thread(log: RawLogWriter) -> None:
    loop = Loop()
    with pytest.raises(KeyboardInterrupt), LogStream(log, loop.columns, loop.done, loop.orders):
        loop.advance(5)
        raise KeyboardInterrupt
    assert in_file(log).shape == (2, 5)
    assert not [thread for thread in threading.enumerate() if thread.name == "rths-log"]


@pytest.mark.parametrize("call", ["pwrite", "fdatasync"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_failing_disk_stops_the_loop_and_memory_keeps_everything(
    log: RawLogWriter, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    loop = Loop()
    real = getattr(os, call)
    with LogStream(log, loop.columns, loop.done, loop.orders) as streamed:
        loop.advance(50)
        wait_for(lambda: streamed.written == 50)

        causes = [number]

        def refuse(*_: object) -> None:
            causes.append(errno.EBUSY)
            raise OSError(causes[-2], os.strerror(causes[-2]))

        monkeypatch.setattr(raw_log.os, call, refuse)
        loop.advance(50)
        wait_for(lambda: loop.orders[0] == LOG_LOST)
        loop.advance(100)  # the loop leads the table to rest
        wait_for(lambda: len(causes) > 2)
        assert streamed.fault == f"{log.path}: cannot write the raw log: {os.strerror(number)}"  # the first cause
        np.testing.assert_array_equal(loop.columns[:, :200], expected(200))
        monkeypatch.setattr(raw_log.os, call, real)
    assert streamed.fault and in_file(log).shape == (2, 200)  # once the disk takes them again


def test_another_order_is_not_overwritten(log: RawLogWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Loop()
    loop.orders[0] = CTRL_C
    monkeypatch.setattr(log, "append", lambda *_: 1 / 0)  # a bug of ours counts like a broken disk
    with LogStream(log, loop.columns, loop.done, loop.orders) as streamed:
        loop.advance(1)
        wait_for(lambda: streamed.fault)
    assert loop.orders[0] == CTRL_C and "ZeroDivisionError: division by zero" in streamed.fault


def test_a_disk_that_does_not_answer_holds_nobody_up_for_ever(
    log: RawLogWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, answers = Loop(), threading.Event()
    monkeypatch.setattr(run_log, "PATIENCE_S", 0.05)
    monkeypatch.setattr(raw_log.os, "fdatasync", lambda file: answers.wait(20))
    with LogStream(log, loop.columns, loop.done, loop.orders) as streamed:
        loop.advance(1)
    assert "a.rthslog: cannot write the raw log: the disk has not answered for 0.05 s" in streamed.fault
    reserved = log.path.stat().st_size
    log.close()
    assert log.path.stat().st_size == reserved  # the file is left to the call that holds it
    (thread,) = log_threads()
    answers.set()
    thread.join(20)
    assert not thread.is_alive()


def test_other_columns_than_the_header_states_are_a_bug(log: RawLogWriter) -> None:
    loop = Loop()
    told = r"\(2, 399\), the header of the log states \(2, 400\)"
    with pytest.raises(ValueError, match=told):
        LogStream(log, loop.columns[:, 1:], loop.done, loop.orders)


@pytest.mark.skipif(
    not hasattr(os, "sched_setscheduler"), reason="scheduling classes are set where the system has them"
)
def test_the_thread_takes_no_part_in_real_time(log: RawLogWriter) -> None:
    found: list[int] = []

    def born_in_real_time() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except PermissionError:
            return
        loop = Loop()
        with LogStream(log, loop.columns, loop.done, loop.orders) as streamed:
            loop.advance(1)
            wait_for(lambda: streamed.written == 1)
            (thread,) = log_threads()
            found.append(os.sched_getscheduler(thread.native_id or 0))
            found.append(os.sched_getscheduler(0))

    maker = threading.Thread(target=born_in_real_time)
    maker.start()
    maker.join(30)
    if not found:
        pytest.skip("this machine permits no real-time class")
    assert found == [os.SCHED_OTHER, os.SCHED_FIFO]
