"""Cases at the ends of all documented ranges: SIM and SIM-DELAY answer, or refuse in a sentence, in 20 s and 1 GB.

python benchmarks/range_ends.py [COUNT] [--seed SEED] [--json FILE]    one process per case, 500 of seed 1 by default

The ranges are those of docs/reference/case.md and rig.md. Every case is run once to its end, and once more with SIGTERM
at a random instant of that time, which must be obeyed within a second. Where other programs keep the processors busy,
times are allowed to be longer by as much as each has to wait.
"""

from __future__ import annotations

import argparse
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
from typing import Any

import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
MOST_S, MOST_BYTES, MOST_TERM_S = 20.0, 2**30, 1.0
STARTED_S = 0.1  # from the process's own start to where Python can take signals
ADDRESS_SPACE = 8 * 2**30  # the process may reserve; what it uses is measured
NEAR_ZERO = (1e-300, 1e-9, 1e-3)  # ends of a range that excludes zero
STOREYS = (1, 2, 5, 200)
MOST_PAYLOAD_KG = 1e6  # that a table may carry
PLAIN = 0.75  # share of the keys that keep a usual value
RECORD_SAMPLES = (3, 500, 3000, 30_000)
RIG_KEYS = ("sensors.", "converters.", "limits.", "nominal.", "physics.", "after_identification.")
Random = np.random.Generator


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


def documented(page: str, kind: str = "") -> dict[str, str]:
    """Return the limits of each number a reference page documents, of one kind of rig where there are several."""
    text = (ROOT / "docs" / "reference" / page).read_text(encoding="utf-8")
    if kind:
        text = text.split(f"## Kind `{kind}`")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `([^`]+)` \| ([^|]+)\|[^|]*\|[^|]*\|([^|]*)\|", text, re.MULTILINE)
    return {key: limits for key, what, limits in rows if "number" in what and re.search(r"[<>]", limits)}


def an_end(limits: str, random: Random, whole: bool = False) -> float:
    """Return one end of a documented range."""
    bounds = dict(re.findall(r"([<>]=?) ([-+.e0-9]+)", limits.replace("0 or ", "").split(";")[0]))
    low = float(bounds[">="]) if ">=" in bounds else float(random.choice(NEAR_ZERO))
    high = float(bounds["<="]) if "<=" in bounds else float(bounds.get("<", 1.0)) * (1.0 - 1e-9)
    value = low if random.random() < 0.5 else high
    return int(value) if whole else value


def drawn(random: Random, folder: Path) -> dict[str, Any]:
    """Draw a case; its record is written to the folder."""
    of_case = documented("case.md")

    def either(key: str, usual: float, whole: bool = False) -> float:
        return usual if random.random() < PLAIN else an_end(of_case[key], random, whole)

    def listed(key: str, usual: float, count: int) -> list[float]:
        if random.random() < 0.7:
            return [either(key, usual)] * count
        values = [usual] * count
        values[int(random.integers(count))] = an_end(of_case[key], random)
        return values

    p, n = (int(random.choice(STOREYS)) for _ in range(2))
    masses_kg = listed("structure.experimental.masses_kg", 0.1, n)
    if sum(masses_kg) > MOST_PAYLOAD_KG and random.random() < 0.9:  # that sentence is heard often enough
        masses_kg = [min(mass, 0.8 * MOST_PAYLOAD_KG / n) for mass in masses_kg]
    experimental: dict[str, Any] = {"masses_kg": masses_kg}
    if n <= 5 and random.random() < 0.3:
        ends = sorted({either("structure.experimental.natural_frequencies_hz", 3.0 * (i + 1)) for i in range(n)})
        experimental["natural_frequencies_hz"] = ends if len(ends) == n else [3.0 * (i + 1) for i in range(n)]
    else:
        experimental["stiffness_n_per_m"] = listed("structure.experimental.stiffness_n_per_m", 7e3, n)
    if random.random() < 0.5:
        experimental["damping_ratios"] = listed("structure.experimental.damping_ratios", 0.04, n)
    else:
        experimental["dashpots_n_s_per_m"] = listed("structure.experimental.dashpots_n_s_per_m", 8.0, n)
    masses = listed("structure.numerical.masses_kg", 7.0, p)
    structure: dict[str, Any] = {
        "numerical": {
            "masses_kg": masses,
            "stiffness_n_per_m": (
                "mean_of_experimental"
                if random.random() < 0.3
                else listed("structure.numerical.stiffness_n_per_m", 7e3, p)
            ),
        },
        "experimental": experimental,
        "interface_experimental_mass_kg": float(random.choice([0.0, 0.0, 0.5, 1.0 - 1e-9])) * masses[-1],
    }
    if random.random() < 0.3:
        damping: dict[str, Any] = {"first_mode_ratio": either("damping.first_mode_ratio", 0.03)}
    else:
        damping = {"dashpots_n_s_per_m": listed("damping.dashpots_n_s_per_m", 22.0, p)}
    rate = float(random.choice([either("sample_rate_hz", 2000.0), 2000.0, 20_000.0]))
    record = write_record(random, folder, float(random.choice([0.005, 0.02, 0.02, either("record.dt_s", 0.02)])))
    case: dict[str, Any] = {
        "structure": structure,
        "damping": damping,
        "record": record,
        "scaling": either("scaling", 0.3),
        "controller": str(random.choice(["FF", "FF+FB", "none"])),
        "integration": str(random.choice(["exact", "cr", "newmark"])),
        "method": str(random.choice(["best", "paper"])),
        "runs": ["sim", "sim_delay"],
        "sample_rate_hz": rate,
        "delay_s": either("delay_s", 0.005),
        "record_filter": {
            "corner_hz": 0.0 if random.random() < 0.5 else either("record_filter.corner_hz", 0.25),
            "order": either("record_filter.order", 2, whole=True),
        },
        "seed": either("seed", 0, whole=True),
        "identification": {"high_hz": min(60.0, 0.2 * rate)},
        "table": {"extends": "aps400_virtual", **drawn_rig(random)},
    }
    return case


def write_record(random: Random, folder: Path, dt_s: float) -> dict[str, Any]:
    """Write a record of random length, white and at rest at its start; return the mapping of a case that names it."""
    series = random.normal(size=int(random.choice(RECORD_SAMPLES)))
    series[0] = 0.0
    np.savetxt(folder / "record.txt", series, fmt="%.4f")
    return {"file": str(folder / "record.txt"), "unit": "m/s^2", "dt_s": dt_s}


def drawn_rig(random: Random) -> dict[str, Any]:
    """Draw the keys of a virtual rig; it carries any specimen, or most cases were refused for their weight."""
    rig: dict[str, Any] = {}
    for key, limits in documented("rig.md", "virtual").items():
        if key.startswith(RIG_KEYS) and random.random() > PLAIN:
            whole = key in ("converters.bits", "converters.latency_samples", "limits.lost_samples")
            part, name = key.split(".")
            rig.setdefault(part, {})[name] = an_end(limits, random, whole)
    rig.setdefault("nominal", {})["payload_kg"] = MOST_PAYLOAD_KG
    return rig


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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write every case here")
    asked = parser.parse_args()
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
