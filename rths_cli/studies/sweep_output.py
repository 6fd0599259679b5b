"""The files of a sweep: where its table goes, which runs an interrupted one has already, all rows joined."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.case.load import resolved_yaml
from rths_cli.errors import InputError
from rths_cli.experiment.run_case import worst_code
from rths_cli.files.durable_files import Stamp, is_stream, stamp
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_writer import check_writable
from rths_cli.files.sweep_file import (
    Figure,
    Sweep,
    count_rows,
    read_attributes,
    read_rows,
    rows_path,
    stored_values,
)
from rths_cli.studies.sweep_table import Row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.studies.grid_points import Points
    from rths_cli.studies.sweep_table import Table

IDENTITY = ("plan_sha256", "software_sha256", "part")
OTHER = "another sweep (case, grid, options, part or version of rths differ)"
STRANGE = "holds rows that are not of this sweep; remove it and run the sweep anew"
ELSEWHERE = "choose another --output, or remove the file"
BYTES_PER_RUN = 3000  # of rows and result file, for the check of free space


@dataclass(frozen=True)
class Begun:
    """A sweep about to be played: the root attributes of its file, and whether an earlier start has played rows."""

    path: Path
    attributes: dict[str, Any]
    resumed: bool
    replaces: Stamp = None  # a finished file


def begin(
    path: Path, attributes: dict[str, Any], runs: int, replace: bool, resume: bool, force: bool = False
) -> Begun | None:
    """Return the sweep of so many runs to be played, None when the file is whole and `resume` asks for what is left.

    Raises InputError where the file cannot be written or would replace what it must not; with `force` it may be that of
    another plan.
    """
    if path.is_dir():
        raise InputError(f"--output {path}: is a folder; give the name of a file in it")
    begun = _under_way(path, attributes, resume) if rows_path(path).exists() else None
    if begun is None and path.exists() and not is_stream(path):
        if _is_whole(path, attributes, resume):
            return None
        if replace and not force:
            check_same_plan(path, attributes)
    if begun is None:
        check_existing([(path, Kind.SWEEP)], replace)
    check_writable(path.parent, BYTES_PER_RUN * runs)
    return begun or Begun(path, attributes, False, stamp(path))


def check_same_plan(path: Path, attributes: Mapping[str, Any]) -> None:
    """Raise InputError for a finished sweep of another plan or part than a new one that is to take its place."""
    stored = read_attributes(path)
    if any(stored.get(name) != attributes.get(name) for name in ("plan_sha256", "part")):
        raise InputError(
            f"{path}: exists and holds another sweep (case, grid, options or part differ); choose another --output, or "
            "add --force to replace it"
        )


def _under_way(path: Path, attributes: Mapping[str, Any], resume: bool) -> Begun:
    """Return the sweep whose rows stand beside the file."""
    place = rows_path(path)
    stored, _ = read_rows(place)
    if any(stored.get(name) != attributes.get(name) for name in IDENTITY):
        raise InputError(f"{place}: holds {count_rows(place)} runs of {OTHER}; {ELSEWHERE}")
    if not resume:
        raise InputError(
            f"{place}: holds {count_rows(place)} runs of this sweep, which was interrupted; add --resume to go on, or "
            "remove the file to begin anew"
        )
    begun = {name: value for name, value in stored.items() if name != "format"}
    if _types(begun) != _types(attributes):
        raise InputError(f"{place}: {STRANGE}")
    return Begun(path, begun, True)


def take_rows(begun: Begun, rows: Table) -> None:
    """Put the rows that an earlier start has played into the table; raises InputError for one of another sweep."""
    if not begun.resumed:
        return
    place = rows_path(begun.path)
    for line in read_rows(place)[1]:
        if not (_is_row(line, rows.width) and rows.has(line[0])):
            raise InputError(f"{place}: {STRANGE}")
        rows.add(_row(line))


def _types(attributes: Mapping[str, Any]) -> dict[str, type]:
    """Return which attributes there are, and of what type each is."""
    return {name: type(value) for name, value in attributes.items()}


def _is_row(line: Any, figures: int) -> bool:
    """Tell whether a line is of the types that `as_line` makes, and of this sweep."""
    if not isinstance(line, list) or [type(item) for item in line] != [int, str, str, int, str, str, str, list]:
        return False
    return len(line[-1]) == figures and all(isinstance(item, int | float) for item in line[-1])


def _row(line: list[Any]) -> Row:
    """Return a row from what `as_line` made of it."""
    variant, status, reason, exit_code, verdict, model, processor, figures = line
    return Row(variant, status, reason, exit_code, verdict, model, processor, np.array(figures, dtype=float))


def _is_whole(path: Path, attributes: Mapping[str, Any], resume: bool) -> bool:
    """Tell whether a finished file answers what is asked; raises InputError if it is no sweep, or another one is to be
    resumed."""
    stored = read_attributes(path)
    if resume and any(stored.get(name) != attributes.get(name) for name in ("plan_sha256", "part")):
        raise InputError(f"{path}: holds {OTHER}; {ELSEWHERE}")
    return resume and stored.get("software_sha256") == attributes["software_sha256"]


def as_line(row: Row) -> list[Any]:
    """Return a row as the file of a sweep under way holds it."""
    *start, figures = astuple(row)
    return [*start, figures.tolist()]


def as_sweep(points: Points, begun: Begun, rows: Table, part: NDArray[np.int64] | None = None) -> Sweep:
    """Return the table of all rows, in the order of the plan; `part` (n,): of these rows alone, in ascending order."""
    plan, figures, texts = points.plan, rows.figures, rows.texts
    ends = {
        "status": "complete",
        "status_reason": told(Counter(texts["status"])),
        "exit_code": worst_code(rows.exit_codes),
    }
    written = points.planned.case
    study = points.planned.study
    varied, seeds = dict(plan.columns()), np.tile(np.array(plan.seeds, dtype=np.int64), plan.points)
    if part is not None:  # values are stored as numbers or texts by what they are in the whole sweep
        varied, seeds = {key: stored_values(values)[part] for key, values in varied.items()}, seeds[part]
    return Sweep(
        begun.attributes | ends,
        written.text,
        resolved_yaml(points.base.case),
        len(plan.seeds),
        varied,
        seeds,
        texts,
        {column.path: Figure(figures[column.path], column.units, column.definition) for column in points.columns},
        study.read_text(encoding="utf-8-sig") if study else "",
        None if part is None else part + 1,
    )


def several_processors(sweep: Sweep) -> str:
    """Return a sentence where the runs were computed on processors of several kinds, else nothing."""
    kinds = len(set(sweep.texts["processor"]))
    return f"the runs were computed on processors of {kinds} kinds, which may round differently" if kinds > 1 else ""


def told(counts: Mapping[str, int]) -> str:
    """Return how many runs ended how."""
    return ", ".join(f"{counts[status]} {status}" for status in sorted(counts))
