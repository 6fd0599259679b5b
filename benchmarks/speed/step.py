"""The compiled step on the virtual table against C of the same blocks."""

from __future__ import annotations

import statistics
import tempfile
from functools import partial
from pathlib import Path

from campaigns import step_in_c, step_run

from speed.rows import RATIO, Row, alternating_s, difference, seconds_of

PAIRS = 25
SAME, SLOWER = 1e-12, 1.1  # demands: difference of signals over their peaks, time over that of C
CONTENTS = "noise, quantisation, friction, guard, log, and a look at the time every 16 steps"


def step_rows(given: step_run.Inputs) -> list[Row]:
    """Play the run by turns in ours and in C."""
    if step_in_c.compiler() is None:
        return [Row("EXP-RTHS step / C: no C compiler here", None, RATIO, SLOWER), _alone(given)]
    with tempfile.TemporaryDirectory() as folder:
        library = step_in_c.compiled(Path(folder))
        bind_c = partial(step_in_c.bound, library)
        apart = _apart(given, bind_c)
        ours, theirs = alternating_s(
            lambda: seconds_of(given, step_run.bound), lambda: seconds_of(given, bind_c), PAIRS
        )
    return _rows(len(given.drive), ours, theirs, apart)


def _rows(steps: int, ours: list[float], theirs: list[float], apart: float) -> list[Row]:
    ratios = [one / two for one, two in zip(ours, theirs, strict=True)]
    per_step = f"{_ns(min(ours), steps)} against {_ns(min(theirs), steps)} a step"
    pairs = f"lowest pair {min(ratios):.2f}, highest {max(ratios):.2f}; {steps:,} steps: {CONTENTS}"
    return [
        Row(f"EXP-RTHS step / C, median of {PAIRS} pairs", statistics.median(ratios), RATIO, SLOWER, pairs),
        Row("EXP-RTHS step / C, shortest of each", min(ours) / min(theirs), RATIO, SLOWER, per_step),
        Row("EXP-RTHS step less C, signals, of their peaks", apart, RATIO, SAME, ", ".join(step_run.SIGNALS)),
        _loop(steps, ours),
    ]


def _alone(given: step_run.Inputs) -> Row:
    return _loop(len(given.drive), [seconds_of(given, step_run.bound) for _ in range(PAIRS)])


def _loop(steps: int, ours: list[float]) -> Row:
    behind = f"median; shortest {1e3 * min(ours):.1f} ms, {_ns(min(ours), steps)} a step"
    return Row("one EXP-RTHS of 54 s at 2 kHz, in the loop", 1e3 * statistics.median(ours), "ms", 20.0, behind)


def _apart(given: step_run.Inputs, bind_c: step_run.Bind) -> float:
    """Return by how much the signals of both differ at most, of the peak of each (infinite when one stops early)."""
    ours, theirs = step_run.fresh(given), step_run.fresh(given)
    done = step_run.bound(given, ours)(), bind_c(given, theirs)()
    if done != (len(given.drive), len(given.drive)):
        return float("inf")
    return max(difference(getattr(ours.signals, name), getattr(theirs.signals, name)) for name in step_run.SIGNALS)


def _ns(duration_s: float, steps: int) -> str:
    return f"{1e9 * duration_s / steps:.0f} ns"
