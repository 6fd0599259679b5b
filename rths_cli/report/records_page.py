"""`rths records` of several motions: a row for each, and what is wrong with any of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rths_cli.report.document import Block, Column, Document, Line, by_columns

COLUMNS = (  # name, unit, value of a motion
    ("PGA", "m/s^2", "pga_m_s2", 1.0),
    ("PGV", "m/s", "pgv_m_s", 1.0),
    ("PGD", "mm", "pgd_m", 1e3),
    ("Arias", "m/s", "arias_m_s", 1.0),
    ("D5-95", "s", "d5_95_s", 1.0),
    ("Tm", "s", "mean_period_s", 1.0),
)


def document(found: Sequence[Mapping[str, Any]], faults: Sequence[str] = ()) -> Document:
    """Return the motions as a table, then a line on each that is doubted or was corrected by its agency, and on each
    file that cannot be read."""
    labels = [Path(one["file"]).name for one in found]
    if not found:
        return [[*map(Line, faults)]]
    words = [
        (Column("component", words=True), [one["component"] or "-" for one in found]),
        (Column("station", words=True), [one["station"] or "-" for one in found]),
        (Column("unit", words=True), [one["unit"] for one in found]),
        (Column("duration", unit="s"), [f"{one['duration_s']:.4g}" for one in found]),
    ]
    numbers = [
        (Column(name, unit=unit), [f"{factor * one['measures'][key]:.4g}" for one in found])
        for name, unit, key, factor in COLUMNS
    ]
    if "playable" in found[0]:
        played = [one["playable"] for one in found]
        words.append((Column("limited by", words=True), [one["limited_by"] for one in played]))
        numbers.insert(0, (Column("largest scale"), [f"{one['largest_scale']:.3g}" for one in played]))
    table = by_columns("record", labels, [*words, *numbers])
    notes: list[Block] = [
        Line(f"{label} {one['component']}: {text}".replace(" : ", ": "))
        for label, one in zip(labels, found, strict=True)
        for text in (one["corrected"] and f"corrected: {one['corrected']}", one["baseline_doubt"], *one["defects"])
        if text
    ]
    return [[table, *notes, *map(Line, faults)]]
