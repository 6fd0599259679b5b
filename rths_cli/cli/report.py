"""`rths report`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rths_cli.cli.command_group import SIGNALS, cli
from rths_cli.cli.options import FILE, Number, command_line, json_option, no_replace_option, quiet_option
from rths_cli.cli.terminal import show_page
from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.cli.terminal import Screen
    from rths_cli.report.report_contents import Contents
    from rths_cli.report.report_options import Asked

TABLES = ("text", "markdown", "csv", "json", "latex", "html")
DRAWN = ("pdf", "svg", "png")


@cli.command()
@click.argument("results", nargs=-1, type=FILE, metavar="[RESULT...]")
@click.option(
    "--format",
    "formats",
    multiple=True,
    type=click.Choice([*TABLES, *DRAWN]),
    help="Of the tables (text, markdown, csv, json, latex, html) or of the figures (pdf, svg, png); give it twice for "
    "both [default: text, pdf].",
)
@click.option("--output", type=FILE, metavar="FILE", help="Write the tables to a file instead of stdout.")
@click.option("--figures", type=FILE, metavar="DIR", help="Draw the figures of every result and sweep into a folder.")
@click.option(
    "--width", type=click.Choice(["one", "two"]), default="one", show_default=True, help="Columns a figure is wide."
)
@click.option(
    "--header", type=click.Choice(["case", "none"]), default="case", show_default=True,
    help="Above the panels of a figure: case and table, or nothing, for a caption of one's own.",
)  # fmt: skip
@click.option(
    "--metric",
    metavar="PATH",
    default="",
    help="What the figure of a sweep shows over the varied keys, as check.delay_margin_s or exp_rths.rms_error_m_s2[3] "
    "[default: exp_rths.rms_error_m_s2 of the worst storey].",
)
@click.option(
    "--group-by",
    "keys",
    multiple=True,
    metavar="KEY",
    help="Compare groups of results: controller, method, rig, software, folder, record, damping, scaling, seed, case, "
    "or any attribute. Repeatable.",
)
@click.option("--baseline", type=FILE, metavar="PATH", help="Compare with the results in a file or folder.")
@click.option(
    "--fail-worse",
    "percent",
    type=Number(min=0),
    metavar="PERCENT",
    help="Exit code 1 when an error is worse than the baseline's by more than this.",
)
@click.option(
    "--report-in",
    type=click.Choice(["model", "prototype"]),
    help="Scale of the figures of cases with a scale [default: the report_in of the cases].",
)
@click.option("--full", is_flag=True, help="Print every figure below the answer, and all notes whole.")
@click.option("--paper", is_flag=True, help="Print errors beside published ones, and judge the paper's claims.")
@click.option("--keep-going", is_flag=True, help="Report the good files although others cannot be read.")
@click.option("--parquet", type=FILE, metavar="FILE", help="Write the table of a sweep as Apache Parquet, with units.")
@click.option("--junit", type=FILE, metavar="FILE", help="Write JUnit XML: one test per accept limit.")
@no_replace_option
@quiet_option
@json_option
def report(
    results: tuple[Path, ...],
    formats: tuple[str, ...],
    output: Path | None,
    figures: Path | None,
    width: str,
    header: str,
    metric: str,
    keys: tuple[str, ...],
    baseline: Path | None,
    percent: float | None,
    report_in: str | None,
    full: bool,
    paper: bool,
    keep_going: bool,
    parquet: Path | None,
    junit: Path | None,
    no_replace: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Print the answer of a result, or the comparison of several (default: results/); draw figures, write a page.

    Exit code 1: an error is worse than --fail-worse allows, or --keep-going left something out.

    Example: rths report results --format markdown --output report.md
    """
    from rths_cli.report.report_options import Asked

    if not results and not Path("results").is_dir():
        raise InputError("there are no results here yet: rths run CASE makes results/, or name result files.")
    table, drawn = _formats(formats, as_json)
    asked = Asked(
        paths=results or (Path("results"),),
        table=table,
        output=output,
        figures=figures,
        drawn=drawn,
        width=width,
        header=header,
        metric=metric,
        keys=tuple(dict.fromkeys(keys)),
        baseline=baseline,
        percent=percent,
        keep_going=keep_going,
        junit=junit,
        replace=not no_replace,
        full=full,
        paper=paper,
        report_in=report_in,
        parquet=parquet,
    )
    return _report(asked, quiet)


def _formats(formats: tuple[str, ...], as_json: bool) -> tuple[str, str]:
    """Return the format of the tables, "" for the default, and of the figures."""
    tables = dict.fromkeys([*(name for name in formats if name in TABLES), *(("json",) if as_json else ())])
    drawn = dict.fromkeys(name for name in formats if name in DRAWN)
    for kinds, what in ((tables, "the tables"), (drawn, "the figures")):
        if len(kinds) > 1:
            raise InputError(f"--format: {' and '.join(kinds)} are two formats of {what}; give one.")
    return next(iter(tables), ""), next(iter(drawn), "")


def _report(asked: Asked, quiet: bool) -> int:
    from rths_cli.cli.terminal import Screen
    from rths_cli.files.existing_files import replaced_sentence
    from rths_cli.report.report_options import check_asked, read_asked
    from rths_cli.report.results_by_case import unrecovered

    replaced = check_asked(asked)
    screen = Screen(quiet, poll=SIGNALS.poll)
    for sentence in unrecovered(asked.paths):
        click.echo(sentence, err=True)
    found = read_asked(asked, screen.doing)
    screen.clear()
    for sentence in found.faults:
        click.echo(sentence, err=True)
    _write(asked, found, screen, quiet)
    if replaced and not quiet:
        screen.message(replaced_sentence(replaced))
    from rths_cli.report.group_comparison import got_worse

    worse = found.baseline is not None and asked.percent is not None and got_worse(found.baseline.changes)
    return 1 if worse or found.faults else 0


def _write(asked: Asked, found: Contents, screen: Screen, quiet: bool) -> None:
    """Write the figures first, because they alone read time histories; then the tests, and the tables or the page."""
    from rths_cli.report.report_options import rendered, write_text

    if asked.metric and not found.inputs.sweeps:
        raise InputError("--metric chooses what the figure of a sweep shows, and none of the files is a sweep.")
    if asked.parquet:
        from rths_cli.files.sweep_parquet import write_parquet

        if len(found.inputs.sweeps) != 1:
            raise InputError(f"--parquet holds the table of one sweep, got {len(found.inputs.sweeps)}; name one.")
        write_parquet(asked.parquet, found.inputs.sweeps[0][1])
    if asked.figures:
        from rths_cli.report.figures import write_figures, write_sweep_figures

        form, say = asked.drawn or "pdf", _nothing if quiet else screen.message
        look = (asked.figures, form, asked.width, say, asked.header)
        sweeps = found.inputs.sweeps
        written = write_sweep_figures(sweeps, *look, asked.metric, asked.replace) if sweeps else []
        written += write_figures(found.inputs.results, *look, asked.replace)
        say(f"{len(written)} figures in {asked.figures}")
    if asked.junit:
        from rths_cli.report.formats.junit import junit

        changes = found.baseline.changes if found.baseline and asked.percent is not None else ()

        write_text(asked.junit, junit(found.inputs.results, found.unread, (), changes))
    if asked.table == "html":
        from rths_cli.report.page import write_page
        from rths_cli.report.report_contents import comparison

        assert asked.output is not None  # check_asked
        write_page(found.inputs.results, asked.output, command_line(), comparison(found), found.inputs.sweeps)
    elif asked.output:
        write_text(asked.output, rendered(asked, found))
    elif quiet and asked.table in ("", "text"):
        from rths_cli.report.report_contents import verdicts

        click.echo("".join(f"{line}\n" for line in verdicts(found)), nl=False)
    else:
        text = asked.table in ("", "text")
        show_page(lambda: rendered(asked, found)) if text else click.echo(rendered(asked, found), nl=False)


def _nothing(text: str) -> None:
    """Say nothing."""
