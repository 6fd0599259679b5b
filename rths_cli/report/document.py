"""What is printed, whatever the format: a document of sections, each of lines and tables.

The functions that know a subject return these records; `to_text`, `to_html` and `to_files` write them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise


class Verdict(str):
    """A word, a cell of a table, that a terminal shows in the colour of its meaning."""

    __slots__ = ()


@dataclass(frozen=True)
class Line:
    """A sentence, or a label with its text; a line that is too long is wrapped."""

    text: str
    label: str | None = None  # in the column of labels; "": the text stands below that of the line before
    indent: int = 2  # columns by which continuation lines of a sentence are indented
    verdict: str = ""  # the beginning of the text, a verdict


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str
    group: tuple[str, ...] = ()  # headings above the name, from the top; columns beside each other share equal ones
    unit: str = ""
    words: bool = False  # whether the cells are words, which stand at the left of their column


@dataclass(frozen=True)
class Row:
    """A row of a table."""

    label: str
    cells: tuple[str | None, ...] = ()  # one per column; None: the cell before reaches over this column, too
    # (): the label is a heading across the table; without a label the row is a rule


RULE = Row("")


@dataclass(frozen=True)
class Table:
    """A table; one with a title has rules, and a bar behind each group of columns."""

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    title: str = ""
    corner: str = ""  # heading of the labels
    notes: tuple[str, ...] = ()  # explain the words of the table
    indent: int = 0  # columns before it

    def headings(self) -> list[Row]:
        """Return the lines of headings: shared ones from the top, names with the corner, units if there are any."""
        depth = max((len(column.group) for column in self.columns), default=0)
        paths = [("",) * (depth - len(column.group)) + column.group for column in self.columns]
        shared = [
            Row("", tuple(None if place and path[: i + 1] == paths[place - 1][: i + 1] else path[i]
                          for place, path in enumerate(paths)))
            for i in range(depth)
        ]  # fmt: skip
        units = tuple(column.unit for column in self.columns)
        names = Row(self.corner, tuple(column.name for column in self.columns))
        return [*shared, names, *([Row("", units)] if any(units) else [])]

    def ends(self) -> set[int]:
        """Return the last column of each group, from 0."""
        last = {len(self.columns) - 1}
        return last | {k for k, (one, after) in enumerate(pairwise(self.columns)) if one.group != after.group}

    def part(self, first: int, end: int) -> Table:
        """Return the columns from `first` to `end` alone; a cell that reaches into them is repeated, a row that has
        nothing there is left out."""
        rows: list[Row] = []
        for row in self.rows:
            cells = (spread(row.cells)[first], *row.cells[first + 1 : end]) if row.cells else ()
            if any(cells) or not row.cells:
                rows.append(replace(row, cells=cells))
        while rows and rows[-1] == RULE:
            rows.pop()
        return replace(self, columns=self.columns[first:end], rows=tuple(rows))


Block = Line | Table
Section = Sequence[Block]
Document = Sequence[Section]


def labelled(label: str, text: str, verdict: str = "") -> Line:
    """Return a text behind its label; `verdict`: the beginning of the text, where that is one."""
    return Line(text, label, verdict=verdict)


def verdict_line(sentence: str) -> Line:
    """Return a sentence VERDICT: REASON as the line with which an output begins."""
    return Line(sentence, verdict=sentence.partition(":")[0])


def labelled_lines(label: str, texts: Iterable[str]) -> list[Block]:
    """Return texts below each other behind one label."""
    return [labelled("" if place else label, text) for place, text in enumerate(texts)]


def spread(cells: Sequence[str | None]) -> list[str]:
    """Return a text for each column; a cell that reaches over several is repeated."""
    texts: list[str] = []
    for cell in cells:
        texts.append(texts[-1] if cell is None else cell)
    return texts


def across(text: str, columns: int) -> tuple[str | None, ...]:
    """Return cells of which the first reaches over all columns."""
    return (text, *[None] * (columns - 1))


def runs(cells: Sequence[str | None]) -> Iterator[tuple[int, int, str]]:
    """Yield first and last column of each cell, and the cell."""
    for first, cell in enumerate(cells):
        if cell is not None:
            last = first
            while last + 1 < len(cells) and cells[last + 1] is None:
                last += 1
            yield first, last, cell


def grid(rows: Iterable[Sequence[str]], words: bool = False) -> Table:
    """Return a table below labelled lines: its first row holds the headings, the first column the labels."""
    heads, *body = rows
    columns = tuple(Column(name, words=words) for name in heads[1:])
    return Table(columns, tuple(Row(row[0], tuple(row[1:])) for row in body), corner=heads[0], indent=2)


def by_columns(corner: str, labels: Sequence[str], columns: Sequence[tuple[Column, Sequence[str]]]) -> Table:
    """Return a table that is stated by columns, each with its cells."""
    cells = zip(*(cells for _, cells in columns), strict=True)
    rows = tuple(Row(label, one) for label, one in zip(labels, cells, strict=True))
    return Table(tuple(column for column, _ in columns), rows, corner=corner)
