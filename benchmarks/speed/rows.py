"""Rows of the table: what was measured, against which demand, and the times behind it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from campaigns.step_run import Bind, Inputs, fresh

RATIO = "x"  # the unit of a ratio


@dataclass(frozen=True)
class Row:
    """One figure with its unit, its largest demanded value (None: no demand), and what stands behind it.

    A figure that could not be measured is None.
    """

    what: str
    figure: float | None
    unit: str
    demand: float | None = None
    behind: str = ""

    @property
    def verdict(self) -> str:
        """Return whether the demand holds, nothing where there is none."""
        if self.demand is None or self.figure is None:
            return ""
        return "holds" if self.figure <= self.demand else "MISSED"


def text(rows: Sequence[Row]) -> str:
    """Return the table, ratios first."""
    ordered = sorted(rows, key=lambda row: row.unit != RATIO)
    cells = [("what", "figure", "demand", "verdict", "behind it")]
    cells += [(r.what, _number(r.figure, r.unit), _number(r.demand, r.unit), r.verdict, r.behind) for r in ordered]
    wide = [max(len(line[i]) for line in cells) for i in range(4)]
    return "\n".join(
        f"{line[0]:<{wide[0]}}  {line[1]:>{wide[1]}}  {line[2]:>{wide[2]}}  {line[3]:<{wide[3]}}  {line[4]}".rstrip()
        for line in cells
    )


def _number(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.3g} {unit}"


def seconds(work: Callable[[], object]) -> float:
    """Return how long the work takes on this thread's processor: what others run meanwhile does not count."""
    start = time.thread_time()
    work()
    return time.thread_time() - start


def seconds_of(given: Inputs, bind: Bind) -> float:
    """Return how long a run takes that begins at rest, by whatever `bind` makes of it."""
    return seconds(bind(given, fresh(given)))


def lowest_s(work: Callable[[], object], repetitions: int) -> float:
    """Return the shortest of several durations after one warm-up."""
    work()
    return min(seconds(work) for _ in range(repetitions))


def alternating_s(one: Callable[[], float], two: Callable[[], float], pairs: int) -> tuple[list[float], list[float]]:
    """Return durations of two works, one after the other and over again: what slows the machine slows both."""
    measured = [(one(), two()) for _ in range(pairs)]
    return [first for first, _ in measured], [second for _, second in measured]


def difference(one: np.ndarray, two: np.ndarray) -> float:
    """Return the largest difference of two series over the peak of the first."""
    return float(np.abs(one - two).max() / np.abs(one).max())
