"""`rths list results`: a line for each result of a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rths_cli.errors import InputError
from rths_cli.files.result_reader import COMPLETE, Result, read_summary
from rths_cli.files.stored_case import with_keys
from rths_cli.report.answer import grade
from rths_cli.report.document import Column, Document, Line, Table, Verdict, by_columns
from rths_cli.report.numbers import three

FIGURES = tuple(f"exp_rths.true_error_{name}_percent" for name in ("bound", "median"))  # from which a grade follows
ABOUT = ("created_utc", "rig", "case_name", "status", "exp_rths_status", "own_parts", "own_building")


@dataclass(frozen=True)
class ListedResult:
    """A result file, or a file that is none."""

    name: str  # of the file, without suffix
    file: str
    grade: str  # or how the run ended; "" for a file that is no result
    error_percent: float | None  # 95 % bound of the true error, in percent of SIM; None: not stated
    date: str  # UTC
    rig: str
    case: str
    megabytes: float
    fault: str = ""  # why the file is no result


def list_results(folder: Path) -> list[ListedResult]:
    """Return the results of a folder, the newest first, then the files that are none; raises InputError for no
    folder."""
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; name one that holds results, as rths run writes them to results/")
    found = [_listed(path) for path in sorted(folder.glob("*.h5"))]
    return sorted(found, key=lambda one: (not one.fault, one.date, one.name), reverse=True)


def _listed(path: Path) -> ListedResult:
    size = path.stat().st_size / 1e6 if path.exists() else 0.0
    try:
        result = read_summary(path, FIGURES, ABOUT)
    except InputError as error:
        return ListedResult(path.stem, str(path), "", None, "", "", "", size, str(error))
    about, found = result.attributes, grade(with_keys(result, ("grade_limits",)))
    date, rig, case = (str(about.get(key) or "-") for key in ("created_utc", "rig", "case_name"))
    bound = found.percent if found else None
    return ListedResult(path.stem, str(path), found.grade if found else _end(result), bound, date, rig, case, size)


def _end(result: Result) -> str:
    """Return how a result without a grade ended, a dash where nothing went wrong."""
    ended = result.attributes.get("exp_rths_status") or result.attributes.get("status")
    return "-" if ended == COMPLETE else str(ended)


def as_document(results: Sequence[ListedResult], folder: Path) -> Document:
    """Return the results as a table, and a line for each file that is none."""
    whole = [one for one in results if not one.fault]
    columns: list[tuple[Column, Sequence[str]]] = [
        (Column("grade", words=True), [Verdict(one.grade) for one in whole]),
        (
            Column("error", unit="% of SIM"),
            ["-" if one.error_percent is None else three(one.error_percent) for one in whole],
        ),
        (Column("date", unit="UTC", words=True), [one.date[:16].replace("T", " ") for one in whole]),
        (Column("rig", words=True), [one.rig for one in whole]),
        (Column("case", words=True), [one.case for one in whole]),
        (Column("size", unit="MB"), [three(one.megabytes) for one in whole]),
    ]
    table: list[Table | Line] = [by_columns("result", [one.name for one in whole], columns)] if whole else []
    faults = [Line(one.fault) for one in results if one.fault]
    return [[*table, *faults] or [Line(f"{folder}: holds no result file (*.h5)")]]


def as_data(results: Sequence[ListedResult]) -> list[dict[str, Any]]:
    """Return the results as plain texts and numbers for JSON."""
    return [asdict(one) for one in results]
