"""Tables of EXP-RTHS by case: errors in percent of SIM; tracking fidelity, J criteria and energy error; all metrics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rths_cli.files.result_reader import Result
from rths_cli.quantities import metric
from rths_cli.report.numbers import listed, rounded_to_four
from rths_cli.report.results_by_case import Entry, state, storeys
from rths_cli.report.table_cells import mark, ratio
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
PAIRS = ("nrmse_percent", "peak_error_percent", "rms_error_m_s2")  # the last one over that of SIM-DELAY
PERCENT_COLUMN = 8
PERCENT_NOTES = (
    "RMS error: in percent of the RMS of SIM (NRMSE); peak error: in percent of SIM's peak; / SIM-DELAY: RMS error of "
    "EXP-RTHS over that of SIM-DELAY, a ratio.",
    "FEI: frequency evaluation index of the table in EXP-RTHS, effective delay (positive: late) and gain (1 = exact).",
)


def merit_table(cases: Sequence[Entry]) -> Table:
    """Return the table of EXP-RTHS's figures of merit, a line per case and method, with the definitions as notes."""
    rows: list[Row] = []
    for entry in cases:
        rows.append(Row(f"{entry.excitation}, damping {entry.damping}, {entry.controller}"))
        rows += [Row(method, tuple(_cells(result))) for method, result in entry.results.items()]
    title = f"Figures of merit of EXP-RTHS, measured, test band; {cases[0].table_name}"
    return Table(title, "method", (len(COLUMNS),), 10, (tuple(map(Cell, COLUMNS)),), tuple(rows), tuple(_notes()))


def percent_table(cases: Sequence[Entry]) -> Table:
    """Return the table of EXP-RTHS's errors in percent of SIM, beside the ratio to SIM-DELAY and the table's FEI.

    A row for each storey of a case and method, in test band and full band; effective delay and gain are those of the
    table, stated in the first row.
    """
    rows: list[Row] = []
    for entry in cases:
        for method, result in entry.results.items():
            rows.append(Row(f"{entry.excitation}, damping {entry.damping}, {entry.controller}, {method}"))
            rows += [Row(f"storey {k + 1}", _percent_cells(result, k)) for k in range(storeys([entry]))]
    of_pairs = ("RMS error (%)", "peak error (%)", "/ SIM-DELAY (-)", "table (FEI)")
    heads = (
        tuple(Cell(text, 2) for text in of_pairs),
        (*(Cell(band) for _ in PAIRS for band in ("test", "full")), Cell("ms late"), Cell("gain")),
    )
    title = f"EXP-RTHS against SIM, measured, test band and full band; {cases[0].table_name}"
    return Table(title, "", (2, 2, 2, 2), PERCENT_COLUMN, heads, tuple(rows))


def _percent_cells(result: Result, storey: int) -> tuple[Cell, ...]:
    values: list[float | str] = []
    for leaf in PAIRS:
        for suffix in ("", "_full"):
            value = state(result, f"exp_rths.{leaf}{suffix}", storey)
            if leaf == "rms_error_m_s2":
                value = ratio(value, state(result, f"sim_delay.{leaf}{suffix}", storey))
            values.append(value)
    cells = [_cell(value, mark(result, "exp_rths.nrmse_percent")) for value in values]
    if storey > 0:
        return (*cells, Cell(""), Cell(""))
    delay_s, gain = state(result, "exp_rths.fei_delay_s"), state(result, "exp_rths.fei_amplitude")
    delay_ms = delay_s if isinstance(delay_s, str) else round(1e3 * delay_s, 4) + 0.0  # a column has room for -0.1234
    shown = Cell(gain) if isinstance(gain, str) else Cell(f"{gain:.4f}", mark=mark(result, "exp_rths.fei_amplitude"))
    return (*cells, _cell(delay_ms, mark(result, "exp_rths.fei_delay_s")), shown)


def _cell(value: float | str, mark: str) -> Cell:
    return Cell(value) if isinstance(value, str) else Cell(f"{value:.3g}", mark=mark)


def _cells(result: Result) -> Iterator[Cell]:
    for path, factor in COLUMNS.values():
        value = state(result, path)
        yield Cell(value) if isinstance(value, str) else Cell(rounded_to_four(factor * value), mark=mark(result, path))


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
    return listed(result.metrics.get(path, np.nan), result.intervals.get(path), rounded_to_four)
