"""`rths doctor`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import Number, json_option, settings_option, yes_option
from rths_cli.cli.terminal import new_screen, show_page

if TYPE_CHECKING:
    from collections.abc import Callable

    from rths_cli.cli.terminal import Screen
    from rths_cli.experiment.doctor_request import DoctorRequest
    from rths_cli.experiment.setup import Setup

PUSH = (
    "After your answer, push the top floor once in the positive direction, that of a positive command, and let go.",
)


@cli.command()
@click.argument("case", required=False)
@click.option(
    "--rig", metavar="FILE", help="Measure the exchange with this rig too: its table is armed, and held at zero."
)
@click.option(
    "--rate",
    "rates_hz",
    type=Number(min=10, max=20_000),
    multiple=True,
    metavar="HZ",
    help="Rate that must be held [default: the case's; without one 500, 1000, 2000 and 4000 are tried]. Repeatable.",
)
@click.option(
    "--seconds",
    type=Number(min=0.1, max=3600),
    default=3.0,
    show_default=True,
    help="Duration of each measurement.",
)
@click.option("--channels", is_flag=True, help="Instead: zeros, noise and range of every channel of the rig, at rest.")
@click.option("--move", is_flag=True, help="With --channels: compare channels that must agree in a slow, small motion.")
@click.option("--push", is_flag=True, help="With --channels: tell the signs by a push, for which you are asked.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
@yes_option
@settings_option
@json_option
def doctor(
    case: str | None,
    rig: str | None,
    rates_hz: tuple[float, ...],
    seconds: float,
    channels: bool,
    move: bool,
    push: bool,
    quiet: bool,
    yes: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Measure which sample rates this machine holds in real time, and say what would make it more punctual.

    Exit code 1: the rate of the case, or one given by --rate, is not held. The figures are kept for rths run.

    Example: rths doctor --seconds 1
    """
    from rths_cli.experiment.doctor_request import DoctorRequest, examine_request
    from rths_cli.report.doctor_page import document, page

    screen = new_screen(quiet)
    request = DoctorRequest(case, rig, rates_hz, seconds, settings)

    def permit(setup: Setup) -> None:
        from rths_cli.experiment.operator_consent import ask_to_move
        from rths_cli.experiment.unit_plausibility import OF_RIG

        # without a case the structure is a lent one
        ask_to_move([setup], yes, screen.confirm, played=("",) if case else OF_RIG)

    if channels or move or push:
        return _of_channels(request, (channels, move, push), screen, permit, as_json)
    found = examine_request(request, screen.doing, permit)
    screen.clear()
    if as_json:
        click.echo(json.dumps(document(found), indent=2))
    else:
        show_page(lambda: page(found))
    return found.exit_code


def _of_channels(
    request: DoctorRequest,
    asked: tuple[bool, bool, bool],
    screen: Screen,
    permit: Callable[[Setup], None],
    as_json: bool,
) -> int:
    """Show the channels of a rig; return the exit code."""
    from rths_cli.errors import InputError
    from rths_cli.experiment.doctor_request import channels_request
    from rths_cli.report.doctor_page import channels_document, channels_page

    channels, move, push = asked
    if not channels:
        raise InputError("--move and --push belong to --channels; add it")

    def ask() -> None:
        if not screen.confirm(PUSH):
            raise InputError("nobody pushed; leave --push out")

    found = channels_request(request, move, ask if push else None, screen.doing, permit)
    screen.clear()
    if as_json:
        click.echo(json.dumps(channels_document(found), indent=2))
    else:
        show_page(lambda: channels_page(found))
    return found.exit_code
