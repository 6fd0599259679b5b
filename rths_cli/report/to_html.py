"""A document's tables and other elements as HTML; all text is escaped, so that nothing can be injected."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from html import escape

from rths_cli.quantities.declaration import typeset
from rths_cli.report.document import RULE, Block, Row, Section, Table, runs

UNSEEN = dict.fromkeys((*range(9), 11, 12, *range(14, 32), 127, *range(0xD800, 0xE000)), "�")
IN_SCRIPT = {ord(sign): f"\\u{ord(sign):04x}" for sign in "<>&\u2028\u2029"}


class Html(str):
    """A text that is HTML already; every other text is escaped when it is added to the page."""

    __slots__ = ()


def safe(content: str) -> Html:
    """Return HTML unchanged and text escaped; control characters and lone surrogates are replaced by a visible sign."""
    return content if isinstance(content, Html) else Html(escape(str(content).translate(UNSEEN), quote=True))


def join(parts: Iterable[str]) -> Html:
    """Return the joined parts, with text escaped."""
    return Html("".join(safe(part) for part in parts))


def element(name: str, *children: str, attributes: Mapping[str, str] | None = None) -> Html:
    """Return an element with its children; values of `attributes` are escaped, an empty one gives the name alone."""
    given = "".join(f' {key}="{safe(value)}"' if value else f" {key}" for key, value in (attributes or {}).items())
    return Html(f"<{name}{given}>{join(children)}</{name}>")


def classed(name: str, kind: str, *children: str) -> Html:
    """Return an element of a class."""
    return element(name, *children, attributes={"class": kind})


def data_script(name: str, document: object) -> Html:
    """Return an element with a document as JSON, which scripts find by its id; no text can end the element."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).translate(IN_SCRIPT)
    return Html(f'<script type="application/json" id="{safe(name)}">{text}</script>')


def table(shown: Table) -> Html:
    """Return a table in a frame that scrolls if it is wider than the page, its title above; the first column holds the
    row labels.

    Its class is "texts" if all columns hold words, else "figures" (right-aligned numbers).
    """
    heads = (_row("th", row, shown) for row in shown.headings())
    rows = (_row("td", row, shown) for row in shown.rows if row != RULE)
    title = typeset(shown.title)
    about = {"class": "texts" if all(column.words for column in shown.columns) else "figures"}
    about |= {"aria-label": title} if title else {}
    body = element("table", element("thead", *heads), element("tbody", *rows), attributes=about)
    notes = (classed("p", "note", note) for note in shown.notes)
    return join([*([element("h4", title)] if title else []), framed(body), *notes])


def _row(kind: str, row: Row, shown: Table) -> Html:
    """Return a row, or a heading across the table; the last cell of each group has a bar."""
    if not row.cells:
        across = {"colspan": str(len(shown.columns) + 1), "class": "heading"}
        return element("tr", element("th", element("span", row.label), attributes=across))
    ends = shown.ends() if len(shown.ends()) > 1 else set()
    parts = [element("th", row.label, attributes={"scope": "row"} if kind == "td" else None)]
    for first, last, cell in runs(row.cells):
        span = {"colspan": str(last - first + 1)} if last > first else {}
        bar = {"class": "end"} if last in ends else {}
        parts.append(element(kind, typeset(cell.strip()), attributes=span | bar))
    return element("tr", *parts)


def blocks(section: Section) -> Html:
    """Return a section: its tables, and sentences as paragraphs."""
    return join(_block(block) for block in section)


def _block(block: Block) -> Html:
    if isinstance(block, Table):
        return table(block)
    told = block.text if block.label is None else f"{block.label} {block.text}".strip()
    return classed("p", "note", told) if told else Html("")


def framed(wide: Html) -> Html:
    """Return a wide element in a frame that scrolls by itself, also by keyboard."""
    return element("div", wide, attributes={"class": "frame", "tabindex": "0"})


def details(title: str, *children: str, unfolded: bool = False) -> Html:
    """Return children that unfold at a click on their title; in print, they are shown as on the screen."""
    state = {"open": ""} if unfolded else {}
    return element("details", element("summary", title), *children, attributes=state)
