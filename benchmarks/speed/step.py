"""The compiled step on recorded samples against the exported one in C; the whole run on the virtual table."""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path

from campaigns import step_run
from campaigns.exported_step import EQUAL, FAST, compiled, compiler, differences, played, shipped

from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.loop.recorded_steps import conduct_over
from speed.rows import RATIO, Row, alternating_s, seconds_of

PAIRS = 25
SAME = 1e-10  # demand: difference of signals over their peaks
SLOWER, PLAIN = 1.3, 6.0  # demands: time of C over ours, compiled for this processor and for any
CONTENTS = "samples, substituted where lost, to a command behind its guard; ours writes its log, too"


def step_rows(given: step_run.Inputs) -> list[Row]:
    """Play the samples of one run by turns in ours and in C."""
    if compiler() is None:
        return [Row("C / EXP-RTHS step: no C compiler here", None, RATIO, SLOWER), _loop(given)]
    step, samples = shipped(Memory(Cache()), step_run.CASE)
    rows, count = [], len(samples.samples_v)
    with tempfile.TemporaryDirectory() as folder:
        for options, demand in ((FAST, SLOWER), (EQUAL[:1], PLAIN)):
            library = compiled(step, Path(folder), options)
            theirs, ours = alternating_s(
                lambda library=library: played(library, samples).seconds,  # type: ignore[misc]
                lambda: conduct_over(step.info, step.blocks, step.limits, samples).seconds,
                PAIRS,
            )
            ratios = [one / two for one, two in zip(theirs, ours, strict=True)]
            said = f"{_ns(min(theirs), count)} against {_ns(min(ours), count)} a step; {count:,} steps: {CONTENTS}"
            rows.append(Row(f"C, {' '.join(options)}, / EXP-RTHS step", statistics.median(ratios), RATIO, demand, said))
        equal = played(compiled(step, Path(folder), EQUAL), samples)
        ours_once = conduct_over(step.info, step.blocks, step.limits, samples)
        apart = list(differences(ours_once, equal, SAME))
    return [
        *rows,
        Row("EXP-RTHS step less C, signals beyond 1e-10", float(len(apart)), RATIO, 0.0, "; ".join(apart)),
        _loop(given),
    ]


def _loop(given: step_run.Inputs) -> Row:
    ours = [seconds_of(given, step_run.bound) for _ in range(PAIRS)]
    behind = f"median; shortest {1e3 * min(ours):.1f} ms, {_ns(min(ours), len(given.drive))} a step"
    return Row("one EXP-RTHS of 54 s at 2 kHz, in the loop", 1e3 * statistics.median(ours), "ms", 20.0, behind)


def _ns(duration_s: float, steps: int) -> str:
    return f"{1e9 * duration_s / steps:.0f} ns"
