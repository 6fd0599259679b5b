"""The tables of results that `rths run` and `rths report` print (5.1, 5.2 or one case; legend; claims), and `rths run
--json`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result
from rths_cli.report.case_metric_tables import other_figures
from rths_cli.report.fidelity_table import every_figure, merit_table
from rths_cli.report.paper_claims import claims_tables, claims_text
from rths_cli.report.paper_tables import response_tables, tracking_tables
from rths_cli.report.results_by_case import SHORT, Entry, Figures, entries, sources, state
from rths_cli.report.single_case_table import paths, single_table
from rths_cli.report.table_cells import losses, remarks
from rths_cli.report.text_layout import Block, Fixed, Paragraphs, plain_text

ABOUT = (
    "case_name", "method", "rig", "rig_kind", "record_name", "scaling", "damping_name", "controller", "seed",
    "created_utc", "rths_version", "git_commit",
)  # fmt: skip
TEST_BAND = (
    "Test band: the error above high_pass_hz, through a 4th-order 12 Hz low pass, forward and backward; "
    "full: without the low pass. Measured: by the accelerometers, corrected for their known dynamics."
)
TRUE = "True: table and floors before any sensor, which only a virtual rig knows; full-t: true, in full band."
HALTED_WORD = SHORT["interrupted"]
HALTED = f"{HALTED_WORD}: interrupted, by an order to stop or because the process ended."
TOLD = ("shake_table.tracking_rms_m_s2", "exp_rths.tracking_rms_m_s2")
WORDS = "-: not run or not published. *: figure of a run that did not end as planned."


def tables(results: Sequence[Result], references: Mapping[str, Figures] | None = None) -> str:
    """Return all tables and the verdicts on the paper's claims as text of at most 100 columns.

    `references` gives published figures by case name and metric path, before those stored with the results.
    One case alone is printed in a compact form with all its figures. Raises InputError without results.
    """
    return plain_text(blocks(results, references, laid_out=True))


def blocks(
    results: Sequence[Result], references: Mapping[str, Figures] | None = None, laid_out: bool = False
) -> list[Block]:
    """Return the tables of a report, the verdicts on the paper's claims and what their words mean.

    `laid_out`: error by cause, latency and claims as text for a terminal, else as tables with the figures of merit.
    Raises InputError without results.
    """
    if not results:
        raise InputError("There are no results to print; give result files or run a case first.")
    cases = entries(results, references or {})
    groups = [list(group) for _, group in groupby(cases, key=lambda entry: entry.table_name)]
    return [block for group in groups for block in _blocks(group, laid_out)]


def to_json(results: Sequence[Result]) -> dict[str, object]:
    """Return every result with every metric by its path; what is not a finite number is null."""
    return {"results": [_json_result(result) for result in results]}


def _blocks(cases: Sequence[Entry], laid_out: bool) -> Iterator[Block]:
    """Yield what went wrong, the tables of one rig, what their words mean, and the claims."""
    for title, lines in (("Runs that ended otherwise", remarks(cases)), ("Steps without samples", losses(cases))):
        if lines:
            yield Paragraphs((title, *(f"  {line}" for line in lines)), indent=4)
    if len(cases) == 1:
        yield single_table(cases[0])
    else:
        yield from tracking_tables(cases)
        yield from response_tables(cases)
    if len(cases) == 1 and laid_out:
        yield Fixed(other_figures(cases[0], paths()))
    if not laid_out:
        yield merit_table(cases)
        yield from every_figure(cases[0]) if len(cases) == 1 else ()
    yield Paragraphs(tuple(_legend(cases)))
    yield from (Fixed(claims_text(cases)),) if laid_out else claims_tables(cases)


def _legend(cases: Sequence[Entry]) -> list[str]:
    ends = {state(result, path) for entry in cases for result in entry.results.values() for path in TOLD}
    halted = [HALTED] if HALTED_WORD in ends else []
    return [*sources(cases), TEST_BAND, *([TRUE] if cases[0].virtual else []), WORDS, *halted]


def _json_result(result: Result) -> dict[str, object]:
    about = {key: result.attributes.get(key) for key in (*ABOUT, "status", "status_reason")}
    metrics = {path: _json_value(value) for path, value in result.metrics.items()}
    words = {"units": dict(result.units), "definitions": dict(result.definitions)}
    return {"file": str(result.path), **about, "metrics": metrics, **words}


def _json_value(value: object) -> object:
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim:
        return [_json_value(item) for item in numbers]
    return float(numbers) if math.isfinite(float(numbers)) else None
