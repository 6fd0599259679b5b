"""The output of `rths calibrate`, as text and with `--json`."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rths_cli.report.document import Line, grid, labelled, labelled_lines
from rths_cli.report.to_text import text

if TYPE_CHECKING:
    from rths_cli.laboratory.calibrate import CalibrationMade, Row

HEADINGS = ("", "unit", "declared", "measured", "found", "before, %", "after, %", "alone, %")
ABOUT = (
    "standard uncertainties: before the measurements, after them together with the ratios of the model, and of each by "
    "itself, which is the prior of later identifications"
)


def page(made: CalibrationMade) -> str:
    """Return the result of `rths calibrate` as text."""
    rows = [_cells(row) for row in made.rows]
    about = made.calibration
    head = f"Calibration of {about.told}, rig {about.rig}{f', ratios of {about.model}' if about.model else ''}"
    notes = [labelled("wrote", str(made.file)), labelled("uncertainties", ABOUT), *labelled_lines("next", made.notes)]
    return text([[Line(head), grid([HEADINGS, *rows])], notes])


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
    return {**head, "rows": [asdict(row) for row in made.rows], "notes": list(made.notes)}
