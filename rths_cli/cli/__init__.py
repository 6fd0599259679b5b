"""The commands: text in, exit code out. Everything heavy is imported inside them."""

from __future__ import annotations

from rths_cli.cli import (
    calibrate,
    check,
    doctor,
    export,
    identify,
    listing,
    merge,
    new,
    plugin,
    records,
    recover,
    report,
    run,
    schema,
    serve,
    structure,
    sweep,
)
from rths_cli.cli.command_group import SIGNALS, cli
from rths_cli.cli.completion import complete_names
from rths_cli.cli.entry_point import main
from rths_cli.cli.logs import add_log_options

__all__ = [
    "SIGNALS",
    "calibrate",
    "check",
    "cli",
    "doctor",
    "export",
    "identify",
    "listing",
    "main",
    "merge",
    "new",
    "plugin",
    "records",
    "recover",
    "report",
    "run",
    "schema",
    "serve",
    "structure",
    "sweep",
]

complete_names(cli.commands.values())
add_log_options(cli.commands.values())
