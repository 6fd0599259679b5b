"""The whole page: its sections (cases, identified table, error tables, studies), embedded style, scripts and data."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import groupby
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
from rths_cli.files.result_reader import Result, read_series
from rths_cli.files.stored_case import stored_case
from rths_cli.files.sweep_file import Sweep
from rths_cli.interrupts import interruptible
from rths_cli.loop.lost_samples import without_samples
from rths_cli.numerics.lti import Array, Model
from rths_cli.report.case_metric_tables import budget_table, every_figure, latency, named_causes
from rths_cli.report.document import Document, grid
from rths_cli.report.figures.figure_data import Pool, pack_floats, phases
from rths_cli.report.numbers import percent, rounded, significant
from rths_cli.report.page import histories, overview
from rths_cli.report.page.overview import (
    case_files,
    commands,
    is_virtual,
    name_of,
    provenance,
    summary,
    verdict_table,
)
from rths_cli.report.paper_tables import claims_tables
from rths_cli.report.result_scale import scale_lines
from rths_cli.report.result_tables import error_tables, legend, remarks
from rths_cli.report.results_by_case import RUN_NAMES, TABLE_RUNS, Entry, entries, status
from rths_cli.report.study_pages import is_ida, sections
from rths_cli.report.sweep_page import below_grid_points, grid_points, verdict_lines
from rths_cli.report.to_html import Html, blocks, classed, data_script, details, element, join, table

GROUP = "identification"

_ROOT_HEAD = ["Root of the table model", "frequency (Hz)", "damping ratio (%)"]
KINDS = ("check", "budget")
TIMES = {
    "late_s": "start of the exchange, late by",
    "exchange_s": "exchange with the rig",
    "compute_s": "step and guard",
}
SHARES = {"median": 50.0, "99 %": 99.0, "99.9 %": 99.9, "largest": 100.0}
CAPTIONS = {
    "ida": "Intensity over the largest response of each record, with fractiles over the records and the limit.",
    "fragility": "Probability that the limit is exceeded, with its 95 % confidence, and the shares that exceeded it.",
    "sweep": "The metric over the varied keys{of}. A cross or an empty cell: a run was refused, aborted or failed.",
    "tornado": "How far each key moves the median: grid points with its smallest and with its largest values{of}. "
    "Grey bar: all values of the key. Black line: median of all grid points.",
    "parallel": "Each line is a grid point{of}; its colour is its height on the last axis. Grey: a run was refused, "
    "aborted or failed.",
    "sobol": "Share of the variance that comes from each key; bars: one standard error.",
    "stability": "Boundary of stability by the check, and how the runs ended. Shaded: the check forecasts an unstable "
    "loop.",
}
ORIGIN = {
    "created_utc": "Made",
    "rths_version": "rths",
    "command_line": "Command",
    "seeds": "Seeds",
    "grid_points": "Grid points",
    "status_reason": "Runs",
    "plan_sha256": "Hash of the plan",
    "software_sha256": "Hash of the software",
}
STYLES = ("uPlot.min.css", "page.css")
SCRIPTS = ("uPlot.iife.min.js", "page.js")
ENCODING = "utf-8"
WITH_ERRORS = ("sim_delay", "shake_table", "exp_rths")  # runs that are compared with others
SECTIONS = {
    "overview": "Overview",
    "response": "Response by storey",
    "verdicts": "Status and limits",
    "errors": "Errors",
    "histories": "Table",
    "cases": "Cases and metrics",
    "provenance": "Provenance",
}


def response(result: Result) -> dict[str, str] | None:
    """Return measured and modelled response of the table for JSON: Hz, m/s²/V, degrees; None if none is stored."""
    if GROUP not in result.groups:
        return None
    frequency = _read(result, "frequency_hz")
    measured = _read(result, "frf_real") + 1j * _read(result, "frf_imag")
    modelled = model(result).sampled_response(frequency)
    phase, of_model = phases(measured, modelled)
    series = {
        "frequency": frequency,
        "measured": np.abs(measured),
        "modelled": np.abs(modelled),
        "phase": phase,
        "modelled_phase": of_model,
        "coherence": _read(result, "coherence"),
    }
    return {name: pack_floats(values) for name, values in series.items()}


def model(result: Result) -> Model:
    """Return the table model that the controllers of a result used."""
    return Model(
        zeros=_read(result, "zeros_real") + 1j * _read(result, "zeros_imag"),
        poles=_read(result, "poles_real") + 1j * _read(result, "poles_imag"),
        gain=_number(result, "gain"),
        delay_s=_number(result, "delay_s"),
        band_hz=(0.0, 0.0),
        ripple_m_s2_per_v=_number(result, "ripple_m_s2_per_v"),
        latency_samples=_latency_samples(result),
        dt_s=1.0 / result.sample_rate_hz,
        coupling_hz=_number(result, "coupling_hz"),
    )


def _latency_samples(result: Result) -> int:
    table = stored_case(result).get("table")
    converters = table.get("converters") if isinstance(table, dict) else None
    latency = converters.get("latency_samples", 1) if isinstance(converters, dict) else 1
    return latency if isinstance(latency, int) else 1


def identification(result: Result) -> Html:
    """Return tables of the identification: fit, delay, specimen, roots; "" without an identification."""
    if GROUP not in result.groups:
        return Html("")
    numbers = grid([["Identified", "value"], *_numbers(result)], words=True)
    return join([table(numbers), table(grid([_ROOT_HEAD, *_roots(result)]))])


def _numbers(result: Result) -> Iterator[list[str]]:
    used = model(result)
    yield ["source of the model", str(result.attributes.get("model_source") or "-")]
    yield ["poles, zeros", f"{len(used.poles)}, {len(used.zeros)}"]
    yield ["gain at low frequency", f"{significant(1e3 * used.low_frequency_gain_m_per_v, 4)} mm/V"]
    yield ["delay told to the fit", f"{rounded(1e3 * used.delay_s)} ms"]
    errors = [percent(_number(result, f"fit_error_{kind}")) for kind in ("rms", "max")]
    yield [f"|fit / FRF - 1|, {result.compared}", f"RMS {errors[0]} %, largest {errors[1]} %"]
    ratios = _read(result, "damping_ratio")
    for mode, (hz, ratio) in enumerate(zip(_read(result, "natural_frequency_hz"), ratios, strict=True), 1):
        yield [f"specimen, mode {mode}", f"{significant(hz, 4)} Hz, damping {percent(ratio)} %"]


def _roots(result: Result) -> Iterator[list[str]]:
    """Yield a row for each root or pair of roots that is not at the origin."""
    used = model(result)
    for kind, roots in (("pole", used.poles), ("zero", used.zeros)):
        for root in sorted((r for r in roots if r.imag >= 0.0 and abs(r) > 1e-9), key=abs):
            real = "real" if root.imag == 0.0 else percent(-root.real / abs(root))
            yield [f"{kind}{'' if root.imag == 0.0 else ' pair'}", significant(abs(root) / (2.0 * np.pi), 4), real]


def heading(virtual: bool) -> Html:
    """Return the heading of the plots."""
    what = "Identified virtual table" if virtual else "Identified table"
    return element("h3", f"{what}: frequency response and model")


def _read(result: Result, name: str) -> Array:
    return np.asarray(read_series(result.path, f"{GROUP}/{name}"), dtype=float)


def _number(result: Result, name: str) -> float:
    return float(_read(result, name))


def errors(cases: Sequence[Entry]) -> Html:
    """Return the error tables of the cases on one shake table, with the legend and remarks on runs that failed."""
    lines = (classed("p", "note", line) for line in (*legend(cases), *remarks(cases)))
    return join([*map(table, error_tables(cases, "mm/s^2")), *lines])


def claims(cases: Sequence[Entry]) -> Html:
    """Return the counted verdicts on the paper's claims, with all comparisons folded."""
    return join(
        join([*(element("p", element("strong", note)) for note in one.notes), details("comparisons", table(whole))])
        for one in claims_tables(cases)
        for whole in [replace(one, notes=())]
    )


def by_cause(result: Result) -> Html:
    """Return the error of EXP-RTHS by cause in mm/s², predicted and measured; "" if neither is known."""
    if not any(f"{kind}.rms_error_coupling_m_s2" in result.metrics for kind in KINDS):
        return Html("")
    whole = table(budget_table(result.metrics, what="; virtual" if is_virtual(result) else ""))
    named = named_causes(result)
    return join([whole, element("p", named)]) if named else whole


def timing(result: Result) -> Html:
    """Return the durations of the steps on a real rig in microseconds; "" for a virtual rig, which has no clock."""
    if is_virtual(result):
        return Html("")
    rows = [row for run in reversed(TABLE_RUNS) if run in result.groups for row in _timing(result, run)]
    if not rows:
        return Html("")
    return table(grid([["loop timing (µs)", *SHARES], *rows]))


def _timing(result: Result, run: str) -> Iterator[list[str]]:
    for name, label in TIMES.items():
        values = _noted(result, f"{run}/timing/{name}")
        if values is not None and np.any(np.isfinite(values)):
            shares = np.nanpercentile(values, list(SHARES.values()))
            yield [f"{RUN_NAMES[run]}: {label}", *(f"{1e6 * share:.1f}" for share in shares)]
    overruns = result.attributes.get(f"{run}_overruns")
    if overruns is not None:
        yield [f"{RUN_NAMES[run]}: intervals overrun", "", "", "", str(overruns)]
    lost = _noted(result, f"{run}/timing/lost")
    if lost is not None:
        yield [
            f"{RUN_NAMES[run]}: steps without samples, of {lost.size}",
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


def study_section(path: Path, sweep: Sweep) -> Html:
    """Return the section of a sweep, given with its file."""
    head, *rest = sections(sweep, path) if (ida := is_ida(sweep)) else [verdict_lines(sweep, path)]
    parts = [blocks(head), *_figures(sweep)]
    if below := rest or [section for section in below_grid_points(sweep) if section]:
        parts += [element("h3", "Summary"), *map(blocks, below)]
    if points := [] if ida else grid_points(sweep):
        parts += [element("h3", "Grid points"), blocks(points)]
    if sweep.study_yaml:
        parts.append(details("The study", element("pre", sweep.study_yaml)))
    parts.append(details("The case that is varied", element("pre", sweep.case_yaml)))
    found = {label: str(sweep.attributes[name]) for name, label in ORIGIN.items() if name in sweep.attributes}
    rows = [("", path.name), *found.items()]
    rows.append(("Processors", ", ".join(sorted({*sweep.texts["processor"]} - {""})) or "-"))
    parts.append(details("Origin", table(grid(rows, words=True))))
    return element("section", element("h2", path.stem), *parts)


def studies_title(sweeps: Sequence[tuple[Path, Sweep]]) -> str:
    """Return the title of a page of sweeps alone."""
    return "Hybrid simulation: " + (f"study {sweeps[0][0].stem}" if len(sweeps) == 1 else f"{len(sweeps)} studies")


def studies_told(sweeps: Sequence[tuple[Path, Sweep]]) -> str:
    """Return the sentence below the title."""
    runs = sum(len(sweep.seed) for _, sweep in sweeps)
    rigs = ", ".join(sorted({str(sweep.attributes["rig"]) for _, sweep in sweeps}))
    return f"{runs} runs of EXP-RTHS on the virtual shake table {rigs}: no table moved."


def _figures(sweep: Sweep) -> Iterator[Html]:
    from rths_cli.report.figures.write import sweep_images

    seeds = sweep.seeds_per_point
    of = f", median of {seeds} seeds" if seeds > 1 else ""
    for name, image in sweep_images(sweep) if sweep.numbers is None else ():
        source = f"data:image/svg+xml;base64,{base64.b64encode(image).decode('ascii')}"
        told = CAPTIONS[name].format(of=of)
        yield classed("div", "drawing", Html(f'<img src="{source}" alt="{told}">'))
        yield classed("p", "caption", told)


def write_page(
    results: Sequence[Result],
    path: Path,
    command_line: str,
    comparison: Document = (),
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
    results: Sequence[Result], command_line: str, comparison: Document = (), sweeps: Sequence[tuple[Path, Sweep]] = ()
) -> str:
    """Return the page of results and sweeps as HTML; raises InputError without any.

    `command_line`: the command that makes the page; `comparison`: sections that compare the results; `sweeps`: with
    their files.
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


def _comparison(document: Document) -> tuple[Html, ...]:
    """Return the section that compares results; () without one."""
    told = [blocks(section) for section in document]
    return (element("section", element("h2", "Comparison"), *told, attributes={"id": "comparison"}),) if told else ()


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


def _sections(cases: Sequence[Entry], results: Sequence[Result], command_line: str) -> list[tuple[str, Html]]:
    """Return the sections that have contents, by their ids."""
    contents = {
        "overview": [_overview(results)],
        "response": [overview.responses(results)],
        "verdicts": [verdict_table(results)],
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
        found.append(errors(members))
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
    response = element("div", heading(virtual), element("div", attributes={"id": "frequency-plots"}))
    return [element("div", attributes={"id": "table-controls"}), time, response]


def _case(entry: Entry, unfolded: bool) -> Html:
    """Return the section of one case: error by cause, timing, latency, table and case by method; all metrics."""
    names = dict.fromkeys(str(result.attributes.get("case_name") or "-") for result in entry.results.values())
    what = f"{', '.join(names)}: {entry.excitation}, damping {entry.damping}, {entry.controller}; {entry.table_name}"
    parts = [part for result in entry.results.values() for part in _result(result)]
    figures = details("Every metric with its definition", *map(table, every_figure(entry)))
    return details(what, *parts, figures, unfolded=unfolded)


def _result(result: Result) -> Iterator[Html]:
    yield element("h3", name_of(result))
    yield by_cause(result)
    yield timing(result)
    yield identification(result)
    loop = latency(result.metrics)
    yield details("Latency of the loop", blocks(loop)) if loop else Html("")
    yield case_files(result)


def _data(results: Sequence[Result]) -> dict[str, object]:
    """Return the data of the plots; series and responses that several results share are stored once."""
    pool, responses, shown = Pool(), [], []
    for result in results:
        measured = response(result)
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
