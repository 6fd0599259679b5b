"""Pages on a terminal of 60 columns: no line is longer, and no number of the wide page is missing."""

from __future__ import annotations

import re
from collections.abc import Callable

import made_up_check
import made_up_identification
import pytest
from made_up import paper_cases

from rths_cli.report import check_page, identification_page
from rths_cli.report.document import Column, Row, Table
from rths_cli.report.result_tables import tables
from rths_cli.report.to_text import laid_out_in, width
from rths_cli.report.to_text import text as printed

COLUMNS = 60


def table(label: str, columns: int = 5) -> Table:
    """Return a table of two groups of columns, with a heading over each."""
    heads = tuple(Column(f"h{side}{c:02}", (side,)) for side in ("left", "right") for c in range(columns))
    rows = (Row(f"{label} {k}", tuple(f"{k}{c:02}" for c in range(2 * columns))) for k in range(1, 4))
    return Table(heads, (Row("a heading " * 8), *rows), "A title " * 12, "corner", ("a note " * 20,))


def numbers(text: str) -> set[str]:
    return set(re.findall(r"\b\d{3}\b", text))


@pytest.mark.parametrize("label", ["row", "a label that alone is longer than a third of the page, and more"])
@pytest.mark.parametrize("columns", [2, 5, 11])
def test_a_wide_table_is_printed_in_parts(label: str, columns: int) -> None:
    wide = table(label, columns)
    with laid_out_in(COLUMNS):
        narrow = printed([[wide]])
    assert max(map(len, narrow.splitlines())) <= COLUMNS
    assert numbers(narrow) == {f"{k}{c:02}" for k in range(1, 4) for c in range(2 * columns)}
    assert width() == 100


def test_a_group_that_fits_by_itself_is_not_divided() -> None:
    with laid_out_in(COLUMNS):
        heads = [line for line in printed([[table("row")]]).splitlines() if line.endswith(("left|", "right|"))]
    assert [line.split("|")[1].strip() for line in heads] == ["left", "right"]


def test_a_table_that_fits_is_the_same_on_a_narrow_page() -> None:
    small = table("row", 2)
    with laid_out_in(COLUMNS):
        narrow = [line for line in printed([[small]]).splitlines() if "|" in line]
    assert [line.rstrip("| ") for line in narrow if "hleft00" in line] != []
    assert max(map(len, narrow)) <= COLUMNS


PAGES: dict[str, Callable[[], str]] = {
    "check": lambda: check_page.pages([made_up_check.checked("unsafe", ("a reason " * 20,))]),
    "identify": lambda: identification_page.page(made_up_identification.identification(), made_up_identification.ABOUT),
    "report": lambda: tables(paper_cases()),
}


@pytest.mark.parametrize("command", PAGES)
def test_a_page_fits_a_narrow_terminal_and_says_the_same(command: str) -> None:
    wide = PAGES[command]()
    with laid_out_in(COLUMNS):
        narrow = PAGES[command]()
    assert max(map(len, wide.splitlines())) <= width()
    too_long = [line for line in narrow.splitlines() if len(line) > COLUMNS]
    assert not too_long
    told = re.compile(r"-?\d+\.\d+")
    assert set(told.findall(wide)) == set(told.findall(narrow))
