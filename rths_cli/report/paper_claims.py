"""The paper's four claims, judged on its published numbers and on ours, and printed below the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

from rths_cli.files.result_reader import COMPLETE
from rths_cli.report.numbers import six_wide
from rths_cli.report.results_by_case import (
    METHODS,
    PUBLISHED,
    Entry,
    damping_key,
    methods,
    published,
    run_state,
    state,
    storeys,
)
from rths_cli.report.table_cells import EXP_ERROR, SIM_DELAY_ERROR, of, sim_delay_result
from rths_cli.report.text_layout import Cell, Row, Table, wrapped

HELD, NOT_HELD, UNJUDGED = "held", "not held", "cannot be judged"


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


def claims_text(cases: Sequence[Entry]) -> str:
    """Return the verdicts for measured metrics as text, then those that differ for true metrics."""
    lines = [f"The paper's claims (m/s^2, test band, measured); {cases[0].table_name}"]
    turned: list[str] = []
    for place, claim in enumerate(CLAIMS, 1):
        measured = judge(claim, cases, "")
        lines += ["", f"{place}. {claim.text}: {_count(measured)}", *_lines(measured)]
        if cases[0].virtual:
            turned += _lines(_turned(measured, judge(claim, cases, "_true")), f"{place}. ")
    absent = [method for method in methods(cases) if not any(of(entry, method) for entry in cases)]
    lines += ["", *(f"Method {method} was not run: nothing is judged for it." for method in absent)]
    if turned:
        lines += ["Where true figures give another verdict than measured ones:", *turned]
    return wrapped(lines, indent=33).rstrip()


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


def _lines(verdicts: Sequence[Verdict], prefix: str = "") -> Iterator[str]:
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


HEADS = (Cell("source"), Cell("measured"), Cell("true"), Cell("figures compared"))


def claims_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield a table for each claim with comparisons among these cases: where, verdicts, compared metrics."""
    for place, claim in enumerate(CLAIMS, 1):
        rows = tuple(_rows(claim, cases))
        if rows:
            title = f"Claim {place} of the paper: {claim.text} (m/s^2, test band); {cases[0].table_name}"
            yield Table(title, "where", (4,), 16, (HEADS,), rows)


def _rows(claim: Claim, cases: Sequence[Entry]) -> Iterator[Row]:
    virtual = cases[0].virtual
    measured = judge(claim, cases, "")
    true = judge(claim, cases, "_true") if virtual else measured
    for seen, real in zip(measured, true, strict=True):
        verdict = real.verdict if virtual and seen.source != "published" else "-"
        texts = (seen.source, seen.verdict, verdict, seen.because)
        yield Row(seen.where, tuple(Cell(text) for text in texts))
