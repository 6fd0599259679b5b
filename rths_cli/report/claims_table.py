"""The verdicts on the paper's claims as a table: one line per claim, place and source of figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rths_cli.report.claims import CLAIMS, Claim, judge
from rths_cli.report.layout import Cell, Row, Table
from rths_cli.report.load import Entry

HEADS = (Cell("source"), Cell("measured"), Cell("true"), Cell("figures compared"))


def claims_tables(cases: Sequence[Entry]) -> Iterator[Table]:
    """Yield a table per claim that can be made of these cases: where, verdicts, and the figures compared."""
    for place, claim in enumerate(CLAIMS, 1):
        rows = tuple(_rows(claim, cases))
        if rows:
            title = f"Claim {place} of the paper: {claim.text} (m/s^2, test band); {cases[0].table_name}"
            yield Table(title, "where", (4,), 16, (HEADS,), rows)


def _rows(claim: Claim, cases: Sequence[Entry]) -> Iterator[Row]:
    virtual = cases[0].virtual
    measured = judge(claim, cases, "")
    true = judge(claim, cases, "_true") if virtual else measured
    for seen, real in zip(measured, true, strict=True):
        verdict = real.verdict if virtual and seen.source != "published" else "-"
        texts = (seen.source, seen.verdict, verdict, seen.because)
        yield Row(seen.where, tuple(Cell(text) for text in texts))
