r"""`--format latex`: tables with booktabs, for \input."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from rths_cli.report.formats.csv_table import shown, width
from rths_cli.report.text_layout import Block, Cell, Paragraphs, Row, Table

HEAD = r"""% Tables of hybrid simulations. The preamble needs: \usepackage{booktabs,longtable,array}
"""
SIGNS = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "*": r"\textsuperscript{*}",
    **{sign: f"\\{sign}" for sign in "&%$#_"},
}
POWERS = {"m/s^2": "m/s$^2$", "m^2/s^4": "m$^2$/s$^4$"}
EXPONENT = re.compile(r"^(-?[\d.]+)e([+-]?\d+)(\*?)$")
NEGATIVE = re.compile(r"^-(?=\d)")
WORDY = 30  # characters from which a column breaks its lines


def latex(blocks: Iterable[Block]) -> str:
    """Return blocks as LaTeX: a longtable with rules of booktabs for each table, sentences as paragraphs."""
    parts = [part for block in blocks for part in _parts(block)]
    return "\n".join([HEAD, *parts])


def escaped(text: str) -> str:
    """Return a text with LaTeX's special characters escaped, units typeset, and only ASCII characters."""
    pieces = re.split("(" + "|".join(re.escape(unit) for unit in sorted(POWERS, key=len, reverse=True)) + ")", text)
    return "".join(POWERS.get(piece) or "".join(_sign(sign) for sign in piece) for piece in pieces)


def _sign(sign: str) -> str:
    if sign.isascii():
        return SIGNS.get(sign, sign if sign.isprintable() else " ")
    return "?" if not sign.isprintable() else rf"\symbol{{{ord(sign)}}}" if ord(sign) < 256 else "?"


def _parts(block: Block) -> Iterator[str]:
    if isinstance(block, Table):
        yield "\n".join(_table(block))
        yield "\n".join([*(rf"\noindent {escaped(note)}\par" for note in block.notes), ""])
    elif isinstance(block, Paragraphs):
        yield "\n".join([*(rf"\noindent {escaped(line.strip())}\par" for line in block.lines), ""])
    else:
        yield "\n".join([*(rf"\noindent\texttt{{{escaped(line)}}}\par" for line in block.text.splitlines()), ""])


def _table(table: Table) -> Iterator[str]:
    columns = width(table)
    wide = [_is_wordy(table, column) for column in range(columns)]
    kinds = "".join(r"p{3.5cm}" if wordy else "r" for wordy in wide)
    small = r"\scriptsize\setlength{\tabcolsep}{2pt}" if columns > 6 or any(wide) else r"\small"
    yield rf"{{{small}"
    yield rf"\begin{{longtable}}{{@{{}}l{kinds}@{{}}}}"
    yield rf"\caption{{{escaped(table.title)}}}\\"
    yield r"\toprule"
    corners = [""] * (len(table.headers) - 1) + [table.corner]
    for level, (corner, cells) in enumerate(zip(corners, table.headers, strict=True)):
        yield _line(corner, [_head(cell) for cell in cells])
        if level < len(table.headers) - 1:
            yield " ".join(_rules(cells))
    yield r"\midrule"
    yield r"\endhead"
    for row in table.rows:
        yield _row(row, columns)
    yield r"\bottomrule"
    yield "\\end{longtable}}\n"


def _is_wordy(table: Table, column: int) -> bool:
    """Return whether a column contains sentences."""
    texts = [cells[column].text for row in table.rows if len(cells := row.cells) == width(table)]
    return max((len(text) for text in texts), default=0) > WORDY


def _head(cell: Cell) -> str:
    return rf"\multicolumn{{{cell.span}}}{{c}}{{{escaped(cell.text)}}}"


def _rules(cells: Sequence[Cell]) -> Iterator[str]:
    """Yield a rule under each header that spans several columns."""
    column = 2
    for cell in cells:
        if cell.span > 1:
            yield rf"\cmidrule(lr){{{column}-{column + cell.span - 1}}}"
        column += cell.span


def _row(row: Row, columns: int) -> str:
    if not row.cells:
        return rf"\addlinespace \multicolumn{{{columns + 1}}}{{@{{}}l}}{{\textit{{{escaped(row.label)}}}}}\\"
    return _line(row.label, [_cell(cell) for cell in row.cells])


def _cell(cell: Cell) -> str:
    text = number(shown(cell))
    return text if cell.span == 1 else rf"\multicolumn{{{cell.span}}}{{c}}{{{text}}}"


def number(text: str) -> str:
    """Return the text of a cell: powers of ten and minus signs typeset, "-" as a dash."""
    if text == "-":
        return "--"
    power = EXPONENT.match(text)
    if power:
        return rf"${power[1]}\times10^{{{int(power[2])}}}${escaped(power[3])}"
    return NEGATIVE.sub(lambda _: r"$-$", escaped(text))


def _line(label: str, cells: Sequence[str]) -> str:
    return " & ".join([escaped(label), *cells]) + r" \\"
