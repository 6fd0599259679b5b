"""`rths identify`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import (
    FILE,
    json_option,
    no_replace_option,
    quiet_option,
    rate_option,
    settings_option,
    yes_option,
)
from rths_cli.cli.terminal import new_screen, show_page
from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup

SAID_S = 5.0  # interval between two lines of progress if stderr is no terminal


@cli.command()
@click.argument("case", default="el_centro_low_ff_fb")
@click.option(
    "--data",
    multiple=True,
    metavar="FILE",
    type=FILE,
    help="Evaluate measured time histories (see rths data) instead of exciting the rig. Repeatable: averaged.",
)
@click.option(
    "--channel",
    "channels",
    multiple=True,
    metavar="ROLE=NAME[:UNIT]|FILE",
    help="Which channel of the file is what: command, table, floor_2, ...; for instance --channel table=ai0:g; or a "
    "YAML file as rths data prints it.",
)
@rate_option
@click.option("--corrected", is_flag=True, help="The file's accelerations are free of the sensors' dynamics already.")
@click.option(
    "--model",
    type=FILE,
    metavar="FILE",
    help="Judge this model (zeros, poles, gain in YAML or .mat; or a model file) instead of fitting one.",
)
@click.option("--output", type=FILE, metavar="FILE", help="Model file [default: models/RIG_STRUCTURE.h5].")
@click.option(
    "--figure",
    type=FILE,
    metavar="FILE",
    help="Figure, .png, .svg or .pdf [default: beside the model file, .png].",
)
@click.option("--no-figure", is_flag=True, help="Draw no figure.")
@click.option(
    "--save-data",
    type=FILE,
    metavar="FILE",
    help="Write what was measured, for --data --corrected.",
)
@no_replace_option
@quiet_option
@yes_option
@settings_option
@json_option
def identify(
    case: str,
    data: tuple[Path, ...],
    channels: tuple[str, ...],
    rate_hz: float | None,
    corrected: bool,
    model: Path | None,
    output: Path | None,
    figure: Path | None,
    no_figure: bool,
    save_data: Path | None,
    no_replace: bool,
    quiet: bool,
    yes: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Identify the table and specimen of a case, write a model file, say what it is fit for.

    The rig is excited, first at a low level; or measured records are read (--data). Without CASE: the default rig and
    structure.

    Example: rths identify el_centro_low_ff_fb --set identification.seed=1
    """
    from rths_cli.experiment.identify_command import Asked, DataRequest, make_model, read_roles
    from rths_cli.experiment.real_rig_readiness import ask_to_move
    from rths_cli.experiment.unit_plausibility import OF_IDENTIFICATION

    if not data and (channels or rate_hz is not None or corrected):
        raise InputError("--channel, --rate and --corrected belong to --data FILE; add it, or leave them out")
    request = DataRequest(data, read_roles(channels), rate_hz, corrected) if data else None
    # without --model, the model file that the case names is ignored: it is the one to be made here
    judged = json.dumps(str(model.absolute()), ensure_ascii=False) if model else "null"
    settings = (f"identification.model={judged}", *settings)
    asked = Asked(case, settings, request, output, save_data, figure, not no_figure, not no_replace)
    screen = new_screen(quiet, command="" if as_json else "identify")

    def permit(setup: Setup) -> None:
        ask_to_move([setup], yes, screen.confirm, played=OF_IDENTIFICATION)

    with screen.reading("starting"):
        made = make_model(asked, screen.doing, permit, screen.warning)
    screen.clear()
    _show_identified(made, as_json, quiet)
    return made.exit_code


def _show_identified(made: Any, as_json: bool, quiet: bool) -> None:
    """Print the page of an identification, with `as_json` its document, with `quiet` its verdict; draw its figure."""
    from rths_cli.report.identification_page import (
        as_document,
        page,
        rejected_document,
        rejected_page,
        rejected_sentence,
        verdict_sentence,
    )

    found, unfit = made.found, made.unfit
    if found is not None and made.figure:
        from rths_cli.report.identification_figure import write_figure

        write_figure(found, made.about, made.figure)
    if as_json:
        document = as_document(found, made.about) if found is not None else None
        document = document or rejected_document(unfit.channels, unfit.findings, made.about)
        click.echo(json.dumps(document, indent=2))
    elif quiet:
        told = rejected_sentence(unfit.faults) if found is None else verdict_sentence(found.verdict)
        click.echo("; ".join([told, *([str(made.model)] if made.model else [])]))
    elif found is not None:
        show_page(lambda: page(found, made.about))
    else:
        show_page(lambda: rejected_page(unfit.channels, unfit.faults, made.about))
    if made.model is not None and not as_json and not quiet:
        click.echo(f"\nto use it in a case:\nidentification: {{model: {_quoted(made.model)}}}")


def _quoted(path: Path) -> str:
    """Return a path, absolute and quoted, as it is written in a case file."""
    return json.dumps(str(path.absolute()), ensure_ascii=False)
