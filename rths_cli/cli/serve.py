"""`rths serve`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, Number, json_option, settings_option
from rths_cli.cli.terminal import new_screen


@cli.command()
@click.argument("rig", default="aps400_virtual")
@click.option("--structure", default="three_storey", show_default=True, help="Whose experimental storeys stand on it.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=47800, show_default=True, help="Port to listen at; 0: a free one."
)
@click.option(
    "--key-file",
    type=FILE,
    metavar="FILE",
    help="Secret shared with the runner, 32 hexadecimal digits [default: one made in your cache].",
)
@click.option(
    "--watchdog",
    "watchdog_s",
    type=Number(min=0.001, max=10),
    default=0.15,
    show_default=True,
    metavar="S",
    help="Rest the table after so long without a command.",
)
@click.option("--seconds", type=Number(min=0, min_open=True), metavar="S", help="End after so long.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the sensors' noise.")
@settings_option
@json_option
def serve(
    rig: str,
    structure: str,
    host: str,
    port: int,
    key_file: Path | None,
    watchdog_s: float,
    seconds: float | None,
    seed: int,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Serve a virtual table with a specimen in real time over UDP, to rehearse without a laboratory.

    Ends, with the table at rest, after --seconds or by Ctrl-C.

    Example: rths serve aps400_virtual --structure three_storey
    """
    from dataclasses import asdict

    from rths_cli.experiment.serve_command import ServeRequest, serve

    screen = new_screen(False)
    request = ServeRequest(rig, structure, host, port, key_file, watchdog_s, seconds, seed, settings)
    ended = serve(request, screen.message if as_json else click.echo)
    if as_json:
        click.echo(json.dumps({"sessions": [asdict(one) for one in ended]}, indent=2))
    return 0
