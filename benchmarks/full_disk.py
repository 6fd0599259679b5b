"""Fill the disk at random instants of a command: python benchmarks/full_disk.py [--count N] [--seed N] [--json].

Every command that writes works in a small file system of its own (a tmpfs, which root may mount), and a filler takes
all that is left of it at a random instant; in half of the trials it gives the space back after a moment. Demanded of
each: no death by signal, no traceback, a sentence and exit code 2 or 4 where a file is missing, no part and no empty
file left, the other cases of a batch run where they can, and every file that is there can be read.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from options import arguments, parsed

from rths_cli.errors import InputError
from rths_cli.files.model_file import read_model
from rths_cli.files.result_reader import read_result
from rths_cli.files.sweep_file import read_sweep

SHORT = ("--count", "2")
PRINTS = "^2 trials, .* 0 failed"  # the short form at its end

CASES = ("el_centro_low_ff_fb", "el_centro_high_ff", "hachinohe_low_ff")
SIZE_MB = 220  # of the file system: what rths run wants to find free for three cases, and little more
BACK_S = 0.4  # the space is given back after
LIMIT_S = 300.0
GOOD_CODES = (0, 1, 2, 4)
REFUSED_WHOLE = ("MB needed; free space", "cannot write result files here")
"""What a batch says that finds the disk full before its first case: it is refused whole, and nothing is begun."""


@dataclass(frozen=True)
class Trial:
    """One command on a disk that was full from an instant on: how it ended, and what is wrong with that."""

    command: str
    after_s: float
    given_back: bool
    code: int
    said: str
    faults: tuple[str, ...]


def main() -> int:
    """Run the trials, print a line for each, return 1 where one failed."""
    parser = arguments(__doc__, seed=15, count=50)
    parser.add_argument("--json", action="store_true")
    asked = parsed(parser, SHORT)
    rng = random.Random(asked.seed)
    with tempfile.TemporaryDirectory(prefix="rths-full-disk-") as name, small_disk(Path(name) / "disk") as disk:
        trials = run_all(asked.count, rng, Path(name), disk, asked.json)
    failed = [trial for trial in trials if trial.faults]
    if asked.json:
        print(json.dumps([asdict(trial) for trial in trials], indent=2))
    else:
        met = sum(trial.code != 0 for trial in trials)
        print(f"{len(trials)} trials, {met} met the full disk, {len(failed)} failed")
    return 1 if failed else 0


def run_all(count: int, rng: random.Random, home: Path, disk: Path, silent: bool) -> list[Trial]:
    """Run the commands in turn, each as often as fits into the count; their instants are drawn from their duration."""
    results = home / "results"
    subprocess.run(rths("run", *CASES, "--output", str(results)), check=True, capture_output=True)
    commands = lines(results, disk)
    lasts = {name: duration(line, disk) for name, line in commands.items()}
    trials = []
    for number in range(count):
        name = list(commands)[number % len(commands)]
        trials.append(trial(name, commands[name], disk, rng.uniform(0.0, lasts[name]), rng.random() < 0.5))
        if not silent:
            last = trials[-1]
            print(
                f"{name:9} {last.after_s:6.3f} s back {last.given_back:d} code {last.code}: {last.faults or 'good'}",
                flush=True,
            )
            if last.faults:
                print(f"    {last.said!r}", flush=True)
    return trials


def rths(*words: str) -> list[str]:
    """Return the command line of this rths."""
    return [sys.executable, "-m", "rths_cli", *words]


def lines(results: Path, disk: Path) -> dict[str, list[str]]:
    """Return the commands by name; each writes to the small disk only."""
    out = str(disk / "out")
    short = ("--set", "runs=[sim,exp_rths]")
    return {
        "run": rths("run", *CASES, *short, "--output", out),
        "report": rths("report", str(results), "--format", "html", "--output", f"{out}/report.html"),
        "figures": rths("report", str(results), "--figures", out, "--format", "png"),
        "csv": rths("export", str(results / f"{CASES[0]}.h5"), "--to", "csv", "--output", out),
        "mat": rths("export", str(results / f"{CASES[0]}.h5"), "--to", "mat", "--output", out),
        "identify": rths("identify", "--output", f"{out}/model.h5", "--save-data", f"{out}/data.h5"),
        "sweep": rths("sweep", CASES[0], "--seeds", "6", "--output", f"{out}/sweep.h5", "--csv", f"{out}/sweep.csv"),
    }


def duration(line: Sequence[str], disk: Path) -> float:
    """Return how long a command takes on an empty disk, the second time; raises CalledProcessError where it fails."""
    for _ in range(2):
        emptied(disk)
        start = time.monotonic()
        subprocess.run(line, check=True, capture_output=True)
    return time.monotonic() - start


def trial(name: str, line: Sequence[str], disk: Path, after_s: float, given_back: bool) -> Trial:
    """Run a command and fill the disk after some time."""
    emptied(disk)
    stop = threading.Event()
    filler = threading.Thread(target=fill, args=(disk, after_s, given_back, stop))
    filler.start()
    try:
        done = subprocess.run(line, capture_output=True, text=True, timeout=LIMIT_S)
        code, said = done.returncode, done.stderr
    except subprocess.TimeoutExpired:
        code, said = -1, "hangs"
    finally:
        came_back = given_back and not filler.is_alive()  # while the command still ran
        stop.set()
        filler.join()
    return Trial(name, after_s, given_back, code, said[-500:], tuple(faults(name, code, said, disk, came_back)))


def fill(disk: Path, after_s: float, given_back: bool, stop: threading.Event) -> None:
    """Take all space that is left, again and again until the command ends or the space is given back."""
    stop.wait(after_s)
    end = time.monotonic() + (BACK_S if given_back else LIMIT_S)
    with open(disk / "filler", "wb", buffering=0) as file:
        while not stop.is_set() and time.monotonic() < end:
            try:
                file.write(bytes(1 << 20 if shutil.disk_usage(disk).free > 1 << 20 else 1 << 12))
            except OSError:
                stop.wait(0.001)
    (disk / "filler").unlink()


def faults(name: str, code: int, said: str, disk: Path, given_back: bool) -> Iterator[str]:
    """Yield what a command must not do on a full disk."""
    if code not in GOOD_CODES:
        yield f"exit code {code}"
    if "Traceback" in said or "Error:" in said:
        yield "a traceback"
    if code in (2, 4) and "space" not in said:
        yield "no sentence about the space"
    left = [path for path in (disk / "out").glob("**/*") if path.is_file()]
    for path in left:
        if path.suffix == ".part" or path.name.startswith(".") or not path.stat().st_size:
            yield f"{path.name} is left behind"
        elif fault := unreadable(path):
            yield fault
    results = {path.stem for path in left if path.suffix == ".h5"}
    refused = any(sentence in said for sentence in REFUSED_WHOLE)
    if name == "run" and code == 2 and given_back and not results and not refused:
        yield "no case of the batch ran, although there was space again"


def unreadable(path: Path) -> str:
    """Return why a file of rths cannot be read, "" where it can."""
    readers = {"model.h5": read_model, "sweep.h5": read_sweep}
    if path.suffix != ".h5" or path.name.startswith("data"):
        return ""
    try:
        readers.get(path.name, read_result)(path)
    except InputError as error:
        return str(error)
    return ""


def emptied(disk: Path) -> None:
    """Remove everything from the disk, and make the folder for what is written."""
    for path in disk.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    (disk / "out").mkdir()


@contextmanager
def small_disk(place: Path) -> Iterator[Path]:
    """Yield a small file system of its own; raises SystemExit where this user may mount none."""
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SIZE_MB}m", "tmpfs", str(place)])
    if mounted.returncode:
        raise SystemExit("full_disk.py: mounting a tmpfs needs root; run it as root, or in a container of its own")
    try:
        yield place
    finally:
        os.sync()
        subprocess.run(["umount", str(place)], check=True)


if __name__ == "__main__":
    sys.exit(main())
