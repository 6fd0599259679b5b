"""Give every option and argument what nobody means.

python benchmarks/hostile_options.py [--count N] [--seed N] [--command NAME]

Options and arguments are those of the commands themselves, and the keys of --set those of docs/reference/case.md. Each
is tried with empty, wrong, huge and non-finite values, control characters, bytes that are no text, names of 300
characters, 1,200 dots, pipes, devices, circles of links and removed folders, beside what the command needs otherwise.
Every trial is a process of its own in a folder of its own. Demanded: exit code 0, 1 or 2 (4 where a link is tried), no
traceback, no control character on the screen, 1 GB, and 5 s of the processor more than the command takes otherwise;
after code 2 nothing is left in the folder. --count 0, the default, tries all.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns import command_trials, valid_files
from campaigns.option_trials import NEEDED, QUICK, Trial, folder_with, shown, trials, tried
from campaigns.valid_files import CASE, RECORDED, SHORT_RECORD
from options import arguments, parsed

import rths_cli

SHORT = ("--count", "5")
PRINTS = "^5 trials, 0 failed"  # the short form at its end

USUAL: dict[tuple[str, str], tuple[str, ...]] = {("report", "--figures"): ("--figures", "figures")}
"""With what an option is compared that lets its command work for long."""


def main() -> int:
    """Try as many values as asked; return 1 where a demand was not met."""
    parser = arguments(__doc__, seed=15, count=0)
    parser.add_argument("--command", help="options of one command")
    asked = parsed(parser, SHORT)
    chosen = [one for one in trials() if asked.command in (None, one.command)]
    if asked.count:
        chosen = random.Random(asked.seed).sample(chosen, min(asked.count, len(chosen)))
    with tempfile.TemporaryDirectory(prefix="rths-options-") as name:
        rths_cli.check(CASE)  # what every command compiles and imports is there before the copies are made
        files = make_files(Path(name) / "valid")
        bad = run_all(Path(name) / "work", files, chosen)
    return 1 if bad else 0


def make_files(folder: Path) -> dict[str, Path]:
    """Make the files that commands need, by the names they get in the folder of a trial."""
    folder.mkdir(parents=True)
    (folder / "short.csv").write_text(SHORT_RECORD)
    line = ("run", *QUICK, "--output", ".", "--quiet")
    code, _, _, said = command_trials.in_a_process_slow(folder, line)
    assert code in (0, 1), said.decode()
    result = folder / f"{CASE}.h5"
    log = valid_files.make_log(folder, result)
    command_trials.in_a_process_slow(folder, RECORDED)
    data = next(path for path in valid_files.foreign_files(folder) if path.name == "data.csv")
    sweep = ("sweep", *QUICK, "--seeds", "2", "--part", "1/2", "--quiet")
    code, _, _, said = command_trials.in_a_process_slow(folder, sweep)
    assert code in (0, 1), said.decode()
    (part,) = folder.glob("sweeps/*-part1of2.h5")
    return {"short.csv": folder / "short.csv", "result.h5": result, "part.h5": part, log.name: log, "data.csv": data}


def run_all(work: Path, files: dict[str, Path], chosen: Sequence[Trial]) -> int:
    """Run trials, print what went wrong and a summary, and return how many did."""
    usual = {key: usual_seconds(work, files, *key) for key in dict.fromkeys(map(of_usual, chosen))}
    codes, bad = Counter[tuple[str, int]](), 0
    for done, one in enumerate(chosen, 1):
        code, fault, said = tried(work, files, one, usual[of_usual(one)])
        codes[one.command, code] += 1
        if fault:
            bad += 1
            line = " ".join(shown(part) for part in one.line)
            print(f"{one.option}: rths {line}: {fault}\n    {said[-300:]!r}", flush=True)
        if done % 500 == 0:
            print(f"{done} trials, {bad} failed", flush=True)
    print(f"{len(chosen)} trials, {bad} failed; {dict(sorted(codes.items()))}")
    return bad


def of_usual(one: Trial) -> tuple[str, tuple[str, ...]]:
    """Return the command of a trial, and what it is given when its usual time is taken."""
    return one.command, (*NEEDED[one.command], *USUAL.get((one.command, one.option), ()))


def usual_seconds(work: Path, files: dict[str, Path], name: str, line: tuple[str, ...]) -> float:
    """Return the time of the processor that a command takes with what it needs; raises SystemExit where it fails."""
    for run in (command_trials.in_a_process_slow, command_trials.in_a_process):  # the first compiles
        folder_with(work, files)
        code, seconds, _, said = run(work, (name, *line))
    if code not in (0, 1):
        raise SystemExit(f"hostile_options.py: rths {name} {' '.join(line)} ends with {code}: {said.decode()}")
    return seconds


if __name__ == "__main__":
    sys.exit(main())
