"""`rths run`."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import (
    FILE,
    command_line,
    json_option,
    methods_option,
    no_replace_option,
    overrides_option,
    settings_option,
    yes_option,
)
from rths_cli.cli.terminal import new_screen, page_width, show_page

if TYPE_CHECKING:
    from rths_cli.cli.terminal import Screen
    from rths_cli.errors import InputError
    from rths_cli.experiment.run_case import Ended
    from rths_cli.files.result_reader import Result
    from rths_cli.studies.row_of_sweep import SweptRow


class Wanted(NamedTuple):
    """How much a run prints."""

    full: bool  # every figure
    paper: bool  # errors beside published ones
    quiet: int  # 1: a line per case, 2: nothing


@cli.command()
@click.argument("cases", nargs=-1, metavar="CASE...")
@click.option(
    "--output", type=FILE, default="results", show_default=True, metavar="DIR", help="Folder of the result files."
)
@methods_option("compare (files NAME-paper.h5, NAME-best.h5)")
@no_replace_option
@click.option(
    "--series",
    type=click.Choice(["all", "essential", "none"]),
    default="all",
    show_default=True,
    help="Time series that the result keeps: essential are those of most figures, in single precision.",
)
@click.option("--full", is_flag=True, help="Print every figure below the answer, and all notes whole.")
@click.option("--paper", is_flag=True, help="Print errors beside published ones, and judge the paper's claims.")
@click.option("--quiet", count=True, help="Show no progress, and one line per case; given twice, only what went wrong.")
@click.option("--junit", type=FILE, metavar="FILE", help="Write JUnit XML: one test per accept limit.")
@click.option("--from", "sweep", type=FILE, metavar="SWEEP", help="Run one row of a finished sweep instead of cases.")
@click.option("--row", type=click.IntRange(min=1), metavar="N", help="Which row of --from, counted from 1.")
@overrides_option(
    ["check", "model"],
    "Run EXP-RTHS although its check says no, or use a model that was rejected. Repeatable, stored in the result.",
)
@click.option(
    "--keep-going",
    is_flag=True,
    help="Run the other cases where one cannot be used: it is one that failed, and the exit code tells.",
)
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", help="At most N cases at a time; on a real rig one.")
@yes_option
@click.option("--fresh", is_flag=True, help="Identify anew; use no model of a virtual rig kept from earlier runs.")
@settings_option
@json_option
def run(
    cases: tuple[str, ...],
    output: Path,
    methods: tuple[str, ...],
    no_replace: bool,
    series: str,
    full: bool,
    paper: bool,
    quiet: int,
    junit: Path | None,
    sweep: Path | None,
    row: int | None,
    overrides: tuple[str, ...],
    keep_going: bool,
    jobs: int | None,
    yes: bool,
    fresh: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Run cases and print the answer; one result file per case. CASE is a name, a file, a folder or a pattern.

    Example: rths run el_centro_low_ff_fb --set scaling=0.2
    """
    from rths_cli.case.load import load_all, load_each
    from rths_cli.case.named_files import case_files

    chosen = tuple(dict.fromkeys(methods))
    swept = _row(cases, sweep, row, chosen, settings)
    refused: dict[str, InputError] = {}
    screen = new_screen(quiet > 0, answered=quiet < 2 and not as_json, command="" if as_json else "run")
    with screen.reading("reading the cases"):
        files = case_files(cases)
        if swept:  # a fault in a case is told before the numerical libraries are imported
            loaded = [swept.case]
        elif keep_going:
            loaded, refused = load_each(files, settings, chosen)
        else:
            loaded = load_all(files, settings, chosen)
    screen.doing("starting")
    from rths_cli.experiment.run_command import Request, exit_code, run_batch

    if junit:
        from rths_cli.report.report_options import check_output

        replaced = check_output("--junit", junit, (), not no_replace)
    request = Request(
        cases=tuple(loaded),
        methods=chosen,
        output=output,
        replace=not no_replace,
        command_line=command_line(),
        overrides=tuple(dict.fromkeys((*overrides, *(swept.overrides if swept else ())))),
        fresh=fresh,
        yes=yes,
        series=series,
        session_seed=swept.session_seed if swept else None,
        keep_going=keep_going,
        refused=tuple((name, "; ".join(error.faults)) for name, error in refused.items()),
        at_once=jobs,
    )
    with screen.reading("starting"):
        ended = run_batch(request, screen)
    show_results(ended, as_json, junit, Wanted(full, paper, quiet))
    if junit and replaced and not quiet:
        screen.message(f"replaced {junit}")
    differs = swept is not None and ended[0].path is not None and _differs(swept, ended[0].path, screen, quiet)
    return exit_code(ended) or int(differs)


def _row(
    cases: Sequence[str], sweep: Path | None, row: int | None, methods: Sequence[str], settings: Sequence[str]
) -> SweptRow | None:
    """Return the row of a sweep that is to be run, None for cases; raises UsageError unless one of them is named."""
    if sweep is None and row is None:
        if not cases:
            raise click.UsageError("CASE is missing; rths list cases shows what can be named")
        return None
    if sweep is None or row is None:
        raise click.UsageError("--from SWEEP and --row N name one row together; give both.")
    if cases or methods:
        raise click.UsageError("--from runs a row with its own case and method; leave CASE and --method out.")
    from rths_cli.studies.row_of_sweep import read_row

    return read_row(sweep, row, settings)


def _differs(row: SweptRow, path: Path, screen: Screen, quiet: int) -> bool:
    """Say whether the result has the metrics of the row, and return whether it has not."""
    from rths_cli.files.result_reader import read_result

    differences = row.differences(read_result(path))
    if not differences:
        if row.left_out == set(row.figures):
            screen.message(f"row {row.number} of {row.path} has no metrics of these runs: nothing is compared")
        elif not quiet:
            screen.message(f"row {row.number} of {row.path} has the same metrics")
        return False
    more = f" and {len(differences) - 1} more" if len(differences) > 1 else ""
    why = "a file that the case names, a setting or rths is not what it was"
    if row.later:
        as_then = " ".join(f"--set {shlex.quote(setting)}" for setting in row.later)
        why = f"some values were others then, by default or in a file; {as_then} has those of then"
    screen.message(f"the metrics are not those of row {row.number} of {row.path}: {differences[0]}{more}; {why}")
    return True


def show_results(ended: Sequence[Ended], as_json: bool, junit: Path | None, wanted: Wanted) -> None:
    """Read the result files back, write their tests and print what is wanted of them."""
    from rths_cli.report.result_scale import reported
    from rths_cli.report.results_by_case import load

    paths = [one.path for one in ended if one.path]
    results = reported(load(paths)) if paths or as_json else []
    if junit:
        from rths_cli.report.formats.junit import junit as as_junit
        from rths_cli.report.report_options import write_text

        failed = [(one.name, one.reason, one.seconds) for one in ended if one.path is None]
        seconds = {one.path: one.seconds for one in ended if one.path}
        write_text(junit, as_junit(results, failed=failed, seconds=seconds))
    if as_json:
        from rths_cli.report.result_tables import to_json

        document = to_json(results) | {"cases": [one.__dict__ for one in ended]}
        click.echo(json.dumps(document, indent=2, default=str))
    elif paths:
        _print(results, wanted)


def _print(results: Sequence[Result], wanted: Wanted) -> None:
    """Print the answer, and below it the tables that are wanted."""
    from rths_cli.report.answer import answers, one_line

    if wanted.quiet:
        click.echo("".join(f"{one_line(result)}\n" for result in results if wanted.quiet == 1), nl=False)
        return
    show_page(lambda: answers(results, page_width(), whole=wanted.full))
    if wanted.full or wanted.paper:
        from rths_cli.report.result_tables import tables

        show_page(lambda: f"\n{tables(results, paper=wanted.paper, brief=not wanted.full)}")
