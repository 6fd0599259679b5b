"""Plain text: tables with lines of equal width, cells of metrics, labelled lines, wrapped paragraphs.

Pages are 100 columns wide, or as wide as `laid_out_in` says while they are made: a table that is wider is printed in
parts, one below the other.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from rths_cli.experiment.lost_samples import losses_of_runs
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.report.numbers import six_wide
from rths_cli.report.results_by_case import DIVERGED, Entry, look_up, published, run_state, state
from rths_cli.report.to_text import width

LABEL_SHARE = 3  # of a narrow page a column of labels takes at most one part of so many
NARROWEST_LABEL = 6  # characters

LABEL = 24
TRACKING = ("tracking_max_m_s2", "tracking_rms_m_s2")
TESTS = {"shake_table": "shake table test", "exp_rths": "RTHS"}
SIM_DELAY_ERROR = "sim_delay.rms_error_m_s2"
EXP_ERROR = "exp_rths.rms_error_m_s2"
UNFINISHED = "*"  # mark of a metric whose run did not end as planned


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
    return "\n".join([*textwrap.wrap(table.title, width()), *body, *([wrapped(table.notes, 2)] if table.notes else [])])


def plain_text(blocks: Iterable[Block]) -> str:
    """Return the blocks of a report as text, separated by empty lines."""
    return "\n\n".join(text for block in blocks if (text := _plain(block))) + "\n"


def _plain(block: Block) -> str:
    if isinstance(block, Table):
        return render(block)
    return wrapped(block.lines, block.indent) if isinstance(block, Paragraphs) else block.text


def table_lines(table: Table) -> list[str]:
    """Return the lines of a table below its title, all of the same width; of a wide table, those of its parts."""
    labels = [table.corner, *(row.label for row in table.rows if row.cells)]
    longest = max(len(label) for label in labels)
    columns = _columns_wide(table.groups, table.column_width)
    if max(NARROWEST_LABEL, min(longest, width() - columns)) + columns <= width():
        return _lines_of_part(table, longest)
    narrow = max(NARROWEST_LABEL, min(longest, width() // LABEL_SHARE))
    return [line for part in _parts(table, width() - narrow) for line in _lines_of_part(part, longest)]


def _columns_wide(groups: Sequence[int], column_width: int) -> int:
    return sum(groups) * column_width + len(groups) + 1


def _parts(table: Table, room: int) -> Iterator[Table]:
    """Yield tables of the columns that fit into `room`; a group is divided only if it does not fit by itself."""
    slices: list[tuple[int, int]] = []
    first, end = 0, 0
    for size in table.groups:
        if end > first and _columns_wide(_groups_of(table, first, end + size), table.column_width) > room:
            slices.append((first, end))
            first = end
        end += size
        while _columns_wide(_groups_of(table, first, end), table.column_width) > room and end - first > 1:
            count = max((room - 2) // table.column_width, 1)
            slices.append((first, first + count))
            first += count
    slices.append((first, end))
    for a, b in slices:
        rows = tuple(replace(row, cells=_sliced(row.cells, a, b)) for row in table.rows)
        headers = tuple(_sliced(cells, a, b) for cells in table.headers)
        yield replace(table, groups=_groups_of(table, a, b), headers=headers, rows=rows)


def _groups_of(table: Table, first: int, end: int) -> tuple[int, ...]:
    """Return the numbers of columns from `first` to `end` of each group that has any."""
    edges = [0, *_ends(table.groups)]
    sizes = (min(end, right) - max(first, left) for left, right in pairwise(edges))
    return tuple(size for size in sizes if size > 0)


def _sliced(cells: Sequence[Cell], first: int, end: int) -> tuple[Cell, ...]:
    """Return the cells of the columns from `first` to `end`; one that spans columns beside them is cut."""
    kept, start = [], 0
    for cell in cells:
        span = min(start + cell.span, end) - max(start, first)
        start += cell.span
        if span > 0:
            kept.append(replace(cell, span=span))
    return tuple(kept)


def _lines_of_part(table: Table, longest: int) -> list[str]:
    """Return the lines of a table whose columns fit, with labels of at most `longest` characters."""
    columns = _columns_wide(table.groups, table.column_width)
    label_width = max(NARROWEST_LABEL, min(longest, width() - columns))
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
    """Return lines wrapped at the width of the page; continuation lines are indented by `indent` columns."""
    return "\n".join(_filled(line, indent) for line in lines)


def _filled(line: str, indent: int) -> str:
    return textwrap.fill(line, width(), subsequent_indent=" " * indent, drop_whitespace=True)


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


def labelled(label: str, text: str) -> str:
    """Return a line with a label in its column, followed by a text."""
    return f"{label:<{LABEL - 1}} {text}".rstrip()


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of cells as aligned lines, the first column left-aligned, the others right-aligned.

    Columns that do not fit beside the others come below them, with the first column again.
    """
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    widths[0] = max(widths[0], LABEL - 4)
    fit, taken = len(widths), 2 + widths[0]
    for column, each in enumerate(widths[1:], 1):
        taken += 2 + each
        if taken > width() and column > 1:
            fit = column
            break
    if fit < len(widths):
        return [*aligned([row[:fit] for row in rows]), *aligned([[row[0], *row[fit:]] for row in rows])]
    return [
        ("  " + row[0].ljust(widths[0]) + "".join("  " + c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True)))
        .rstrip()
        for row in rows
    ]  # fmt: skip


def wrapped_below_labels(lines: Sequence[str]) -> str:
    """Return lines wrapped at the width of the page; continuation lines begin below the text of `labelled`."""
    indent = " " * LABEL
    return "\n".join(textwrap.fill(line, width(), subsequent_indent=indent, break_on_hyphens=False) for line in lines)


def words(states: Sequence[float | str], mark: str = " ") -> tuple[Cell, ...]:
    """Return one cell per state (number or word); if all states are the same word, one cell spans their columns."""
    first = states[0]
    if len(states) > 1 and isinstance(first, str) and all(item == first for item in states):
        return (Cell(first, len(states)),)
    return tuple(Cell(s) if isinstance(s, str) else Cell(six_wide(s), mark=mark) for s in states)


def our_cells(result: Result | None, paths: Sequence[str], index: int | None = None) -> tuple[Cell, ...]:
    """Return the cells of metrics of one result; `index`: storey, from 0; None: a metric with one value."""
    return words([state(result, path, index) for path in paths], mark(result, paths[0]))


def published_cells(entry: Entry | None, paths: Sequence[str], index: int | None = None) -> tuple[Cell, ...]:
    """Return the cells of published metrics; `index` as in `our_cells`."""
    return words([published(entry, path, index) if entry else "-" for path in paths])


def mark(result: Result | None, path: str) -> str:
    """Return UNFINISHED if the run of a metric did not end as planned, " " if it did or was refused."""
    return UNFINISHED if result and run_state(result, path) not in (COMPLETE, "refused") else " "


def of(entry: Entry | None, method: str) -> Result | None:
    """Return the result of a method, None if it was not run."""
    return entry.results.get(method) if entry else None


def sim_delay_result(entry: Entry | None) -> Result | None:
    """Return the result whose SIM-DELAY is shown, the last one with its errors; all methods have the same SIM-DELAY."""
    found = list(entry.results.values()) if entry else []
    having = [r for r in reversed(found) if look_up(r.metrics, SIM_DELAY_ERROR, 0) is not None]
    return next(iter(having or found), None)


def ratio(above: float | str, below: float | str) -> float | str:
    """Return the ratio of EXP-RTHS to SIM-DELAY, or the word of the one that has no number."""
    if isinstance(above, str) or isinstance(below, str):
        return above if isinstance(above, str) else str(below)
    return above / below if below > 0 else "-"


def remarks(cases: Sequence[Entry]) -> list[str]:
    """Return a line for each run that did not end as planned, diverged, or has another SIM-DELAY than shown."""
    lines: list[str] = []
    for entry in cases:
        for method, result in entry.results.items():
            name = f"{result.attributes.get('case_name') or '-'} ({method})"
            status = str(result.attributes.get("status", COMPLETE))
            reason = str(result.attributes.get("status_reason") or "no reason stored")
            told = reason if status in reason else f"{status}: {reason}"
            lines += [f"{name}: {told}"] if status != COMPLETE else []
            lines += [f"{name}: {text}" for text in _divergences(result)]
        lines += _other_sim_delay(entry)
    return lines


def losses(cases: Sequence[Entry]) -> list[str]:
    """Return a line for each run in real time that had steps without samples of their own."""
    return [
        f"{result.attributes.get('case_name') or '-'} ({method}): {text}"
        for entry in cases
        for method, result in entry.results.items()
        for text in losses_of_runs(result.metrics)
    ]


def _divergences(result: Result) -> list[str]:
    runs = {path.partition(".")[0]: path for path in result.metrics if path.endswith(".diverged_at_s")}
    times = {run: look_up(result.metrics, path, 0) for run, path in runs.items()}
    return [f"{run} {DIVERGED} at {time:.2f} s" for run, time in times.items() if time is not None and time == time]


def _other_sim_delay(entry: Entry) -> list[str]:
    """Return a line for each method whose SIM-DELAY differs from the one in the tables (other delay or version)."""
    shown = sim_delay_result(entry)
    lines: list[str] = []
    for method, result in entry.results.items():
        size = len(_values(result))
        pairs = [(state(result, SIM_DELAY_ERROR, i), state(shown, SIM_DELAY_ERROR, i)) for i in range(size)]
        if any(mine != theirs for mine, theirs in pairs):
            texts = ", ".join(six_wide(mine) if isinstance(mine, float) else mine for mine, _ in pairs)
            lines.append(f"{entry.excitation}, {entry.damping}, {entry.controller} ({method}): SIM-DELAY is {texts}")
    return lines


def _values(result: Result) -> list[float]:
    return list(np.atleast_1d(result.metrics.get(SIM_DELAY_ERROR, [])))
