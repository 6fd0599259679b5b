"""The commands: text in, exit code out. Everything heavy is imported inside them."""

from __future__ import annotations

from rths_cli.cli import check, doctor, export, identify, new, records, recover, report, run, schema, serve, sweep
from rths_cli.cli.command_group import SIGNALS, cli
from rths_cli.cli.completion import complete_cases
from rths_cli.cli.entry_point import main

__all__ = [
    "SIGNALS",
    "check",
    "cli",
    "doctor",
    "export",
    "identify",
    "main",
    "new",
    "records",
    "recover",
    "report",
    "run",
    "schema",
    "serve",
    "sweep",
]

complete_cases(cli.commands.values())
