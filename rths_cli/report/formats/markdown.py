"""`--format markdown`: pipe tables, for a repository's pages, issues and merge requests."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from rths_cli.report.formats.csv_table import filled, names, width
from rths_cli.report.text_layout import Block, Paragraphs, Row, Table

SPECIAL = re.compile(r"([\\`*_\[\]<>|#~$])")


def markdown(blocks: Iterable[Block]) -> str:
    """Return blocks as Markdown: a heading and a pipe table each, sentences as paragraphs."""
    parts = [part for block in blocks for part in _parts(block)]
    return "\n\n".join(["# Report of hybrid simulations", *parts]) + "\n"


def escaped(text: str) -> str:
    """Return a text with the special characters of Markdown and HTML escaped."""
    return SPECIAL.sub(r"\\\1", " ".join(text.split())).replace("&", "&amp;")


def _parts(block: Block) -> Iterator[str]:
    if isinstance(block, Table):
        yield f"## {escaped(block.title)}"
        yield "\n".join(_lines(block))
        if block.notes:
            yield "\n".join(f"- {escaped(note)}" for note in block.notes)
    elif isinstance(block, Paragraphs):
        yield "\n".join(f"{'- ' if line.startswith(' ') else ''}{escaped(line)}  " for line in block.lines)
    else:
        fence = "`" * max(3, 1 + max((len(run) for run in re.findall(r"`+", block.text)), default=0))
        yield f"{fence}text\n{block.text}\n{fence}"


def _lines(table: Table) -> Iterator[str]:
    columns = width(table)
    yield _line([table.corner, *names(table)])
    yield "|" + ":---|" + "---:|" * columns
    for row in table.rows:
        yield _line([row.label, *filled(row, columns)]) if row.cells else _heading(row, columns)


def _heading(row: Row, columns: int) -> str:
    return f"| **{escaped(row.label)}** |" + " |" * columns


def _line(texts: Iterable[str]) -> str:
    return "| " + " | ".join(escaped(text) for text in texts) + " |"
