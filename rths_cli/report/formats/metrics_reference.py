"""Generate docs/reference/metrics.md from the declarations of the metrics."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from rths_cli.quantities import KINDS, Quantity, declared
from rths_cli.report.formats.markdown import escaped

HEAD = """# Every figure and its definition

Made from `rths_cli/quantities/metrics.py`; [how a test is judged](../background/metrics.md) has formulas and sources.
A figure stands in the result file under `/metrics/` with `/` for `.`, in `rths report --format json`, in CSV, and in a
case's `accept` under the path given here; one of several storeys as `exp_rths.rms_error_m_s2[3]`, counted from 1.
*Better* says which way an error or index improves; only figures that are better when
smaller are judged against a baseline. *Scales as* is the unit by whose factor a figure of the building is converted to
[prototype scale](../background/similitude.md); a figure without one belongs to the rig or the loop and stays in model
scale.

A figure may carry an interval, which holds the true one with a stated probability: the attributes `low`, `high` and
`probability` of its dataset, `intervals` in JSON and in Python, three more columns in CSV, and `[low, high]` behind the
figure in texts. Figures of the check carry one where the identified model has several samples.

Suffixes: {kinds}. Without one: measured, in the test band.
"""
COLUMNS = ("figure", "also with", "unit", "scales as", "one per", "better", "definition")


def reference_page() -> str:
    """Return the page as Markdown: a table per group of figures."""
    kinds = "; ".join(f"`{suffix}` {words}" for suffix, words in KINDS.items())
    parts = [HEAD.format(kinds=kinds)]
    for group, members in groupby(declared(), key=lambda one: one.group):
        lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS), *_rows(members)]
        parts.append(f"## {group}\n\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def _rows(members: Iterator[Quantity]) -> Iterator[str]:
    for one in members:
        kinds = ", ".join(f"`{kind}`" for kind in one.kinds) or "-"
        words = (kinds, one.units, one.scales_as or "-", one.over or "-", one.better, escaped(one.text))
        cells = (f"`{one.path}`", *words)
        yield f"| {' | '.join(cells)} |"
