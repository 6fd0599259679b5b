"""The paper's Tables 5.1 and 5.2 for several cases: tracking error, and response error to SIM storey by storey."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby

from rths_cli.report.results_by_case import Entry, controllers, damping_key, methods, published, state, storeys
from rths_cli.report.table_cells import (
    EXP_ERROR,
    SIM_DELAY_ERROR,
    TESTS,
    TRACKING,
    mark,
    of,
    our_cells,
    published_cells,
    ratio,
    sim_delay_result,
    words,
)
from rths_cli.report.text_layout import Cell, Row, Table

TRACKING_KINDS = {"true": "_true", "full band, measured": "_full", "full band, true": "_true_full"}
WIDTH = 7


def tracking_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield Table 5.1: measured in the test band, then true (on a virtual rig) and in full band."""
    ours = methods(cases)
    name = cases[0].table_name
    yield Table(
        f"Table 5.1  Tracking error (m/s^2), test band, measured; {name}",
        "control",
        (2,) * 2 * (1 + len(ours)),
        WIDTH,
        _headers(("published", *ours)),
        tuple(_tracking_rows(cases, {"": ""}, with_published=True)),
    )
    kinds = TRACKING_KINDS if cases[0].virtual else {"full band, measured": "_full"}
    what = "true and full band" if cases[0].virtual else "full band"
    yield Table(
        f"Table 5.1, more  Tracking error (m/s^2), {what}; {name}",
        "control",
        (2,) * 2 * len(ours),
        WIDTH,
        _headers(ours),
        tuple(_tracking_rows(cases, kinds, with_published=False)),
    )


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


def _cells(entry: Entry | None, suffix: str, sources: Sequence[str], with_published: bool) -> tuple[Cell, ...]:
    cells: tuple[Cell, ...] = ()
    for test in TESTS:
        paths = [f"{test}.{figure}{suffix}" for figure in TRACKING]
        cells += published_cells(entry, paths) if with_published else ()
        for method in sources:
            cells += our_cells(of(entry, method), paths)
    return cells


def _headers(sources: Sequence[str]) -> tuple[tuple[Cell, ...], ...]:
    span = 2 * len(sources)
    tests = (Cell("(1) Shake table test", span), Cell("(2) RTHS", span))
    return tests, tuple(Cell(source, 2) for source in sources) * 2, (Cell("max"), Cell("RMS")) * span


Cells = Callable[[Entry | None, int], tuple[Cell, ...]]
RESPONSE_KINDS = {"true": "_true", "full": "_full", "full-t": "_true_full"}
DAMPINGS_PER_TABLE = 2


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

    def cells(entry: Entry | None, storey: int) -> tuple[Cell, ...]:
        row = published_cells(entry, [SIM_DELAY_ERROR], storey)
        row += our_cells(sim_delay_result(entry), [SIM_DELAY_ERROR], storey)
        row += published_cells(entry, [EXP_ERROR], storey)
        for method in sources:
            row += our_cells(of(entry, method), [EXP_ERROR], storey)
        return row

    groups = (Cell("SIM-DELAY", 2), Cell("EXP-RTHS", 1 + len(sources)))
    names = (Cell("publ."), Cell("ours"), Cell("publ."), *(Cell(source) for source in sources))
    what = "RMS error to SIM (m/s^2), test band, measured"
    return _table(what, cases, (len(names),), 9, (groups, names), cells)


def _other_errors(cases: Sequence[Entry]) -> Table:
    """Return the table of RMS errors of EXP-RTHS that are true (on a virtual rig) and in full band."""
    sources = methods(cases)
    kinds = RESPONSE_KINDS if cases[0].virtual else {"full": "_full"}

    def cells(entry: Entry | None, storey: int) -> tuple[Cell, ...]:
        row: tuple[Cell, ...] = ()
        for method in sources:
            paths = [EXP_ERROR + suffix for suffix in kinds.values()]
            row += our_cells(of(entry, method), paths, storey)
        return row

    heads = (
        tuple(Cell(f"EXP-RTHS {source}", len(kinds)) for source in sources),
        tuple(Cell(kind) for kind in kinds) * len(sources),
    )
    what = "RMS error to SIM (m/s^2), " + ("true and full band" if cases[0].virtual else "full band")
    return _table(what, cases, (len(kinds),) * len(sources), 7 if len(kinds) > 1 else 18, heads, cells)


def _ratios(cases: Sequence[Entry]) -> Table:
    """Return the table of ratios EXP-RTHS / SIM-DELAY, published and of the results, measured and true."""
    sources = methods(cases)
    kinds = {"meas.": "", "true": "_true"} if cases[0].virtual else {"meas.": ""}

    def cells(entry: Entry | None, storey: int) -> tuple[Cell, ...]:
        theirs = (published(entry, path, storey) if entry else "-" for path in (EXP_ERROR, SIM_DELAY_ERROR))
        row = words([ratio(*theirs)])
        delayed = sim_delay_result(entry)
        below = state(delayed, SIM_DELAY_ERROR, storey)
        for method in sources:
            result = of(entry, method)
            above = [state(result, EXP_ERROR + suffix, storey) for suffix in kinds.values()]
            row += words([ratio(item, below) for item in above], mark(result, EXP_ERROR))
        return row

    heads = (
        (Cell("publ."), *(Cell(source, len(kinds)) for source in sources)),
        (Cell(""), *[Cell(kind) for kind in kinds] * len(sources)),
    )
    what = "EXP-RTHS / SIM-DELAY (ratio of RMS errors, -)"
    return _table(what, cases, (1 + len(kinds) * len(sources),), 9, heads, cells)


def _table(
    what: str,
    cases: Sequence[Entry],
    groups: tuple[int, ...],
    column_width: int,
    heads: Sequence[tuple[Cell, ...]],
    cells: Cells,
) -> Table:
    """Return a table of storeys (rows) and damping levels (bands of the same columns)."""
    levels = sorted({damping_key(entry) for entry in cases})
    name = cases[0].table_name
    return Table(
        f"Table 5.2, {cases[0].controller}  {what}; {name}",
        "storey",
        groups * len(levels),
        column_width,
        (tuple(Cell(f"damping {level[-1]}", sum(groups)) for level in levels), *(row * len(levels) for row in heads)),
        tuple(_response_rows(cases, levels, cells)),
    )


def _response_rows(cases: Sequence[Entry], levels: Sequence[tuple[bool, float, str]], cells: Cells) -> Iterator[Row]:
    by_record = sorted(cases, key=lambda entry: [e.excitation for e in cases].index(entry.excitation))
    for heading, group in groupby(by_record, key=lambda entry: entry.excitation):
        yield Row(heading)
        found = {damping_key(entry): entry for entry in group}
        for storey in range(storeys(list(found.values()))):
            row: tuple[Cell, ...] = ()
            for level in levels:
                row += cells(found.get(level), storey)
            yield Row(str(storey + 1), row)
