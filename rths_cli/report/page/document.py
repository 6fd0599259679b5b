"""The whole page: its sections in their order, embedded style, scripts and data."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from itertools import groupby
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
from rths_cli.files.result_reader import Result
from rths_cli.files.sweep_file import Sweep
from rths_cli.interrupts import interruptible
from rths_cli.report.page import case_details, frequency, histories, overview
from rths_cli.report.page.decimated_series import Pool
from rths_cli.report.page.html import Html, classed, data_script, details, element, join
from rths_cli.report.page.paper_tables import claims, error_tables
from rths_cli.report.page.studies import studies_title, studies_told, study_section
from rths_cli.report.page.summary import (
    case_files,
    commands,
    is_virtual,
    name_of,
    provenance,
    status,
    summary,
    verdicts,
)
from rths_cli.report.result_scale import scale_lines
from rths_cli.report.results_by_case import Entry, entries

STYLES = ("uPlot.min.css", "page.css")
SCRIPTS = ("uPlot.iife.min.js", "page.js")
ENCODING = "utf-8"
WITH_ERRORS = ("sim_delay", "shake_table", "exp_rths")  # runs that are compared with others


def write_page(
    results: Sequence[Result],
    path: Path,
    command_line: str,
    comparison: str = "",
    sweeps: Sequence[tuple[Path, Sweep]] = (),
) -> None:
    """Write the page of results and sweeps; equal results and command lines give equal bytes.

    Raises InputError if there are neither, a result can no longer be read, or the file cannot be written; then no
    file is left behind.
    """
    text = interruptible(lambda: page(results, command_line, comparison, sweeps))
    try:
        with written_whole(path) as part:
            part.write_text(text, encoding=ENCODING)
    except OSError as error:
        raise InputError(f"{path}: cannot write the page: {error.strerror}; choose another file") from error


def page(
    results: Sequence[Result], command_line: str, comparison: str = "", sweeps: Sequence[tuple[Path, Sweep]] = ()
) -> str:
    """Return the page of results and sweeps as HTML; raises InputError without any.

    `command_line`: the command that makes the page; `comparison`: text that compares the results; `sweeps`: each with
    its file.
    """
    studies = [study_section(path, sweep) for path, sweep in sweeps]
    if studies and not results:
        title = studies_title(sweeps)
        made = element("section", element("h2", "Make it again"), element("pre", command_line))
        main = element("main", *studies, *_comparison(comparison), made)
        body = join([element("header", element("h1", title), element("p", studies_told(sweeps))), main])
        return _whole(title, body, data_script("rths-data", _data(())))
    if not results:
        raise InputError("There are no results to show; give result files or run a case first.")
    cases = entries(results, {})
    ordered = [result for entry in cases for result in entry.results.values()]
    title = f"Hybrid simulation: {_subject(cases, ordered)}"
    sections = _sections(cases, ordered, command_line)
    main = element("main", *(one for _, one in sections), *studies, *_comparison(comparison))
    body = join([_header(title, cases, ordered, [name for name, _ in sections]), main])
    return _whole(title, body, data_script("rths-data", _data(ordered)))


def _comparison(text: str) -> tuple[Html, ...]:
    """Return a section with text that is laid out already; () without text."""
    if not text.strip():
        return ()
    return (element("section", element("h2", "Comparison"), element("pre", text), attributes={"id": "comparison"}),)


def _subject(cases: Sequence[Entry], results: Sequence[Result]) -> str:
    if len(cases) > 1:
        return f"{len(results)} results of {len(cases)} cases"
    return str(results[0].attributes.get("case_name") or results[0].path.stem)


def _header(title: str, cases: Sequence[Entry], results: Sequence[Result], sections: Sequence[str]) -> Html:
    """Return title, kind of rig (virtual or not), status of the results, and links to the sections."""
    tables = ", ".join(dict.fromkeys(entry.table_name for entry in cases))
    virtual = [is_virtual(result) for result in results]
    words = "virtual: no table moved" if all(virtual) else "some results are virtual"
    badge = [classed("span", "badge", words)] if any(virtual) else []
    links = (element("a", SECTIONS[name], attributes={"href": f"#{name}"}) for name in sections)
    told = element("p", *badge, f" On {tables}. {summary(results)}.")
    scales = (classed("p", "note", line) for line in scale_lines(results))
    verdicts = overview.verdicts(results)
    return element("header", element("h1", title), told, *scales, verdicts, element("nav", *links))


SECTIONS = {
    "overview": "Overview",
    "response": "Response by storey",
    "verdicts": "Status and limits",
    "errors": "Errors",
    "histories": "Table",
    "cases": "Cases and metrics",
    "provenance": "Provenance",
}


def _sections(cases: Sequence[Entry], results: Sequence[Result], command_line: str) -> list[tuple[str, Html]]:
    """Return the sections that have contents, by their ids."""
    contents = {
        "overview": [_overview(results)],
        "response": [overview.responses(results)],
        "verdicts": [verdicts(results)],
        "errors": _errors(cases),
        "histories": [
            *(classed("p", "note", sentence) for sentence in histories.left_out(results)),
            *_table_plots(any(is_virtual(result) for result in results)),
        ],
        "cases": [_case(entry, unfolded=len(cases) == 1) for entry in cases],
        "provenance": [provenance(results), element("h3", "Make it again"), commands(results, command_line)],
    }
    return [
        (name, element("section", element("h2", heading), *contents[name], attributes={"id": name}))
        for name, heading in SECTIONS.items()
        if any(contents[name])
    ]


def _errors(cases: Sequence[Entry]) -> list[Html]:
    """Return error tables and claims for each shake table."""
    found: list[Html] = []
    for name, group in groupby(cases, key=lambda entry: entry.table_name):
        members = list(group)
        if not any({*WITH_ERRORS} & {*r.groups} for entry in members for r in entry.results.values()):
            found.append(element("p", f"No run on {name} has errors."))
            continue
        found.append(error_tables(members))
        if any(entry.published or entry.reference_title for entry in members):
            found += [element("h3", f"The paper's claims, on {name}"), claims(members)]
    return found


def _overview(results: Sequence[Result]) -> Html:
    """Return sketches and the frames of the plots of record, response and error, which the script fills."""
    hint = (
        "Drag across a plot to zoom, drag with shift to move, double click for the whole; on a phone one finger moves "
        "and two zoom. A click on a name below a plot hides its line."
    )
    needs = element("noscript", element("p", "The plots need JavaScript, which is switched off here."))
    controls = element("div", attributes={"id": "controls"})
    plots = classed("div", "plots", needs, controls, element("div", attributes={"id": "response-plots"}))
    sketch = classed("div", "sketches", overview.sketches(results))
    return join([classed("div", "first", sketch, plots), classed("p", "note hint", hint)])


def _table_plots(virtual: bool) -> list[Html]:
    """Return the frames of the plots of the table, which the script fills."""
    time = element("div", attributes={"id": "time-plots"})
    response = element("div", frequency.heading(virtual), element("div", attributes={"id": "frequency-plots"}))
    return [element("div", attributes={"id": "table-controls"}), time, response]


def _case(entry: Entry, unfolded: bool) -> Html:
    """Return the section of one case: error by cause, timing, latency, table and case by method; all metrics."""
    names = dict.fromkeys(str(result.attributes.get("case_name") or "-") for result in entry.results.values())
    what = f"{', '.join(names)}: {entry.excitation}, damping {entry.damping}, {entry.controller}; {entry.table_name}"
    parts = [part for result in entry.results.values() for part in _result(result)]
    figures = details("Every metric with its definition", case_details.every_figure(entry))
    return details(what, *parts, figures, unfolded=unfolded)


def _result(result: Result) -> Iterator[Html]:
    yield element("h3", name_of(result))
    yield case_details.by_cause(result)
    yield case_details.timing(result)
    yield frequency.identification(result)
    loop = case_details.latency(result)
    yield details("Latency of the loop", loop) if loop else Html("")
    yield case_files(result)


def _data(results: Sequence[Result]) -> dict[str, object]:
    """Return the data of the plots; series and responses that several results share are stored once."""
    pool, responses, shown = Pool(), [], []
    for result in results:
        measured = frequency.response(result)
        if measured is not None and measured not in responses:
            responses.append(measured)
        about = {"name": name_of(result), "remark": _remark(result), **histories.document(result, pool)}
        shown.append(about | {"response": None if measured is None else responses.index(measured)})
    return {"results": shown, "responses": responses, "series": pool.packed()}


def _remark(result: Result) -> str:
    """Return the heading of a result's plots: the table, virtual or not, and the status if it is not complete."""
    rig = f"{'virtual ' if is_virtual(result) else ''}shake table {result.attributes.get('rig', '-')}"
    end = status(result)
    reason = str(result.attributes.get("status_reason") or "no reason stored")
    return rig if end == "complete" else f"{rig}; {end}: {reason}"


def _whole(title: str, body: Html, data: Html) -> str:
    """Return the document; its security policy permits only the embedded scripts, and no network access."""
    scripts = [asset(name) for name in SCRIPTS]
    allowed = " ".join(f"'sha256-{_hash(script)}'" for script in scripts)
    policy = f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; base-uri 'none'"
    head = join(
        [
            Html('<meta charset="utf-8">'),
            Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
            Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
            Html('<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'),
            element("title", title),
            *(element("style", Html(asset(name))) for name in STYLES),
        ]
    )
    told = join(element("script", Html(script)) for script in scripts)
    whole = element("html", element("head", head), element("body", body, data, told), attributes={"lang": "en"})
    return f"<!DOCTYPE html>\n{whole}\n"


@cache
def asset(name: str) -> str:
    """Return a file that is embedded in every page."""
    return files("rths_cli.report.page").joinpath("assets", name).read_text(ENCODING)


def _hash(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode(ENCODING)).digest()).decode("ascii")
