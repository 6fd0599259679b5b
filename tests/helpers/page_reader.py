"""Read a report page as a stranger would: by the standard library's parser, and by the words of its data alone."""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

VOID = {"meta", "link"}


@dataclass
class Page(HTMLParser):
    """Hold elements with attributes, their texts by name, and whatever was closed in a wrong order."""

    elements: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    texts: list[tuple[str, str]] = field(default_factory=list)
    open_: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open_.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if not self.open_ or self.open_.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data: str) -> None:
        self.texts.append((self.open_[-1] if self.open_ else "", data))

    def all(self, name: str) -> list[dict[str, str]]:
        """Return the attributes of every element of a name."""
        return [attributes for tag, attributes in self.elements if tag == name]

    def words(self) -> str:
        """Return all text but that of styles and scripts."""
        return " ".join(text for tag, text in self.texts if tag not in ("style", "script"))


def read(text: str) -> Page:
    """Return a parsed page."""
    page = Page()
    page.feed(text)
    page.close()
    return page


def data(text: str) -> dict[str, Any]:
    """Return the document that the script plots."""
    start = text.index(">", text.index('id="rths-data"')) + 1
    return json.loads(text[start : text.index("</script>", start)])


def series(packed: dict[str, Any]) -> tuple[list[int], list[float]]:
    """Return places and values of a packed series, NaN for what was lost."""
    letter = {1: "B", 2: "H", 4: "I"}[packed["w"]]
    steps = _numbers(packed["i"], letter)
    raw = _numbers(packed["y"], "h" if packed["k"] else "f")
    values = [float("nan") if v == -32768 else v * packed["k"] for v in raw] if packed["k"] else raw
    places, place = [], 0
    for step in steps:
        place += step
        places.append(place)
    return places, values


def floats(text: str) -> list[float]:
    """Return packed floats."""
    return _numbers(text, "f")


def _numbers(text: str, letter: str) -> list[Any]:
    raw = base64.b64decode(text)
    return list(struct.unpack(f"<{len(raw) // struct.calcsize(letter)}{letter}", raw))
