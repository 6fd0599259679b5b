"""The commands: text in, exit code out. Everything heavy is imported inside them."""

from __future__ import annotations

from rths_cli.cli import (  # each adds its commands
    check_command,
    doctor_command,
    export_command,
    identify_command,
    recover_command,
    report_command,
    run_commands,
    serve_command,
    start_commands,
    sweep_command,
)
from rths_cli.cli.completion import complete_cases
from rths_cli.cli.ending import main
from rths_cli.cli.group import SIGNALS, cli

__all__ = [
    "SIGNALS",
    "check_command",
    "cli",
    "doctor_command",
    "export_command",
    "identify_command",
    "main",
    "recover_command",
    "report_command",
    "run_commands",
    "serve_command",
    "start_commands",
    "sweep_command",
]

complete_cases(cli.commands.values())
