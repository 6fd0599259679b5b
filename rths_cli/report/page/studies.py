"""The sections of sweeps and studies in the page: figures, summary, the study and its case, origin."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from pathlib import Path

from rths_cli.files.sweep_file import Sweep
from rths_cli.report.page.html import Html, classed, details, element, table
from rths_cli.report.sweep_page import grid_points, page_without_grid_points

CAPTIONS = {
    "sweep": "The metric over the varied keys{of}. A cross or an empty cell: a run was refused, aborted or failed.",
    "tornado": "How far each key moves the median: grid points with its smallest and with its largest values{of}. "
    "Grey bar: all values of the key. Black line: median of all grid points.",
    "parallel": "Each line is a grid point{of}; its colour is its height on the last axis. Grey: a run was refused, "
    "aborted or failed.",
    "sobol": "Share of the variance that comes from each key; bars: one standard error.",
    "stability": "Boundary of stability by the check, and how the runs ended. Shaded: the check forecasts an unstable "
    "loop.",
}
ORIGIN = {
    "created_utc": "Made",
    "rths_version": "rths",
    "command_line": "Command",
    "seeds": "Seeds",
    "grid_points": "Grid points",
    "status_reason": "Runs",
    "plan_sha256": "Hash of the plan",
    "software_sha256": "Hash of the software",
}


def study_section(path: Path, sweep: Sweep) -> Html:
    """Return the section of a sweep, given with its file."""
    told = element("pre", page_without_grid_points(sweep, path).strip("\n"))
    parts = [*_figures(sweep), element("h3", "Summary"), told]
    if points := grid_points(sweep):
        parts += [element("h3", "Grid points"), element("pre", points.rstrip("\n"))]
    if sweep.study_yaml:
        parts.append(details("The study", element("pre", sweep.study_yaml)))
    parts.append(details("The case that is varied", element("pre", sweep.case_yaml)))
    rows = [(label, str(sweep.attributes[name])) for name, label in ORIGIN.items() if name in sweep.attributes]
    rows.append(("Processors", ", ".join(sorted({*sweep.texts["processor"]} - {""})) or "-"))
    parts.append(details("Origin", table([["", path.name]], rows)))
    return element("section", element("h2", path.stem), *parts)


def studies_title(sweeps: Sequence[tuple[Path, Sweep]]) -> str:
    """Return the title of a page of sweeps alone."""
    return "Hybrid simulation: " + (f"study {sweeps[0][0].stem}" if len(sweeps) == 1 else f"{len(sweeps)} studies")


def studies_told(sweeps: Sequence[tuple[Path, Sweep]]) -> str:
    """Return the sentence below the title."""
    runs = sum(len(sweep.seed) for _, sweep in sweeps)
    rigs = ", ".join(sorted({str(sweep.attributes["rig"]) for _, sweep in sweeps}))
    return f"{runs} runs of EXP-RTHS on the virtual shake table {rigs}: no table moved."


def _figures(sweep: Sweep) -> Iterator[Html]:
    from rths_cli.report.figures.write import sweep_images

    seeds = sweep.seeds_per_point
    of = f", median of {seeds} seeds" if seeds > 1 else ""
    for name, image in sweep_images(sweep) if sweep.numbers is None else ():
        source = f"data:image/svg+xml;base64,{base64.b64encode(image).decode('ascii')}"
        told = CAPTIONS[name].format(of=of)
        yield classed("div", "drawing", Html(f'<img src="{source}" alt="{told}">'))
        yield classed("p", "caption", told)
