"""The tables of results that `rths run` and `rths report` print (5.1, 5.2 or one case; legend; claims), and `rths run
--json`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result
from rths_cli.report.answer import verdict
from rths_cli.report.case_metric_tables import PERCENT_NOTES, every_figure, merit_table, other_figures, percent_table
from rths_cli.report.numbers import intervals_json, json_value
from rths_cli.report.paper_tables import (
    claims_tables,
    claims_text,
    paths,
    response_tables,
    single_table,
    tracking_tables,
)
from rths_cli.report.result_scale import scale_json, scale_lines
from rths_cli.report.results_by_case import SHORT, Entry, Figures, entries, sources, state
from rths_cli.report.text_layout import Block, Fixed, Paragraphs, losses, plain_text, remarks

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
    return plain_text(blocks(results, references, laid_out=True, paper=paper, brief=brief))


def blocks(
    results: Sequence[Result], references: Mapping[str, Figures] | None = None, laid_out: bool = False,
    paper: bool = False, brief: bool = False,
) -> list[Block]:  # fmt: skip
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
    said: list[Block] = [Paragraphs(("Scale", *(f"  {line}" for line in scales)), indent=4)] if scales else []
    return [*said, *(block for group in groups for block in _blocks(group, laid_out, paper, brief))]


def has_reference(result: Result) -> bool:
    """Return whether the case of a result names published figures to be compared with."""
    return bool(result.attributes.get("reference_title"))


def of_one_case(results: Sequence[Result]) -> list[Result]:
    """Return the results with published figures if they are of one case, by whatever methods; else none."""
    published = [result for result in results if has_reference(result)]
    return published if len({result.attributes.get("case_name") for result in published}) == 1 else []


def to_json(results: Sequence[Result]) -> dict[str, object]:
    """Return every result with every metric by its path; what is not a finite number is null."""
    return {"results": [_json_result(result) for result in results]}


def _blocks(cases: Sequence[Entry], laid_out: bool, paper: bool, brief: bool) -> Iterator[Block]:
    """Yield what went wrong, the tables of one rig, what their words mean, and claims where there is a reference."""
    for title, lines in (("Runs that ended otherwise", remarks(cases)), ("Steps without samples", losses(cases))):
        if lines:
            yield Paragraphs((title, *(f"  {line}" for line in lines)), indent=4)
    if len(cases) == 1:
        yield single_table(cases[0])
    else:
        yield from tracking_tables(cases)
        yield from response_tables(cases)
    if not brief:
        yield percent_table(cases)
    if len(cases) == 1 and laid_out and not brief:
        yield Fixed(other_figures(cases[0], paths()))
    if not laid_out:
        yield merit_table(cases)
        yield from every_figure(cases[0]) if len(cases) == 1 else ()
    yield Paragraphs((*_legend(cases), *(() if brief else PERCENT_NOTES)))
    if paper or any(entry.published or entry.reference_title for entry in cases):
        yield from (Fixed(claims_text(cases)),) if laid_out else claims_tables(cases)


def test_band(cases: Sequence[Entry]) -> str:
    """Return what the errors of the tables are: the test band of the cases, and the full band."""
    bands = sorted({result.test_band_hz for entry in cases for result in entry.results.values()})
    listed = " or ".join(f"{hz:g}" for hz in bands)
    return (
        f"Test band: the error above high_pass_hz, through a 4th-order {listed} Hz low pass, forward and backward; "
        "full: without the low pass. Measured: by the accelerometers, corrected for their known dynamics."
    )


def _legend(cases: Sequence[Entry]) -> list[str]:
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
