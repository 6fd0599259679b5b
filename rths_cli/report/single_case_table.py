"""The table of a single case: the paper's metrics by method."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rths_cli.files.result_reader import Result
from rths_cli.report.results_by_case import Entry, published, state, storeys
from rths_cli.report.table_cells import EXP_ERROR, TESTS, mark, ratio, words
from rths_cli.report.text_layout import Cell, Row, Table

KINDS = {"meas.": "", "true": "_true", "full": "_full", "full-t": "_true_full"}
TRACKING = {"max": "tracking_max_m_s2", "RMS": "tracking_rms_m_s2"}
ERRORS = {"RMS": "rms_error_m_s2", "max": "max_error_m_s2"}
FACTORS = {"m/s^2": 1.0, "mm/s^2": 1e3}
RUNS = {"SIM-DELAY": "sim_delay", "EXP-RTHS": "exp_rths"}


def single_table(entry: Entry, unit: str = "m/s^2") -> Table:
    """Return the metrics of the paper's two tables for one case: published if known, then by method and kind.

    `unit`: of the errors, "m/s^2" or "mm/s^2".
    """
    kinds, known = _kinds(entry), 1 if entry.published else 0
    heads = (
        (*[Cell("")] * known, *(Cell(method, len(kinds)) for method in entry.results)),
        (*[Cell("publ.")] * known, *[Cell(kind) for kind in kinds] * len(entry.results)),
    )
    what = f"{entry.excitation}, damping {entry.damping}, controller {entry.controller}"
    return Table(
        f"{what}: errors ({unit}, test band unless full); {entry.table_name}",
        "",
        (*(1,) * known, *(len(kinds),) * len(entry.results)),
        9 if len(entry.results) < 2 else 8,
        heads,
        (*_tracking(entry, FACTORS[unit]), *_errors(entry, FACTORS[unit]), *_ratios(entry)),
    )


def paths() -> Iterator[str]:
    """Yield the path of each metric in the table of a single case."""
    for suffix in KINDS.values():
        yield from (f"{run}.{figure}{suffix}" for run in TESTS for figure in TRACKING.values())
        yield from (f"{run}.{figure}{suffix}" for run in RUNS.values() for figure in ERRORS.values())


def _kinds(entry: Entry) -> dict[str, str]:
    return {kind: suffix for kind, suffix in KINDS.items() if entry.virtual or "true" not in suffix}


def _tracking(entry: Entry, factor: float) -> Iterator[Row]:
    yield Row("Tracking error of the table: desired - measured acceleration")
    for run, name in TESTS.items():
        for figure, leaf in TRACKING.items():
            yield Row(f"{name}, {figure}", _cells(entry, f"{run}.{leaf}", None, factor))


def _errors(entry: Entry, factor: float) -> Iterator[Row]:
    for figure, leaf in ERRORS.items():
        if not any(f"{run}.{leaf}" in r.metrics for run in RUNS.values() for r in entry.results.values()):
            continue
        yield Row(f"{figure} error of the absolute acceleration against SIM")
        for name, run in RUNS.items():
            for storey in range(storeys([entry])):
                yield Row(f"{name}, storey {storey + 1}", _cells(entry, f"{run}.{leaf}", storey, factor))


def _ratios(entry: Entry) -> Iterator[Row]:
    """Yield the ratios of EXP-RTHS to SIM-DELAY, both in the same band.

    SIM-DELAY is computed, so it has no true error beside the measured one.
    """
    leaf = ERRORS["RMS"]
    yield Row("EXP-RTHS / SIM-DELAY (ratio of RMS errors, -)")
    for storey in range(storeys([entry])):
        theirs = [published(entry, f"{run}.{leaf}", storey) for run in ("exp_rths", "sim_delay")]
        cells = words([ratio(*theirs)]) if entry.published else ()
        for result in entry.results.values():
            cells += words(
                [_ratio(result, suffix, storey) for suffix in _kinds(entry).values()], mark(result, EXP_ERROR)
            )
        yield Row(f"storey {storey + 1}", cells)


def _ratio(result: Result, suffix: str, storey: int) -> float | str:
    leaf = ERRORS["RMS"]
    above = state(result, f"exp_rths.{leaf}{suffix}", storey)
    below = state(result, f"sim_delay.{leaf}{suffix.replace('_true', '')}", storey)
    return ratio(above, below)


def _cells(entry: Entry, path: str, storey: int | None, factor: float) -> tuple[Cell, ...]:
    cells = words(_scaled([published(entry, path, storey)], factor)) if entry.published else ()
    for result in entry.results.values():
        states: Sequence[float | str] = [_state(result, path, s, storey) for s in _kinds(entry).values()]
        cells += words(_scaled(states, factor), mark(result, path))
    return cells


def _scaled(states: Sequence[float | str], factor: float) -> list[float | str]:
    return [one if isinstance(one, str) else factor * one for one in states]


def _state(result: Result, path: str, suffix: str, storey: int | None) -> float | str:
    """Return a number or the word why there is none; "-" for a true error of SIM-DELAY, which is computed."""
    return "-" if path.startswith("sim_delay.") and "_true" in suffix else state(result, path + suffix, storey)
