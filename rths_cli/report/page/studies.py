"""The sections of sweeps and studies in the page: figures, summary, the study and its case, origin."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from pathlib import Path

from rths_cli.files.sweep_file import Sweep
from rths_cli.report.page.html import Html, classed, details, element, table
from rths_cli.report.sweep_page import page

ALT = {
    "sweep": "the error over the varied keys",
    "tornado": "how far each varied key moves the error",
    "parallel": "every run as a line through its values",
    "sobol": "Sobol indices with their standard errors",
    "stability": "boundary of stability",
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
    parts = [*_figures(sweep), element("pre", page(sweep, path).rstrip("\n"))]
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

    for name, image in sweep_images(sweep) if sweep.numbers is None else ():
        source = f"data:image/svg+xml;base64,{base64.b64encode(image).decode('ascii')}"
        shown = Html(f'<img src="{source}" alt="{ALT[name]}" style="max-width: 100%; background: white">')
        yield classed("p", "figure", shown)
