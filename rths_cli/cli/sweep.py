"""`rths sweep` and `rths merge`."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import (
    FILE,
    F,
    command_line,
    force_option,
    json_option,
    methods_option,
    no_replace_option,
    overrides_option,
    quiet_option,
    settings_option,
)
from rths_cli.cli.terminal import new_screen, show_page
from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.studies.study_plan import Asked
    from rths_cli.studies.sweep import SweepRequest, Swept


def threads() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def jobs_of(jobs: int | None, engine: str) -> int:
    """Return how many runs are played at a time; raises InputError where the engine decides itself."""
    if jobs is not None and engine in ("inline", "dask"):
        why = "plays one run at a time" if engine == "inline" else "plays as many runs as its workers have threads"
        raise InputError(f"--jobs {jobs}: --engine {engine} {why}; drop --jobs")
    return 1 if engine == "inline" else jobs or threads()


def engine_options(command: F) -> F:
    """Add --jobs, --engine and --scheduler."""
    for option in (
        click.option(
            "--scheduler", metavar="ADDRESS", default="", help="Of --engine dask: tcp://HOST:8786, or a scheduler file."
        ),
        click.option(
            "--engine",
            type=click.Choice(["inline", "threads", "processes", "dask"]),
            default="threads",
            show_default=True,
            help="What plays the runs: this process one at a time, its threads, processes of this machine, or Dask's "
            "workers.",
        ),
        click.option(
            "--jobs", type=click.IntRange(min=1, max=1024), help="Runs at a time [default: the number of cores]."
        ),
    ):
        command = option(command)
    return command


def table_options(noun: str) -> Callable[[F], F]:
    """Return what adds the options that every table of runs has; `noun` is what one is called in them."""

    def add(command: F) -> F:
        for option in (
            json_option,
            settings_option,
            quiet_option,
            overrides_option(
                ["check", "model"],
                "Run what the check refuses, or use a model that was rejected. Repeatable, stored in the result.",
            ),
            click.option("--resume", is_flag=True, help=f"Go on with an interrupted {noun}."),
            force_option,
            no_replace_option,
        ):
            command = option(command)
        return command

    return add


@dataclass(frozen=True)
class TableOptions:
    """What the options of every table of runs say."""

    jobs: int | None
    engine: str
    scheduler: str
    output: Path | None
    csv: Path | None
    no_replace: bool
    force: bool
    resume: bool
    overrides: tuple[str, ...]

    def request(self, noun: str, asked: Asked, **more: Any) -> SweepRequest:
        """Return the request of a table; raises InputError for options that contradict each other."""
        from rths_cli.studies.engines import Engine
        from rths_cli.studies.sweep import SweepRequest

        if self.force and (self.no_replace or self.resume):
            raise InputError(f"--force replaces a finished {noun}; --no-replace and --resume do not: give one of them")
        return SweepRequest(
            asked=asked,
            output=self.output,
            csv=self.csv,
            engine=Engine(self.engine, jobs_of(self.jobs, self.engine), self.scheduler),
            replace=not self.no_replace,
            resume=self.resume,
            command_line=command_line(),
            overrides=tuple(dict.fromkeys(self.overrides)),
            force=self.force,
            **more,
        )


def show_table(
    swept: Swept, code: int, as_json: bool, quiet: bool, document: Callable[..., dict[str, Any]],
    verdict: Callable[..., str], page: Callable[[], str],
) -> int:  # fmt: skip
    """Print a table of runs as JSON, in a line or as a page; return its exit code."""
    if as_json:
        click.echo(json.dumps(document(swept.sweep, swept.path) | {"exit_code": code}, indent=2))
    elif quiet:
        click.echo(verdict(swept.sweep, swept.path))
    else:
        show_page(page)
    return code


class Part(click.ParamType):
    """One part of many: K/N, counted from 1."""

    name = "K/N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Return number and count; fails for what is none of 1/N to N/N."""
        if isinstance(value, tuple):
            return value
        number, _, count = str(value).partition("/")
        if not (number.isdecimal() and count.isdecimal() and len(count) <= 7 and 1 <= int(number) <= int(count)):
            self.fail(f"{value!r} must be K/N with 1 <= K <= N, as 3/100.", param, ctx)
        return int(number), int(count)


@cli.command()
@click.argument("case", metavar="CASE|STUDY")
@click.option(
    "--vary",
    multiple=True,
    metavar="KEY=VALUES",
    help="A key of the case and its values, V1,V2,... or LOW:HIGH:COUNT (both ends included). Repeatable: all "
    "combinations are run.",
)
@click.option("--seeds", metavar="N|A:B", help="Seeds 0 to N-1, or A to B, of every combination [default: the case's].")
@engine_options
@click.option("--part", type=Part(), help="Play part K of N alone, and write its file; rths merge joins all parts.")
@click.option("--output", type=FILE, metavar="FILE", help="Result file [default: sweeps/NAME.h5].")
@click.option("--csv", type=FILE, metavar="FILE", help="Write the table as CSV too.")
@methods_option("run both")
@table_options("sweep")
def sweep(
    case: str,
    vary: tuple[str, ...],
    seeds: str | None,
    part: tuple[int, int] | None,
    methods: tuple[str, ...],
    quiet: bool,
    settings: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> int:
    """Run EXP-RTHS of one case over varied keys and seeds on the virtual rig, and write one table of figures.

    A study file states the case, its axes with values or distributions, and seeds.

    Exit code 0: all ran and were accepted; 1: some were refused or not accepted; 3: some were stopped by a limit.

    Example: rths sweep el_centro_low_ff_fb --seeds 20 --vary scaling=0.2,0.3
    """
    from rths_cli.studies.study_plan import Asked
    from rths_cli.studies.sweep import run_sweep

    chosen = tuple(dict.fromkeys(methods))
    varied = (f"method={','.join(chosen)}",) if len(chosen) > 1 else ()
    one = (f"method={chosen[0]}",) if len(chosen) == 1 else ()
    asked = Asked(case, (*settings, *one), (*varied, *vary), seeds)
    request = TableOptions(**options).request("sweep", asked, part=part)
    screen = new_screen(quiet)
    with screen.reading("starting"):
        swept = run_sweep(request, screen)
    screen.clear()
    from rths_cli.report.sweep_page import document, page, verdict

    return show_table(swept, swept.exit_code, as_json, quiet, document, verdict, lambda: page(swept.sweep, swept.path))


@cli.command()
@click.argument("parts", nargs=-1, required=True, type=FILE, metavar="PART...")
@click.option("--output", type=FILE, required=True, metavar="FILE", help="File of the whole sweep, as sweeps/NAME.h5.")
@no_replace_option
@force_option
@json_option
def merge(parts: tuple[Path, ...], output: Path, no_replace: bool, force: bool, as_json: bool) -> int:
    """Join the files of `rths sweep --part K/N`, in any order, to the table of the whole sweep.

    Parts of different sweeps or versions of rths are refused, and so are rows that are missing or there twice. The exit
    code is that of the sweep.

    Example: rths merge sweeps/study-part*.h5 --output sweeps/study.h5
    """
    from rths_cli.files.durable_files import taken_sentence
    from rths_cli.files.existing_files import replaced_sentence
    from rths_cli.report.sweep_page import document, page
    from rths_cli.studies.merge import merge_parts
    from rths_cli.studies.sweep_output import several_processors

    if force and no_replace:
        raise InputError("--force replaces a finished sweep, --no-replace does not: give one of them")
    sweep, written, replaced = merge_parts(parts, output, not no_replace, command_line(), force)
    if replaced:
        click.echo(replaced_sentence([output]), err=True)
    if written != output:
        click.echo(taken_sentence(output, written), err=True)
    if several := several_processors(sweep):
        click.echo(several, err=True)
    code = int(sweep.attributes["exit_code"])
    if as_json:
        click.echo(json.dumps(document(sweep, written) | {"exit_code": code}, indent=2))
    else:
        show_page(lambda: page(sweep, written))
    return code
