"""A short sample of benchmarks/study_interruptions.py: sweeps that are interrupted at random instants lose no row."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "study_interruptions.py"
SEED = 5


@pytest.mark.skipif(sys.platform != "linux", reason="forks, kills and reads /proc")
@pytest.mark.parametrize("kind", ["killed worker", "Ctrl-C", "SIGKILL"])
def test_a_sweep_that_is_interrupted_gives_the_table_of_an_uninterrupted_one(kind: str) -> None:
    command = [sys.executable, str(BENCHMARK), "1", str(SEED), kind]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", 1 met the sweep when " in done.stdout and ", 0 failed" in done.stdout
