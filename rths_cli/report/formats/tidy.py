"""A report as CSV, tidy: one figure of one run a line, with all that tells the run apart."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping

import numpy as np

from rths_cli.files.results import Result
from rths_cli.printed import csv_cell
from rths_cli.report.contents import Contents
from rths_cli.report.groups import software

ABOUT = (
    "case_name", "method", "rig", "rig_kind", "record_name", "scaling", "damping_name", "controller", "seed",
    "created_utc", "status", "status_reason",
)  # fmt: skip
COLUMNS = ("file", *ABOUT, "software", "figure", "number", "value", "unit", "published")
UNREADABLE = "unreadable"


def tidy(found: Contents) -> str:
    """Return the figures as CSV (RFC 4180, but for line ends of one newline); `number` counts storeys, modes or
    frequencies from 1 and is empty for one value. A run without figures, or a file that cannot be read, has a line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for result in found.inputs.results:
        writer.writerows(_lines(result))
    for one in found.unread:
        told = {"file": str(one.path), "status": UNREADABLE, "status_reason": one.sentence}
        stated = {column: csv_cell(text) for column, text in told.items()}
        writer.writerow([stated.get(column, "") for column in COLUMNS])
    return text.getvalue()


def _lines(result: Result) -> Iterator[list[str]]:
    told = (str(result.path), *(result.attributes.get(key) for key in ABOUT), software(result))
    about = [_text(value) for value in told]
    published = json.loads(str(result.attributes.get("reference_json") or "{}"))
    if not result.metrics:
        yield [*about, "", "", "", "", ""]
    for path, value in sorted(result.metrics.items()):
        values = np.asarray(value, dtype=float)
        for number, item in enumerate(values.ravel(), 1):
            place = str(number) if values.ndim else ""
            unit = csv_cell(result.units[path])
            yield [*about, csv_cell(path), place, _number(item), unit, _published(published, path, number)]


def _published(figures: Mapping[str, object], path: str, number: int) -> str:
    values = np.atleast_1d(np.asarray(figures.get(path, []), dtype=float))
    return _number(values[number - 1]) if number <= values.size else ""


def _number(value: float) -> str:
    """Return a number that reads back to the last bit; empty for one that is not finite."""
    return repr(float(value)) if np.isfinite(value) else ""


def _text(value: object) -> str:
    return csv_cell(value) if isinstance(value, str) else "" if value is None else str(value)
