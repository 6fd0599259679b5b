"""Section of error tables: those of report/paper_tables.py, single_case_table.py and paper_claims.py as HTML."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rths_cli.quantities.units import typeset
from rths_cli.report.page.html import Html, classed, details, element, framed, join, table
from rths_cli.report.page.summary import BAD, GOOD, OPEN, pill
from rths_cli.report.paper_claims import CLAIMS, HELD, NOT_HELD, UNJUDGED, Claim, Verdict, judge
from rths_cli.report.paper_tables import response_tables, tracking_tables
from rths_cli.report.result_tables import TRUE, WORDS, test_band
from rths_cli.report.results_by_case import Entry, sources
from rths_cli.report.single_case_table import single_table
from rths_cli.report.table_cells import remarks
from rths_cli.report.text_layout import Cell, Row, Table

JUDGED = {HELD: GOOD, NOT_HELD: BAD}


def error_tables(cases: Sequence[Entry]) -> Html:
    """Return the error tables of the cases on one shake table, with the legend and remarks on runs that failed."""
    found = (
        [single_table(cases[0], "mm/s^2")] if len(cases) == 1 else [*tracking_tables(cases), *response_tables(cases)]
    )
    lines = [*sources(cases), test_band(cases), *([TRUE] if cases[0].virtual else []), WORDS, *remarks(cases)]
    return join([*(as_html(one) for one in found), *(classed("p", "note", line) for line in lines)])


def as_html(shown: Table) -> Html:
    """Return a table with its title, with bars as in the text form."""
    corners = [""] * (len(shown.headers) - 1) + [shown.corner]
    heads = (_row("th", corner, cells, shown) for corner, cells in zip(corners, shown.headers, strict=True))
    rows = (_row("td", row.label, row.cells, shown) if row.cells else _heading(row, shown) for row in shown.rows)
    title = typeset(shown.title)
    about = {"class": "figures", "aria-label": title}
    body = element("table", element("thead", *heads), element("tbody", *rows), attributes=about)
    return join([element("h4", title), framed(body)])


def claims(cases: Sequence[Entry]) -> Html:
    """Return the counted verdicts on the paper's claims, with all comparisons folded."""
    return join(_claim(place, claim, cases) for place, claim in enumerate(CLAIMS, 1))


def _claim(place: int, claim: Claim, cases: Sequence[Entry]) -> Html:
    found = judge(claim, cases, "")
    if not found:
        return Html("")
    counts = element(
        "div", *(part for source in dict.fromkeys(v.source for v in found) for part in _count(source, found))
    )
    rows = ([v.where, v.source, v.verdict, v.because] for v in found)
    compared = table([["where", "source", "verdict", "metrics compared, measured (m/s²)"]], rows)
    return join([element("p", element("strong", f"{place}. {claim.text}")), counts, details("comparisons", compared)])


def _count(source: str, found: Sequence[Verdict]) -> Iterator[Html]:
    mine = [verdict.verdict for verdict in found if verdict.source == source]
    judged = [word for word in mine if word in JUDGED]
    for word, kind in JUDGED.items():
        if word in judged:
            yield join([pill(kind, f"{source}: {word} in {judged.count(word)} of {len(judged)}"), " "])
    if len(judged) < len(mine):
        yield join([pill(OPEN, f"{source}: {UNJUDGED} in {len(mine) - len(judged)}"), " "])


def _row(kind: str, label: str, cells: Sequence[Cell], shown: Table) -> Html:
    """Return a row; the last cell of each group has a bar."""
    ends = {sum(shown.groups[: place + 1]) for place in range(len(shown.groups))}
    parts, column = [element("th", label, attributes={"scope": "row"} if kind == "td" else None)], 0
    for cell in cells:
        column += cell.span
        span = {"colspan": str(cell.span)} if cell.span > 1 else {}
        bar = {"class": "end"} if column in ends else {}
        parts.append(element(kind, f"{cell.text}{cell.mark}".strip(), attributes=span | bar))
    return element("tr", *parts)


def _heading(row: Row, shown: Table) -> Html:
    attributes = {"colspan": str(sum(shown.groups) + 1), "class": "heading"}
    return element("tr", element("th", element("span", row.label), attributes=attributes))
