"""The output of `rths calibrate`, as text and with `--json`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rths_cli.report.document import Line, grid, labelled, labelled_lines, verdict_line
from rths_cli.report.to_text import text

if TYPE_CHECKING:
    from rths_cli.laboratory.calibrate import CalibrationMade, Row

HEADINGS = ("", "unit", "declared", "measured", "found", "before, %", "after, %", "alone, %")
ABOUT = (
    "standard uncertainties: before the measurements, after them together with the ratios of the model, and of each by "
    "itself, which is the prior of later identifications"
)


def verdict(made: CalibrationMade) -> str:
    """Return in one sentence how much was measured, the uncertainties that this leaves, and the file."""
    measured = sum(row.measured is not None for row in made.rows)
    word = "CALIBRATED" if measured else "NOTHING MEASURED"
    before, after = (_percents([getattr(row, when) for row in made.rows]) for when in ("before", "after"))
    return (
        f"{word}: {measured} of {len(made.rows)} sensors and masses measured; standard uncertainties {after}, "
        f"before {before}; wrote {made.file}"
    )


def _percents(shares: Sequence[float]) -> str:
    """Return the smallest and the largest of some shares in per cent, once where they are equal."""
    ends = dict.fromkeys(f"{100.0 * end:.3g}" for end in (min(shares), max(shares)))
    return f"{' to '.join(ends)} %"


def page(made: CalibrationMade) -> str:
    """Return the result of `rths calibrate` as text."""
    rows = [_cells(row) for row in made.rows]
    about = made.calibration
    head = f"Calibration of {about.told}, rig {about.rig}{f', ratios of {about.model}' if about.model else ''}"
    notes = [labelled("uncertainties", ABOUT), *labelled_lines("next", made.notes)]
    return text([[verdict_line(verdict(made)), Line(head)], [grid([HEADINGS, *rows])], notes])


def _cells(row: Row) -> tuple[str, ...]:
    return (
        f"mass of {row.name}" if row.unit == "kg" else row.name,
        row.unit,
        f"{row.declared:.6g}",
        "" if row.measured is None else f"{row.measured:.6g}",
        f"{row.found:.6g}",
        *(f"{100.0 * one:.3f}" for one in (row.before, row.after, row.alone)),
    )


def document(made: CalibrationMade) -> dict[str, Any]:
    """Return the result of `rths calibrate` as a document for JSON."""
    about = made.calibration
    head = {"file": str(made.file), "rig": about.rig, "made_utc": about.made_utc, "by": about.by, "model": about.model}
    return {"verdict": verdict(made), **head, "rows": [asdict(row) for row in made.rows], "notes": list(made.notes)}
