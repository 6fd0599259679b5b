"""Table 5.2: how far SIM-DELAY and EXP-RTHS are from SIM, storey by storey, for one controller."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

from rths_cli.report.cells import (
    EXP_ERROR,
    SIM_DELAY_ERROR,
    mark,
    of,
    our_cells,
    published_cells,
    ratio,
    sim_delay_result,
    words,
)
from rths_cli.report.layout import Cell, Row, Table
from rths_cli.report.load import Entry, controllers, damping_key, methods, published, state, storeys

Cells = Callable[[Entry | None, int], tuple[Cell, ...]]
KINDS = {"true": "_true", "full": "_full", "full-t": "_true_full"}
DAMPINGS_PER_TABLE = 2


def response_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield Table 5.2 of every controller, FF+FB as in the paper first; two damping levels stand side by side."""
    names = controllers(cases)
    for controller in sorted(names, key=lambda name: name != "FF+FB"):
        members = [entry for entry in cases if entry.controller == controller]
        levels = sorted({damping_key(entry) for entry in members})
        for start in range(0, len(levels), DAMPINGS_PER_TABLE):
            pair = levels[start : start + DAMPINGS_PER_TABLE]
            few = [entry for entry in members if damping_key(entry) in pair]
            yield from (_errors(few), _other_errors(few), _ratios(few))


def _errors(cases: Sequence[Entry]) -> Table:
    """Return RMS errors in the test band, measured: SIM-DELAY and EXP-RTHS, published and ours."""
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
    """Return RMS errors of EXP-RTHS as they truly were (on a virtual rig) and in full band."""
    sources = methods(cases)
    kinds = KINDS if cases[0].virtual else {"full": "_full"}

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
    """Return EXP-RTHS over SIM-DELAY, published and ours, measured and true."""
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
        tuple(_rows(cases, levels, cells)),
    )


def _rows(cases: Sequence[Entry], levels: Sequence[tuple[bool, float, str]], cells: Cells) -> Iterator[Row]:
    by_record = sorted(cases, key=lambda entry: [e.excitation for e in cases].index(entry.excitation))
    for heading, group in groupby(by_record, key=lambda entry: entry.excitation):
        yield Row(heading)
        found = {damping_key(entry): entry for entry in group}
        for storey in range(storeys(list(found.values()))):
            row: tuple[Cell, ...] = ()
            for level in levels:
                row += cells(found.get(level), storey)
            yield Row(str(storey + 1), row)
