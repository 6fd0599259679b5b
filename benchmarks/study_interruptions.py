"""Interrupt sweeps at random instants: python benchmarks/study_interruptions.py [--count N] [--seed N] [KIND...].

Kinds: a worker process is killed, the Dask scheduler is killed and started again, Ctrl-C, SIGKILL of the command, and
a full disk; COUNT (default 20) instants of each. Demanded of each: rows that are kept are whole and there once, the
sweep goes on (`--resume`; after a killed worker by itself) and plays the others alone, and its table is that of an
uninterrupted sweep to the last bit. Left out with a sentence: the scheduler where Dask is not installed, the full disk
where this user may not mount a tmpfs.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.study_interruptions import KINDS, Bench, Trial, free_port, small_disk, trial
from options import arguments, parsed

SHORT = ("--count", "1", "--seed", "5", "Ctrl-C")
PRINTS = ", 1 met the sweep when .*, 0 failed"  # the short form at its end

MOST = 20  # trials for one that meets the sweep: after the last row a sweep may have ended before


def main() -> int:
    """Run the trials, print a line for each, return 1 where one failed."""
    parser = arguments(__doc__, seed=20, count=20)
    parser.add_argument("kinds", nargs="*", help=f"of {', '.join(KINDS)}; default: all")
    asked = parsed(parser, SHORT)
    count, seed, kinds = asked.count, asked.seed, asked.kinds or list(KINDS)
    failed = 0
    with tempfile.TemporaryDirectory(prefix="rths-interruptions-") as name, small_disk(Path(name) / "disk") as disk:
        bench = Bench.made(Path(name))
        for kind in kinds:
            if kind == "full disk" and disk is None:
                print("full disk: left out, mounting a tmpfs needs root")
            elif kind == "restarted scheduler" and find_spec("distributed") is None:
                print("restarted scheduler: left out, distributed is not installed: pip install 'rths-cli[dask]'")
            else:
                rng = random.Random(f"{seed} {kind}")
                trials: list[Trial] = []
                while sum(one.met for one in trials) < count and len(trials) < MOST * count:
                    trials.append(trial(bench, kind, rng, disk, free_port()))
                failed += told(kind, trials)
    return int(failed > 0)


def told(kind: str, trials: Sequence[Trial]) -> int:
    """Print what came of the trials of a kind, and return how many failed."""
    bad = [one for one in trials if one.faults]
    met = [one for one in trials if one.met]
    there = sorted(one.there for one in met)
    rows = f" when {there[0]} to {there[-1]} of its rows were there" if there else ""
    print(f"{kind}: {len(trials)} trials, {len(met)} met the sweep{rows}, {len(bad)} failed", flush=True)
    for one in bad:
        print(f"    {one.engine} {one.after_s:.3f} s after row {one.after_rows}: {'; '.join(one.faults)}", flush=True)
    return len(bad)


if __name__ == "__main__":
    sys.exit(main())
