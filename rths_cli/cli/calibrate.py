"""`rths calibrate`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, json_option, settings_option
from rths_cli.cli.terminal import show_page

if TYPE_CHECKING:
    from rths_cli.experiment.calibrate_command import Question


@cli.command()
@click.argument("case")
@click.option("--output", required=True, type=FILE, metavar="FILE", help="File to write; one that exists is refused.")
@click.option(
    "--model", type=FILE, metavar="FILE", help="Model of this rig (rths identify), for the ratios of sensors."
)
@click.option(
    "--sensitivity",
    "sensitivities",
    multiple=True,
    metavar="NAME=V+-U",
    help="A sensor compared with a standard: table=1022mV/g+-0.2%, table=0.1042+-0.0002 (V per m/s^2, m, N or 1). "
    "Repeatable.",
)
@click.option(
    "--mass",
    "masses",
    multiple=True,
    metavar="NAME=M+-U",
    help="A floor weighed, in kg: floor_2=6.93+-0.007. Repeatable.",
)
@click.option("--by", default="", metavar="NAME", help="Who measured; kept in the file.")
@click.option("--yes", is_flag=True, help="Ask nothing: what is not given was not measured.")
@settings_option
@json_option
def calibrate(
    case: str,
    output: Path,
    model: Path | None,
    sensitivities: tuple[str, ...],
    masses: tuple[str, ...],
    by: str,
    yes: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Write the calibration file of a rig from comparisons of its sensors, weighed floors and an identified model.

    The rig file names it under `calibration`. On a terminal you are asked for what is not given. Before: rths doctor
    --channels --push --move tells zeros and signs.

    Example: rths calibrate el_centro_low_ff_fb --set table=aps400_laboratory --mass floor_2=6.91+-0.1% --output a.yaml
    """
    from rths_cli.experiment.calibrate_command import CalibrateRequest, calibrate_rig
    from rths_cli.report.calibration_page import document, page

    asks = not (yes or as_json) and sys.stdin is not None and sys.stdin.isatty()
    asked = CalibrateRequest(case, output, model, sensitivities, masses, by, settings)
    made = calibrate_rig(asked, _ask if asks else None)
    if as_json:
        click.echo(json.dumps(document(made), indent=2))
    else:
        show_page(lambda: page(made))
    return 0


def _ask(question: Question) -> str:
    """Return what a person measured, as text; "" for nothing."""
    if question.refused:
        click.echo(question.refused, err=True)
    known = f"{question.declared} +- {100.0 * question.uncertainty:.2g} %"
    text = f"{question.what}, declared {known}; measured (VALUE+-U, Enter: not)"
    return str(click.prompt(text, default="", show_default=False, err=True))
