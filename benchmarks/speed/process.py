"""Whole commands, each in a process of its own."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHORT = False  # whether every command runs once, to see that it runs


@dataclass(frozen=True)
class Ran:
    """How long a command took, the largest memory it held, and its exit code."""

    wall_s: float
    peak_bytes: int
    exit_code: int


def rths(*words: str, cache: Path | None = None) -> Ran:
    """Run rths once in an empty folder; `cache` stands in for the user's.

    Raises CalledProcessError with its output when it fails.
    """
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | ({"XDG_CACHE_HOME": str(cache)} if cache else {})
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as said:
        start = time.perf_counter()
        child = subprocess.Popen(
            [sys.executable, "-m", "rths_cli", *words], cwd=folder, env=environment, stdout=said, stderr=said
        )
        _, status, usage = os.wait4(child.pid, 0)
        wall_s = time.perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode not in (0, 1):
            said.seek(0)
            raise subprocess.CalledProcessError(child.returncode, " ".join(words), said.read().decode())
    return Ran(wall_s, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024), child.returncode)


def median_s(*words: str, repetitions: int = 5) -> float:
    """Return the median wall time of a command after one warm-up; in the short form that of one run."""
    first = rths(*words)
    if SHORT:
        return first.wall_s
    return statistics.median(rths(*words).wall_s for _ in range(repetitions))
