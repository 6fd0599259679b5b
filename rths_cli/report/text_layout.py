"""Plain text layout: tables with lines of equal width, wrapped paragraphs, numbers in six characters."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

WIDTH = 100  # largest number of columns of a line
NARROWEST_LABEL = 6  # characters


@dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    text: str
    span: int = 1  # number of columns
    mark: str = " "  # character after the text


@dataclass(frozen=True)
class Row:
    """A row of a table."""

    label: str
    cells: tuple[Cell, ...] = ()  # (): the label is a heading across the table


@dataclass(frozen=True)
class Table:
    """A table; the title or the last of the headers states the units."""

    title: str
    corner: str  # heading of the labels
    groups: tuple[int, ...]  # number of columns of each group; a bar follows each group
    column_width: int  # characters, the same for all columns
    headers: tuple[tuple[Cell, ...], ...]  # lines of headings
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()  # explain the words of the table


@dataclass(frozen=True)
class Paragraphs:
    """Sentences, each of which begins a new line."""

    lines: tuple[str, ...]
    indent: int = 0  # columns by which continuation lines are indented


@dataclass(frozen=True)
class Fixed:
    """Text that is laid out already, for tables without a grid."""

    text: str


Block = Table | Paragraphs | Fixed


def render(table: Table) -> str:
    """Return the table as text: title, lines of equal width, notes."""
    body = table_lines(table)
    return "\n".join([*textwrap.wrap(table.title, WIDTH), *body, *([wrapped(table.notes, 2)] if table.notes else [])])


def plain_text(blocks: Iterable[Block]) -> str:
    """Return the blocks of a report as text of at most 100 columns, separated by empty lines."""
    return "\n\n".join(text for block in blocks if (text := _plain(block))) + "\n"


def _plain(block: Block) -> str:
    if isinstance(block, Table):
        return render(block)
    return wrapped(block.lines, block.indent) if isinstance(block, Paragraphs) else block.text


def table_lines(table: Table) -> list[str]:
    """Return the lines of a table below its title, all of the same width."""
    columns = sum(table.groups) * table.column_width + len(table.groups) + 1
    labels = [table.corner, *(row.label for row in table.rows if row.cells)]
    longest = max(len(label) for label in labels)
    label_width = max(NARROWEST_LABEL, min(longest, WIDTH - columns))
    total = label_width + columns
    rule = "-" * total
    corners = [""] * (len(table.headers) - 1) + [table.corner]
    heads = [Row(label, cells) for label, cells in zip(corners, table.headers, strict=True)]
    lines = [rule]
    for row in heads:
        lines += _row_lines(row, table, label_width, heading=True)
    lines.append(rule)
    for row in table.rows:
        lines += _row_lines(row, table, label_width) if row.cells else _heading_lines(row.label, total)
    return [*lines, rule]


def wrapped(lines: Sequence[str], indent: int = 0) -> str:
    """Return lines wrapped at 100 columns; continuation lines are indented by `indent` columns."""
    return "\n".join(textwrap.fill(line, WIDTH, subsequent_indent=" " * indent, drop_whitespace=True) for line in lines)


def number(value: float) -> str:
    """Return a number that is not negative in at most six characters, with four decimals if they fit."""
    size = abs(value)
    if 0 < size < 1e-9 or size >= 9.95e98:
        return "<1e-9" if size < 1 else ">1e99"
    if size != 0 and (size < 5e-5 or size >= 99999.5):
        mantissa, _, exponent = f"{value:.1e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    for decimals, limit in ((4, 9.99995), (3, 99.9995), (2, 999.995), (1, 9999.95)):
        if size < limit:
            return f"{value:.{decimals}f}"
    return f"{value:.0f}"


def _heading_lines(label: str, total: int) -> list[str]:
    return [f"{line:<{total - 1}}|" for line in textwrap.wrap(label, total - 1) or [""]]


def _row_lines(row: Row, table: Table, label_width: int, heading: bool = False) -> list[str]:
    """Return the lines of one row: the cells beside the first line of the label, then the label's other lines."""
    first, *more = textwrap.wrap(row.label, label_width) or [""]
    lines = [f"{first:<{label_width}}" + _cells(row.cells, table, heading)]
    blank = (Cell("", sum(table.groups)),)
    return lines + [f"{line:<{label_width}}" + _cells(blank, table, heading) for line in more]


def _cells(cells: Sequence[Cell], table: Table, heading: bool) -> str:
    """Return the cells with bars; a cell that spans columns replaces the bars between them."""
    ends = set(_ends(table.groups))
    text, column = "|", 0
    for cell in cells:
        inside = sum(1 for end in range(column + 1, column + cell.span) if end in ends)
        width = cell.span * table.column_width + inside
        column += cell.span
        text += _fit(cell, width, heading) + ("|" if column in ends else "")
    return text


def _fit(cell: Cell, width: int, heading: bool) -> str:
    """Return the text of a cell in its width: centred if it spans columns, else right-aligned; cut with a full stop."""
    text = cell.text if len(cell.text) < width else cell.text[: width - 2] + "."
    if cell.span > 1:
        return (text + cell.mark).center(width)
    return (text + ("" if heading and len(text) == width else cell.mark)).rjust(width)


def _ends(groups: Sequence[int]) -> Iterator[int]:
    end = 0
    for size in groups:
        end += size
        yield end
