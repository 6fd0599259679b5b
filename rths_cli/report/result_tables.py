"""The tables of results that `rths run` and `rths report` print (5.1, 5.2 or one case; legend; claims), and `rths run
--json`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby

import numpy as np

from rths_cli.errors import InputError
from rths_cli.experiment.lost_samples import losses_of_runs
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.report.answer import verdict
from rths_cli.report.case_metric_tables import PERCENT_NOTES, every_figure, merit_table, other_figures, percent_table
from rths_cli.report.document import Block, Document, Line, Table
from rths_cli.report.numbers import intervals_json, json_value, six_wide
from rths_cli.report.paper_tables import (
    claims_lines,
    claims_tables,
    paths,
    response_tables,
    single_table,
    tracking_tables,
)
from rths_cli.report.result_scale import scale_json, scale_lines
from rths_cli.report.results_by_case import (
    DIVERGED,
    SHORT,
    SIM_DELAY_ERROR,
    Entry,
    Figures,
    entries,
    look_up,
    sim_delay_result,
    sources,
    state,
    status,
)
from rths_cli.report.to_text import text

ABOUT = (
    "case_name", "method", "rig", "rig_kind", "record_name", "scaling", "damping_name", "controller", "seed",
    "created_utc", "rths_version", "git_commit",
)  # fmt: skip
TRUE = "True: table and floors before any sensor, which only a simulated rig knows; full-t: true, in full band."
HALTED_WORD = SHORT["interrupted"]
HALTED = f"{HALTED_WORD}: interrupted, by an order to stop or because the process ended."
TOLD = ("shake_table.tracking_rms_m_s2", "exp_rths.tracking_rms_m_s2")
WORDS = "-: not run or not published. *: figure of a run that did not end as planned."


def tables(
    results: Sequence[Result], references: Mapping[str, Figures] | None = None, paper: bool = False, brief: bool = False
) -> str:
    """Return all tables and the verdicts on the paper's claims as text of at most 100 columns.

    `references` gives published figures by case name and metric path, before those stored with the results.
    One case alone is printed in a compact form with all its figures, unless `brief`. Raises InputError without results.
    """
    return text(document(results, references, laid_out=True, paper=paper, brief=brief))


def document(
    results: Sequence[Result], references: Mapping[str, Figures] | None = None, laid_out: bool = False,
    paper: bool = False, brief: bool = False,
) -> Document:  # fmt: skip
    """Return the tables of a report, the verdicts on the paper's claims and what their words mean.

    `paper`: whether the paper's claims are judged without published figures, too. `laid_out`: error by cause, latency
    and claims as text for a terminal, else as tables with the figures of merit. `brief`: the errors of one case alone,
    without its other figures. Raises InputError without results.
    """
    if not results:
        raise InputError("There are no results to print; give result files or run a case first.")
    cases = entries(results, references or {})
    groups = [list(group) for _, group in groupby(cases, key=lambda entry: entry.table_name)]
    scales = scale_lines(results)
    said = [listed("Scale", scales)] if scales else []
    return [*said, *(section for group in groups for section in _sections(group, laid_out, paper, brief))]


def to_json(results: Sequence[Result]) -> dict[str, object]:
    """Return every result with every metric by its path; what is not a finite number is null."""
    return {"results": [_json_result(result) for result in results]}


def _sections(cases: Sequence[Entry], laid_out: bool, paper: bool, brief: bool) -> Iterator[Sequence[Block]]:
    """Yield what went wrong, the tables of one rig, what their words mean, and claims where there is a reference."""
    for title, lines in (("Runs that ended otherwise", remarks(cases)), ("Steps without samples", losses(cases))):
        if lines:
            yield listed(title, lines)
    yield from ([table] for table in error_tables(cases, brief=brief))
    if len(cases) == 1 and laid_out and not brief:
        yield from other_figures(cases[0], paths())
    if not laid_out:
        yield [merit_table(cases)]
        yield from ([table] for table in every_figure(cases[0])) if len(cases) == 1 else ()
    yield [Line(line) for line in (*legend(cases), *(() if brief else PERCENT_NOTES))]
    if paper or any(entry.published or entry.reference_title for entry in cases):
        yield from (claims_lines(cases),) if laid_out else ([table] for table in claims_tables(cases))


def error_tables(cases: Sequence[Entry], unit: str = "m/s^2", brief: bool = False) -> Iterator[Table]:
    """Yield the tables of errors of one rig that every format shows; `unit`: of one case alone, `brief`: its first."""
    if len(cases) == 1:
        yield single_table(cases[0], unit)
    else:
        yield from tracking_tables(cases)
        yield from response_tables(cases)
    if not brief:
        yield percent_table(cases)


def listed(title: str, lines: Iterable[str]) -> list[Block]:
    """Return a title with lines below it."""
    return [Line(title), *(Line(f"  {line}", indent=4) for line in lines)]


def test_band(cases: Sequence[Entry]) -> str:
    """Return what the errors of the tables are: the test band of the cases, and the full band."""
    bands = sorted({result.test_band_hz for entry in cases for result in entry.results.values()})
    listed = " or ".join(f"{hz:g}" for hz in bands)
    return (
        f"Test band: the error above high_pass_hz, through a 4th-order {listed} Hz low pass, forward and backward; "
        "full: without the low pass. Measured: by the accelerometers, corrected for their known dynamics."
    )


def legend(cases: Sequence[Entry]) -> list[str]:
    """Return what the words of the tables mean."""
    ends = {state(result, path) for entry in cases for result in entry.results.values() for path in TOLD}
    halted = [HALTED] if HALTED_WORD in ends else []
    return [*sources(cases), test_band(cases), *([TRUE] if cases[0].virtual else []), WORDS, *halted]


def _json_result(result: Result) -> dict[str, object]:
    about = {key: result.attributes.get(key) for key in (*ABOUT, "status", "status_reason")}
    metrics = {path: json_value(value) for path, value in result.metrics.items()}
    words = {"units": dict(result.units), "definitions": dict(result.definitions)}
    ends, scale = intervals_json(result.intervals), scale_json(result)
    more = {**({"intervals": ends} if ends else {}), **({"scale": scale} if scale else {})}
    return {"file": str(result.path), **about, "verdict": verdict(result), "metrics": metrics, **words, **more}


def remarks(cases: Sequence[Entry]) -> list[str]:
    """Return a line for each run that did not end as planned, diverged, or has another SIM-DELAY than shown."""
    lines: list[str] = []
    for entry in cases:
        for method, result in entry.results.items():
            name = f"{result.attributes.get('case_name') or '-'} ({method})"
            end = status(result)
            reason = str(result.attributes.get("status_reason") or "no reason stored")
            told = reason if end in reason else f"{end}: {reason}"
            lines += [f"{name}: {told}"] if end != COMPLETE else []
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
