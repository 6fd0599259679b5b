"""A metric as a table cell: a number, a marked number of an unfinished run, or a word if there is no number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.experiment.lost_sample_sentence import losses_of_runs
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.report.numbers import six_wide
from rths_cli.report.results_by_case import DIVERGED, Entry, look_up, published, run_state, state
from rths_cli.report.text_layout import Cell

TRACKING = ("tracking_max_m_s2", "tracking_rms_m_s2")
TESTS = {"shake_table": "shake table test", "exp_rths": "RTHS"}
SIM_DELAY_ERROR = "sim_delay.rms_error_m_s2"
EXP_ERROR = "exp_rths.rms_error_m_s2"
UNFINISHED = "*"  # mark of a metric whose run did not end as planned


def words(states: Sequence[float | str], mark: str = " ") -> tuple[Cell, ...]:
    """Return one cell per state (number or word); if all states are the same word, one cell spans their columns."""
    first = states[0]
    if len(states) > 1 and isinstance(first, str) and all(item == first for item in states):
        return (Cell(first, len(states)),)
    return tuple(Cell(s) if isinstance(s, str) else Cell(six_wide(s), mark=mark) for s in states)


def our_cells(result: Result | None, paths: Sequence[str], index: int | None = None) -> tuple[Cell, ...]:
    """Return the cells of metrics of one result; `index`: storey, from 0; None: a metric with one value."""
    return words([state(result, path, index) for path in paths], mark(result, paths[0]))


def published_cells(entry: Entry | None, paths: Sequence[str], index: int | None = None) -> tuple[Cell, ...]:
    """Return the cells of published metrics; `index` as in `our_cells`."""
    return words([published(entry, path, index) if entry else "-" for path in paths])


def mark(result: Result | None, path: str) -> str:
    """Return UNFINISHED if the run of a metric did not end as planned, " " if it did or was refused."""
    return UNFINISHED if result and run_state(result, path) not in (COMPLETE, "refused") else " "


def of(entry: Entry | None, method: str) -> Result | None:
    """Return the result of a method, None if it was not run."""
    return entry.results.get(method) if entry else None


def sim_delay_result(entry: Entry | None) -> Result | None:
    """Return the result whose SIM-DELAY is shown, the last one with its errors; all methods have the same SIM-DELAY."""
    found = list(entry.results.values()) if entry else []
    having = [r for r in reversed(found) if look_up(r.metrics, SIM_DELAY_ERROR, 0) is not None]
    return next(iter(having or found), None)


def ratio(above: float | str, below: float | str) -> float | str:
    """Return the ratio of EXP-RTHS to SIM-DELAY, or the word of the one that has no number."""
    if isinstance(above, str) or isinstance(below, str):
        return above if isinstance(above, str) else str(below)
    return above / below if below > 0 else "-"


def remarks(cases: Sequence[Entry]) -> list[str]:
    """Return a line for each run that did not end as planned, diverged, or has another SIM-DELAY than shown."""
    lines: list[str] = []
    for entry in cases:
        for method, result in entry.results.items():
            name = f"{result.attributes.get('case_name') or '-'} ({method})"
            status = str(result.attributes.get("status", COMPLETE))
            reason = str(result.attributes.get("status_reason") or "no reason stored")
            told = reason if status in reason else f"{status}: {reason}"
            lines += [f"{name}: {told}"] if status != COMPLETE else []
            lines += [f"{name}: {text}" for text in _divergences(result)]
        lines += _other_sim_delay(entry)
    return lines


def losses(cases: Sequence[Entry]) -> list[str]:
    """Return a line for each run in real time that had steps without samples of their own."""
    return [
        f"{result.attributes.get('case_name') or '-'} ({method}): {text}"
        for entry in cases
        for method, result in entry.results.items()
        for text in losses_of_runs(result.metrics)
    ]


def _divergences(result: Result) -> list[str]:
    runs = {path.partition(".")[0]: path for path in result.metrics if path.endswith(".diverged_at_s")}
    times = {run: look_up(result.metrics, path, 0) for run, path in runs.items()}
    return [f"{run} {DIVERGED} at {time:.2f} s" for run, time in times.items() if time is not None and time == time]


def _other_sim_delay(entry: Entry) -> list[str]:
    """Return a line for each method whose SIM-DELAY differs from the one in the tables (other delay or version)."""
    shown = sim_delay_result(entry)
    lines: list[str] = []
    for method, result in entry.results.items():
        size = len(_values(result))
        pairs = [(state(result, SIM_DELAY_ERROR, i), state(shown, SIM_DELAY_ERROR, i)) for i in range(size)]
        if any(mine != theirs for mine, theirs in pairs):
            texts = ", ".join(six_wide(mine) if isinstance(mine, float) else mine for mine, _ in pairs)
            lines.append(f"{entry.excitation}, {entry.damping}, {entry.controller} ({method}): SIM-DELAY is {texts}")
    return lines


def _values(result: Result) -> list[float]:
    return list(np.atleast_1d(result.metrics.get(SIM_DELAY_ERROR, [])))
