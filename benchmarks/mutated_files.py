"""Damage files of every kind and read them.

Valid files (results, models, sweeps and their rows, accelerograms, recordings, models from elsewhere, raw logs) are
damaged: bits flipped, pieces cut, doubled or zeroed, headers and names edited, attributes and datasets of other types
and shapes, datasets declared as terabytes, links to elsewhere and in circles. Each is given to a command that reads it,
in a process of its own with 1 GB and 5 s more than the intact file takes (all figures of a result take
longer than 5 s alone). Demanded: exit code 0, 1 or 2, no traceback, no warning of a library, no
control character on the screen. Files checked by a sum are damaged with and without a sum that fits again.
"""

from __future__ import annotations

import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.command_trials import in_a_process, in_a_process_slow, judged
from campaigns.file_damage import Target, damaged
from campaigns.valid_files import CASE, make_targets
from options import arguments, parsed

import rths_cli

SHORT = ("--count", "5")
PRINTS = "^5 files, 0 failed"  # the short form at its end

REFUSING = 0.05  # share of files that are given to a command for another kind of file


@dataclass(frozen=True)
class Outcome:
    """How one command took one damaged file."""

    number: int
    kind: str
    damage: str
    command: tuple[str, ...]
    code: int
    seconds: float
    fault: str
    said: str


def main() -> int:
    """Damage and read as many files as asked; return 1 where a demand was not met."""
    parser = arguments(__doc__, seed=15, count=20_000)
    parser.add_argument("--only", type=int, help="number of one file")
    parser.add_argument("--keep", type=Path, help="folder for files that fail")
    parser.add_argument("--valid", type=Path, help="folder of the intact files")
    asked = parsed(parser, SHORT)
    chosen = range(asked.count) if asked.only is None else [asked.only]
    kept = asked.keep and asked.keep.absolute()
    with tempfile.TemporaryDirectory(prefix="rths-mutated-") as name:
        valid = (asked.valid or Path(name) / "valid").absolute()
        bad = run_all(Path(name), valid, asked.seed, chosen, kept)
    return 1 if bad else 0


def run_all(home: Path, valid: Path, seed: int, chosen: Sequence[int], kept: Path | None) -> int:
    """Read damaged files by their numbers, print what went wrong and a summary, and return how many did."""
    rths_cli.check(CASE)  # what every command compiles and imports is there before the copies are made
    targets, codes, bad = make_targets(valid), Counter[tuple[str, int]](), 0
    usual = {} if len(chosen) == 1 else seconds_of_intact(home / "work", targets)
    for done, number in enumerate(chosen, 1):
        outcome = one(home / "work", targets, seed, number, usual, kept)
        codes[outcome.kind, outcome.code] += 1
        if outcome.fault:
            bad += 1
            print(f"{number}: {outcome.kind}, {outcome.damage}, rths {' '.join(outcome.command)}: {outcome.fault}")
            print("   ", outcome.said[-300:].replace("\n", " | ").encode("unicode_escape").decode(), flush=True)
        if done % 500 == 0:
            print(f"{done} files, {bad} failed", flush=True)
    print(f"{len(chosen)} files, {bad} failed; {dict(sorted(codes.items()))}")
    return bad


def one(
    work: Path,
    targets: Sequence[Target],
    seed: int,
    number: int,
    usual_s: Mapping[tuple[str, ...], float],
    kept: Path | None = None,
) -> Outcome:
    """Damage one file, chosen by seed and number alone, and give it to one command."""
    rng = random.Random(f"{seed}/{number}")
    target = targets[number % len(targets)]
    file = folder_with(work, target)
    damage = damaged(target, file, rng)
    command = rng.choice(target.refusing if target.refusing and rng.random() < REFUSING else target.commands)
    told = tuple(part.replace("FILE", file.name) for part in command)
    code, seconds, memory, said = in_a_process(work, told)
    fault = judged(code, seconds - usual_s.get(told, 0.0), memory, said)
    if fault and kept and file.is_file():
        kept.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, kept / f"{number}-{file.name}")
    return Outcome(number, target.kind, damage, told, code, seconds, fault, said.decode(errors="replace"))


def folder_with(work: Path, target: Target) -> Path:
    """Make the folder of one command anew, with what it finds beside its file; return the file's place."""
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    os.mkfifo(work / "fifo")
    for path in target.beside:
        shutil.copy(path, work)
    return work / target.valid.name


def seconds_of_intact(work: Path, targets: Sequence[Target]) -> dict[tuple[str, ...], float]:
    """Return the CPU time that each command takes with the intact file; raises SystemExit where it does not end as it
    must: only a file that is read to its end says what damage does."""
    found = {}
    for target in targets:
        for command in (*target.commands, *target.refusing):
            file = folder_with(work, target)
            shutil.copy(target.valid, file)
            told = tuple(part.replace("FILE", file.name) for part in command)
            code, found[told], _, said = in_a_process_slow(work, told)
            if code != (2 if command in target.refusing else 0):
                line = f"rths {' '.join(told)} of the valid {target.kind} ends with {code}"
                raise SystemExit(f"mutated_files.py: {line}: {said.decode(errors='replace')}")
    return found


if __name__ == "__main__":
    sys.exit(main())
