"""Wake-up delay of our loop against cyclictest (package rt-tests), by turns on the same processor.

python benchmarks/jitter.py [--seconds 10] [--turns 1] [--rate 1000 --rate 4000]
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess

import numpy as np
from numpy.typing import NDArray
from options import arguments, parsed

from rths_cli.loop.scheduling import PRIORITY, real_time, wake_up_delays

SHORT = ("--seconds", "0.2", "--rate", "1000")

Delays = NDArray[np.float64]  # (n,) in us
QUANTILES = (50.0, 99.0, 99.9, 100.0)
LONGEST_US = 100_000
OURS, ASLEEP, THEIRS = "rths", "rths, no spin", "cyclictest"


def ours(rate_hz: float, seconds: float, spins: bool) -> Delays:
    """Return the delays of our loop."""
    with real_time():
        return wake_up_delays(rate_hz, seconds, spins) / 1e3


def cyclictest(rate_hz: float, seconds: float, cpu: int) -> Delays:
    """Return the delays that cyclictest finds, whole us; what lasts longer than 0.1 s counts as 0.1 s."""
    words = f"-q -m -t1 -p{PRIORITY} -i{round(1e6 / rate_hz)} -l{round(rate_hz * seconds)} -h{LONGEST_US}".split()
    pinned = [f"-a{cpu}"] if cpu >= 0 else []
    done = subprocess.run(["cyclictest", *words, *pinned], capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines() if line and line[0].isdigit()]
    values = [np.full(int(count), float(us)) for us, count in lines]
    over = next((line.split()[-1] for line in done.stdout.splitlines() if "Histogram Overflows" in line), "0")
    return np.concatenate([*values, np.full(int(over), float(LONGEST_US))])


def compare(rate_hz: float, seconds: float, turns: int) -> None:
    """Measure by turns and print one row per program, the ratio of ours to cyclictest first."""
    with real_time() as granted:
        wake_up_delays(rate_hz, 0.01)  # compiled before it counts
    found: dict[str, list[Delays]] = {OURS: [], ASLEEP: [], THEIRS: []}
    for _ in range(turns):
        if shutil.which("cyclictest"):
            found[THEIRS].append(cyclictest(rate_hz, seconds, granted.cpu))
        found[OURS].append(ours(rate_hz, seconds, True))
        found[ASLEEP].append(ours(rate_hz, seconds, False))
    pooled = {name: np.concatenate(parts) for name, parts in found.items() if parts}
    figures = {name: np.percentile(delays, QUANTILES) for name, delays in pooled.items()}
    print(f"\n{rate_hz:g} Hz, {turns} x {seconds:g} s by turns, processor {granted.cpu}, delays in us")
    if THEIRS in figures:
        for name in (OURS, ASLEEP):
            ratios = figures[name][:2] / np.maximum(figures[THEIRS][:2], 1.0)
            print(f"  {name} / {THEIRS}: p50 {ratios[0]:.2f}, p99 {ratios[1]:.2f}")
    print(f"  {'':<14}{'p50':>8}{'p99':>8}{'p99.9':>9}{'max':>9}  late by an interval")
    for name, (p50, p99, p99_9, most) in figures.items():
        late = np.count_nonzero(pooled[name] >= 1e6 / rate_hz)
        print(f"  {name:<14}{p50:8.1f}{p99:8.1f}{p99_9:9.1f}{most:9.1f}  {late} of {pooled[name].size}")


def main() -> None:
    """Run what the command line asks for."""
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement [10]")
    parser.add_argument("--turns", type=int, default=1, help="[1]")
    parser.add_argument("--rate", type=float, action="append", help="in Hz, repeatable [1000 and 4000]")
    asked = parsed(parser, SHORT)
    print(f"{platform.node()}, kernel {platform.release()}, {len(os.sched_getaffinity(0))} processors")
    if not shutil.which("cyclictest"):
        print("cyclictest is not installed (package rt-tests): ours alone")
    with real_time() as granted:
        print("\n".join(granted.refused) or "everything granted that a real-time thread asks for")
    for rate_hz in asked.rate or (1000.0, 4000.0):
        compare(rate_hz, asked.seconds, asked.turns)


if __name__ == "__main__":
    main()
