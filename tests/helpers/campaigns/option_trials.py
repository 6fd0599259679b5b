"""Command lines that give every option and argument what nobody means, and whether each command takes it as it must.

Options and arguments are those of the commands themselves, and the keys of --set those of docs/reference/case.md.
"""

from __future__ import annotations

import os
import re
import shutil
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click

from campaigns import command_trials
from campaigns.valid_files import CASE
from rths_cli.cli.command_group import cli

ROOT = Path(__file__).parents[3]
QUICK = (CASE, "--set", "record=short.csv")
NEEDED: dict[str, tuple[str, ...]] = {
    "check": QUICK,
    "run": (*QUICK, "--set", "runs=[sim]"),
    "identify": (*QUICK, "--set", "sample_rate_hz=500", "--set", "identification.duration_s=40", "--no-figure"),
    "calibrate": (
        *QUICK,
        "--set",
        "table=aps400_laboratory",
        "--sensitivity",
        "table=0.1022+-0.2%",
        "--output",
        "c.yaml",
        "--yes",
    ),
    "sweep": (*QUICK, "--seeds", "1", "--jobs", "1"),
    "benchmark": ("silva2020", "--case", "1", "--compensator", "chen", "--plants", "1", "--record", "short.csv"),
    "evaluate": (*QUICK, "--data", "data.csv"),
    "ida": (*QUICK, "--records", ".", "--limit", "drift_m=0.01", "--levels", "0.1"),
    "merge": ("part.h5", "--output", "whole.h5"),
    "report": ("result.h5",),
    "export": ("result.h5", "--to", "csv", "--group", "sim"),
    "recover": ("killed.exp_rths.rthslog",),
    "records": ("./short.csv",),
    "data": ("./short.csv",),
    "structure": ("three_storey",),
    "list": ("structures",),
    "schema": (),
    "plugin": ("test", "nowhere"),
    "new": ("new.yaml",),
    "doctor": ("--seconds", "0.1", "--rate", "100"),
    "bridge": ("opensees", "el_centro_actuator", "--length", "m", "--force", "N", "--host", "8.8.8.8"),
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
    "--sensitivity": ("{}", "floor_2={}", "{}=0.1022+-0.2%", "floor_2=0.1022+-{}"),
    "--mass": ("{}", "floor_2={}", "{}=6.91+-0.1%", "floor_2=6.91+-{}"),
    "--channel": ("{}", "table={}", "{}=table", "table=table:{}"),
}
"""How a value stands in options of several parts."""
RECORDED = ("--data", "data.csv", "--corrected")
BESIDE: dict[str, tuple[str, ...]] = {
    "--channel": RECORDED, "--rate": RECORDED, "--fail-worse": ("--baseline", "result.h5"),
}  # fmt: skip
"""What else an option needs to be read at all."""
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
    keys = re.findall(r"^- `([^`*]+)`", (ROOT / "docs/reference/case.md").read_text(encoding="utf-8"), re.MULTILINE)
    for key in dict.fromkeys(keys):
        yield from (Trial("check", f"--set {key}", ("check", *QUICK, "--set", f"{key}={value}")) for value in VALUES)


def _with_option(name: str, option: str) -> Iterator[tuple[str, ...]]:
    for value in VALUES:
        for form in FORMS.get(option, ("{}",)):
            yield (name, *NEEDED[name], *BESIDE.get(option, ()), option, form.replace("{}", value))


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


def shown(part: str) -> str:
    """Return a word of a command line in few visible characters."""
    return repr(part if len(part) < 60 else f"{part[:40]}...({len(part)})")


def tried(work: Path, files: dict[str, Path], one: Trial, usual_s: float) -> tuple[int, str, str]:
    """Run one trial; return its code, which demand was not met ("" when all were), and what it said."""
    folder_with(work, files)
    before = listed(work)
    hangs_s = SERVED_S if (one.command, one.option) in ENDLESS else command_trials.HANGS_S
    code, seconds, memory, said = command_trials.in_a_process(work, one.line, hangs_s)
    if code == 4 and one.command in LINKED:
        code = 2
    if code == command_trials.TOLD_TO_END and (one.command, one.option) in ENDLESS:
        code = 0
    faults = [command_trials.judged(code, seconds - usual_s, memory, said)]
    left = sorted(listed(work) - before)
    faults += [f"code 2, and leaves {', '.join(map(shown, left))}"] if code == 2 and left else []
    return code, ", ".join(fault for fault in faults if fault), said.decode(errors="replace")


def listed(work: Path) -> set[str]:
    """Return what is in a folder and below it."""
    return {str(path.relative_to(work)) for path in work.rglob("*") if path.name != ".output"}
