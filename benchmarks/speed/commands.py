"""Whole commands against their demands, and the first run on a new machine."""

from __future__ import annotations

import tempfile
from pathlib import Path

from campaigns.step_run import CASE

from speed import process
from speed.process import median_s, rths
from speed.rows import Row

EIGHT = tuple(f"{r}_{d}_{c}" for r in ("el_centro", "hachinohe") for d in ("low", "high") for c in ("ff", "ff_fb"))
COMMANDS = {
    "rths --help": (("--help",), 0.15),
    "rths check, model cached": (("check", CASE), 1.2),
    "rths run, model cached": (("run", CASE), 1.5),
    "rths run --fresh": (("run", "--fresh", CASE), 2.5),
    "rths run, the paper's eight cases": (("run", *EIGHT), 5.0),
}


def command_rows() -> list[Row]:
    """Time every command with warm caches, then one run without any."""
    behind = "wall time of the process, median of 5 after one"
    rows = [Row(name, median_s(*words), "s", demand, behind) for name, (words, demand) in COMMANDS.items()]
    return rows if process.SHORT else [*rows, first_run()]


def first_run() -> Row:
    """Compare a run that finds an empty cache with one that finds what it left and identifies again."""
    with tempfile.TemporaryDirectory() as folder:
        first = rths("run", "--fresh", CASE, cache=Path(folder)).wall_s
        second = rths("run", "--fresh", CASE, cache=Path(folder)).wall_s
    behind = f"{first:.1f} s with an empty cache, then {second:.1f} s"
    return Row("first run on a new machine, beyond a later one", first - second, "s", 20.0, behind)
