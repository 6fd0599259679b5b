"""Nothing that enters a page as text is ever anything but text."""

from __future__ import annotations

import json

import page_reader
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rths_cli.report.document import grid
from rths_cli.report.to_html import Html, classed, data_script, element, join, safe, table

HOSTILE = [
    "</script><script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    '"><svg onload=alert(1)>',
    "' autofocus onfocus='alert(1)",
    "<!--<script>",
    "]]>&lt;&amp;",
    "\u2028\u2029\x00\x1b[31m\ud800",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_text_stays_text(text: str) -> None:
    shown = table(grid([["", text], [text, text]], words=True))
    made = join([element("p", text, attributes={"title": text}), classed("b", text, text), shown])
    page = page_reader.read(made)
    assert {tag for tag, _ in page.elements} == {"p", "b", "div", "table", "thead", "tbody", "tr", "th", "td"}
    assert {name for _, attributes in page.elements for name in attributes} == {"title", "class", "tabindex", "scope"}
    assert not page.wrong and not page.open_
    if text.isprintable():
        assert page.all("p") == [{"title": text}] and page.texts[0] == ("p", text)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.text())
def test_any_text_comes_back_but_for_what_cannot_be_shown(text: str) -> None:
    page = page_reader.read(element("p", text))
    told = "".join(part for _, part in page.texts)
    assert page.elements == [("p", {})]
    assert len(told) == len(text.replace("\r\n", "\n"))


@pytest.mark.parametrize("text", HOSTILE)
def test_data_cannot_end_their_element(text: str) -> None:
    made = data_script("d", {text: [text, {"x": text}]})
    assert made.count("<") == 2 and made.endswith("</script>")
    assert "\u2028" not in made
    inside = made[made.index(">") + 1 : -len("</script>")]
    assert json.loads(inside) == {text: [text, {"x": text}]}


def test_html_is_not_escaped_twice_and_numbers_must_be_finite() -> None:
    assert safe(element("b", "a & b")) == "<b>a &amp; b</b>"
    assert element("details", Html("<b></b>"), attributes={"open": ""}) == "<details open><b></b></details>"
    with pytest.raises(ValueError):
        data_script("d", float("nan"))


def test_what_no_page_can_hold_becomes_a_sign() -> None:
    assert safe("a\x00\x1b\x7f\ud800\n\tb") == "a\ufffd\ufffd\ufffd\ufffd\n\tb"
    assert page_reader.read(element("p", "\udfff")).texts == [("p", "\ufffd")]
