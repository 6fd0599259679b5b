"""The commands: text in, exit code out. Everything heavy is imported inside them."""

from __future__ import annotations

from rths_cli.cli import benchmark, check, describe, evaluate, export, ida, identify, laboratory, report, run, sweep
from rths_cli.cli.command_group import SIGNALS, cli
from rths_cli.cli.entry_point import main
from rths_cli.cli.logs import add_log_options
from rths_cli.cli.options import complete_names

__all__ = [
    "SIGNALS",
    "benchmark",
    "check",
    "cli",
    "describe",
    "evaluate",
    "export",
    "ida",
    "identify",
    "laboratory",
    "main",
    "report",
    "run",
    "sweep",
]

complete_names(cli.commands.values())
add_log_options(cli.commands.values())
