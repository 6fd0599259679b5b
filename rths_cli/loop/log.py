"""The log of a run: every signal of every step, written by compiled code, read as named series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rths_cli.clocks import IntArray
from rths_cli.compiled import part
from rths_cli.loop.blocks import Step
from rths_cli.lti import Array

SEVERAL = ("true_velocity_m_s", "corrected", "desired", "estimated")  # signals of more than one row


class Log(NamedTuple):
    """Every signal of n steps in w columns, in the order of `widths`; NaN after the last step.

    `truths`: channels whose true motion is known (of a virtual rig), or 0. A lean log keeps true velocities and
    accelerations alone.
    """

    columns: Array  # (w, n) signal after signal
    done: IntArray  # (1,) steps that stand there
    truths: int
    lean: bool


@dataclass(frozen=True)
class Signals:
    """What a log holds, by name: views of its columns, c channels, e estimator outputs; of no row where not kept."""

    true_velocity_m_s: Array  # (c, n) in the middle between t_k and t_k+1 (virtual rigs)
    corrected: Array  # (c, n) corrected accelerations at k
    desired: Array  # (3, n) acceleration, velocity, displacement at k + n_p; (1, n) of a lean log
    command_v: Array  # (n,) as it left the guard
    base_shear_n: Array  # (n,) at k + n_p
    estimated: Array  # (e, n) estimator outputs at k
    true_displacement_m: Array  # (n,) of the table at t_k (virtual rigs)
    compute_ns: Array  # (n,) duration of step and guard; on a virtual rig, of the rig as well, mean of 16 steps


def widths(channels: int, estimates: int, truths: int, lean: bool) -> dict[str, int]:
    """Return how many columns each signal has, in their order."""
    if lean:
        return {"true_velocity_m_s": truths, "corrected": channels, "desired": 1}
    return {
        "true_velocity_m_s": truths,
        "corrected": channels,
        "desired": 3,
        "command_v": 1,
        "base_shear_n": 1,
        "estimated": estimates,
        "true_displacement_m": min(truths, 1),
        "compute_ns": 1,
    }


def empty_log(steps: int, channels: int, estimates: int, lean: bool = False, truths: int = 0) -> Log:
    """Return a log full of NaN; `lean` and `truths` as in Log."""
    count = sum(widths(channels, estimates, truths, lean).values())
    return Log(np.full((count, steps), np.nan), np.zeros(1, dtype=np.int64), truths, lean)


def signals(log: Log, channels: int, estimates: int) -> Signals:
    """Return the columns of a log by name: c channels, e estimator outputs."""
    named = dict.fromkeys(Signals.__dataclass_fields__, log.columns[:0])
    first = 0
    for name, count in widths(channels, estimates, log.truths, log.lean).items():
        named[name] = log.columns[first : first + count]
        first += count
    return Signals(**{name: rows if name in SEVERAL else rows.reshape(-1) for name, rows in named.items()})


@part
def note_step(log: Log, s: Step, command: float, k: int) -> int:
    """Note what step k knows; return the first column after it."""
    to, at = log.columns, log.truths
    for i in range(s.corrected.size):
        to[at + i, k] = s.corrected[i]
    at += s.corrected.size
    to[at, k] = s.interface[0]
    if log.lean:
        return at + 1
    to[at + 1, k] = s.interface[1]
    to[at + 2, k] = s.interface[2]
    to[at + 3, k] = command
    to[at + 4, k] = s.base_shear[0]
    at += 5
    for i in range(s.estimated.size):
        to[at + i, k] = s.estimated[i]
    return at + s.estimated.size
