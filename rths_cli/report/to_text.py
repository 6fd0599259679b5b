"""A document as text for a terminal or a file: lines of at most 100 columns, or of as many as `laid_out_in` says.

A table that is wider is printed in parts, one below the other; no number and no word is cut.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace

from rths_cli.report.document import Block, Document, Line, Row, Section, Table, Verdict, runs

WIDTH = 100  # largest number of columns of a line, unless `laid_out_in` says another
_COLUMNS = ContextVar("columns", default=WIDTH)
LABEL = 24  # columns of a label and the space behind it
GAPS = (2, 1)  # before a column, where the table fits so
NARROWEST_LABEL = 6  # of a table one of whose cells has no room on the page
_GLUE = "\N{NO-BREAK SPACE}"
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:%|[num]?s|[mk]?Hz|[mk]?m|k?N|k?g|m?V|[mk]?m/s(?:\^2)?)(?![\w/]))")
LABEL_SHARE = 3  # labels of a table that is too wide are wrapped to one part of the page of so many
MARKS = "\x0e", "\x0f"  # around a verdict, where a terminal colours it
_MARKED = ContextVar("marked", default=False)


@contextmanager
def laid_out_in(columns: int, marked: bool | None = None) -> Iterator[None]:
    """Lay pages out for lines of at most so many columns meanwhile; `marked`: whether verdicts stand between MARKS."""
    before = _COLUMNS.set(columns), _MARKED.set(_MARKED.get() if marked is None else marked)
    try:
        yield
    finally:
        _COLUMNS.reset(before[0])
        _MARKED.reset(before[1])


def width() -> int:
    """Return the largest number of columns of a line, 100 unless `laid_out_in` says another."""
    return _COLUMNS.get()


def text(document: Document) -> str:
    """Return a document as text, its sections separated by empty lines."""
    return "\n\n".join("\n".join(section_lines(one)) for one in document if one) + "\n"


def section_lines(section: Section) -> list[str]:
    """Return the lines of a section."""
    return [line for block in section for line in _block_lines(block)]


def _block_lines(block: Block) -> list[str]:
    if isinstance(block, Line):
        return _line_lines(block)
    title = wrapped(block.title) if block.title else []
    return [*title, *table_lines(block), *(line for note in block.notes for line in wrapped(note, 2))]


def _line_lines(line: Line) -> list[str]:
    label = "" if line.label is None else f"{line.label:<{LABEL - 1}} "
    first, *more = wrapped(label + line.text, LABEL if label else line.indent)
    if line.verdict and first[len(label) :].startswith(line.verdict):
        first = label + marked(line.verdict) + first[len(label) + len(line.verdict) :]
    return [first, *more]


def marked(verdict: str) -> str:
    """Return a verdict between MARKS where they are wanted."""
    return verdict.join(MARKS) if _MARKED.get() else verdict


def wrapped(sentence: str, indent: int = 0) -> list[str]:
    """Return the lines of a sentence; continuation lines are indented.

    A number stays with its unit, and a path is not broken: it will be copied.
    """
    made = textwrap.wrap(
        _BEFORE_UNIT.sub(_GLUE, sentence),
        width(),
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
        break_long_words="/" not in sentence,
    )
    return [line.rstrip().replace(_GLUE, " ") for line in made] or [""]


def in_room(sentences: Sequence[str], room: int, whole: str) -> list[Block]:
    """Return sentences in at most `room` lines: the last ones are cut first, and what has no room is left out; one line
    says so, with the command that prints them `whole`."""
    lines = [wrapped(sentence, 2) for sentence in sentences]
    if sum(map(len, lines)) > room:
        lines, left = lines[: room - 1], max(len(lines) - (room - 1), 0)
        for place in reversed(range(len(lines))):
            others = sum(map(len, lines)) - len(lines[place])
            lines[place] = _cut(lines[place], max(room - 1 - others, 1))
        more = f", {left} more left out" if left else ""
        lines.append(wrapped(f"(notes shortened{more}; {whole} prints them whole)", 2))
    return [Line(line) for sentence in lines for line in sentence]


def _cut(lines: list[str], most: int) -> list[str]:
    """Return the first lines of a note, which say that more follows."""
    if len(lines) <= most:
        return lines
    rest = " ".join(line.strip() for line in lines[most - 1 :])
    indent = " " * (len(lines[most - 1]) - len(lines[most - 1].lstrip()))
    return [*lines[: most - 1], indent + textwrap.shorten(rest, width() - len(indent), placeholder=" ...")]


def table_lines(table: Table) -> list[str]:
    """Return the lines of a table without title and notes; of a wide table, those of its parts."""
    table, room = _with_room_for_marks(table), width() - table.indent
    labels = [table.corner, *(row.label for row in table.rows if row.cells)]
    longest, word = max(map(len, labels)), max((len(word) for label in labels for word in label.split()), default=0)
    least = min(longest, max(min(word, room // 2), room // LABEL_SHARE))
    parts, gap = [table], next((g for label in (longest, least) for g in GAPS if label + _wide(table, g) <= room), 0)
    if not gap:
        parts, gap = [*_parts(table, room - least)], GAPS[0]
    labels_of = (max(min(longest, room - _wide(part, gap)), min(longest, NARROWEST_LABEL)) for part in parts)
    return [line for part, label in zip(parts, labels_of, strict=True) for line in _part_lines(part, label, gap)]


def _with_room_for_marks(table: Table) -> Table:
    """Return a table of which numbers without a mark have its room behind them, beside others that have one."""
    marked = {k for row in table.rows for k, cell in enumerate(row.cells) if cell and cell.endswith("*")}

    def cell(k: int, text: str | None) -> str | None:
        return f"{text} " if k in marked and text is not None and not text.endswith("*") else text

    rows = (replace(row, cells=tuple(cell(k, text) for k, text in enumerate(row.cells))) for row in table.rows)
    return replace(table, rows=tuple(rows)) if marked else table


def _parts(table: Table, room: int) -> Iterator[Table]:
    """Yield tables of the columns that fit into `room`; a group is divided only if it does not fit by itself."""
    first, count, ends = 0, len(table.columns), table.ends()
    while first < count:
        fit = [first + 1]
        while fit[-1] < count and _wide(table.part(first, fit[-1] + 1), GAPS[0]) <= room:
            fit.append(fit[-1] + 1)
        end = next((end for end in reversed(fit) if end - 1 in ends), fit[-1])
        yield table.part(first, end)
        first = end


def _bar(table: Table) -> str:
    return "|" if table.title else ""


def _wide(table: Table, gap: int) -> int:
    """Return the width of a table without its labels."""
    return sum(_widths(table, gap)) + len(_bar(table)) * (1 + len(table.ends()))


def _widths(table: Table, gap: int) -> list[int]:
    """Return the width of each column with the gap before it; what reaches over several widens the first of them."""
    rows = [row.cells for row in (*table.headings(), *table.rows) if row.cells]
    widths = [gap] * len(table.columns)
    ends, bar = table.ends(), len(_bar(table))
    for first, last, cell in sorted((one for cells in rows for one in runs(cells)), key=lambda one: one[1] - one[0]):
        inside = sum(widths[first : last + 1]) + bar * sum(1 for k in range(first, last) if k in ends)
        widths[first] += max(gap + len(cell) - inside, 0)
    return widths


def _part_lines(table: Table, label: int, gap: int) -> list[str]:
    """Return the lines of a table whose columns fit."""
    widths, bar = _widths(table, gap), _bar(table)
    total = label + sum(widths) + len(bar) * (1 + len(table.ends()))
    rule = ["-" * total] if bar else []

    def lines(row: Row) -> list[str]:
        if not row.cells:
            heads = textwrap.wrap(row.label, total - len(bar))
            return [f"{line:<{total - len(bar)}}{bar}" for line in heads] if row.label else rule
        first, *more = textwrap.wrap(row.label, max(label, 1), break_on_hyphens=False) or [""]
        blank: list[str] = [""] * len(widths)
        made = [(first, row.cells), *((line, blank) for line in more)]
        return [f"{name:<{label}}{bar}{_cells(table, cells, widths, gap)}" for name, cells in made]

    heads = [line for row in table.headings() for line in lines(row)]
    body = [line for row in table.rows for line in lines(row)]
    return [(" " * table.indent + line).rstrip() for line in (*rule, *heads, *rule, *body, *rule)]


def _cells(table: Table, cells: Sequence[str | None], widths: Sequence[int], gap: int) -> str:
    """Return the cells of a row with the bars behind groups; a cell that reaches over columns takes their bars."""
    ends, bar, made = table.ends(), _bar(table), ""
    for first, last, cell in runs(cells):
        wide = sum(widths[first : last + 1]) + len(bar) * sum(1 for k in range(first, last) if k in ends)
        left = " " * gap + cell.ljust(wide - gap) if table.columns[first].words else cell.rjust(wide)
        made += left.replace(cell, marked(cell)) if isinstance(cell, Verdict) else left
        made += bar if last in ends else ""
    return made
