"""`rths ida`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE
from rths_cli.cli.sweep import TableOptions, engine_options, show_table, table_options
from rths_cli.cli.terminal import new_screen


@cli.command()
@click.argument("case", metavar="CASE")
@click.option(
    "--records",
    required=True,
    metavar="SET",
    help="A folder of records, a text file that names one in each line, or names with commas between them.",
)
@click.option(
    "--measure",
    type=click.Choice(["sa_t1", "pga", "arias"]),
    default="sa_t1",
    show_default=True,
    help="Intensity measure, of the record as it is written: Sa(T1, 5 %) and PGA in m/s^2, Arias intensity in m/s.",
)
@click.option(
    "--levels",
    metavar="LEVELS",
    default="",
    help="Of the measure: V1,V2,... or LOW:HIGH:COUNT [default: around the one at which SIM of half of the records "
    "reaches the first limit].",
)
@click.option(
    "--limit",
    "limits",
    multiple=True,
    required=True,
    metavar="NAME=VALUE",
    help="Limit on a response, as drift_ratio=0.02 or drift_m=0.004; also accel_m_s2, base_shear_n, ductility. "
    "Repeatable.",
)
@click.option(
    "--on",
    type=click.Choice(["sim", "exp_rths", "both"]),
    default="both",
    show_default=True,
    help="What answers: SIM, the hybrid test on the virtual rig, or both.",
)
@click.option(
    "--hunt", is_flag=True, help="Run of each record only the levels that bracket its limits, and fit its capacities."
)
@engine_options
@click.option("--output", type=FILE, metavar="FILE", help="Result file [default: sweeps/NAME-ida.h5].")
@click.option("--csv", type=FILE, metavar="FILE", help="Write the table of all points as CSV too.")
@click.option("--figures", type=FILE, metavar="DIR", help="Draw curves and fragility into a folder, as SVG.")
@table_options("analysis")
def ida(
    case: str,
    records: str,
    measure: str,
    levels: str,
    limits: tuple[str, ...],
    on: str,
    hunt: bool,
    figures: Path | None,
    quiet: bool,
    settings: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> int:
    """Scale a set of records to levels of an intensity, run one case with each, and state the fragility.

    The case's scaling and record give way to them. Of every point the check says whether its hybrid test is valid.

    Exit code 0: a fragility is stated for every limit; 1: for one it is not. Points that the check refuses or a limit
    stops are listed, counted and left out of the fit; with more than a fifth of a stripe missing none is stated.

    Example: rths ida el_centro_low_ff_fb --records el_centro,hachinohe --limit drift_m=0.002 --on sim
    """
    from rths_cli.files.existing_files import Kind, check_existing
    from rths_cli.studies.ida import AskedIda, plan_ida
    from rths_cli.studies.ida_curves import hunt as hunting
    from rths_cli.studies.study_plan import Asked
    from rths_cli.studies.sweep import run_sweep
    from rths_cli.studies.sweep_runs import Shared

    given, screen = TableOptions(**options), new_screen(quiet)
    of_all = given.request("analysis", Asked(case, settings, (), None), choose=hunting if hunt else None)
    with screen.reading("starting"):
        asked = AskedIda(case, records, measure, levels, limits, on, hunt, settings)
        planned, every = plan_ida(asked, Shared(of_all.overrides, screen.doing))
        request = replace(of_all, asked=Asked(case, every, (), None), planned=planned)
        if figures is not None:
            stem = given.output.stem if given.output is not None else planned.name
            drawn = [(figures / f"{stem}-{name}.svg", Kind.DOCUMENT) for name in ("ida", "fragility")]
            check_existing(drawn, not given.no_replace)
        swept = run_sweep(request, screen)
        if figures is not None:
            from rths_cli.report.figures import write_sweep_figures

            write_sweep_figures(
                [(swept.path, swept.sweep)], figures, "svg", "two", screen.message, replace=not given.no_replace
            )
    screen.clear()
    from rths_cli.report.ida_page import document, exit_code, sections, verdict
    from rths_cli.report.to_text import text

    code = exit_code(swept.sweep)
    return show_table(swept, code, as_json, quiet, document, verdict, lambda: text(sections(swept.sweep, swept.path)))
