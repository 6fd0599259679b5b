"""`rths structure`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.listing import show_list
from rths_cli.cli.options import FILE, json_option, no_replace_option
from rths_cli.cli.terminal import page_width, show_page


@cli.command()
@click.argument("structure", required=False, metavar="[NAME|FILE]")
@click.option("--figure", type=FILE, metavar="FILE", help="Draw building and mode shapes, .pdf, .svg or .png.")
@no_replace_option
@json_option
def structure(structure: str | None, figure: Path | None, no_replace: bool, as_json: bool) -> int:
    """Show a building before anything is run: modes, damping, mass split, stiffnesses, doubts on units.

    A case shows its building, with its own damping. Without NAME: the structures that are known. Exit code 1: the
    building cannot have one of its damping levels.

    Example: rths structure three_storey
    """
    if structure is None:
        return show_list("structures", as_json)
    from rths_cli.experiment.structure_command import inspect_structure
    from rths_cli.report.structure_page import document, page

    found = inspect_structure(structure)
    if figure is not None:
        from rths_cli.files.existing_files import Kind, check_existing
        from rths_cli.report.structure_figure import write_figure

        replaced = check_existing([(figure, Kind.DOCUMENT)], not no_replace, streams=True)
        write_figure(found, figure)
        click.echo(f"{'replaced' if replaced else 'wrote'} {figure}", err=True)
    if as_json:
        click.echo(json.dumps(document(found), indent=2))
    else:
        show_page(lambda: page(found, page_width()))
    return found.exit_code
