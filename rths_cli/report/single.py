"""One case by itself: all its figures in one table, then whatever else was measured or identified."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rths_cli.files.results import Result
from rths_cli.report.cells import TESTS, mark, published_cells, ratio, words
from rths_cli.report.layout import Cell, Row, Table
from rths_cli.report.load import Entry, published, state, storeys

KINDS = {"meas.": "", "true": "_true", "full": "_full", "full-t": "_true_full"}
TRACKING = {"max": "tracking_max_m_s2", "RMS": "tracking_rms_m_s2"}
ERRORS = {"RMS": "rms_error_m_s2", "max": "max_error_m_s2"}
RUNS = {"SIM-DELAY": "sim_delay", "EXP-RTHS": "exp_rths"}


def single_table(entry: Entry) -> Table:
    """Return every figure of the paper's two tables for one case: published, then per method and kind."""
    kinds = _kinds(entry)
    heads = (
        (Cell(""), *(Cell(method, len(kinds)) for method in entry.results)),
        (Cell("publ."), *[Cell(kind) for kind in kinds] * len(entry.results)),
    )
    what = f"{entry.excitation}, damping {entry.damping}, controller {entry.controller}"
    return Table(
        f"{what}: errors (m/s^2, test band unless full); {entry.table_name}",
        "",
        (1, *(len(kinds),) * len(entry.results)),
        9 if len(entry.results) < 2 else 8,
        heads,
        (*_tracking(entry), *_errors(entry), *_ratios(entry)),
    )


def other_figures(entry: Entry) -> str:
    """Return a line for every further metric of the case: path, unit, values by method; seconds shown in ms."""
    shown = {f"{run}.{figure}{suffix}" for run, figure, suffix in _shown()}
    results = list(entry.results.values())
    paths = sorted({path for result in results for path in result.metrics} - shown)
    if not paths:
        return ""
    wide = max(len(path) for path in paths)
    lines = []
    for path in paths:
        unit = next(result.units[path] for result in results if path in result.units)
        values = {method: _listed(result, path, unit) for method, result in entry.results.items()}
        same = len(set(values.values())) == 1
        text = next(iter(values.values())) if same else "   ".join(f"{m}: {v}" for m, v in values.items())
        lines.append(f"  {path:<{wide}}  {'ms' if unit == 's' else unit:<8}{text}")
    return "\n".join(["Other figures of this case (definitions: rths report --json, or the result file)", *lines])


def _listed(result: Result, path: str, unit: str) -> str:
    if path not in result.metrics:
        return "-"
    values = np.atleast_1d(result.metrics[path])
    return " ".join(f"{round(1e3 * value, 3) + 0.0:.3f}" if unit == "s" else _plain(value) for value in values)


def _shown() -> Iterator[tuple[str, str, str]]:
    for suffix in KINDS.values():
        yield from ((run, figure, suffix) for run in TESTS for figure in TRACKING.values())
        yield from ((run, figure, suffix) for run in RUNS.values() for figure in ERRORS.values())


def _kinds(entry: Entry) -> dict[str, str]:
    return {kind: suffix for kind, suffix in KINDS.items() if entry.virtual or "true" not in suffix}


def _tracking(entry: Entry) -> Iterator[Row]:
    yield Row("Tracking error of the table: desired - measured acceleration")
    for run, name in TESTS.items():
        for figure, leaf in TRACKING.items():
            yield Row(f"{name}, {figure}", _cells(entry, f"{run}.{leaf}", None))


def _errors(entry: Entry) -> Iterator[Row]:
    for figure, leaf in ERRORS.items():
        if not any(f"{run}.{leaf}" in r.metrics for run in RUNS.values() for r in entry.results.values()):
            continue
        yield Row(f"{figure} error of the absolute acceleration against SIM")
        for name, run in RUNS.items():
            for storey in range(storeys([entry])):
                yield Row(f"{name}, storey {storey + 1}", _cells(entry, f"{run}.{leaf}", storey))


def _ratios(entry: Entry) -> Iterator[Row]:
    """Yield EXP-RTHS over SIM-DELAY, both in the same band; SIM-DELAY has no sensor, so one figure per band."""
    leaf = ERRORS["RMS"]
    yield Row("EXP-RTHS / SIM-DELAY (ratio of RMS errors, -)")
    for storey in range(storeys([entry])):
        theirs = [published(entry, f"{run}.{leaf}", storey) for run in ("exp_rths", "sim_delay")]
        cells = words([ratio(*theirs)])
        for result in entry.results.values():
            cells += words([_ratio(result, suffix, storey) for suffix in _kinds(entry).values()], mark(result))
        yield Row(f"storey {storey + 1}", cells)


def _ratio(result: Result, suffix: str, storey: int) -> float | str:
    leaf = ERRORS["RMS"]
    above = state(result, f"exp_rths.{leaf}{suffix}", storey)
    below = state(result, f"sim_delay.{leaf}{suffix.replace('_true', '')}", storey)
    return ratio(above, below)


def _cells(entry: Entry, path: str, storey: int | None) -> tuple[Cell, ...]:
    cells = published_cells(entry, [path], storey)
    for result in entry.results.values():
        states: Sequence[float | str] = [state(result, path + s, storey) for s in _kinds(entry).values()]
        cells += words(states, mark(result))
    return cells


def _plain(value: float) -> str:
    return f"{float(value):.4g}" if np.isfinite(value) else "-"
