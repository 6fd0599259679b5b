"""A thousand seeds of one case: time, memory, and that both grow no faster than the number of runs."""

from __future__ import annotations

import subprocess

from campaigns.step_run import CASE

from speed.process import Ran, rths
from speed.rows import RATIO, Row

COUNTS = (250, 500, 1000)


def sweep_rows() -> list[Row]:
    """Run sweeps of several sizes."""
    try:
        rths("sweep", CASE, "--seeds", "2", "--quiet")
    except subprocess.CalledProcessError as failed:
        return [Row(f"rths sweep did not run (exit code {failed.returncode})", None, "s", 20.0)]
    ran = {count: rths("sweep", CASE, "--seeds", str(count), "--quiet") for count in COUNTS}
    times = ", ".join(f"{count} seeds {one.wall_s:.1f} s" for count, one in ran.items())
    last = ran[COUNTS[-1]]
    return [
        Row("rths sweep, 1,000 seeds", last.wall_s, "s", 20.0, times),
        Row("rths sweep, 1,000 seeds, peak memory", last.peak_bytes / 1e9, "GB", 1.0, _memory(ran)),
        Row("rths sweep, a run more, 500 to 1,000 / 250 to 500", _growth(ran), RATIO, None, times),
    ]


def _memory(ran: dict[int, Ran]) -> str:
    return ", ".join(f"{count} seeds {one.peak_bytes / 1e6:.0f} MB" for count, one in ran.items())


def _growth(ran: dict[int, Ran]) -> float:
    """Return the time of a further run in the larger half over that in the smaller."""
    few, more, most = (ran[count].wall_s for count in COUNTS)
    return (most - more) / (COUNTS[2] - COUNTS[1]) / ((more - few) / (COUNTS[1] - COUNTS[0]))
