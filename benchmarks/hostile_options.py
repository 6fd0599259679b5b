"""Give every option and argument what nobody means.

python benchmarks/hostile_options.py [COUNT] [SEED] [--command NAME]

Options and arguments are those of the commands themselves, and the keys of --set those of docs/reference/case.md. Each
is tried with empty, wrong, huge and non-finite values, control characters, bytes that are no text, names of 300
characters, 1,200 dots, pipes, devices, circles of links and removed folders, beside what the command needs otherwise.
Every trial is a process of its own in a folder of its own. Demanded: exit code 0, 1 or 2 (4 where a link is tried), no
traceback, no control character on the screen, 1 GB, and 5 s of the processor more than the command takes otherwise;
after code 2 nothing is left in the folder. COUNT 0, the default, tries all.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import stat
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import click
import mutated_files

import rths_cli
from rths_cli.cli.command_group import cli

CASE = mutated_files.CASE
ROOT = Path(__file__).parents[1]
QUICK = (CASE, "--set", "record=short.csv")
NEEDED: dict[str, tuple[str, ...]] = {
    "check": QUICK,
    "run": (*QUICK, "--set", "runs=[sim]"),
    "identify": (*QUICK, "--set", "sample_rate_hz=500", "--set", "identification.duration_s=40", "--no-figure"),
    "sweep": (*QUICK, "--seeds", "1", "--jobs", "1"),
    "report": ("result.h5",),
    "export": ("result.h5", "--to", "csv", "--group", "sim"),
    "recover": ("killed.exp_rths.rthslog",),
    "records": ("./short.csv",),
    "schema": (),
    "new": ("new.yaml",),
    "doctor": ("--seconds", "0.1", "--rate", "100"),
    "serve": ("--port", "0", "--seconds", "0.1"),
}
"""What each command is given beside the value on trial, so that it does its work in a moment."""
VALUES = (
    "", " ", "x", "nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e-320", "9" * 5000, "1e999", "0x10", "1_000",
    "\u0663", "\x1b[2Jred", "a\nb", "\x07", "\udcff", "\u202e", "x" * 300, "a." * 1200 + "b", "a/" * 1200 + "b",
    "[" * 3000, "{", "null", "[]", "true", "=1+1", "a=b=c", "::", "..", ".", "fifo", "zero", "full", "circle",
    "removed/file", "short.csv/file", "short.csv", "!!python/object/apply:os.system [x]", "%s%n", "-",
)  # fmt: skip
FORMS: dict[str, tuple[str, ...]] = {
    "--set": ("{}", "{}=1", "scaling={}", "table={}", "record={}", "runs={}"),
    "--vary": ("{}", "{}=0.1,0.2", "scaling={}", "scaling=0.1:{}:3", "scaling=0.1:0.2:{}", "scaling={},0.2"),
    "--seeds": ("{}", "0:{}", "{}:3"),
    "--channel": ("{}", "table={}", "{}=table", "table=table:{}"),
}
"""How a value stands in options of several parts."""
RECORDED = ("--data", "data.csv", "--corrected")
BESIDE: dict[str, tuple[str, ...]] = {
    "--channel": RECORDED, "--rate": RECORDED, "--fail-worse": ("--baseline", "result.h5"),
}  # fmt: skip
"""What else an option needs to be read at all."""
USUAL: dict[tuple[str, str], tuple[str, ...]] = {("report", "--figures"): ("--figures", "figures")}
"""With what an option is compared that lets its command work for long."""
LINKED = ("doctor", "serve")
ENDLESS = {("serve", "--seconds"), ("doctor", "--seconds")}
"""A huge number is a legitimate one here: the command goes on until it is told to end."""
SERVED_S = 5.0


@dataclass(frozen=True)
class Trial:
    """A command line with one value on trial."""

    command: str
    option: str
    line: tuple[str, ...]


def main(arguments: Sequence[str]) -> int:
    """Try as many values as asked; return 1 where a demand was not met."""
    numbers = [int(text) for text in arguments if text.isdigit()]
    count, seed = (*numbers, *(0, 15)[len(numbers) :])[:2]
    only = dict(pairwise(arguments)).get("--command")
    chosen = [one for one in trials() if only in (None, one.command)]
    if count:
        chosen = random.Random(seed).sample(chosen, min(count, len(chosen)))
    with tempfile.TemporaryDirectory(prefix="rths-options-") as name:
        rths_cli.check(CASE)  # what every command compiles and imports is there before the copies are made
        files = make_files(Path(name) / "valid")
        bad = run_all(Path(name) / "work", files, chosen)
    return 1 if bad else 0


def trials() -> Iterator[Trial]:
    """Yield every option and argument of every command with every value, and every key of a case."""
    for name, command in sorted(cli.commands.items()):
        for parameter in command.params:
            told = next((text for text in parameter.opts if text.startswith("--")), "")
            if isinstance(parameter, click.Option) and not parameter.is_flag:
                yield from (Trial(name, told, line) for line in _with_option(name, told))
            elif isinstance(parameter, click.Argument):
                needed = NEEDED[name]
                rest = needed[1:] if needed and not needed[0].startswith("--") else needed
                yield from (Trial(name, parameter.name or "", (name, *rest, "--", value)) for value in VALUES)
    keys = re.findall(r"^\| `([^`*]+)` \|", (ROOT / "docs/reference/case.md").read_text(encoding="utf-8"), re.MULTILINE)
    for key in dict.fromkeys(keys):
        yield from (Trial("check", f"--set {key}", ("check", *QUICK, "--set", f"{key}={value}")) for value in VALUES)


def _with_option(name: str, option: str) -> Iterator[tuple[str, ...]]:
    for value in VALUES:
        for form in FORMS.get(option, ("{}",)):
            yield (name, *NEEDED[name], *BESIDE.get(option, ()), option, form.replace("{}", value))


def make_files(folder: Path) -> dict[str, Path]:
    """Make the files that commands need, by the names they get in the folder of a trial."""
    folder.mkdir(parents=True)
    (folder / "short.csv").write_text(mutated_files.SHORT_RECORD)
    line = ("run", *QUICK, "--output", ".", "--quiet")
    code, _, _, said = mutated_files.in_a_process_slow(folder, line)
    assert code in (0, 1), said.decode()
    result = folder / f"{CASE}.h5"
    log = mutated_files.make_log(folder, result)
    mutated_files.in_a_process_slow(folder, mutated_files.RECORDED)
    data = next(path for path in mutated_files.foreign_files(folder) if path.name == "data.csv")
    return {"short.csv": folder / "short.csv", "result.h5": result, log.name: log, "data.csv": data}


def folder_with(work: Path, files: dict[str, Path]) -> None:
    """Make the folder of a trial anew: valid files, a pipe, devices, a circle of links."""
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    for name, path in files.items():
        shutil.copy(path, work / name)
    os.mkfifo(work / "fifo")
    (work / "circle").symlink_to("circle")
    for name, minor in (("zero", 5), ("full", 7)):  # of our own: a device of the system could be replaced by mistake
        try:
            os.mknod(work / name, stat.S_IFCHR | 0o666, os.makedev(1, minor))
        except PermissionError:  # only root may
            os.mkfifo(work / name)


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


def shown(part: str) -> str:
    """Return a word of a command line in few visible characters."""
    return repr(part if len(part) < 60 else f"{part[:40]}...({len(part)})")


def of_usual(one: Trial) -> tuple[str, tuple[str, ...]]:
    """Return the command of a trial, and what it is given when its usual time is taken."""
    return one.command, (*NEEDED[one.command], *USUAL.get((one.command, one.option), ()))


def usual_seconds(work: Path, files: dict[str, Path], name: str, line: tuple[str, ...]) -> float:
    """Return the time of the processor that a command takes with what it needs; raises SystemExit where it fails."""
    for run in (mutated_files.in_a_process_slow, mutated_files.in_a_process):  # the first compiles
        folder_with(work, files)
        code, seconds, _, said = run(work, (name, *line))
    if code not in (0, 1):
        raise SystemExit(f"hostile_options.py: rths {name} {' '.join(line)} ends with {code}: {said.decode()}")
    return seconds


def tried(work: Path, files: dict[str, Path], one: Trial, usual_s: float) -> tuple[int, str, str]:
    """Run one trial; return its code, which demand was not met ("" when all were), and what it said."""
    folder_with(work, files)
    before = listed(work)
    hangs_s = SERVED_S if (one.command, one.option) in ENDLESS else mutated_files.HANGS_S
    code, seconds, memory, said = mutated_files.in_a_process(work, one.line, hangs_s)
    if code == 4 and one.command in LINKED:
        code = 2
    if code == mutated_files.TOLD_TO_END and (one.command, one.option) in ENDLESS:
        code = 0
    faults = [mutated_files.judged(code, seconds - usual_s, memory, said)]
    left = sorted(listed(work) - before)
    faults += [f"code 2, and leaves {', '.join(map(shown, left))}"] if code == 2 and left else []
    return code, ", ".join(fault for fault in faults if fault), said.decode(errors="replace")


def listed(work: Path) -> set[str]:
    """Return what is in a folder and below it."""
    return {str(path.relative_to(work)) for path in work.rglob("*") if path.name != ".output"}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
