"""`rths new`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, json_option


@cli.command()
@click.argument("path", type=FILE, metavar="FILE")
@json_option
def new(path: Path, as_json: bool) -> int:
    """Write a commented case file to start from; an existing file is left alone.

    Example: rths new my_case.yaml
    """
    from rths_cli.case.template import case_template
    from rths_cli.files.durable_files import write_new

    write_new(path, case_template())
    click.echo(json.dumps({"written": str(path)}) if as_json else f"wrote {path}; try: rths run {path}")
    return 0
