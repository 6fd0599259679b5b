"""`rths list`."""

from __future__ import annotations

import json
import sys
import textwrap

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import json_option
from rths_cli.cli.terminal import page_width

KINDS = ("cases", "structures", "rigs", "records", "references")


@cli.command("list")
@click.argument("kind", type=click.Choice(KINDS), metavar="KIND")
@json_option
def list_kind(kind: str, as_json: bool) -> int:
    """List what a case may name and `rths run` takes here: your own files first, with their paths, then shipped ones.

    KIND: cases, structures, rigs, records or references.

    Example: rths list structures
    """
    return show_list(kind, as_json)


def show_list(kind: str, as_json: bool) -> int:
    """Print the files of a kind, a line for each; on a terminal the lines are wrapped. Return the exit code."""
    from rths_cli.experiment.file_list import list_files

    found = list_files(kind)
    if as_json:
        listed = [
            {"name": one.name, "file": one.file, "own": one.own, "description": one.description, **one.details}
            for one in found
        ]
        click.echo(json.dumps({kind: listed}, indent=2))
        return 0
    label = max((len(one.name) for one in found), default=0) + 2
    for one in found:
        where = f" ({one.file})" if one.own and one.file not in one.description else ""
        line = f"{one.name:<{label}}{one.description}{where}"
        click.echo(_wrapped(line, label) if sys.stdout.isatty() else line)
    if not found:
        click.echo(f"no {kind} here", err=True)
    return 0


def _wrapped(line: str, indent: int) -> str:
    return textwrap.fill(line, page_width(), subsequent_indent=" " * indent, break_on_hyphens=False)
