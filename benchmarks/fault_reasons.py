"""Whether the reason that a stopped test names first is the true one, a group that contains it, or a false one.

python benchmarks/fault_reasons.py [RUNS] [--seed N] [--amplitude X] [--kind WORD] [--workers N]

Sensors, amplifier, table and source fail at RUNS random instants each (20 by default) on the virtual table of
tests/helpers/faulty_rig.py, with and without a limit on the tracking error: without one, another limit comes first.
`--amplitude` multiplies the motion of the table, 10 mm otherwise; a run that was stopped before its fault is counted as
too early.
Then a target freezes or its answers are lost, in simulated time, in a hybrid test (tests/helpers/freezing.py).
Exit code 1 when one reason is false. A fault that stops nothing is counted apart.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from options import arguments, parsed

TREE = Path(__file__).parents[1]
sys.path[:0] = [str(TREE), str(TREE / "tests" / "helpers")]

import faulty  # noqa: E402
from freezing import HOLDS, PAUSED, Freezing, freezing_of, told  # noqa: E402
from told_causes import FAILED, LINK, verdict  # noqa: E402

from rths_cli.loop.guard import END, LOST, NONE  # noqa: E402

SHORT = ("1", "--kind", "stuck")
PRINTS = "^all "  # the short form at its end

RECORD, RATE_HZ = 8_000, 1_000
FREEZES_MS = (22, 34, 50, 100)
NOT_STOPPED, TOO_EARLY = "not stopped", "too early"


def of_fault(name: str, tracked: bool, amplitude: float, seed: int) -> tuple[str, str]:
    """Return the verdict on one run with a faulty rig, and the sentence."""
    info = faulty.bench_info()
    if not tracked:
        info = replace(info, limits=replace(info.limits, tracking_error_m_s2=np.inf))
    ended = faulty.performed(name, seed, info, amplitude)
    if ended.reason in (END, NONE):
        return NOT_STOPPED, ""
    if ended.taken_over < ended.at:
        return TOO_EARLY, ""
    return verdict(FAILED[name], ended.sentence), ended.sentence


@cache
def laboratory() -> Freezing:
    return freezing_of(RECORD, RATE_HZ)


def of_freeze(mode: int, length_ms: int, seed: int) -> tuple[str, str]:
    """Return the same of a target that gave no answer for so long."""
    at = RATE_HZ + int(np.random.default_rng((seed, length_ms)).integers(1_500, 6_500))
    run, _ = laboratory().run(np.array([at]), length_ms * RATE_HZ // 1000, mode)
    if run.guard.flags[1] == END:
        return NOT_STOPPED, ""
    sentence = told(run)
    return ("true" if run.guard.flags[1] == LOST else verdict({LINK}, sentence)), sentence


def played(
    runs: int, seed: int, amplitude: float, word: str, workers: int
) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Play every kind; yield its name, and what each run came to."""
    rows = {
        f"{name}{'' if tracked else ', no tracking limit'}": partial(of_fault, name, tracked, amplitude)
        for name in FAILED
        for tracked in (True, False)
    }
    for what, mode in (("target holds", HOLDS), ("target and table paused", PAUSED)):
        rows |= {f"{what} for {length} ms": partial(of_freeze, mode, length) for length in FREEZES_MS}
    with ProcessPoolExecutor(workers) as pool:
        for name, once in rows.items():
            if word in name:
                yield name, list(pool.map(once, range(seed, seed + runs)))


def line(name: str, counts: Counter[str]) -> str:
    """Return a row of the table."""
    judged = f"{counts['true']:5} {counts['group']:6} {counts['false']:6}"
    return f"{name:52} {judged} {counts[NOT_STOPPED]:12} {counts[TOO_EARLY]:10}"


def main() -> int:
    """Print a line per kind; return 1 when one reason is false."""
    asked = arguments(__doc__)
    asked.add_argument("runs", nargs="?", type=int, default=20)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--amplitude", type=float, default=1.0)
    asked.add_argument("--kind", default="", help="only kinds whose name holds this")
    asked.add_argument("--workers", type=int, default=1)
    words = parsed(asked, SHORT)
    total: Counter[str] = Counter()
    print(f"{'kind':52} {'true':>5} {'group':>6} {'false':>6} {NOT_STOPPED:>12} {TOO_EARLY:>10}")
    for name, found in played(words.runs, words.seed, words.amplitude, words.kind, words.workers):
        counts = Counter(one for one, _ in found)
        total += counts
        print(line(name, counts), flush=True)
        for sentence in sorted({text for one, text in found if one == "false"}):
            print(f"    {sentence}")
    print(line("all", total))
    return 1 if total["false"] else 0


if __name__ == "__main__":
    sys.exit(main())
