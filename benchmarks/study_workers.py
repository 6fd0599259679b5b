"""Throughput of a sweep by two worker processes, against two processes that know nothing of each other.

    python benchmarks/study_workers.py [--runs N] [--rounds N]

RUNS (default 200) EXP-RTHS of `el_centro_low_ff_fb`, seeds from 0 on, alternating within each of ROUNDS (default 3)
rounds: by `rths sweep --engine processes --jobs 2`, and half of the seeds in each of two commands `--engine inline`
that run at the same time. A rate is rows per second from the first rows that are there to the last one, so that start
and checks do not count. Prints both and their ratio for each round, and the median of the ratios.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from options import arguments, parsed

CASE = "el_centro_low_ff_fb"
SEEN_EACH_S = 0.02


def rate(folder: Path, calls: Sequence[tuple[str, ...]]) -> float:
    """Return the rows per second of commands that run at the same time, each from its first row to its last."""
    outputs = [folder / f"{k}.h5" for k in range(len(calls))]
    processes = [
        subprocess.Popen([sys.executable, "-m", "rths_cli", "sweep", CASE, *call, "--output", str(output), "--quiet"],
                         stdout=subprocess.DEVNULL)
        for call, output in zip(calls, outputs, strict=True)
    ]  # fmt: skip
    first: dict[Path, tuple[float, int]] = {}
    last: dict[Path, tuple[float, int]] = {}
    while any(process.poll() is None for process in processes):
        for output in outputs:
            count = rows_of(output)
            if count > 0 and (output not in last or count > last[output][1]):
                last[output] = (time.monotonic(), count)
                first.setdefault(output, last[output])
        time.sleep(SEEN_EACH_S)
    if any(process.returncode for process in processes):
        raise SystemExit("a sweep failed; run it by hand to see why")
    for output in outputs:
        output.unlink()
    return sum((last[one][1] - first[one][1]) / (last[one][0] - first[one][0]) for one in outputs)


def rows_of(output: Path) -> int:
    """Return how many rows of a sweep under way are there."""
    try:
        return output.with_name(f"{output.name}.rows").read_bytes().count(b"\n") - 1
    except FileNotFoundError:
        return 0


def main() -> int:
    """Run the rounds and print their rates."""
    parser = arguments(__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    asked = parsed(parser)
    runs, rounds = asked.runs, asked.rounds
    half = runs // 2
    ratios = []
    with tempfile.TemporaryDirectory(prefix="rths-workers-") as name:
        folder = Path(name)
        for _ in range(rounds):
            workers = rate(folder, [("--seeds", str(runs), "--engine", "processes", "--jobs", "2")])
            alone = [f"0:{half - 1}", f"{half}:{2 * half - 1}"]
            free = rate(folder, [("--seeds", seeds, "--engine", "inline") for seeds in alone])
            ratios.append(workers / free)
            print(f"two workers {workers:.1f} rows/s, two processes {free:.1f} rows/s: {ratios[-1]:.2f}", flush=True)
    print(f"median {statistics.median(ratios):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
