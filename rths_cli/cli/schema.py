"""`rths schema`."""

from __future__ import annotations

import json

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import json_option

KINDS = ("case", "structure", "rig", "reference", "study")


@cli.command()
@click.argument("kind", type=click.Choice(KINDS), default="case", metavar=f"[{'|'.join(KINDS)}]")
@json_option
def schema(kind: str, as_json: bool) -> int:
    """Print the JSON Schema of case files (or of what they name, or of a study), for editors.

    Example: rths schema > case.schema.json
    """
    from rths_cli.case.json_schema import schema as build_schema

    click.echo(json.dumps(build_schema(kind), indent=2))
    return 0
