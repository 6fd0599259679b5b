"""Section of one case: error by cause, latency, timing of its steps, every metric."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from rths_cli.files.result_reader import Result, read_series
from rths_cli.loop.lost_samples import without_samples
from rths_cli.numerics.lti import Array
from rths_cli.quantities.units import typeset
from rths_cli.report.error_budget_table import CAUSES, named_causes
from rths_cli.report.latency_table import latency_text
from rths_cli.report.numbers import listed, rounded_to_four
from rths_cli.report.page.html import Html, element, framed, join, table
from rths_cli.report.page.paper_tables import as_html
from rths_cli.report.page.summary import is_virtual
from rths_cli.report.results_by_case import Entry
from rths_cli.report.text_layout import Cell, Row, Table

KINDS = {"check": "pred.", "budget": "meas."}
TIMES = {
    "late_s": "start of the exchange, late by",
    "exchange_s": "exchange with the rig",
    "compute_s": "step and guard",
}
SHARES = {"median": 50.0, "99 %": 99.0, "99.9 %": 99.9, "largest": 100.0}
TABLES = {"exp_rths": "EXP-RTHS", "shake_table": "shake table test"}


def every_figure(entry: Entry) -> Html:
    """Return a table of all metrics of a case: path, unit, values by method, definition."""
    methods = entry.results
    paths = sorted({path for result in methods.values() for path in result.metrics})
    return table([["metric", "unit", *methods, "definition"]], (_figure(path, methods) for path in paths))


def by_cause(result: Result) -> Html:
    """Return the error of EXP-RTHS by cause in mm/s², predicted and measured; "" if neither is known."""
    kinds = [kind for kind in KINDS if f"{kind}.rms_error_coupling_m_s2" in result.metrics]
    if not kinds:
        return Html("")
    storeys = np.atleast_1d(result.metrics[f"{kinds[0]}.rms_error_coupling_m_s2"]).size
    columns = ["tracking", *(f"storey {storey}" for storey in range(1, storeys + 1))]
    heads = (
        tuple(Cell(column, len(kinds)) for column in columns),
        tuple(Cell(KINDS[kind]) for kind in kinds) * len(columns),
    )
    rows = [
        Row(label, tuple(Cell(text) for text in _causes(result, kinds, cause, storeys)))
        for cause, label in {**CAUSES, "": "together"}.items()
    ]
    shown = tuple(row for row in rows if any(cell.text != "-" for cell in row.cells))
    virtual = "; virtual" if is_virtual(result) else ""
    title = f"Error by cause (RMS, mm/s^2, test band{virtual})"
    named = named_causes(result)
    whole = as_html(Table(title, "", (len(kinds),) * len(columns), 10, heads, shown))
    return join([whole, element("p", named)]) if named else whole


def latency(result: Result) -> Html:
    """Return the latency budget as on the terminal; "" if it is not known."""
    text = latency_text(result.metrics)
    return framed(element("pre", text)) if text else Html("")


def timing(result: Result) -> Html:
    """Return the durations of the steps on a real rig in microseconds; "" for a virtual rig, which has no clock."""
    if is_virtual(result):
        return Html("")
    rows = [row for run in TABLES if run in result.groups for row in _timing(result, run)]
    if not rows:
        return Html("")
    return table([["loop timing (µs)", *SHARES]], rows, "figures")


def _timing(result: Result, run: str) -> Iterator[list[str]]:
    for name, label in TIMES.items():
        values = _noted(result, f"{run}/timing/{name}")
        if values is not None and np.any(np.isfinite(values)):
            shares = np.nanpercentile(values, list(SHARES.values()))
            yield [f"{TABLES[run]}: {label}", *(f"{1e6 * share:.1f}" for share in shares)]
    overruns = result.attributes.get(f"{run}_overruns")
    if overruns is not None:
        yield [f"{TABLES[run]}: intervals overrun", "", "", "", str(overruns)]
    lost = _noted(result, f"{run}/timing/lost")
    if lost is not None:
        yield [
            f"{TABLES[run]}: steps without samples, of {lost.size}",
            "",
            "",
            "",
            str(int(np.count_nonzero(without_samples(lost)))),
        ]


def _noted(result: Result, name: str) -> Array | None:
    """Return a timing signal (n,) of a loop, None if it is not stored (a recovered run, an old file)."""
    from rths_cli.errors import InputError

    try:
        return np.asarray(read_series(result.path, name), dtype=float)
    except InputError:
        return None


def _figure(path: str, methods: Mapping[str, Result]) -> list[str]:
    having = next(result for result in methods.values() if path in result.metrics)
    values = (_listed(result, path) for result in methods.values())
    return [path, typeset(having.units.get(path, "")), *values, having.definitions.get(path, "")]


def _listed(result: Result, path: str) -> str:
    return listed(result.metrics.get(path, np.nan), result.intervals.get(path), rounded_to_four, between="  ")


def _causes(result: Result, kinds: list[str], cause: str, storeys: int) -> Iterator[str]:
    for column in range(storeys + 1):
        for kind in kinds:
            figure = "rms_error" if column else "tracking_rms"
            source = "exp_rths" if kind == "budget" and not cause else kind
            values = result.metrics.get(f"{source}.{figure}{'_' if cause else ''}{cause}_m_s2")
            yield "-" if values is None else f"{1e3 * float(np.atleast_1d(values)[max(column - 1, 0)]):.3f}"
