"""The commands: text in, exit code out. Everything heavy is imported inside them."""

from __future__ import annotations

import errno
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

from rths_cli import __version__
from rths_cli.errors import InputError, RthsError, write_crash_file
from rths_cli.process import INTERRUPTED, TERMINATED, Signals, Terminated

F = TypeVar("F", bound=Callable[..., Any])
SIGNALS = Signals()


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="rths")
@click.option("--debug", is_flag=True, help="Show a traceback when rths itself fails.")
def cli(debug: bool) -> None:
    """Run substructure real-time hybrid simulations with a uni-axial shake table.

    A case file names a structure, its damping, a record, its scaling and a controller.

    Example: rths run el_centro_low_ff_fb
    """


def settings_option(command: F) -> F:
    """Add --set KEY=VALUE."""
    return click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="KEY=VALUE",
        help="Change a key of every case, for instance --set table.physics.coulomb_n=0. Repeatable.",
    )(command)


def json_option(command: F) -> F:
    """Add --json."""
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout and nothing else.")(
        command
    )


@cli.command()
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@click.option("--output", default="results", show_default=True, metavar="DIR", help="Folder of the result files.")
@click.option(
    "--method",
    "methods",
    multiple=True,
    type=click.Choice(["paper", "best"]),
    help="Method instead of the case's own; give both to compare (files NAME-paper.h5, NAME-best.h5).",
)
@click.option("--no-replace", is_flag=True, help="Refuse, before running, to replace a finished result.")
@click.option("--quiet", is_flag=True, help="Show no progress, only what went wrong.")
@click.option(
    "--override",
    "overrides",
    multiple=True,
    type=click.Choice(["check", "model"]),
    help="I know: run EXP-RTHS although its check says no, or use a model that was rejected. Repeatable, stored in "
    "the result.",
)
@click.option("--fresh", is_flag=True, help="Identify anew; use no model of a virtual rig kept from earlier runs.")
@settings_option
@json_option
def run(
    cases: tuple[str, ...],
    output: str,
    methods: tuple[str, ...],
    no_replace: bool,
    quiet: bool,
    overrides: tuple[str, ...],
    fresh: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Run cases and print their tables; one result file per case.

    Example: rths run el_centro_low_ff_fb --set scaling=0.2
    """
    from rths_cli.screen import Screen
    from rths_cli.workflows.batch import Request, exit_code, run_batch

    screen = Screen(quiet, poll=SIGNALS.poll)
    request = Request(
        paths=cases,
        settings=settings,
        methods=tuple(dict.fromkeys(methods)),
        output=Path(output),
        replace=not no_replace,
        command_line=" ".join(["rths", *sys.argv[1:]]),
        overrides=tuple(dict.fromkeys(overrides)),
        fresh=fresh,
    )
    ended = run_batch(request, screen)
    _show_results([e.path for e in ended if e.path], as_json, [e.__dict__ for e in ended])
    return exit_code(ended)


@cli.command()
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@click.option(
    "--method",
    "methods",
    multiple=True,
    type=click.Choice(["paper", "best"]),
    help="Method instead of the case's own; give both to compare.",
)
@click.option(
    "--override",
    "overrides",
    multiple=True,
    type=click.Choice(["model"]),
    help="I know: judge with a model that its identification rejected.",
)
@click.option("--resolved", is_flag=True, help="Print the cases with all defaults as YAML, and do nothing else.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
@settings_option
@json_option
def check(
    cases: tuple[str, ...],
    methods: tuple[str, ...],
    overrides: tuple[str, ...],
    resolved: bool,
    quiet: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Say whether EXP-RTHS of a case is safe, unsafe or unstable, and how wrong it will be, before anything moves.

    Exit code 0: all are safe; 1: one is not.

    Example: rths check el_centro_low_ff_fb
    """
    from rths_cli.workflows.check_cases import check_cases, load_all

    loaded = load_all(cases, settings, tuple(dict.fromkeys(methods)))
    if resolved:
        _show_resolved(loaded, as_json)
        return 0
    from rths_cli.report.preflight_document import as_document
    from rths_cli.report.preflight_page import pages
    from rths_cli.screen import Screen

    screen = Screen(quiet, poll=SIGNALS.poll)
    checked = check_cases(loaded, tuple(dict.fromkeys(overrides)), screen.doing)
    screen.clear()
    click.echo(json.dumps(as_document(checked), indent=2) if as_json else pages(checked), nl=as_json)
    return max(one.exit_code for one in checked)


def _show_resolved(cases: Sequence[Any], as_json: bool) -> None:
    """Print cases with everything filled in: YAML documents, or these as texts in one JSON document."""
    from rths_cli.case.load import resolved_yaml

    texts = [resolved_yaml(case) for case in cases]
    if as_json:
        named = [{"case": case.name, "resolved": text} for case, text in zip(cases, texts, strict=True)]
        click.echo(json.dumps({"cases": named}, indent=2))
    else:
        click.echo("---\n".join(texts), nl=False)


@cli.command()
@click.argument("results", nargs=-1, metavar="[RESULT...]")
@json_option
def report(results: tuple[str, ...], as_json: bool) -> int:
    """Print the tables of result files or folders of them (default: results/).

    Example: rths report results
    """
    from rths_cli.report.load import load

    paths = [Path(result) for result in results or ("results",)]
    _print_tables(load(paths), as_json, None)
    return 0


def _show_results(paths: list[Path], as_json: bool, endings: list[dict[str, Any]]) -> None:
    """Read the result files back and print their tables."""
    from rths_cli.report.load import load

    if paths or as_json:
        _print_tables(load(paths), as_json, endings)


def _print_tables(results: Any, as_json: bool, endings: list[dict[str, Any]] | None) -> None:
    from rths_cli.report.tables import tables, to_json

    if as_json:
        document = to_json(results) | ({"cases": endings} if endings is not None else {})
        click.echo(json.dumps(document, indent=2, default=str))
    else:
        click.echo(tables(results), nl=False)


@cli.command()
@click.argument("case", default="el_centro_low_ff_fb")
@click.option(
    "--data",
    multiple=True,
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Evaluate measured time histories (CSV, .mat, HDF5, TDMS) instead of exciting the rig. Repeatable: averaged.",
)
@click.option(
    "--channel",
    "channels",
    multiple=True,
    metavar="ROLE=NAME[:UNIT]",
    help="Which channel of the file is what: command, table, floor_2, ...; for instance --channel table=ai0:g.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=click.FloatRange(min=0, min_open=True),
    metavar="HZ",
    help="Sample rate, where the file does not state it.",
)
@click.option("--corrected", is_flag=True, help="The file's accelerations are free of the sensors' dynamics already.")
@click.option(
    "--model",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Judge this model (zeros, poles, gain in YAML or .mat; or a model file) instead of fitting one.",
)
@click.option(
    "--output", type=click.Path(path_type=Path), metavar="FILE", help="Model file [default: models/RIG_STRUCTURE.h5]."
)
@click.option(
    "--figure",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Figure, .png, .svg or .pdf [default: beside the model file, .png].",
)
@click.option("--no-figure", is_flag=True, help="Draw no figure.")
@click.option(
    "--save-data",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write what was measured, for --data --corrected.",
)
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
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Identify the table and specimen of a case, write a model file, say what it is fit for.

    The rig is excited, first at a low level; or measured records are read (--data). Without CASE: the default rig and
    structure.

    Example: rths identify el_centro_low_ff_fb --set identification.seed=1
    """
    from rths_cli.screen import Screen
    from rths_cli.workflows.make_model import Asked, make_model
    from rths_cli.workflows.measured import DataRequest, read_roles

    if not data and (channels or rate_hz is not None or corrected):
        raise InputError("--channel, --rate and --corrected belong to --data FILE; add it, or leave them out")
    request = DataRequest(data, read_roles(channels), rate_hz, corrected) if data else None
    judged = json.dumps(str(model.absolute())) if model else "null"  # what a case names is what is made here
    settings = (f"identification.model={judged}", *settings)
    asked = Asked(case, settings, request, output, save_data, figure, not no_figure)
    screen = Screen(poll=SIGNALS.poll)
    made = make_model(asked, screen.doing)
    screen.clear()
    _show_identified(made, as_json)
    return made.exit_code


def _show_identified(made: Any, as_json: bool) -> None:
    """Print the page (or the document) of an identification and draw its figure."""
    from rths_cli.report.identified import page, rejected_page
    from rths_cli.report.identified_document import as_document, rejected_document

    if made.found is None:
        faults, seen = made.unfit.faults, made.unfit.channels
        text = rejected_page(seen, faults, made.about)
        document = rejected_document(seen, faults, made.about)
    else:
        text, document = page(made.found, made.about), as_document(made.found, made.about)
        if made.figure:
            from rths_cli.report.identified_figure import write_figure

            write_figure(made.found, made.about, made.figure)
    click.echo(json.dumps(document, indent=2) if as_json else text, nl=as_json)


@cli.command()
@click.argument("record", required=False)
@click.option("--unit", help="Unit of the accelerations, where the file does not state it (g, cm/s^2, ...).")
@click.option("--dt", "dt_s", type=float, help="Sample interval in s, where the file does not state it.")
@json_option
def records(record: str | None, unit: str | None, dt_s: float | None, as_json: bool) -> int:
    """List the shipped ground motions, or show one: peaks, duration, response spectrum.

    Example: rths records el_centro
    """
    from rths_cli.workflows.records import listing, show

    document, text = show(record, unit, dt_s) if record else listing()
    click.echo(json.dumps(document, indent=2) if as_json else text, nl=as_json)
    return 0


@cli.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="FILE")
@json_option
def new(path: Path, as_json: bool) -> int:
    """Write a commented case file to start from; an existing file is left alone.

    Example: rths new my_case.yaml
    """
    from rths_cli.case.template import case_template

    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(case_template())
    except FileExistsError:
        raise InputError(f"{path}: exists; choose another name") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    click.echo(json.dumps({"written": str(path)}) if as_json else f"wrote {path}; try: rths run {path}")
    return 0


@cli.command()
@click.argument("kind", type=click.Choice(["case", "structure", "rig", "reference"]), default="case")
@json_option
def schema(kind: str, as_json: bool) -> int:
    """Print the JSON Schema of case files (or of what they name), for editors.

    Example: rths schema > case.schema.json
    """
    from rths_cli.case.schema import schema as build_schema

    click.echo(json.dumps(build_schema(kind), indent=2))
    return 0


def main() -> NoReturn:
    """Run the command line and leave with the exit code of DESIGN.md section 2."""
    SIGNALS.install()
    sys.exit(_guarded())


def _guarded() -> int:
    """Run the command; turn every way of failing into sentences and a code."""
    try:
        code = int(cli.main(standalone_mode=False) or 0)
        sys.stdout.flush()
        return code
    except click.ClickException as error:
        return _say([error.format_message()], 2)
    except (click.Abort, KeyboardInterrupt, Terminated):
        return _ended_by_signal()
    except InputError as error:
        return _say(error.faults, error.exit_code)
    except RthsError as error:
        return _say([str(error)], error.exit_code)
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except Exception as error:
        return _ended_by_signal() if SIGNALS.code else _fault_of_ours(error)


def _ended_by_signal() -> int:
    code = SIGNALS.code or INTERRUPTED
    return _say(["rths: interrupted" if code == INTERRUPTED else "rths: terminated"], code)


def _fault_of_ours(error: Exception) -> int:
    """Report an unforeseen failure: a full disk behind stdout is the user's, the rest is ours."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EIO):
        return _say([f"rths: cannot write the output: {error.strerror}"], 2)
    if "--debug" in sys.argv:
        raise error
    return _say([f"rths: internal error ({type(error).__name__}); details in {write_crash_file()}"], 5)


def _say(sentences: Sequence[str], code: int) -> int:
    """Show sentences on stderr and, where JSON was asked for, as the document on stdout; return the code."""
    click.echo("\n".join(sentences), err=True)
    if "--json" in sys.argv and code not in (INTERRUPTED, TERMINATED):
        click.echo(json.dumps({"exit_code": code, "faults": list(sentences)}, indent=2))
    return code
