"""A document as Markdown or LaTeX: its tables whole, sentences as paragraphs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator

from rths_cli.report.document import RULE, Block, Document, Line, Row, Section, Table, runs, spread

SPECIAL = re.compile(r"([\\`*_\[\]<>|#~$])")  # in Markdown
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


def markdown(document: Document) -> str:
    """Return a document as Markdown, for a repository's pages, issues and merge requests."""
    parts = [part for section in document for part in _markdown(section)]
    return "\n\n".join(["# Report of hybrid simulations", *parts]) + "\n"


def in_markdown(text: str) -> str:
    """Return a text with the special characters of Markdown and HTML escaped."""
    return SPECIAL.sub(r"\\\1", " ".join(text.split())).replace("&", "&amp;")


def _markdown(section: Section) -> Iterator[str]:
    lines = [block for block in section if isinstance(block, Line) and block.text]
    if lines:
        yield "\n".join(f"{'- ' if one.text.startswith(' ') else ''}{in_markdown(_labelled(one))}  " for one in lines)
    for block in section:
        if isinstance(block, Table):
            yield f"## {in_markdown(block.title)}"
            yield "\n".join(_pipe_table(block))
            if block.notes:
                yield "\n".join(f"- {in_markdown(note)}" for note in block.notes)


def _labelled(line: Line) -> str:
    return line.text if line.label is None else f"{line.label} {line.text}"


def _pipe_table(table: Table) -> Iterator[str]:
    yield _pipes([table.corner, *names(table)])
    yield "|" + ":---|" + "---:|" * len(table.columns)
    for row in table.rows:
        if row.cells:
            yield _pipes([row.label, *spread(row.cells)])
        elif row != RULE:
            yield f"| **{in_markdown(row.label)}** |" + " |" * len(table.columns)


def names(table: Table) -> list[str]:
    """Return a name for each column, made of its headings from the top down; a repeated part occurs once."""
    levels = [spread(row.cells) for row in table.headings()]
    return [" ".join(dict.fromkeys(part for part in column if part)) for column in zip(*levels, strict=True)]


def _pipes(texts: Iterable[str]) -> str:
    return "| " + " | ".join(in_markdown(text.strip()) for text in texts) + " |"


def latex(document: Document) -> str:
    r"""Return a document for \input: a longtable with rules of booktabs for each table."""
    parts = [part for section in document for block in section for part in _latex(block)]
    return "\n".join([HEAD, *parts])


def in_latex(text: str) -> str:
    """Return a text with LaTeX's special characters escaped, units typeset, and only ASCII characters."""
    pieces = re.split("(" + "|".join(re.escape(unit) for unit in sorted(POWERS, key=len, reverse=True)) + ")", text)
    return "".join(POWERS.get(piece) or "".join(_sign(sign) for sign in piece) for piece in pieces)


def _sign(sign: str) -> str:
    if sign.isascii():
        return SIGNS.get(sign, sign if sign.isprintable() else " ")
    return "?" if not sign.isprintable() else rf"\symbol{{{ord(sign)}}}" if ord(sign) < 256 else "?"


def _latex(block: Block) -> Iterator[str]:
    if isinstance(block, Table):
        yield "\n".join(_long_table(block))
        yield "\n".join([*(rf"\noindent {in_latex(note)}\par" for note in block.notes), ""])
    else:
        yield rf"\noindent {in_latex(_labelled(block).strip())}\par" + "\n"


def _long_table(table: Table) -> Iterator[str]:
    columns = len(table.columns)
    wide = [_is_wordy(table, column) for column in range(columns)]
    kinds = "".join(r"p{3.5cm}" if wordy else "r" for wordy in wide)
    small = r"\scriptsize\setlength{\tabcolsep}{2pt}" if columns > 6 or any(wide) else r"\small"
    yield rf"{{{small}"
    yield rf"\begin{{longtable}}{{@{{}}l{kinds}@{{}}}}"
    yield rf"\caption{{{in_latex(table.title)}}}\\"
    yield r"\toprule"
    heads = table.headings()
    for row in heads:
        yield _tex_row(row, in_latex)
        if row is not heads[-1]:
            yield " ".join(rf"\cmidrule(lr){{{a + 2}-{b + 2}}}" for a, b, _ in runs(row.cells) if b > a)
    yield r"\midrule"
    yield r"\endhead"
    for row in table.rows:
        if row.cells:
            yield _tex_row(row, number)
        elif row == RULE:
            yield r"\midrule"
        else:
            yield rf"\addlinespace \multicolumn{{{columns + 1}}}{{@{{}}l}}{{\textit{{{in_latex(row.label)}}}}}\\"
    yield r"\bottomrule"
    yield "\\end{longtable}}\n"


def _is_wordy(table: Table, column: int) -> bool:
    """Return whether a column contains sentences."""
    return max((len(row.cells[column] or "") for row in table.rows if row.cells), default=0) > WORDY


def _tex_row(row: Row, spelt: Callable[[str], str]) -> str:
    """Return a row; what reaches over columns, and every heading, stands in their middle."""
    cells = []
    for first, last, cell in runs(row.cells):
        text, heading = spelt(cell.strip()), spelt is in_latex
        cells.append(text if first == last and not heading else rf"\multicolumn{{{last - first + 1}}}{{c}}{{{text}}}")
    return " & ".join([in_latex(row.label), *cells]) + r" \\"


def number(text: str) -> str:
    """Return the text of a cell: powers of ten and minus signs typeset, "-" as a dash."""
    if text == "-":
        return "--"
    power = EXPONENT.match(text)
    if power:
        return rf"${power[1]}\times10^{{{int(power[2])}}}${in_latex(power[3])}"
    return NEGATIVE.sub(lambda _: r"$-$", in_latex(text))
