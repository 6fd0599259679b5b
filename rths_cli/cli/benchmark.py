"""`rths benchmark`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, Number, json_option, no_replace_option, quiet_option
from rths_cli.cli.sweep import threads
from rths_cli.cli.terminal import new_screen, show_page

LIST = "list"


@cli.command()
@click.argument("name", metavar="list|NAME")
@click.option("--case", "cases", multiple=True, metavar="NAME", help="One of its cases [default: all]. Repeatable.")
@click.option(
    "--compensator",
    "compensators",
    multiple=True,
    metavar="NAME|FILE",
    help="One of its table, any kind with its defaults, or your own Python file [default: the table]. Repeatable.",
)
@click.option("--plants", type=click.IntRange(1, 100_000), help="The nominal plant and perturbed ones [default: 20].")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of plants and noise.")
@click.option("--noise-free", is_flag=True, help="Sensors without noise; the converters round all the same.")
@click.option("--record", metavar="NAME|FILE", help="Another ground motion.")
@click.option("--scaling", type=Number(min=0, min_open=True, max=100), metavar="FACTOR", help="Its factor.")
@click.option(
    "--change",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="What changes during the test, as in the file's change: at_s=10, specimen_stiffness_factor=0.7, "
    "command_gain_factor=1.1, latency_samples=1. Laws that adapt are played frozen too. Repeatable.",
)
@click.option("--critical-delays", is_flag=True, help="Print the critical delay of each case, and play nothing.")
@click.option(
    "--responses",
    type=FILE,
    metavar="FILE",
    help="Draw frequency response and step response of every compensator (.pdf, .svg, .png), and play nothing.",
)
@click.option("--jobs", type=click.IntRange(1, 1024), help="Runs at a time [default: the number of cores].")
@click.option("--output", type=FILE, metavar="FILE", help="File of the rows [default: benchmarks/NAME.jsonl].")
@click.option("--table", type=FILE, metavar="FILE", help="Write the tables too: .tex, .md, .html or .txt.")
@click.option("--resume", is_flag=True, help="Go on with an interrupted benchmark.")
@no_replace_option
@quiet_option
@json_option
def benchmark(
    name: str,
    cases: tuple[str, ...],
    compensators: tuple[str, ...],
    plants: int | None,
    seed: int,
    noise_free: bool,
    record: str | None,
    scaling: float | None,
    changes: tuple[str, ...],
    critical_delays: bool,
    responses: Path | None,
    jobs: int | None,
    output: Path | None,
    table: Path | None,
    resume: bool,
    no_replace: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Put compensators to a published test, on the same perturbed plants with the same noise, and rank them.

    NAME: a benchmark of `rths benchmark list`, or a file. The same seed gives the same numbers.

    Example: rths benchmark silva2020 --case 1 --plants 5
    """
    if name == LIST:
        from rths_cli.cli.describe import show_list

        return show_list("benchmarks", as_json)
    screen = new_screen(quiet)
    from rths_cli.benchmark.campaign import BenchmarkRequest, actuator_benchmark, run_benchmark
    from rths_cli.report.benchmark_page import (
        as_json as as_document,
    )
    from rths_cli.report.benchmark_page import (
        check_table,
        delays,
        delays_page,
        page,
        standings,
        verdict,
        write_table,
    )
    from rths_cli.report.report_options import check_output

    request = BenchmarkRequest(
        name, cases, compensators, plants, seed, noise_free, record, scaling, output, jobs or threads(), resume,
        not no_replace, changes,
    )  # fmt: skip
    with screen.reading("starting"):
        if critical_delays:
            bench = actuator_benchmark(request, "--critical-delays")
            screen.clear()
            if as_json:
                click.echo(json.dumps({"benchmark": name, "critical_delays_ms": delays(bench)}, indent=2))
            else:
                show_page(lambda: delays_page(bench))
            return 0
        if responses is not None:
            check_output("--responses", responses, [], not no_replace)
            from rths_cli.benchmark.responses import followed
            from rths_cli.report.compensator_figure import write_responses

            drawn = followed(actuator_benchmark(request, "--responses"))
            write_responses(drawn, responses)
            screen.clear()
            click.echo(f"{responses}: {len(drawn)} compensators")
            return 0
        if table is not None:
            check_table(table)
            check_output("--table", table, [], not no_replace)
        made = run_benchmark(request, screen)
        if table is not None:
            write_table(table, made)
    screen.clear()
    if as_json:
        click.echo(json.dumps(as_document(made), indent=2))
    elif quiet:
        click.echo(verdict(made, standings(made)))
    else:
        show_page(lambda: page(made))
    return 0
