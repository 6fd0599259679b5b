"""Cases at the ends of all documented ranges: SIM and SIM-DELAY answer, or refuse in a sentence, in 20 s and 1 GB.

python benchmarks/range_ends.py [COUNT] [--seed SEED] [--json FILE]    one process per case, 500 of seed 1 by default

The ranges are those of docs/reference/case.md and rig.md. Every case is run once to its end, and once more with SIGTERM
at a random instant of that time, which must be obeyed within a second. Where other programs keep the processors busy,
times are allowed to be longer by as much as each has to wait.
"""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml
from options import arguments, parsed

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.range_end_cases import drawn

SHORT = ("3",)

MOST_S, MOST_BYTES, MOST_TERM_S = 20.0, 2**30, 1.0
STARTED_S = 0.1  # from the process's own start to where Python can take signals
ADDRESS_SPACE = 8 * 2**30  # the process may reserve; what it uses is measured


@dataclass(frozen=True)
class Ended:
    """How a process ended: exit code, time in s, greatest memory in bytes, and what it printed on stderr."""

    code: int
    seconds: float
    memory_bytes: int
    said: str


@dataclass(frozen=True)
class Judged:
    """A case by its seed, how it ended, how long it went on after SIGTERM, and what is wrong with that."""

    seed: int
    code: int
    seconds: float
    memory_mb: float
    after_term_s: float
    term_code: int
    said: str
    faults: tuple[str, ...]


def command(case: Path, results: Path) -> list[str]:
    """Return the command that runs a case."""
    return [sys.executable, "-m", "rths_cli", "run", str(case), "--output", str(results), "--quiet"]


def run(case: Path, folder: Path, term_after_s: float | None = None) -> tuple[Ended, float]:
    """Run a case in its own process, which is ended by SIGTERM after a time, where one is given; return how it ended
    and how long it went on after that."""
    log = folder / "stderr.txt"
    with open(log, "wb") as said:
        start = time.monotonic()
        process = subprocess.Popen(
            command(case, folder / "results"), stdout=subprocess.DEVNULL, stderr=said, cwd=folder,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE)),
        )  # fmt: skip
        told = None
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            elapsed = time.monotonic() - start
            if pid:
                break
            if term_after_s is not None and told is None and elapsed >= max(term_after_s, STARTED_S * waiting()):
                process.send_signal(signal.SIGTERM)
                told = time.monotonic()
            if elapsed > 3.0 * MOST_S * waiting():
                process.kill()
            time.sleep(0.002 if told else 0.01)
    process.returncode = os.waitstatus_to_exitcode(status)
    ended = Ended(process.returncode, elapsed, usage.ru_maxrss * 1024, log.read_text(errors="replace"))
    return ended, time.monotonic() - told if told else 0.0


def judge(seed: int) -> Judged:
    """Draw, run and end the case of a seed."""
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="rths-ends-") as name:
        folder = Path(name)
        case = folder / "case.yaml"
        case.write_text(yaml.safe_dump(drawn(random, folder)), encoding="utf-8")
        whole, _ = run(case, folder)
        term, after_s = run(case, folder, random.random() * min(whole.seconds, MOST_S))
        left = [path.name for path in (folder / "results").glob("*") if path.suffix != ".h5"]
    return Judged(
        seed, whole.code, whole.seconds, whole.memory_bytes / 1e6, after_s, term.code, _short(whole.said),
        (*faults_of(whole), *faults_of_term(term, after_s, whole.code), *(f"left behind: {one}" for one in left)),
    )  # fmt: skip


def waiting() -> float:
    """Return how much longer everything takes because other programs run: those ready to run, over the processors."""
    return max(1.0, 1.5 * os.getloadavg()[0] / (os.cpu_count() or 1))


def faults_of(ended: Ended) -> tuple[str, ...]:
    """Return what is wrong with how a case ended by itself."""
    faults = []
    if ended.code not in (0, 1, 2):
        faults.append(f"exit code {ended.code}")
    if ended.code and not ended.said.strip():
        faults.append("no sentence")
    if re.search("Traceback|Warning", ended.said):
        faults.append("a traceback or a library's warning")
    if ended.seconds > MOST_S * waiting():
        faults.append(f"took {ended.seconds:.1f} s")
    if ended.memory_bytes > MOST_BYTES:
        faults.append(f"took {ended.memory_bytes / 1e6:.0f} MB")
    return tuple(faults)


def faults_of_term(ended: Ended, after_s: float, code: int) -> tuple[str, ...]:
    """Return what is wrong with how a case ended by SIGTERM; one that was through already ends by its own code."""
    faults = []
    if ended.code not in (143, code):
        faults.append(f"exit code {ended.code} after SIGTERM")
    if after_s > MOST_TERM_S * waiting():
        faults.append(f"went on for {after_s:.2f} s after SIGTERM")
    return tuple(faults)


def _short(said: str) -> str:
    """Return the last lines of what was said, without folders and numbers, so that equal refusals count together."""
    lines = [line for line in said.strip().splitlines() if line.strip()]
    return lines[-1].split("case.yaml")[-1].split("case: ")[-1][:300] if lines else ""


def main() -> int:
    """Run the campaign and print what it found; exit code 1 where something is wrong."""
    parser = arguments(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write every case here")
    asked = parsed(parser, SHORT)
    every = []
    for seed in range(asked.seed * 1_000_000, asked.seed * 1_000_000 + asked.count):
        one = judge(seed)
        every.append(one)
        if one.faults:
            print(f"{seed}: {'; '.join(one.faults)} | {one.said}", flush=True)
    if asked.json:
        asked.json.write_text(json.dumps([asdict(one) for one in every], indent=1))
    codes = Counter(one.code for one in every)
    print(f"{len(every)} cases: exit codes {dict(sorted(codes.items()))}, {sum(bool(o.faults) for o in every)} wrong")
    print(
        f"longest {max(o.seconds for o in every):.1f} s, largest {max(o.memory_mb for o in every):.0f} MB, "
        f"longest after SIGTERM {max(o.after_term_s for o in every):.2f} s"
    )
    return int(any(one.faults for one in every))


if __name__ == "__main__":
    sys.exit(main())
