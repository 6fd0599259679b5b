"""`rths merge`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, command_line, force_option, json_option, no_replace_option
from rths_cli.cli.terminal import show_page
from rths_cli.errors import InputError


@cli.command()
@click.argument("parts", nargs=-1, required=True, type=FILE, metavar="PART...")
@click.option("--output", type=FILE, required=True, metavar="FILE", help="File of the whole sweep, as sweeps/NAME.h5.")
@no_replace_option
@force_option
@json_option
def merge(parts: tuple[Path, ...], output: Path, no_replace: bool, force: bool, as_json: bool) -> int:
    """Join the files of `rths sweep --part K/N`, in any order, to the table of the whole sweep.

    Parts of different sweeps or versions of rths are refused, and so are rows that are missing or there twice. The exit
    code is that of the sweep.

    Example: rths merge sweeps/study-part*.h5 --output sweeps/study.h5
    """
    from rths_cli.files.durable_files import taken_sentence
    from rths_cli.files.existing_files import replaced_sentence
    from rths_cli.report.sweep_page import document, page
    from rths_cli.studies.merge import merge_parts
    from rths_cli.studies.sweep_output import several_processors

    if force and no_replace:
        raise InputError("--force replaces a finished sweep, --no-replace does not: give one of them")
    sweep, written, replaced = merge_parts(parts, output, not no_replace, command_line(), force)
    if replaced:
        click.echo(replaced_sentence([output]), err=True)
    if written != output:
        click.echo(taken_sentence(output, written), err=True)
    if several := several_processors(sweep):
        click.echo(several, err=True)
    code = int(sweep.attributes["exit_code"])
    if as_json:
        click.echo(json.dumps(document(sweep, written) | {"exit_code": code}, indent=2))
    else:
        show_page(lambda: page(sweep, written))
    return code
