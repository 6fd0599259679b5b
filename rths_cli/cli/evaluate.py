"""`rths evaluate`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import (
    FILE,
    Number,
    command_line,
    json_option,
    no_replace_option,
    rate_option,
    settings_option,
)
from rths_cli.cli.run import Wanted, show_results
from rths_cli.cli.terminal import new_screen

DATA = "--data"


@cli.command()
@click.argument("case")
@click.option("--data", required=True, type=FILE, metavar="FILE", help="Recording of the run (see rths data).")
@click.option(
    "--channel",
    "channels",
    multiple=True,
    metavar="ROLE=NAME[:UNIT]|FILE",
    help="Which channel is what: ground, desired, command, table, floor_2, ..., base_shear, floor_2_displacement; a "
    "minus before the unit turns the sign; or a YAML file as rths data prints it. Default: by the names in the file.",
)
@click.option(
    "--as",
    "made",
    type=click.Choice(["exp_rths", "shake_table"]),
    default="exp_rths",
    show_default=True,
    help="What was tested: the hybrid test, or the table alone under the ground motion.",
)
@rate_option
@click.option(
    "--until",
    "until_s",
    type=Number(min=0, min_open=True),
    metavar="S",
    help="Judge the run up to this time of the record.",
)
@click.option(
    "--output", type=FILE, default="results", show_default=True, metavar="DIR", help="Folder of the result file."
)
@no_replace_option
@click.option("--full", is_flag=True, help="Print every figure below the answer, and all notes whole.")
@click.option("--quiet", count=True, help="Show no progress, and one line; given twice, only what went wrong.")
@settings_option
@json_option
def evaluate(
    case: str,
    data: Path,
    channels: tuple[str, ...],
    made: str,
    rate_hz: float | None,
    until_s: float | None,
    output: Path,
    no_replace: bool,
    full: bool,
    quiet: int,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Judge a run that any controller made on any computer, from its recording, by the case that it was a test of.

    The recording is laid on the record of the case; SIM and SIM-DELAY of the case stand beside it in a result file like
    any other, NAME-RECORDING.h5. Nothing moves.

    Example: rths evaluate el_centro_low_ff_fb --data run.mat --channel channels.yaml
    """
    from rths_cli.case.load import load_cases
    from rths_cli.experiment.identify_command import read_roles
    from rths_cli.experiment.run_command import Request, exit_code, run_batch

    roles = {role: [name, unit] if unit else [name] for role, (name, unit) in read_roles(channels).items()}
    recorded = {"recording": str(data.absolute()), "channels": roles, "rate_hz": rate_hz, "until_s": until_s}
    of_run = f"{made}={json.dumps(recorded, ensure_ascii=False)}"
    runs = f"runs=[sim, sim_delay, {made}]"
    screen = new_screen(quiet > 0, answered=quiet < 2 and not as_json, command="" if as_json else "evaluate")
    with screen.reading("reading the case"):
        loaded = load_cases([case], (*settings, runs, of_run), {of_run: DATA, runs: DATA})
    request = Request(tuple(loaded), (), output, not no_replace, command_line())
    with screen.reading("reading the recording"):
        ended = run_batch(request, screen)
    show_results(ended, as_json, None, Wanted(full, False, quiet))
    return exit_code(ended)
