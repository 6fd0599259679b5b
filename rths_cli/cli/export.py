"""`rths export`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, json_option, no_replace_option
from rths_cli.cli.terminal import new_screen

if TYPE_CHECKING:
    from rths_cli.report.export_files import Exported


class Formats(click.Choice[str]):
    """The formats; of the one that was removed it says what replaces it."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the format; raises click.BadParameter."""
        if value == "netcdf":
            from rths_cli.report.export_files import NETCDF_REMOVED

            self.fail(NETCDF_REMOVED, param, ctx)
        return super().convert(value, param, ctx)


@cli.command()
@click.argument("results", nargs=-1, required=True, type=FILE, metavar="RESULT...")
@click.option("--to", "form", required=True, type=Formats(["csv", "mat", "c"]), help="Format of the files written.")
@click.option(
    "--output",
    type=FILE,
    default=Path("exported"),
    show_default=True,
    metavar="DIR",
    help="Folder of the files written.",
)
@click.option(
    "--group",
    "groups",
    multiple=True,
    metavar="NAME",
    help="Export this group of the result only, for instance exp_rths. Repeatable.",
)
@no_replace_option
@click.option("--quiet", is_flag=True, help="Show no progress.")
@json_option
def export(
    results: tuple[Path, ...],
    form: str,
    output: Path,
    groups: tuple[str, ...],
    no_replace: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Write result files (or folders of them) for other programs: CSV tables or MATLAB .mat.

    Runs that ended early are exported as far as they went; what is written says how they ended.
    `rths export step CASE --to c DIR` writes the step of a case's EXP-RTHS as a C99 library for a real-time computer.

    Example: rths export results/el_centro_low_ff_fb.h5 --to mat
    """
    if form == "c":
        return _export_step(results, output, groups, not no_replace, quiet, as_json)
    from rths_cli.files.existing_files import replaced_sentence
    from rths_cli.report.export_files import ExportRequest
    from rths_cli.report.export_files import export as export_results

    screen = new_screen(quiet)
    request = ExportRequest(results, form, output, tuple(dict.fromkeys(groups)), not no_replace)
    done = export_results(request, screen.doing)
    screen.clear()
    if as_json:
        click.echo(json.dumps({"exported": [_document(one) for one in done], "exit_code": 0}, indent=2))
        return 0
    for one in done:
        click.echo("\n".join(str(path) for path in one.files))
        if one.status != "complete":
            click.echo(f"{one.result}: {one.status}, exported as far as it goes: {one.reason}", err=True)
    replaced = [path for one in done for path in one.replaced]
    if replaced and not quiet:
        click.echo(replaced_sentence(replaced), err=True)
    return 0


def _export_step(
    words: tuple[Path, ...], output: Path, groups: tuple[str, ...], replace: bool, quiet: bool, as_json: bool
) -> int:
    """Write the step of a case in C; raises click.UsageError for other words than `step CASE DIR`."""
    if str(words[0]) != "step" or not 2 <= len(words) <= 3 or groups:
        raise click.UsageError(
            "--to c writes the step of one case into a folder: rths export step CASE --to c DIR; results are written "
            "by --to csv and --to mat"
        )
    from rths_cli.case.load import load_cases
    from rths_cli.experiment.designed_step import designed_step
    from rths_cli.files.existing_files import replaced_sentence
    from rths_cli.report.c_step.library import summary, write_library

    screen = new_screen(quiet, command="" if as_json else "export")
    with screen.reading("reading the case"):
        case = load_cases([str(words[1])])[0]
    step = designed_step(case, screen.doing)
    files, replaced = write_library(step, words[2] if len(words) == 3 else output, replace, screen.doing)
    screen.clear()
    if as_json:
        click.echo(json.dumps({**summary(step), "files": [str(path) for path in files], "exit_code": 0}, indent=2))
        return 0
    click.echo("\n".join(str(path) for path in files))
    if replaced and not quiet:
        click.echo(replaced_sentence(replaced), err=True)
    return 0


def _document(one: Exported) -> dict[str, object]:
    return {
        "result": str(one.result),
        "status": one.status,
        "status_reason": one.reason,
        "files": [str(path) for path in one.files],
        "replaced": [str(path) for path in one.replaced],
    }
