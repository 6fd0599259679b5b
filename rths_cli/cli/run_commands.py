"""`rths run` and `rths report`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from rths_cli.cli.group import cli
from rths_cli.cli.options import json_option, methods_option, overrides_option, settings_option, yes_option
from rths_cli.cli.screens import new_screen


@cli.command()
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@click.option("--output", default="results", show_default=True, metavar="DIR", help="Folder of the result files.")
@methods_option("compare (files NAME-paper.h5, NAME-best.h5)")
@click.option("--no-replace", is_flag=True, help="Refuse, before running, to replace a finished result.")
@click.option("--quiet", is_flag=True, help="Show no progress, only what went wrong.")
@overrides_option(
    ["check", "model"],
    "run EXP-RTHS although its check says no, or use a model that was rejected. Repeatable, stored in the result.",
)
@yes_option
@click.option("--fresh", is_flag=True, help="Identify anew; use no model of a virtual rig kept from earlier runs.")
@settings_option
@json_option
def run(
    cases: tuple[str, ...],
    output: str,
    methods: tuple[str, ...],
    no_replace: bool,
    quiet: bool,
    overrides: tuple[str, ...],
    yes: bool,
    fresh: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Run cases and print their tables; one result file per case.

    Example: rths run el_centro_low_ff_fb --set scaling=0.2
    """
    from rths_cli.workflows.batch import Request, exit_code, run_batch

    screen = new_screen(quiet)
    request = Request(
        paths=cases,
        settings=settings,
        methods=tuple(dict.fromkeys(methods)),
        output=Path(output),
        replace=not no_replace,
        command_line=" ".join(["rths", *sys.argv[1:]]),
        overrides=tuple(dict.fromkeys(overrides)),
        fresh=fresh,
        yes=yes,
    )
    ended = run_batch(request, screen)
    _show_results([e.path for e in ended if e.path], as_json, [e.__dict__ for e in ended])
    return exit_code(ended)


@cli.command()
@click.argument("results", nargs=-1, metavar="[RESULT...]")
@json_option
def report(results: tuple[str, ...], as_json: bool) -> int:
    """Print the tables of result files or folders of them (default: results/).

    Example: rths report results
    """
    from rths_cli.report.load import load, unrecovered

    paths = [Path(result) for result in results or ("results",)]
    for waiting in unrecovered(paths):
        click.echo(waiting, err=True)
    _print_tables(load(paths), as_json, None)
    return 0


def _show_results(paths: list[Path], as_json: bool, endings: list[dict[str, Any]]) -> None:
    """Read the result files back and print their tables."""
    from rths_cli.report.load import load

    if paths or as_json:
        _print_tables(load(paths), as_json, endings)


def _print_tables(results: Any, as_json: bool, endings: list[dict[str, Any]] | None) -> None:
    from rths_cli.report.tables import tables, to_json

    if as_json:
        document = to_json(results) | ({"cases": endings} if endings is not None else {})
        click.echo(json.dumps(document, indent=2, default=str))
    else:
        click.echo(tables(results), nl=False)
