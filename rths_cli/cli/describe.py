"""`rths list`, `rths new`, `rths records`, `rths data`, `rths schema`, `rths structure`."""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, Number, json_option, no_replace_option, quiet_option, rate_option
from rths_cli.cli.terminal import page_width, show_page

RESULTS = "results"
KINDS = ("cases", "structures", "rigs", "records", "references", "benchmarks")

SCHEMA_KINDS = ("case", "structure", "rig", "reference", "study", "benchmark")


@cli.command("list")
@click.argument("kind", type=click.Choice((*KINDS, RESULTS)), metavar="KIND")
@click.argument("folder", required=False, type=FILE, metavar="[FOLDER]")
@json_option
def list_kind(kind: str, folder: Path | None, as_json: bool) -> int:
    """List what a case may name and `rths run` takes here: your own files first, with their paths, then shipped ones;
    or the results of a folder (default: results), the newest first.

    KIND: cases, structures, rigs, records, references, benchmarks or results.

    Example: rths list structures
    """
    if kind == RESULTS:
        return _show_results(folder or Path(RESULTS), as_json)
    if folder is not None:
        raise click.UsageError(f"{kind} are looked up in the present folder; leave {folder} out, or go there.")
    return show_list(kind, as_json)


def _show_results(folder: Path, as_json: bool) -> int:
    from rths_cli.report.result_list import as_data, as_document, list_results
    from rths_cli.report.to_text import text

    found = list_results(folder)
    if as_json:
        click.echo(json.dumps({RESULTS: as_data(found)}, indent=2))
    else:
        show_page(lambda: text(as_document(found, folder)))
    return 0


def show_list(kind: str, as_json: bool) -> int:
    """Print the files of a kind, a line for each; on a terminal the lines are wrapped. Return the exit code."""
    from rths_cli.laboratory.listing import list_files

    found = list_files(kind)
    if as_json:
        listed = [
            {"name": one.name, "file": one.file, "own": one.own, "description": one.description, **one.details}
            for one in found
        ]
        click.echo(json.dumps({kind: listed}, indent=2))
        return 0
    label = max((len(one.name) for one in found), default=0) + 2
    for one in found:
        where = f" ({one.file})" if one.own and one.file not in one.description else ""
        line = f"{one.name:<{label}}{one.description}{where}"
        click.echo(_wrapped(line, label) if sys.stdout.isatty() else line)
    if not found:
        click.echo(f"no {kind} here", err=True)
    return 0


def _wrapped(line: str, indent: int) -> str:
    return textwrap.fill(line, page_width(), subsequent_indent=" " * indent, break_on_hyphens=False)


@cli.command()
@click.argument("words", nargs=-1, required=True, metavar="[KIND] FILE")
@click.option("--like", metavar="NAME", help="Begin with a shipped case, rig or structure instead (rths list).")
@json_option
def new(words: tuple[str, ...], like: str | None, as_json: bool) -> int:
    """Write a commented file to start from, valid as it is; an existing file is left alone.

    KIND: case (the default), rig, structure, record or compensator, which comes with a test.

    Example: rths new my_case.yaml
    """
    from rths_cli.case.template import KINDS, TRIED_BY, new_files
    from rths_cli.errors import InputError
    from rths_cli.files.durable_files import write_new

    kind, *names = words if words[0] in KINDS else ("case", *words)
    if len(names) != 1:
        raise InputError(f"give one file: rths new {kind} FILE; kinds: {', '.join(KINDS)}")
    path = Path(names[0])
    texts = new_files(kind, path, like)
    for one, content in texts.items():
        write_new(one, content)
    written = [str(one) for one in texts]
    told = f"wrote {' and '.join(written)}; try: {TRIED_BY[kind].format(path)}"
    click.echo(json.dumps({"written": written[0] if len(written) == 1 else written}) if as_json else told)
    return 0


@cli.command()
@click.argument("record", nargs=-1)
@click.option("--unit", help="Unit of the accelerations, where the file does not state it (g, cm/s^2, ...).")
@click.option(
    "--dt", "dt_s", type=Number(min=0, min_open=True), help="Sample interval in s, where the file does not state it."
)
@click.option("--component", help="Which component of a file that holds several (NS, 90, HNE, channel 1).")
@click.option(
    "--scale",
    "scale",
    multiple=True,
    metavar="KEY=VALUE",
    help="Show the record as a case with this scale compresses it, for instance --scale length=2.4. Repeatable.",
)
@click.option(
    "--baseline",
    type=click.Choice(["mean", "linear", "polynomial", "step", "none"]),
    help="Show the record without its mean, line, parabola or step at an end, as a case with this key takes it.",
)
@click.option("--rig", metavar="NAME|FILE", help="Say the largest scale that its table can play, and what limits it.")
@json_option
def records(
    record: tuple[str, ...],
    unit: str | None,
    dt_s: float | None,
    component: str | None,
    scale: tuple[str, ...],
    baseline: str | None,
    rig: str | None,
    as_json: bool,
) -> int:
    """Show a ground motion: peaks, intensity, durations, what is wrong with it, response spectrum; of several, or of a
    file of several components, a row for each. A folder stands for all records in it. Without RECORD: list those that
    are known.

    Example: rths records el_centro
    """
    if not record:
        if scale:
            raise click.UsageError("--scale compresses one record; name it: rths records RECORD --scale length=2.4")
        if rig:
            raise click.UsageError("--rig needs a record or a folder of records; name it.")
        return show_list("records", as_json)
    from rths_cli.case.structure_schema import read_scale
    from rths_cli.laboratory.listing import components_of, show

    of_model, folders = read_scale(scale), any(Path(name).is_dir() for name in record)
    record = _in_folders(record)
    if component is None and (len(record) > 1 or folders or rig):
        return _show_motions(record, lambda name: components_of(name, unit, dt_s, of_model, baseline, rig), as_json)
    if rig:
        raise click.UsageError("--rig takes every component of a file; leave out --component.")
    if component is None:
        found = components_of(record[0], unit, dt_s, of_model, baseline)
        if len(found) > 1:
            return _show_motions(record, lambda _: found, as_json)
    elif len(record) > 1:
        raise click.UsageError("--component belongs to one file; name it alone.")
    document, text = show(record[0], unit, dt_s, page_width(), of_model, baseline, component)
    click.echo(json.dumps(document, indent=2) if as_json else text, nl=as_json)
    return 0


def _in_folders(names: Sequence[str]) -> tuple[str, ...]:
    """Return the records that are named, those of a folder in its place; raises InputError for one without any."""
    from rths_cli.studies.record_sets import records_of

    return tuple(each for name in names for each in (records_of(name, Path.cwd()) if Path(name).is_dir() else (name,)))


def _show_motions(names: Sequence[str], examine: Callable[[str], list[dict[str, Any]]], as_json: bool) -> int:
    """Print a row for each component of the records; return exit code 2 where one of them cannot be read."""
    from rths_cli.errors import InputError
    from rths_cli.report.records_page import document
    from rths_cli.report.to_text import text

    found: list[dict[str, Any]] = []
    faults: list[str] = []
    for name in names:
        try:
            found += examine(name)
        except InputError as error:
            faults += error.faults
    if as_json:
        click.echo(json.dumps({"records": found, "faults": faults}, indent=2))
    else:
        show_page(lambda: text(document(found, faults)))
    return 2 if faults else 0


@cli.command()
@click.argument("file", type=FILE, metavar="FILE")
@rate_option
@json_option
def data(file: Path, rate_hz: float | None, as_json: bool) -> int:
    """Show what is understood of a recording before it is used: format, channels, units, rate, starts, faults, and the
    YAML that names its channels for identify --data.

    Example: rths data short.csv
    """
    from rths_cli.files.measured_data import read_recording
    from rths_cli.report.recording_page import as_data, as_document, judge
    from rths_cli.report.to_text import text

    judged = judge(read_recording(file, 1.0 / rate_hz if rate_hz else None))
    if as_json:
        click.echo(json.dumps(as_data(judged), indent=2))
    else:
        show_page(lambda: text(as_document(judged)))
    return 0


@cli.command()
@click.argument("kind", type=click.Choice(SCHEMA_KINDS), default="case", metavar=f"[{'|'.join(SCHEMA_KINDS)}]")
@json_option
def schema(kind: str, as_json: bool) -> int:
    """Print the JSON Schema of case files (or of what they name, or of a study), for editors.

    Example: rths schema > case.schema.json
    """
    from rths_cli.case.json_schema import schema as build_schema

    click.echo(json.dumps(build_schema(kind), indent=2))
    return 0


@cli.command()
@click.argument("structure", required=False, metavar="[NAME|FILE]")
@click.option("--figure", type=FILE, metavar="FILE", help="Draw building and mode shapes, .pdf, .svg or .png.")
@no_replace_option
@quiet_option
@json_option
def structure(structure: str | None, figure: Path | None, no_replace: bool, quiet: bool, as_json: bool) -> int:
    """Show a building before anything is run: modes, damping, mass split, stiffnesses, doubts on units.

    A case shows its building, with its own damping. Without NAME: the structures that are known. Exit code 1: the
    building cannot have one of its damping levels.

    Example: rths structure three_storey
    """
    if structure is None:
        return show_list("structures", as_json)
    from rths_cli.laboratory.describe import inspect_structure
    from rths_cli.report.structure_page import document, headline, page

    found = inspect_structure(structure)
    if figure is not None:
        from rths_cli.files.existing_files import Kind, check_existing
        from rths_cli.report.figures.structural_figures import write_figure

        replaced = check_existing([(figure, Kind.DOCUMENT)], not no_replace, streams=True)
        write_figure(found, figure)
        click.echo(f"{'replaced' if replaced else 'wrote'} {figure}", err=True)
    if as_json:
        click.echo(json.dumps(document(found), indent=2))
    elif quiet:
        click.echo(headline(found))
    else:
        show_page(lambda: page(found, page_width()))
    return found.exit_code
