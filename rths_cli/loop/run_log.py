"""The log of a run: every signal of every step, written by compiled code, read as named series, streamed to its raw
log file."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rths_cli.files.raw_log import RawLogWriter
from rths_cli.loop.step_arrays import Step
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import kept_part, part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.quantities.datasets import RAW_LOG_COLUMNS

SEVERAL = (
    "true_velocity_m_s",
    "corrected",
    "further",
    "desired",
    "estimated",
    "logged",
    "samples_v",
    "further_v",
)  # always numbered
"""Signals whose columns are always numbered."""
DESIRED = ("desired_accel_m_s2", "desired_velocity_m_s", "desired_displacement_m")

GO_ON, STOP_KEY, CTRL_C, SIGTERM, LOG_LOST = range(5)  # orders[0], read by the loop in every step
PERIOD_S = 0.05
PATIENCE_S = 10.0


class Sizes(NamedTuple):
    """How many values of each kind a step has."""

    channels: int
    estimates: int
    logged: int = 0  # by the parts
    axes: int = 1  # degrees of freedom of the interface
    actuators: int = 1
    further: int = 0  # channels beside the accelerometers


def sizes_of(s: Step) -> Sizes:
    """Return the sizes of a step."""
    further = s.corrected.size - s.accelerometers
    return Sizes(s.accelerometers, s.estimated.size, s.logged, len(s.measured_by), len(s.actuators), further)


class Log(NamedTuple):
    """All signals of n steps in w columns, in the order of `widths`; NaN after the last step."""

    columns: Array  # (w, n) signal after signal
    done: IntArray  # (1,) number of steps in it
    truths: int  # number of channels whose true motion is logged (virtual rig), or 0
    lean: bool  # whether only true velocities, corrected and desired accelerations are logged


@dataclass(frozen=True)
class Signals:
    """The signals of a log by name, as views of its columns: c accelerometers, f further channels, e estimator outputs,
    i degrees of freedom, a commands; empty if not logged."""

    true_velocity_m_s: Array  # (c, n) in the middle between t_k and t_k+1 (virtual rigs)
    corrected: Array  # (c, n) corrected accelerations at k
    further: Array  # (f, n) values of the further channels at k, each in its unit
    desired: Array  # (3 i, n) accelerations, velocities, displacements at k + n_p; (i, n) of a lean log
    command_v: Array  # (n,) as it left the guard; (a, n) of several
    base_shear_n: Array  # (n,) interface force at k + n_p; (i, n) of several
    estimated: Array  # (e, n) estimator outputs at k
    logged: Array  # (l, n) what the parts log, in the order of Blocks.logs
    true_displacement_m: Array  # (n,) of the table at t_k (virtual rigs)
    compute_ns: Array  # (n,) duration of step and guard; on a virtual rig, of the rig as well, mean of 16 steps
    samples_v: Array  # (c, n) as the rig gave them (real time)
    further_v: Array  # (f, n) the same of the further channels
    late_ns: Array  # (n,) delay at which the exchange for the samples of step k began (real time)
    exchange_ns: Array  # (n,) its duration (real time)
    lost: Array  # (n,) 0, or NO_ANSWER, CAUGHT_UP or MIXED (real time)
    state: Array  # (n,) RAMP_UP, RUNNING, RAMP_DOWN, STOPPED (real time)


def widths(sizes: Sizes, truths: int, lean: bool) -> dict[str, int]:
    """Return how many columns each signal has, in their order."""
    channels, axes = sizes.channels, sizes.axes
    if lean:
        return {"true_velocity_m_s": truths, "corrected": channels, "further": sizes.further, "desired": axes}
    if truths:
        own = {"true_displacement_m": 1, "compute_ns": 1}
    else:
        own = {"samples_v": channels, "further_v": sizes.further}
        own |= {"late_ns": 1, "exchange_ns": 1, "lost": 1, "state": 1, "compute_ns": 1}
    common = {"true_velocity_m_s": truths, "corrected": channels, "further": sizes.further, "desired": 3 * axes}
    made = {"command_v": sizes.actuators, "base_shear_n": axes, "estimated": sizes.estimates, "logged": sizes.logged}
    return {**common, **made, **own}


def column_names(sizes: Sizes) -> tuple[str, ...]:
    """Return a name for each column of the log of a run on a real rig, as declared in RAW_LOG_COLUMNS.

    Signals that always may have several columns are numbered, others where they have several.
    """
    names: list[str] = []
    for name, count in widths(sizes, truths=0, lean=False).items():
        signals_of = [(one, sizes.axes) for one in DESIRED] if name == "desired" else [(name, count)]
        for one, each in signals_of:
            names += [f"{one}_{i}" for i in range(each)] if one in SEVERAL or each > 1 else [one] * each
    return tuple(names)


def column_units(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the unit of each column named by `column_names`."""
    of_one = [name if name in RAW_LOG_COLUMNS else name.rpartition("_")[0] for name in names]
    return tuple(RAW_LOG_COLUMNS[name].units for name in of_one)


def empty_log(steps: int, sizes: Sizes, lean: bool = False, truths: int = 0) -> Log:
    """Return a log full of NaN; `lean` and `truths` as in Log."""
    count = sum(widths(sizes, truths, lean).values())
    return Log(np.full((count, steps), np.nan), np.zeros(1, dtype=np.int64), truths, lean)


def signals(log: Log, sizes: Sizes) -> Signals:
    """Return the columns of a log by name."""
    named = dict.fromkeys(Signals.__dataclass_fields__, log.columns[:0])
    first = 0
    for name, count in widths(sizes, log.truths, log.lean).items():
        named[name] = log.columns[first : first + count]
        first += count
    alone = {name: rows.reshape(-1) for name, rows in named.items() if name not in SEVERAL and len(rows) < 2}
    return Signals(**{**named, **alone})


@kept_part
def note_step(log: Log, s: Step, k: int) -> int:
    """Log the signals of step k; return the first column after them."""
    to, at = log.columns, log.truths
    for i in range(s.corrected.size):
        to[at + i, k] = s.corrected[i]
    at += s.corrected.size
    for q in range(1 if log.lean else 3):
        for i in range(len(s.measured_by)):
            to[at, k] = s.motion[q, i]
            at += 1
    if log.lean:
        return at
    for a in range(len(s.actuators)):
        to[at + a, k] = s.command[a]
    at += len(s.actuators)
    for i in range(len(s.measured_by)):
        to[at + i, k] = s.force[i]
    at = noted(s.estimated, to, at + len(s.measured_by), k)
    if s.logged > 0:
        at = noted(s.numerical.logged, to, at, k)
        at = noted(s.feedforward.logged, to, at, k)
        at = noted(s.feedback.logged, to, at, k)
    return at


@part
def noted(values: Array, to: Array, at: int, k: int) -> int:
    """Write values (n,) of step k into columns from `at` on; return the first column after them."""
    for i in range(values.size):
        to[at + i, k] = values[i]
    return at + values.size


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
