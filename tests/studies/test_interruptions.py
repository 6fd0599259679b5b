"""A short sample of benchmarks/study_interruptions.py: sweeps that are interrupted at random instants lose no row."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "study_interruptions.py"
SEED = 5
KINDS = ("Ctrl-C",)


@pytest.mark.skipif(sys.platform != "linux", reason="forks, kills and reads /proc")
def test_sweeps_that_are_interrupted_give_the_table_of_an_uninterrupted_one() -> None:
    command = [sys.executable, str(BENCHMARK), "1", str(SEED), *KINDS]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(", 1 met the sweep when ") == len(KINDS), done.stdout
    assert done.stdout.count(", 0 failed") == len(KINDS)
