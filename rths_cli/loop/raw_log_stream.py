"""Stream the log of a running loop to its raw log file, from a thread of its own."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

from rths_cli.files.raw_log import RawLogWriter
from rths_cli.numerics.lti import Array, Integers

GO_ON, STOP_KEY, CTRL_C, SIGTERM, LOG_LOST = range(5)  # orders[0], read by the loop in every step
PERIOD_S = 0.05
PATIENCE_S = 10.0


class LogStream:
    """Append the steps of a running loop to its raw log; use it as a context manager around the loop.

    The loop writes `columns` (w, n), then `done` (1,), and reads `orders` (1 or more,). If the log cannot be written,
    `fault` states the reason, orders[0] becomes LOG_LOST unless there is another order, and all data stay in `columns`.
    `worst_lag_s` is the longest time of data that a kill would have lost.

    Enter it before the loop takes a real-time class: the thread keeps the processors of its parent and gives up that
    class.
    """

    def __init__(self, log: RawLogWriter, columns: Array, done: Integers, orders: Integers) -> None:
        expected = (len(log.header.names), log.header.steps)
        if columns.shape != expected:
            raise ValueError(f"columns have the shape {columns.shape}, the header of the log states {expected}.")
        self.fault = ""
        self.written = 0
        self.worst_lag_s = 0.0
        self._log, self._columns, self._done, self._orders = log, columns, done, orders
        self._ended = threading.Event()
        self._finished = threading.Event()  # a signal in Thread.join makes Python 3.11 take a thread for dead
        self._thread = threading.Thread(target=self._run, name="rths-log", daemon=True)

    def __enter__(self) -> LogStream:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Finish the log."""
        self.finish()

    def finish(self) -> None:
        """Write the remaining steps and end the thread; safe to call twice.

        A disk that does not respond for 10 s is a fault; the log is then abandoned.
        """
        self._ended.set()
        if not self._finished.wait(PATIENCE_S):
            self._log.leave()
            self._fail(f"the disk has not answered for {PATIENCE_S:g} s")

    def _run(self) -> None:
        """Append until the loop has ended, and once more after that."""
        _take_no_part_in_real_time()
        ended = False
        while not ended:
            ended = self._ended.wait(PERIOD_S)
            try:
                self._append(ended)
            except Exception as error:  # any exception: the loop must stop if its data are no longer stored
                self._fail(getattr(error, "strerror", None) or f"{type(error).__name__}: {error}")
        self._finished.set()

    def _append(self, last: bool) -> None:
        done = int(self._done[0])
        if done > self.written:
            self._log.append(self.written, self._columns[:, self.written : done])
            lag = int(self._done[0]) - self.written
            self.worst_lag_s = max(self.worst_lag_s, lag * self._log.header.dt_s)
            self.written = done
        self._log.sync(at_once=last)

    def _fail(self, cause: str) -> None:
        """Store why the log cannot be written, and order the loop to stop."""
        self.fault = self.fault or f"{self._log.path}: cannot write the raw log: {cause}"
        if self._orders[0] == GO_ON:
            self._orders[0] = LOG_LOST


def _take_no_part_in_real_time() -> None:
    """Give up a real-time class that this thread inherited: the loop must never wait for it."""
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
