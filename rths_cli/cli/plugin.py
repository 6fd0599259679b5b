"""`rths plugin`."""

from __future__ import annotations

import json

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import json_option
from rths_cli.cli.terminal import new_screen, show_page


@cli.command()
@click.argument("action", type=click.Choice(["test"]), metavar="test")
@click.argument("package", metavar="PACKAGE")
@click.option("--rig", metavar="FILE", help="Rig file whose channels, limits and options are tried [default: made up].")
@json_option
def plugin(action: str, package: str, rig: str | None, as_json: bool) -> int:
    """Hold the rigs and laws of an installed package to the contract of every rig.

    PACKAGE is its name, or the kind of a rig that it brings. Each rig is opened, armed and moved to its limits; one
    that states hardware behind it is refused. Exit code 1: the contract is broken.

    Example: rths plugin test rths-slow-table
    """
    from rths_cli.experiment.plugin_command import try_package
    from rths_cli.report.plugin_page import document, page

    screen = new_screen(as_json)
    found = try_package(package, rig, screen.doing)
    screen.clear()
    code = 0 if all(one.kept for one in found) else 1
    if as_json:
        click.echo(json.dumps(document(package, found) | {"exit_code": code}, indent=2))
    else:
        show_page(lambda: page(package, found))
    return code
