"""The paper's Tables 5.1 and 5.2 for several cases, the table of a single case by method, and the paper's four
claims judged on its numbers and ours."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.report.document import Block, Column, Line, Row, Table
from rths_cli.report.numbers import six_wide
from rths_cli.report.results_by_case import (
    EXP_ERROR,
    METHODS,
    PUBLISHED,
    SIM_DELAY_ERROR,
    Entry,
    controllers,
    damping_key,
    mark,
    methods,
    of,
    our_cells,
    published,
    published_cells,
    ratio,
    run_state,
    sim_delay_result,
    state,
    storeys,
    words,
)

TRACKING = ("tracking_max_m_s2", "tracking_rms_m_s2")
TESTS = {"shake_table": "shake table test", "exp_rths": "RTHS"}
TRACKING_KINDS = {"true": "_true", "full band, measured": "_full", "full band, true": "_true_full"}
Cells = tuple[str | None, ...]
CellsOf = Callable[[Entry | None, int], Cells]
RESPONSE_KINDS = {"true": "_true", "full": "_full", "full-t": "_true_full"}
DAMPINGS_PER_TABLE = 2
KINDS = {"meas.": "", "true": "_true", "full": "_full", "full-t": "_true_full"}
TRACKING_METRICS = {"max": "tracking_max_m_s2", "RMS": "tracking_rms_m_s2"}
ERRORS = {"RMS": "rms_error_m_s2", "max": "max_error_m_s2"}
FACTORS = {"m/s^2": 1.0, "mm/s^2": 1e3}
RUNS = {"SIM-DELAY": "sim_delay", "EXP-RTHS": "exp_rths"}
HELD, NOT_HELD, UNJUDGED = "held", "not held", "cannot be judged"
HEADS = ("source", "measured", "true", "figures compared")


def tracking_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield Table 5.1: measured in the test band, then true (on a virtual rig) and in full band."""
    ours, name = methods(cases), cases[0].table_name
    title = f"Table 5.1  Tracking error (m/s^2), test band, measured; {name}"
    rows = tuple(_tracking_rows(cases, {"": ""}, with_published=True))
    yield Table(_tracking_columns(("published", *ours)), rows, title, "control")
    kinds = TRACKING_KINDS if cases[0].virtual else {"full band, measured": "_full"}
    what = "true and full band" if cases[0].virtual else "full band"
    rows = tuple(_tracking_rows(cases, kinds, with_published=False))
    yield Table(_tracking_columns(ours), rows, f"Table 5.1, more  Tracking error (m/s^2), {what}; {name}", "control")


def _tracking_columns(sources: Sequence[str]) -> tuple[Column, ...]:
    tests = ("(1) Shake table test", "(2) RTHS")
    return tuple(Column(name, (test, one)) for test in tests for one in sources for name in ("max", "RMS"))


def _tracking_rows(cases: Sequence[Entry], kinds: Mapping[str, str], with_published: bool) -> Iterator[Row]:
    """Yield a heading for each record and damping, followed by a row for each controller and kind of metric."""
    sources = methods(cases)
    for heading, group in groupby(cases, key=lambda e: f"{e.excitation}, damping {e.damping}"):
        yield Row(heading)
        for label, entry in _lines(list(group), controllers(cases)):
            for kind, suffix in kinds.items():
                cells = _cells(entry, suffix, sources, with_published)
                yield Row(f"{label}, {kind}" if kind else label, cells)


def _lines(members: Sequence[Entry], every: Sequence[str]) -> list[tuple[str, Entry | None]]:
    """Return the controllers of a section with their cases; None for a controller that only other sections have."""
    found = {entry.controller: entry for entry in members}
    shown = found if members[0].variant else every
    return [(name, found.get(name)) for name in shown]


def _cells(entry: Entry | None, suffix: str, sources: Sequence[str], with_published: bool) -> Cells:
    cells: Cells = ()
    for test in TESTS:
        paths = [f"{test}.{figure}{suffix}" for figure in TRACKING]
        cells += published_cells(entry, paths) if with_published else ()
        for method in sources:
            cells += our_cells(of(entry, method), paths)
    return cells


def response_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield Table 5.2 for each controller, FF+FB first as in the paper; two damping levels are side by side."""
    names = controllers(cases)
    for controller in sorted(names, key=lambda name: name != "FF+FB"):
        members = [entry for entry in cases if entry.controller == controller]
        levels = sorted({damping_key(entry) for entry in members})
        for start in range(0, len(levels), DAMPINGS_PER_TABLE):
            pair = levels[start : start + DAMPINGS_PER_TABLE]
            few = [entry for entry in members if damping_key(entry) in pair]
            yield from (_errors(few), _other_errors(few), _ratios(few))


def _errors(cases: Sequence[Entry]) -> Table:
    """Return the table of measured RMS errors in the test band, of SIM-DELAY and EXP-RTHS, also the published ones."""
    sources = methods(cases)

    def cells(entry: Entry | None, storey: int) -> Cells:
        row = published_cells(entry, [SIM_DELAY_ERROR], storey)
        row += our_cells(sim_delay_result(entry), [SIM_DELAY_ERROR], storey)
        row += published_cells(entry, [EXP_ERROR], storey)
        for method in sources:
            row += our_cells(of(entry, method), [EXP_ERROR], storey)
        return row

    delayed, tested = ("SIM-DELAY",), ("EXP-RTHS",)
    columns = [Column("publ.", delayed), Column("ours", delayed), Column("publ.", tested)]
    columns += [Column(source, tested) for source in sources]
    return _table("RMS error to SIM (m/s^2), test band, measured", cases, columns, cells)


def _other_errors(cases: Sequence[Entry]) -> Table:
    """Return the table of RMS errors of EXP-RTHS that are true (on a virtual rig) and in full band."""
    sources = methods(cases)
    kinds = RESPONSE_KINDS if cases[0].virtual else {"full": "_full"}

    def cells(entry: Entry | None, storey: int) -> Cells:
        row: Cells = ()
        for method in sources:
            paths = [EXP_ERROR + suffix for suffix in kinds.values()]
            row += our_cells(of(entry, method), paths, storey)
        return row

    columns = [Column(kind, (f"EXP-RTHS {source}",)) for source in sources for kind in kinds]
    what = "RMS error to SIM (m/s^2), " + ("true and full band" if cases[0].virtual else "full band")
    return _table(what, cases, columns, cells)


def _ratios(cases: Sequence[Entry]) -> Table:
    """Return the table of ratios EXP-RTHS / SIM-DELAY, published and of the results, measured and true."""
    sources = methods(cases)
    kinds = {"meas.": "", "true": "_true"} if cases[0].virtual else {"meas.": ""}

    def cells(entry: Entry | None, storey: int) -> Cells:
        theirs = (published(entry, path, storey) if entry else "-" for path in (EXP_ERROR, SIM_DELAY_ERROR))
        row = words([ratio(*theirs)])
        delayed = sim_delay_result(entry)
        below = state(delayed, SIM_DELAY_ERROR, storey)
        for method in sources:
            result = of(entry, method)
            above = [state(result, EXP_ERROR + suffix, storey) for suffix in kinds.values()]
            row += words([ratio(item, below) for item in above], mark(result, EXP_ERROR))
        return row

    columns = [Column("", ("publ.",)), *(Column(kind, (source,)) for source in sources for kind in kinds)]
    return _table("EXP-RTHS / SIM-DELAY (ratio of RMS errors, -)", cases, columns, cells)


def _table(what: str, cases: Sequence[Entry], columns: Sequence[Column], cells: CellsOf) -> Table:
    """Return a table of storeys (rows) and damping levels (bands of the same columns)."""
    levels = sorted({damping_key(entry) for entry in cases})
    title = f"Table 5.2, {cases[0].controller}  {what}; {cases[0].table_name}"
    banded = (replace(one, group=(f"damping {level[-1]}", *one.group)) for level in levels for one in columns)
    return Table(tuple(banded), tuple(_response_rows(cases, levels, cells)), title, "storey")


def _response_rows(cases: Sequence[Entry], levels: Sequence[tuple[bool, float, str]], cells: CellsOf) -> Iterator[Row]:
    by_record = sorted(cases, key=lambda entry: [e.excitation for e in cases].index(entry.excitation))
    for heading, group in groupby(by_record, key=lambda entry: entry.excitation):
        yield Row(heading)
        found = {damping_key(entry): entry for entry in group}
        for storey in range(storeys(list(found.values()))):
            row: Cells = ()
            for level in levels:
                row += cells(found.get(level), storey)
            yield Row(str(storey + 1), row)


def single_table(entry: Entry, unit: str = "m/s^2") -> Table:
    """Return the metrics of the paper's two tables for one case: published if known, then by method and kind.

    `unit`: of the errors, "m/s^2" or "mm/s^2".
    """
    known = [Column("publ.")] if entry.published else []
    columns = [Column(kind, (method,)) for method in entry.results for kind in _kinds(entry)]
    what = f"{entry.excitation}, damping {entry.damping}, controller {entry.controller}"
    title = f"{what}: errors ({unit}, test band unless full); {entry.table_name}"
    factor = FACTORS[unit]
    rows = (*_tracking(entry, factor), *_case_errors(entry, factor), *_case_ratios(entry))
    return Table((*known, *columns), rows, title)


def paths() -> Iterator[str]:
    """Yield the path of each metric in the table of a single case."""
    for suffix in KINDS.values():
        yield from (f"{run}.{figure}{suffix}" for run in TESTS for figure in TRACKING_METRICS.values())
        yield from (f"{run}.{figure}{suffix}" for run in RUNS.values() for figure in ERRORS.values())


def _kinds(entry: Entry) -> dict[str, str]:
    return {kind: suffix for kind, suffix in KINDS.items() if entry.virtual or "true" not in suffix}


def _tracking(entry: Entry, factor: float) -> Iterator[Row]:
    yield Row("Tracking error of the table: desired - measured acceleration")
    for run, name in TESTS.items():
        for figure, leaf in TRACKING_METRICS.items():
            yield Row(f"{name}, {figure}", _case_cells(entry, f"{run}.{leaf}", None, factor))


def _case_errors(entry: Entry, factor: float) -> Iterator[Row]:
    for figure, leaf in ERRORS.items():
        if not any(f"{run}.{leaf}" in r.metrics for run in RUNS.values() for r in entry.results.values()):
            continue
        yield Row(f"{figure} error of the absolute acceleration against SIM")
        for name, run in RUNS.items():
            for storey in range(storeys([entry])):
                yield Row(f"{name}, storey {storey + 1}", _case_cells(entry, f"{run}.{leaf}", storey, factor))


def _case_ratios(entry: Entry) -> Iterator[Row]:
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


def _case_cells(entry: Entry, path: str, storey: int | None, factor: float) -> Cells:
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


@dataclass(frozen=True)
class Pick:
    """A metric of a case that a claim compares."""

    entry: Entry | None  # case; None: the case is missing
    name: str  # of the case, in words
    path: str  # of the metric
    index: int | None = None  # storey, from 0; None: a metric with one value
    missing: str = "was not run"  # why the case is missing, after its name


@dataclass(frozen=True)
class Comparison:
    """The comparisons of a claim for one excitation and damping, one controller, or the like."""

    where: str  # in words
    pairs: tuple[tuple[str, Pick, Pick], ...]  # (name, lower, upper): the claim holds if each lower is below its upper


@dataclass(frozen=True)
class Verdict:
    """Verdict on one comparison of a claim for one source of metrics."""

    source: str  # PUBLISHED or a method
    where: str  # of the Comparison
    verdict: str  # HELD, NOT_HELD or UNJUDGED
    because: str  # the compared numbers, and what is missing


@dataclass(frozen=True)
class Claim:
    """A claim of the paper."""

    text: str
    comparisons: Callable[[Sequence[Entry]], Iterator[Comparison]]  # finds its comparisons among the cases


def claims_lines(cases: Sequence[Entry]) -> list[Block]:
    """Return the verdicts for measured metrics as lines, then those that differ for true metrics."""
    lines = [f"The paper's claims (m/s^2, test band, measured); {cases[0].table_name}"]
    turned: list[str] = []
    for place, claim in enumerate(CLAIMS, 1):
        measured = judge(claim, cases, "")
        lines += ["", f"{place}. {claim.text}: {_count(measured)}", *_claim_lines(measured)]
        if cases[0].virtual:
            turned += _claim_lines(_turned(measured, judge(claim, cases, "_true")), f"{place}. ")
    absent = [method for method in methods(cases) if not any(of(entry, method) for entry in cases)]
    last = [f"Method {method} was not run: nothing is judged for it." for method in absent]
    last += ["Where true figures give another verdict than measured ones:", *turned] if turned else []
    return [Line(line, indent=33) for line in (*lines, *([""] if last else []), *last)]


def judge(claim: Claim, cases: Sequence[Entry], suffix: str) -> list[Verdict]:
    """Return the verdicts on a claim for each comparison and source; none for metrics that were not published.

    `suffix`: "" for measured, "_true" for true metrics of the results; published metrics have no suffix.
    """
    verdicts: list[Verdict] = []
    run = [method for method in methods(cases) if any(of(entry, method) for entry in cases)]
    for comparison in claim.comparisons(cases):
        for source in (PUBLISHED, *run):
            verdict = _judge_one(comparison, source, suffix)
            if source != PUBLISHED or verdict.verdict != UNJUDGED:
                verdicts.append(verdict)
    return verdicts


def _judge_one(comparison: Comparison, source: str, suffix: str) -> Verdict:
    """Return the verdict on a comparison: not held if one pair is reversed, else not judged if a metric is missing."""
    held: list[bool] = []
    texts: list[str] = []
    missing: list[str] = []
    for name, lower, upper in comparison.pairs:
        low, high = _figure(lower, source, suffix), _figure(upper, source, suffix)
        missing += [text for text in (low, high) if isinstance(text, str)]
        if isinstance(low, float) and isinstance(high, float):
            held.append(low < high)
            sign = "<" if low < high else ">="
            texts.append(f"{name} {six_wide(low)} {sign} {six_wide(high)}".strip())
    verdict = NOT_HELD if not all(held) else UNJUDGED if missing or not held else HELD
    return Verdict(source, comparison.where, verdict, "; ".join([*texts, *dict.fromkeys(missing)]))


def _figure(pick: Pick, source: str, suffix: str) -> float | str:
    """Return a metric, or in words why it is missing; a run that did not end as planned does not count."""
    if pick.entry is None:
        return f"{pick.name} {pick.missing}"
    if source == PUBLISHED:
        value = published(pick.entry, pick.path, pick.index)
        return value if isinstance(value, float) else f"{pick.name} is not published"
    delayed = pick.path == SIM_DELAY_ERROR
    result = sim_delay_result(pick.entry) if delayed else of(pick.entry, source)
    if result is None:
        return f"{pick.name} was not run"
    end = run_state(result, pick.path)
    if end != COMPLETE:
        return f"{pick.name} {end}"
    value = state(result, pick.path + ("" if delayed else suffix), pick.index)
    if isinstance(value, float):
        return value
    return f"{pick.name} has no such figure" if value == "-" else f"{pick.name} {value}"


def _feedback_tracks_better(cases: Sequence[Entry]) -> Iterator[Comparison]:
    for where, found in _by_controller(cases):
        pairs = tuple(
            (name, Pick(found.get("FF+FB"), "FF+FB", path), Pick(found.get("FF"), "FF", path))
            for name, path in (
                ("shake table test", "shake_table.tracking_rms_m_s2"),
                ("RTHS", "exp_rths.tracking_rms_m_s2"),
            )
        )
        yield Comparison(where, pairs)


def _feedback_peaks_higher(cases: Sequence[Entry]) -> Iterator[Comparison]:
    path = "exp_rths.tracking_max_m_s2"
    for where, found in _by_controller(cases):
        yield Comparison(where, (("", Pick(found.get("FF"), "FF", path), Pick(found.get("FF+FB"), "FF+FB", path)),))


def _better_than_delay(cases: Sequence[Entry]) -> Iterator[Comparison]:
    for entry in cases:
        pairs = tuple(
            (
                f"{i + 1}:",
                Pick(entry, "EXP-RTHS", EXP_ERROR, i),
                Pick(entry, "SIM-DELAY", SIM_DELAY_ERROR, i),
            )
            for i in range(storeys([entry]))
        )
        yield Comparison(f"{entry.excitation}, {entry.damping}, {entry.controller}", pairs)


def _better_with_damping(cases: Sequence[Entry]) -> Iterator[Comparison]:
    ordered = sorted(cases, key=lambda e: (e.excitation, e.controller, damping_key(e)))
    for (excitation, controller), group in groupby(ordered, key=lambda e: (e.excitation, e.controller)):
        members = list(group)
        where = f"{excitation}, {controller}"
        if len(members) < 2 or damping_key(members[-1])[0]:
            none = Pick(None, "another damping level", EXP_ERROR)
            if len(members) > 1:
                none = Pick(None, f"the ratio of damping {members[-1].damping}", EXP_ERROR, missing="is not known")
            yield Comparison(where, (("", none, none),))
            continue
        for low, high in pairwise(members):
            pairs = tuple(
                (f"{i + 1}:", Pick(high, high.damping, EXP_ERROR, i), Pick(low, low.damping, EXP_ERROR, i))
                for i in range(storeys(members))
            )
            yield Comparison(f"{where}: {high.damping} against {low.damping}", pairs)


def _by_controller(cases: Sequence[Entry]) -> Iterator[tuple[str, dict[str, Entry]]]:
    """Yield the cases with FF or FF+FB of one excitation and damping."""
    ordered = sorted(cases, key=lambda e: (e.excitation, damping_key(e)))
    for (excitation, (*_, damping)), group in groupby(ordered, key=lambda e: (e.excitation, damping_key(e))):
        found = {entry.controller: entry for entry in group}
        if "FF" in found or "FF+FB" in found:
            yield f"{excitation}, {damping}", found


def _count(verdicts: Sequence[Verdict]) -> str:
    """Return in words how often the claim held, for each source."""
    parts: list[str] = []
    for source in sorted({verdict.source for verdict in verdicts}, key=_source_rank):
        mine = [verdict.verdict for verdict in verdicts if verdict.source == source]
        open_ = mine.count(UNJUDGED)
        judged = f"held {mine.count(HELD)} of {len(mine) - open_}" if open_ < len(mine) else "not judged"
        parts.append(f"{source} {judged}" + (f" ({open_} not judged)" if 0 < open_ < len(mine) else ""))
    return "; ".join(parts) or UNJUDGED


def _source_rank(source: str) -> tuple[int, str]:
    known = (PUBLISHED, *METHODS)
    return (known.index(source), "") if source in known else (len(known), source)


def _claim_lines(verdicts: Sequence[Verdict], prefix: str = "") -> Iterator[str]:
    """Yield a heading for each comparison and a line for each source."""
    for where, group in groupby(verdicts, key=lambda verdict: verdict.where):
        yield f"  {prefix}{where}"
        for verdict in group:
            yield f"    {verdict.verdict:<16}  {verdict.source:<9}  {verdict.because}"


def _turned(measured: Sequence[Verdict], true: Sequence[Verdict]) -> list[Verdict]:
    """Return the verdicts for true metrics that differ from those for measured ones."""
    return [real for seen, real in zip(measured, true, strict=True) if real.verdict != seen.verdict]


CLAIMS = (
    Claim("FF+FB tracks better than FF (RMS tracking error)", _feedback_tracks_better),
    Claim("EXP-RTHS is better than SIM-DELAY in every storey (RMS error)", _better_than_delay),
    Claim("EXP-RTHS is better with more damping (RMS error)", _better_with_damping),
    Claim("FF+FB's maximum tracking error in RTHS is above FF's", _feedback_peaks_higher),
)


def claims_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield a table for each claim with comparisons among these cases: where, verdicts, compared metrics."""
    columns = tuple(Column(head, words=True) for head in HEADS)
    for place, claim in enumerate(CLAIMS, 1):
        if rows := tuple(_rows(claim, cases)):
            title = f"Claim {place} of the paper (m/s^2, test band); {cases[0].table_name}"
            note = f"{place}. {claim.text}: {_count(judge(claim, cases, ''))}."
            yield Table(columns, rows, title, "where", (note,))


def _rows(claim: Claim, cases: Sequence[Entry]) -> Iterator[Row]:
    virtual = cases[0].virtual
    measured = judge(claim, cases, "")
    true = judge(claim, cases, "_true") if virtual else measured
    for seen, real in zip(measured, true, strict=True):
        verdict = real.verdict if virtual and seen.source != "published" else "-"
        yield Row(seen.where, (seen.source, seen.verdict, verdict, seen.because))
