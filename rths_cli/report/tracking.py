"""Table 5.1: how well the table tracked its desired acceleration, in the shake table test and in the RTHS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from rths_cli.report.cells import TESTS, TRACKING, of, our_cells, published_cells
from rths_cli.report.layout import Cell, Row, Table
from rths_cli.report.load import Entry, controllers, methods

KINDS = {"true": "_true", "full band, measured": "_full", "full band, true": "_true_full"}
WIDTH = 7


def tracking_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield Table 5.1 measured in the test band, then true (on a virtual rig) and in full band."""
    ours = methods(cases)
    name = cases[0].table_name
    yield Table(
        f"Table 5.1  Tracking error (m/s^2), test band, measured; {name}",
        "control",
        (2,) * 2 * (1 + len(ours)),
        WIDTH,
        _headers(("published", *ours)),
        tuple(_rows(cases, {"": ""}, with_published=True)),
    )
    kinds = KINDS if cases[0].virtual else {"full band, measured": "_full"}
    what = "true and full band" if cases[0].virtual else "full band"
    yield Table(
        f"Table 5.1, more  Tracking error (m/s^2), {what}; {name}",
        "control",
        (2,) * 2 * len(ours),
        WIDTH,
        _headers(ours),
        tuple(_rows(cases, kinds, with_published=False)),
    )


def _rows(cases: Sequence[Entry], kinds: Mapping[str, str], with_published: bool) -> Iterator[Row]:
    """Yield a heading per record and damping, and under it a row per controller and kind of figure."""
    sources = methods(cases)
    for heading, group in groupby(cases, key=lambda e: f"{e.excitation}, damping {e.damping}"):
        yield Row(heading)
        for label, entry in _lines(list(group), controllers(cases)):
            for kind, suffix in kinds.items():
                cells = _cells(entry, suffix, sources, with_published)
                yield Row(f"{label}, {kind}" if kind else label, cells)


def _lines(members: Sequence[Entry], every: Sequence[str]) -> list[tuple[str, Entry | None]]:
    """Return the controllers of a section with their cases; one that other sections have is shown as missing."""
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
