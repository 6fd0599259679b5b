"""`rths records`."""

from __future__ import annotations

import json

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.listing import show_list
from rths_cli.cli.options import Number, json_option
from rths_cli.cli.terminal import page_width


@cli.command()
@click.argument("record", required=False)
@click.option("--unit", help="Unit of the accelerations, where the file does not state it (g, cm/s^2, ...).")
@click.option(
    "--dt", "dt_s", type=Number(min=0, min_open=True), help="Sample interval in s, where the file does not state it."
)
@click.option(
    "--scale",
    "scale",
    multiple=True,
    metavar="KEY=VALUE",
    help="Show the record as a case with this scale compresses it, for instance --scale length=2.4. Repeatable.",
)
@click.option(
    "--baseline",
    type=click.Choice(["mean", "linear", "none"]),
    help="Show the record without its mean or its straight line, as a case with this key takes it.",
)
@json_option
def records(
    record: str | None,
    unit: str | None,
    dt_s: float | None,
    scale: tuple[str, ...],
    baseline: str | None,
    as_json: bool,
) -> int:
    """Show a ground motion: peaks, duration, response spectrum. Without RECORD: list those that are known.

    Example: rths records el_centro
    """
    if record is None:
        if scale:
            raise click.UsageError("--scale compresses one record; name it: rths records RECORD --scale length=2.4")
        return show_list("records", as_json)
    from rths_cli.case.scale_schema import read_scale
    from rths_cli.experiment.ground_motion_list import show

    document, text = show(record, unit, dt_s, page_width(), read_scale(scale), baseline)
    click.echo(json.dumps(document, indent=2) if as_json else text, nl=as_json)
    return 0
