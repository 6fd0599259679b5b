"""Ten runs are killed by SIGKILL at random instants: every file opens, and what comes back is right."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

TREE = Path(__file__).parents[2]


@pytest.mark.campaign
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
def test_what_ten_killed_runs_leave_opens_and_holds_their_samples() -> None:
    words = [sys.executable, str(TREE / "benchmarks" / "kill.py"), "--json", "--count", "10"]
    environment = {**os.environ, "PYTHONPATH": str(TREE)}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120, check=False)
    trials = json.loads(done.stdout)
    assert len(trials) == 10 and [trial for trial in trials if trial["fault"]] == []
    assert len([trial for trial in trials if trial["status"] == "interrupted" and trial["back"] > 0]) > 3
    assert sum(trial["back"] for trial in trials) > 0.5 * sum(trial["done"] for trial in trials)  # on any machine
