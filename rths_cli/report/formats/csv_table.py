"""`--format csv`: tidy table, one metric of one run per line, with the attributes that identify the run."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping

import numpy as np

from rths_cli.files.hdf5 import INTERVAL
from rths_cli.files.result_reader import Result
from rths_cli.quantities import Interval
from rths_cli.report.group_comparison import software
from rths_cli.report.report_contents import Contents
from rths_cli.report.result_scale import scale_words
from rths_cli.safe_text import csv_cell

ABOUT = (
    "case_name", "method", "rig", "rig_kind", "record_name", "scaling", "damping_name", "controller", "seed",
    "created_utc", "status", "status_reason",
)  # fmt: skip
SCALE = ("reported_in", "scale_length", "scale_acceleration", "scale_mass")
COLUMNS = ("file", *ABOUT, "software", "figure", "number", "value", "unit", "published")
UNREADABLE = "unreadable"


def tidy(found: Contents) -> str:
    """Return the metrics as CSV (RFC 4180, except that lines end with a newline character).

    The column `number` counts storeys, modes or frequencies from 1; it is empty for a metric with one value. A run
    without metrics, and a file that cannot be read, have one line each. The columns of INTERVAL are there if a metric
    carries an interval, those of SCALE if a case states a scale; `reported_in` is that of the building's values.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    ends = INTERVAL if any(result.intervals for result in found.inputs.results) else ()
    scales = SCALE if any(scale_words(result) for result in found.inputs.results) else ()
    columns = (*COLUMNS, *ends, *scales)
    writer.writerow(columns)
    for result in found.inputs.results:
        told = _scale(result) if scales else []
        writer.writerows([*line, *told] for line in _lines(result, bool(ends)))
    for one in found.unread:
        known = {"file": str(one.path), "status": UNREADABLE, "status_reason": one.sentence}
        stated = {column: csv_cell(text) for column, text in known.items()}
        writer.writerow([stated.get(column, "") for column in columns])
    return text.getvalue()


def _lines(result: Result, with_intervals: bool) -> Iterator[list[str]]:
    told = (str(result.path), *(result.attributes.get(key) for key in ABOUT), software(result))
    about = [_text(value) for value in told]
    published = json.loads(str(result.attributes.get("reference_json") or "{}"))
    if not result.metrics:
        yield [*about, "", "", "", "", "", *[""] * (len(INTERVAL) if with_intervals else 0)]
    for path, value in sorted(result.metrics.items()):
        values = np.asarray(value, dtype=float)
        for number, item in enumerate(values.ravel(), 1):
            place = str(number) if values.ndim else ""
            unit = csv_cell(result.units[path])
            ends = _ends(result.intervals.get(path), number) if with_intervals else []
            yield [*about, csv_cell(path), place, _number(item), unit, _published(published, path, number), *ends]


def _ends(interval: Interval | None, number: int) -> list[str]:
    """Return the texts of the columns INTERVAL for one value of a metric, counted from 1."""
    if interval is None:
        return [""] * len(INTERVAL)
    ends = (np.atleast_1d(end)[number - 1] for end in (interval.low, interval.high))
    return [*map(_number, ends), _number(interval.probability)]


def _scale(result: Result) -> list[str]:
    """Return the texts of the columns SCALE of a result."""
    return [scale_words(result).partition(" ")[0], *(_text(result.attributes.get(key)) for key in SCALE[1:])]


def _published(figures: Mapping[str, object], path: str, number: int) -> str:
    values = np.atleast_1d(np.asarray(figures.get(path, []), dtype=float))
    return _number(values[number - 1]) if number <= values.size else ""


def _number(value: float) -> str:
    """Return a number with all digits of a double, "" if it is not finite."""
    return repr(float(value)) if np.isfinite(value) else ""


def _text(value: object) -> str:
    return csv_cell(value) if isinstance(value, str) else "" if value is None else str(value)
