"""The compiled step on the virtual table against C of the same blocks."""

from __future__ import annotations

import statistics
import tempfile
from functools import partial
from pathlib import Path

from speed import in_c, play
from speed.rows import RATIO, Row, alternating_s, difference

PAIRS = 25
SAME = 1e-9
CONTENTS = "noise, quantisation, friction, guard, log, and a look at the time every 16 steps"


def step_rows(given: play.Inputs) -> list[Row]:
    """Play the run by turns in ours and in C."""
    if in_c.compiler() is None:
        return [Row("EXP-RTHS step / C: no C compiler here", None, RATIO, 1.2), _alone(given)]
    with tempfile.TemporaryDirectory() as folder:
        library = in_c.compiled(Path(folder))
        bind_c = partial(in_c.bound, library)
        apart = _apart(given, bind_c)
        ours, theirs = alternating_s(
            lambda: play.seconds_of(given, play.bound), lambda: play.seconds_of(given, bind_c), PAIRS
        )
    return _rows(len(given.drive), ours, theirs, apart)


def _rows(steps: int, ours: list[float], theirs: list[float], apart: float) -> list[Row]:
    ratios = [one / two for one, two in zip(ours, theirs, strict=True)]
    per_step = f"{_ns(min(ours), steps)} against {_ns(min(theirs), steps)} a step"
    pairs = f"lowest pair {min(ratios):.2f}, highest {max(ratios):.2f}; {steps:,} steps: {CONTENTS}"
    return [
        Row(f"EXP-RTHS step / C, median of {PAIRS} pairs", statistics.median(ratios), RATIO, 1.2, pairs),
        Row("EXP-RTHS step / C, shortest of each", min(ours) / min(theirs), RATIO, 1.2, per_step),
        Row("EXP-RTHS step less C, signals, of their peaks", apart, RATIO, SAME, ", ".join(play.SIGNALS)),
        _loop(steps, ours),
    ]


def _alone(given: play.Inputs) -> Row:
    return _loop(len(given.drive), [play.seconds_of(given, play.bound) for _ in range(PAIRS)])


def _loop(steps: int, ours: list[float]) -> Row:
    behind = f"median; shortest {1e3 * min(ours):.1f} ms, {_ns(min(ours), steps)} a step"
    return Row("one EXP-RTHS of 54 s at 2 kHz, in the loop", 1e3 * statistics.median(ours), "ms", 20.0, behind)


def _apart(given: play.Inputs, bind_c: play.Bind) -> float:
    """Return by how much the signals of both differ at most, of the peak of each (infinite when one stops early)."""
    ours, theirs = play.fresh(given), play.fresh(given)
    done = play.bound(given, ours)(), bind_c(given, theirs)()
    if done != (len(given.drive), len(given.drive)):
        return float("inf")
    return max(difference(getattr(ours.signals, name), getattr(theirs.signals, name)) for name in play.SIGNALS)


def _ns(duration_s: float, steps: int) -> str:
    return f"{1e9 * duration_s / steps:.0f} ns"
