"""Show that a change of the code changes no result: record everything before it, record it after it, compare.

    python benchmarks/unchanged.py record BEFORE
    python benchmarks/unchanged.py record AFTER
    python benchmarks/unchanged.py compare BEFORE AFTER

A recording holds the eight cases of the paper by both methods, the bare specimen, random cases, laboratories, storeys
with laws, shake-table tests, identifications from files and sweeps: result files, and what the commands print. The
comparison is byte by byte: datasets (not those of `timing`), printed text and JSON. Attributes are compared too, but
a text that differs is only counted: `--texts` shows them. Exit code 1 when something else than an attribute's text
differs.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from options import arguments, parsed

PAPER = [f"{r}_{d}_{c}" for r in ("el_centro", "hachinohe") for d in ("low", "high") for c in ("ff", "ff_fb")]
BASE = "el_centro_low_ff_fb"
BARE = "el_centro_bare_ff_fb"
SWEEP = ["sweep", BASE, "--seeds", "10", "--vary", "scaling=0.05:0.3:5", "--output", "sweep.h5"]
LAWS = [
    "{kind: bilinear, yield_displacement_m: 0.002, hardening: 0.05}",
    "{kind: bouc_wen, yield_displacement_m: 0.002, hardening: 0.05}",
    "{kind: clough, yield_displacement_m: 0.002, hardening: 0.05, unloading_exponent: 0.4}",
    "{kind: viscous_power, coefficient: 5.0, exponent: 0.4}",
    "{kind: maxwell, spring_n_per_m: 2200.0, dashpot_n_s_per_m: 100.0}",
    "{kind: friction, force_n: 4.0}",
]
IDENTIFY_FILE = ["identify", "--no-figure", "--corrected", "--data"]
OF_THE_MOMENT = re.compile(
    r"(\d+(\.\d+)?) (s|ms|min|minutes?|hours?)\b|\d{4}-\d\d-\d\d[T ]?[\d:.]*Z?"
    r"|[0-9a-f]{12,}|\d+\.\d+\.\d+ [0-9a-f]{7}\b"
)
PROGRESS = ("reading results:", "compiling real-time code", "first run of this version")  # as far as the machine is
ADDED = ("findings", "findings_entry")  # code and values beside the texts, not in files of earlier commits
CHANGING = ("created_utc", "git_commit", "command_line", "platform", "package_versions", "rths_version")


def main() -> int:
    """Record or compare."""
    parser = arguments(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    record_parser = commands.add_parser("record")
    record_parser.add_argument("folder", type=Path)
    record_parser.add_argument("--random", type=int, default=20, help="number of random cases")
    compare_parser = commands.add_parser("compare")
    compare_parser.add_argument("before", type=Path)
    compare_parser.add_argument("after", type=Path)
    compare_parser.add_argument("--texts", action="store_true", help="show attributes whose text differs")
    given = parsed(parser)
    if given.command == "record":
        record(given.folder, given.random)
        return 0
    return compare(given.before, given.after, given.texts)


def record(folder: Path, random_cases: int) -> None:
    """Run everything in an empty folder, with a cache of its own for models."""
    folder.mkdir(parents=True)
    names = [write_case(folder, seed) for seed in range(random_cases)]
    jobs = {
        "paper": ["run", *PAPER, BARE, "--method", "paper", "--method", "best"],
        "random": ["run", *names],
        "random_json": ["run", *names, "--json", "--output", "results_json"],
        "check": ["check", *PAPER[:2], BARE, *names[:5]],
        "check_json": ["check", *PAPER[:2], BARE, *names[:5], "--json"],
        "identify": ["identify", "--no-figure"],
        "report": ["report", "results"],
        "report_json": ["report", "results", "--format", "json"],
        "report_csv": ["report", "results", "--format", "csv"],
        "report_markdown": ["report", "results", "--format", "markdown"],
        "sweep": SWEEP,
        "sweep_laboratory": [
            "sweep",
            BASE,
            "--seeds",
            "4",
            "--set",
            "table=aps400_laboratory",
            "--override",
            "check",
            "--vary",
            "controller=FF,FF+FB",
            "--output",
            "sweep_laboratory.h5",
        ],
        "sweep_law": [
            "sweep",
            BASE,
            "--seeds",
            "2",
            "--set",
            f"structure.numerical.law=[{LAWS[0]}]",
            "--vary",
            "damping=low,high",
            "--output",
            "sweep_law.h5",
        ],
        "shake_table": ["run", BASE, "hachinohe_high_ff", "--set", "runs=[shake_table]", "--output", "shake_table"],
        "identify_data": ["identify", "--no-figure", "--save-data", "data.h5", "--output", "models/saved.h5"],
        "identify_from_data": [*IDENTIFY_FILE, "data.h5", "--output", "models/from_data.h5"],
    }
    for number in range(8):
        table = ["--set", "table=aps400_laboratory", "--set", f"seed={number}", "--override", "check"]
        jobs[f"laboratory_{number}"] = ["run", PAPER[number], *table, "--output", f"laboratory_{number}"]
    for number, law in enumerate(LAWS):
        laws = ["--set", f"structure.numerical.law=[{law}]"]
        jobs[f"law_{number}"] = ["run", PAPER[4 * (number % 2)], *laws, "--output", f"law_{number}"]
    for name, words in jobs.items():
        print(name, flush=True)
        ended = rths(folder, words)
        (folder / f"{name}.txt").write_text(f"exit {ended.returncode}\n{ended.stdout}\n--- stderr\n{ended.stderr}")


def rths(folder: Path, words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a command of the rths that this process would import, in a folder; return what it printed and its end."""
    return subprocess.run(
        [sys.executable, "-m", "rths_cli", *words], cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "COLUMNS": "100", "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip


def write_case(folder: Path, seed: int) -> str:
    """Write a random case and return its name."""
    draw = np.random.default_rng(1000 + seed)
    floors, storeys = int(draw.integers(1, 4)), int(draw.integers(1, 4))
    masses = draw.uniform(3.0, 7.0, floors) * min(1.0, 20.0 / (5.0 * floors))
    case = {
        "structure": {
            "numerical": {
                "masses_kg": list(draw.uniform(10.0, 20.0, storeys)),
                "stiffness_n_per_m": list(draw.uniform(15e3, 40e3, storeys)),
            },
            "experimental": {
                "masses_kg": list(masses),
                "stiffness_n_per_m": list(draw.uniform(5e3, 15e3, floors)),
                "damping_ratios": list(draw.uniform(0.02, 0.05, floors)),
            },
        },
        "damping": {"dashpots_n_s_per_m": list(draw.uniform(50.0, 150.0, storeys))},
        "record": str(draw.choice(["el_centro", "hachinohe"])),
        "scaling": float(draw.uniform(0.05, 0.2)),
        "controller": str(draw.choice(["FF", "FF+FB"])),
        "integration": str(draw.choice(["exact", "newmark", "cr"])),
        "sample_rate_hz": float(draw.choice([1000.0, 2000.0])),
        "seed": seed,
    }
    name = f"random_{seed:02d}"
    (folder / f"{name}.yaml").write_text(json.dumps(case))  # JSON is YAML
    return name


def compare(before: Path, after: Path, show_texts: bool) -> int:
    """Compare two recordings; return the exit code."""
    faults, texts = [], []
    names = sorted({path.relative_to(root) for root in (before, after) for path in root.rglob("*") if path.is_file()})
    for name in names:
        one, other = before / name, after / name
        if not (one.exists() and other.exists()):
            faults.append(f"{name}: only in {before if one.exists() else after}")
        elif name.suffix == ".h5":
            compare_hdf5(str(name), one, other, faults, texts)
        elif name.suffix == ".txt" and plain(one) != plain(other):
            faults.append(f"{name}: {first_difference(plain(one), plain(other))}")
    print(f"{len(names)} files compared; {len(faults)} differences; {len(texts)} attributes with another text")
    print("\n".join(faults[:40] + (texts if show_texts else [])))
    return 1 if faults else 0


def plain(path: Path) -> list[str]:
    """Return the printed lines of a command without times, dates, hashes and the folder's own name."""
    text = path.read_text().replace(str(path.parent.resolve()), "FOLDER")
    if text.startswith("{"):
        text = json.dumps(json.loads(text, object_hook=_without_added), indent=2)
    return [OF_THE_MOMENT.sub("#", line) for line in text.splitlines() if not line.startswith(PROGRESS)]


def _without_added(members: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in members.items() if name not in ADDED}


def first_difference(one: list[str], other: list[str]) -> str:
    """Return the first lines that differ."""
    for number, (left, right) in enumerate(zip(one, other, strict=False), 1):
        if left != right:
            return f"line {number}: {left!r} -> {right!r}"
    return f"{len(one)} lines -> {len(other)} lines"


def compare_hdf5(name: str, one: Path, other: Path, faults: list[str], texts: list[str]) -> None:
    """Compare datasets byte by byte and attributes by value."""
    with h5py.File(one) as first, h5py.File(other) as second:
        nodes: list[set[str]] = [set(), set()]
        first.visit(nodes[0].add)
        second.visit(nodes[1].add)
        alone = (path for path in sorted(nodes[0] ^ nodes[1]) if path.rpartition("/")[2] not in ADDED)
        faults += [f"{name}: {path} only in one of the two" for path in alone]
        for path in [*sorted(nodes[0] & nodes[1]), "/"]:
            compare_node(f"{name}: {path}", first[path], second[path], faults, texts)


def compare_node(where: str, one: h5py.Group | h5py.Dataset, other: h5py.Group | h5py.Dataset,
                 faults: list[str], texts: list[str]) -> None:  # fmt: skip
    """Compare one dataset or group."""
    if isinstance(one, h5py.Dataset) and "timing" not in where:
        values = one[()], other[()]
        same = one.dtype == other.dtype and np.asarray(values[0]).tobytes() == np.asarray(values[1]).tobytes()
        if one.dtype.kind == "O":
            same = bool(np.all(values[0] == values[1]))
        if not same:
            faults.append(f"{where}: values differ")
    for key in sorted(set(one.attrs) | set(other.attrs)):
        left, right = (node.attrs.get(key) for node in (one, other))
        if key in (*CHANGING, *ADDED) or key in ("DIMENSION_LIST", "REFERENCE_LIST") or np.array_equal(left, right):
            continue
        if isinstance(left, str) and isinstance(right, str):
            texts.append(f"{where}@{key}: {left!r} -> {right!r}")
        else:
            faults.append(f"{where}@{key}: {left!r} -> {right!r}")


if __name__ == "__main__":
    sys.exit(main())
