"""`rths recover`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, json_option

if TYPE_CHECKING:
    from rths_cli.experiment.recovery import Recovered


@cli.command()
@click.argument("logs", nargs=-1, required=True, type=FILE, metavar="LOG...")
@json_option
def recover(logs: tuple[Path, ...], as_json: bool) -> int:
    """Make the results of runs whose process was killed from the raw logs (NAME.RUN.rthslog) beside them.

    Each result says `interrupted` (or how else its run failed) and holds every sample that was on the disk. Complete
    results are left alone, logs stay.

    Example: rths recover results/*.rthslog
    """
    from rths_cli.experiment.recovery import recover as recover_logs

    found = recover_logs(tuple(dict.fromkeys(logs)))
    if as_json:
        click.echo(json.dumps({"recovered": [_document(one) for one in found], "exit_code": 0}, indent=2))
        return 0
    for one in found:
        known = "held it already and is left as it is; " if one.known else ""
        click.echo(f"{one.result}: {known}{one.status}, {one.note}")
    return 0


def _document(one: Recovered) -> dict[str, object]:
    return {
        "log": str(one.log),
        "result": str(one.result),
        "status": one.status,
        "note": one.note,
        "run": one.run,
        "samples": one.samples,
        "steps": one.steps,
        "dt_s": one.dt_s,
        "already_there": one.known,
    }
