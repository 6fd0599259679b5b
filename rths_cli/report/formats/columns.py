"""What formats with tables of their own need of one: its cells one per column, and its columns' names."""

from __future__ import annotations

from collections.abc import Sequence

from rths_cli.report.layout import Cell, Row, Table


def width(table: Table) -> int:
    """Return the number of columns beside the labels."""
    return sum(table.groups)


def shown(cell: Cell) -> str:
    """Return what a cell holds, with its mark."""
    return (cell.text + cell.mark).strip()


def spread(cells: Sequence[Cell]) -> list[str]:
    """Return one text per column: a cell that spans several stands in each."""
    return [shown(cell) for cell in cells for _ in range(cell.span)]


def names(table: Table) -> list[str]:
    """Return a name per column, from the top header down; repeated parts stand once."""
    levels = [spread(cells) for cells in table.headers]
    parts = zip(*levels, strict=True)
    return [" ".join(dict.fromkeys(part for part in column if part)) for column in parts]


def filled(row: Row, columns: int) -> list[str]:
    """Return the texts of a row, as many as there are columns."""
    texts = spread(row.cells)
    return texts + [""] * (columns - len(texts))
