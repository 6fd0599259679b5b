"""HTML elements; all text is escaped, so that nothing can be injected."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from html import escape
from itertools import groupby

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


def table(
    head: Iterable[Iterable[str]], body: Iterable[Iterable[str]], kind: str = "texts", groups: Iterable[str] = ()
) -> Html:
    """Return a table in a frame that scrolls if it is wider than the page; the first column holds the row labels.

    `kind`: class of the table, "texts" or "figures" (right-aligned numbers). `groups`: heading above each column,
    which columns beside each other share.
    """
    shared = [(name, str(len(list(same)))) for name, same in groupby(groups)]
    top = [element("tr", *(element("th", name, attributes={"colspan": span}) for name, span in shared))]
    heads = join([*(top if shared else []), *(element("tr", *(element("th", cell) for cell in row)) for row in head)])
    rows = join(_row(list(row)) for row in body)
    return framed(classed("table", kind, element("thead", heads), element("tbody", rows)))


def framed(wide: Html) -> Html:
    """Return a wide element in a frame that scrolls by itself, also by keyboard."""
    return element("div", wide, attributes={"class": "frame", "tabindex": "0"})


def details(title: str, *children: str, unfolded: bool = False) -> Html:
    """Return children that unfold at a click on their title; in print, they are shown as on the screen."""
    state = {"open": ""} if unfolded else {}
    return element("details", element("summary", title), *children, attributes=state)


def _row(cells: list[str]) -> Html:
    label = element("th", cells[0], attributes={"scope": "row"})
    return element("tr", label, *(element("td", cell) for cell in cells[1:]))
