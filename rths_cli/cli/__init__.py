"""The commands: text in, exit code out. Everything heavy is imported inside them."""

from __future__ import annotations

from rths_cli.cli import check, doctor, export, identify, recover, report, run, serve, start, sweep
from rths_cli.cli.completion import complete_cases
from rths_cli.cli.entry_point import main
from rths_cli.cli.group import SIGNALS, cli

__all__ = [
    "SIGNALS",
    "check",
    "cli",
    "doctor",
    "export",
    "identify",
    "main",
    "recover",
    "report",
    "run",
    "serve",
    "start",
    "sweep",
]

complete_cases(cli.commands.values())
