"""What helps to write a case: `rths records`, `rths new`, `rths schema`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rths_cli.cli.group import cli
from rths_cli.cli.options import FILE, Number, json_option


@cli.command()
@click.argument("record", required=False)
@click.option("--unit", help="Unit of the accelerations, where the file does not state it (g, cm/s^2, ...).")
@click.option(
    "--dt", "dt_s", type=Number(min=0, min_open=True), help="Sample interval in s, where the file does not state it."
)
@json_option
def records(record: str | None, unit: str | None, dt_s: float | None, as_json: bool) -> int:
    """List the shipped ground motions, or show one: peaks, duration, response spectrum.

    Example: rths records el_centro
    """
    from rths_cli.experiment.record_list import listing, show

    document, text = show(record, unit, dt_s) if record else listing()
    click.echo(json.dumps(document, indent=2) if as_json else text, nl=as_json)
    return 0


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


@cli.command()
@click.argument("kind", type=click.Choice(["case", "structure", "rig", "reference"]), default="case")
@json_option
def schema(kind: str, as_json: bool) -> int:
    """Print the JSON Schema of case files (or of what they name), for editors.

    Example: rths schema > case.schema.json
    """
    from rths_cli.case.json_schema import schema as build_schema

    click.echo(json.dumps(build_schema(kind), indent=2))
    return 0
