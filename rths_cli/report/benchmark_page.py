"""The output of `rths benchmark`: the order of the compensators first, then a table of criteria for each case."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.benchmark.campaign import Benchmarked, BenchmarkRow
from rths_cli.benchmark.displacement import ROW, SETTLED_S, DisplacementBenchmark, critical_delay_s
from rths_cli.benchmark.ranking import Standing, contradicted, half_interval, has_failed, standings
from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
from rths_cli.report.document import Block, Column, Document, Line, Row, Table, by_columns, verdict_line
from rths_cli.report.numbers import json_value
from rths_cli.report.to_text import text
from rths_cli.safe_text import visible

COLUMNS = (  # name, unit, figure, decimals
    ("J1", "ms", "j1_ms", 2),
    *((f"J{i}", "%", f"j{i}_percent", 2) for i in range(2, 10)),
    ("FEI", "", "fei_amplitude", 3),
    ("FEI delay", "ms", "fei_delay_ms", 2),
    ("J2 true", "%", "true_j2_percent", 2),
    ("J4 true", "%", "true_j4_percent", 2),
    ("error", "%", "error_percent", 2),
)
LEGEND = (
    "J1: lag of the actuator, 0 to 12 ms; leads are not seen. Tracking: J2 deviation, J3 peak. Against the reference: "
    "J4 deviation and J5 peak of floor 1 as measured, J6 and J7 deviation of floors 2 and 3, J8 and J9 their peaks.",
    "FEI: frequency evaluation index, amplitude and delay. J1 to J5 and FEI have the sensor's noise, the true J2 and "
    "J4 are of the displacement itself.",
)
ORDER = (
    "error: deviation of the displacement itself from the reference with this plant's own specimen, over that of the "
    "reference; mean over cases and plants, with its 95 % interval over the plants. Equal ranks: no significant "
    "difference from the first of that rank on the same plants and noise (95 %). Compensators with an unstable run "
    "come last.",
)
FORMATS = (".tex", ".md", ".html", ".txt")


def document(made: Benchmarked) -> Document:
    """Return the whole output as a document."""
    order = standings(made)
    return [
        [verdict_line(verdict(made, order)), *notes(made)],
        [_ranking(order), *map(Line, adapting(made))],
        *([_case_table(made, case.name, order)] for case in made.bench.spec.cases),
        [Line(one) for one in LEGEND],
        [_delays(made.bench)],
        [Line(f"rows in {made.path}")],
    ]


def page(made: Benchmarked) -> str:
    """Return the whole output as text."""
    return text(document(made))


def verdict(made: Benchmarked, order: Sequence[Standing]) -> str:
    """Return in one sentence which compensator is best."""
    best = [one for one in order if one.rank == 1]
    first = best[0]
    if first.failed:
        return "none: of every compensator a run is unstable"
    beside = "" if len(best) == 1 else f" (no significant difference: {', '.join(one.compensator for one in best[1:])})"
    return (
        f"{first.compensator}: best of {len(order)}, error {_percent(first.error_percent, first.half_percent)} over "
        f"{_counted(len(made.bench.spec.cases), 'case')} and {_counted(made.bench.spec.plants, 'plant')}{beside}"
    )


def notes(made: Benchmarked) -> list[Block]:
    """Return what must be known beside the table: record, noise, plants, and what is unusual in any run."""
    spec, seed = made.bench.spec, int(made.plan["seed"])
    negative = sum(made.bench.plant(i, seed).oil_column_rad_s < 0.0 for i in range(spec.plants))
    clipped = sum(row.figures["peak_force_n"] >= spec.actuator.force_limit_n - 50.0 for row in made.rows)
    noise = "sensors without noise" if made.bench.noise_free else "one draw for both sensors"
    told = [
        f"{spec.heading}; {spec.ground_motion_factor:g} x {spec.ground_motion}, seed {seed}, {noise}, force clipped at "
        f"{spec.actuator.force_limit_n:g} N"
    ]
    if made.bench.change is not None:
        stated = made.bench.change.model_dump(exclude_defaults=True).items()
        changed = ", ".join(f"{key} {value:g}" for key, value in stated)
        told.append(f"the plant changes ({changed}); every figure is that from {SETTLED_S:g} s after it")
    if negative:
        told.append(f"a_3 < 0 in {negative} of {spec.plants} plants: kept as drawn, the feedback stabilises the plant")
    if clipped:
        told.append(f"the force came to its limit in {clipped} of {len(made.rows)} runs")
    if wrong := contradicted(made.rows, made.adapting):
        told.append(f"{len(wrong)} runs diverged although their linear loop is stable: see the rows")
    return [Line(one) for one in told]


def adapting(made: Benchmarked) -> list[str]:
    """Return what is known of each law that adapts, a sentence for all cases of which the same is known."""
    told = []
    for label, cases in made.adaptive.items():
        same: dict[str, list[str]] = {}
        for case, verdict in cases.items():
            same.setdefault(verdict.told, []).append(case)
        told += [f"{label}, case {', '.join(where)}, nominal plant: {what}" for what, where in same.items()]
    return told


def _ranking(order: Sequence[Standing]) -> Table:
    columns = [
        (Column("rank"), [str(one.rank) for one in order]),
        (Column("error", unit="%"), [_number(one.error_percent) for one in order]),
        (Column("+-95 %", unit="%"), [_number(one.half_percent) for one in order]),
        (Column("worst", unit="%"), [_number(one.worst_percent) for one in order]),
        (Column("true J2", unit="%"), [_number(one.tracking_percent) for one in order]),
        (Column("unstable"), [f"{one.failed} of {one.runs}" for one in order]),
        (Column("linear loop", words=True), [one.verdict for one in order]),
    ]
    table = by_columns("compensator", [one.compensator for one in order], columns)
    return Table(table.columns, table.rows, "Order, by the error", "compensator", ORDER)


def _case_table(made: Benchmarked, case: str, order: Sequence[Standing]) -> Table:
    rows = []
    for one in order:
        found = [row for row in made.rows if row.case == case and row.compensator == one.compensator]
        means = {name: float(np.mean([row.figures[name] for row in found])) for name in ROW}
        rows.append(Row(one.compensator, tuple(_number(means[name], digits) for _, _, name, digits in COLUMNS)))
    columns = tuple(Column(name, unit=unit) for name, unit, _, _ in COLUMNS)
    return Table(columns, tuple(rows), f"Case {case}, means over the plants", "compensator")


def delays_page(bench: DisplacementBenchmark) -> str:
    """Return the critical delays alone."""
    return text([[_delays(bench)]])


def delays(bench: DisplacementBenchmark) -> dict[str, float]:
    """Return the critical delay of each case in ms."""
    return {case.name: 1e3 * critical_delay_s(bench, case) for case in bench.spec.cases}


def _delays(bench: DisplacementBenchmark) -> Table:
    found = delays(bench)
    less = 1.5e3 * bench.dt_s
    columns = [
        (Column("critical delay", unit="ms"), [f"{one:.3f}" for one in found.values()]),
        (Column("of it left", unit="ms"), [f"{one - less:.3f}" for one in found.values()]),
    ]
    table = by_columns("case", list(found), columns)
    note = (
        "critical delay: pure delay of the actuator at which the continuous loop is on the border of stability, its "
        f"force without a delay of its own; of it left: without {less:.3f} ms, the force's sample of delay and its hold"
    )
    return Table(table.columns, table.rows, "Critical delays", "case", (note,))


def as_json(made: Benchmarked) -> dict[str, Any]:
    """Return the same as a document for JSON."""
    order = standings(made)
    return {
        "benchmark": made.bench.spec.name,
        "verdict": verdict(made, order),
        "seed": made.plan["seed"],
        "noise_free": made.bench.noise_free,
        "record": made.bench.spec.ground_motion,
        "scaling": made.bench.spec.ground_motion_factor,
        "plants": made.bench.spec.plants,
        "critical_delays_ms": {name: json_value(1e3 * one) for name, one in made.critical_delays_s.items()},
        "ranking": [
            {
                "compensator": one.compensator,
                "rank": one.rank,
                "error_percent": json_value(one.error_percent),
                "error_half_interval_percent": json_value(one.half_percent),
                "worst_error_percent": json_value(one.worst_percent),
                "true_j2_percent": json_value(one.tracking_percent),
                "unstable": one.failed,
                "runs": one.runs,
                "linear_loop": one.verdict,
            }
            for one in order
        ],
        "adapting": adapting(made),
        "cases": {case.name: list(_means(made, case.name, order)) for case in made.bench.spec.cases},
        "rows": [_row(row) for row in made.rows],
        "file": str(made.path),
    }


def _means(made: Benchmarked, case: str, order: Sequence[Standing]) -> Iterator[dict[str, Any]]:
    for one in order:
        found = [row for row in made.rows if row.case == case and row.compensator == one.compensator]
        values = {name: np.array([row.figures[name] for row in found]) for name in ROW}
        half = half_interval(values["error_percent"])
        yield {
            "compensator": one.compensator,
            **{name: json_value(np.mean(each)) for name, each in values.items()},
            "error_half_interval_percent": json_value(half),
            "unstable": sum(map(has_failed, found)),
        }


def _row(row: BenchmarkRow) -> dict[str, Any]:
    figures = {name: json_value(value) for name, value in row.figures.items()}
    return {"case": row.case, "compensator": row.compensator, "plant": row.plant, **figures}


def check_table(path: Path) -> None:
    """Raise InputError for a table's file whose ending names no format."""
    if path.suffix not in FORMATS:
        raise InputError(f"--table {path}: must end with {', '.join(FORMATS)}")


def write_table(path: Path, made: Benchmarked) -> None:
    """Write the output in the format that the file's ending names: LaTeX, Markdown, HTML or text."""
    from rths_cli.report.to_files import latex, markdown
    from rths_cli.report.to_html import Html, blocks, element, join

    found = document(made)
    if path.suffix == ".html":
        body = element("body", element("h1", made.bench.spec.heading), join(map(blocks, found)))
        head = element("head", Html('<meta charset="utf-8">'), element("title", made.bench.spec.heading))
        written = f"<!DOCTYPE html>\n{element('html', head, body, attributes={'lang': 'en'})}\n"
    else:
        written = {".tex": latex, ".md": markdown, ".txt": text}[path.suffix](found)
    with written_whole(path) as part:
        part.write_bytes(visible(written).encode())


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _number(value: float, digits: int = 2) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _percent(value: float, half: float) -> str:
    return f"{value:.2f} %" if math.isnan(half) else f"{value:.2f} +- {half:.2f} %"
