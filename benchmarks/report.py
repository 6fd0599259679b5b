"""Time and memory of `rths report` over many result files: copies of real results, each with a seed of its own.

    python benchmarks/report.py RESULT... [--files 1000] [--folder DIR]

Copies hold attributes, case and figures; time histories, which a report does not read, are left out unless --whole.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
from options import arguments, parsed

FORMATS = ("text", "csv", "json", "markdown", "latex")


def copy(source: Path, target: Path, seed: int, whole: bool) -> None:
    """Write a copy of a result with another seed."""
    if whole:
        shutil.copy(source, target)
    else:
        with h5py.File(source) as old, h5py.File(target, "w") as new:
            new.attrs.update(old.attrs)
            for group in ("case", "metrics"):
                old.copy(group, new)
    with h5py.File(target, "r+") as file:
        file.attrs["seed"] = seed


def measure(folder: Path, form: str) -> str:
    """Return wall time, processor time, largest process and size of the output of one report."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.monotonic()
    output = folder / f"out.{form}"
    words = [sys.executable, "-m", "rths_cli", "report", str(folder), "--format", form, "--output", str(output)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    wall = time.monotonic() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    told = f"{form:<9} {wall:6.1f} s  {cpu:6.1f} s CPU  {after.ru_maxrss / 1024:6.0f} MB"
    return f"{told}  {output.stat().st_size / 1e6:6.1f} MB written  exit {done.returncode}"


def main() -> None:
    """Make the copies, and report them in every format."""
    parser = arguments(__doc__)
    parser.add_argument("results", nargs="+", type=Path)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--whole", action="store_true")
    asked = parsed(parser)
    with tempfile.TemporaryDirectory(dir=asked.folder) as made:
        for number in range(asked.files):
            source = asked.results[number % len(asked.results)]
            copy(source, Path(made) / f"{number:05}.h5", number, asked.whole)
        print(f"{asked.files} files; memory is that of the largest process so far")
        for form in FORMATS:
            print(measure(Path(made), form), flush=True)


if __name__ == "__main__":
    main()
