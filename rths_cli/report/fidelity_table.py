"""Table of tracking fidelity, J criteria and energy error of EXP-RTHS by case; table of all metrics of one case."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rths_cli.files.result_reader import Result
from rths_cli.quantities import metric
from rths_cli.report.figure_values import listed
from rths_cli.report.results_by_case import Entry, state
from rths_cli.report.table_cells import mark
from rths_cli.report.text_layout import Cell, Row, Table

COLUMNS = {  # heading: metric, factor to the unit of the heading
    "delay ms": ("exp_rths.tracking_delay_s", 1e3),
    "FEI A": ("exp_rths.fei_amplitude", 1.0),
    "FEI d ms": ("exp_rths.fei_delay_s", 1e3),
    "J2": ("exp_rths.j2", 1.0),
    "J3": ("exp_rths.j3", 1.0),
    "J4": ("exp_rths.j4", 1.0),
    "J5": ("exp_rths.j5", 1.0),
    "energy": ("exp_rths.energy_error_ratio", 1.0),
}


def merit_table(cases: Sequence[Entry]) -> Table:
    """Return the table of EXP-RTHS's figures of merit, a line per case and method, with the definitions as notes."""
    rows: list[Row] = []
    for entry in cases:
        rows.append(Row(f"{entry.excitation}, damping {entry.damping}, {entry.controller}"))
        rows += [Row(method, tuple(_cells(result))) for method, result in entry.results.items()]
    title = f"Figures of merit of EXP-RTHS, measured, test band; {cases[0].table_name}"
    return Table(title, "method", (len(COLUMNS),), 10, (tuple(map(Cell, COLUMNS)),), tuple(rows), tuple(_notes()))


def _cells(result: Result) -> Iterator[Cell]:
    for path, factor in COLUMNS.values():
        value = state(result, path)
        yield Cell(value) if isinstance(value, str) else Cell(short(factor * value), mark=mark(result, path))


def _notes() -> Iterator[str]:
    for head, (path, _) in COLUMNS.items():
        found = metric(path)
        yield f"{head} ({path}): {found.text if found else ''}."


def every_figure(entry: Entry) -> Iterator[Table]:
    """Yield a table of all metrics of one case: path, unit, values by method, definition; nothing without metrics."""
    methods = list(entry.results)
    paths = sorted({path for result in entry.results.values() for path in result.metrics})
    rows = []
    for path in paths:
        having = next(result for result in entry.results.values() if path in result.metrics)
        values = [_listed(entry.results[method], path) for method in methods]
        rows.append(Row(path, tuple(map(Cell, (having.units[path], *values, having.definitions[path])))))
    heads = tuple(map(Cell, ("unit", *methods, "definition")))
    if rows:
        yield Table(
            f"Every figure of this case; {entry.table_name}", "figure", (len(heads),), 20, (heads,), tuple(rows)
        )


def _listed(result: Result, path: str) -> str:
    return listed(result.metrics.get(path, np.nan), result.intervals.get(path), short)


def short(value: float) -> str:
    """Return a number with four significant digits, "-" if it is not finite."""
    return f"{float(value):.4g}" if np.isfinite(value) else "-"
