"""From what was asked, a case with options or a study file, to the case that is varied and the plan of its rows."""

from __future__ import annotations

import csv
import math
import operator
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.case.file_kinds import is_record
from rths_cli.case.load import WrittenCase, load_study, read_case, study_file, written_case
from rths_cli.case.named_files import suffixes
from rths_cli.case.study_schema import (
    ConstraintSpec,
    EmpiricalAxis,
    FolderAxis,
    ListAxis,
    RangeAxis,
    SamplesSpec,
    Strict,
    StudyKeys,
    is_sampled,
)
from rths_cli.case.yaml_reader import dump
from rths_cli.errors import InputError
from rths_cli.studies.plan import Axis, Block, Plan, checked_plan
from rths_cli.studies.sampling import chosen, correlated, normal_correlation, quantiles, unit_samples
from rths_cli.studies.varied_keys import read_axes, read_seeds, spaced, unvaried

COMPARED = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
MOST_CSV_BYTES = 1 << 28


@dataclass(frozen=True)
class Asked:
    """The case or study of a sweep, settings KEY=VALUE, the texts of --vary, and that of --seeds (None: not given)."""

    path: str
    settings: tuple[str, ...]
    vary: tuple[str, ...]
    seeds: str | None


@dataclass(frozen=True)
class Planned:
    """The case that is varied, as it is written; the rows; whether their seed is the case's own; the metrics that are
    kept (None: all); and the study file (None: a case was given)."""

    case: WrittenCase
    plan: Plan
    own_seed: bool
    metrics: tuple[str, ...] | None = None
    samples: SamplesSpec | None = None
    study: Path | None = None
    name: str = ""


def read_plan(asked: Asked) -> Planned:
    """Return the case and the rows that were asked for; raises InputError with every fault."""
    faults: list[str] = []
    typed = tuple((axis,) for axis in read_axes(asked.vary, faults))
    seeds = range(1) if asked.seeds is None else read_seeds(asked.seeds, faults)
    path = study_file(asked.path)
    if path is None:
        plan = checked_plan(Plan(typed, seeds), faults)
        return Planned(read_case(asked.path), plan, asked.seeds is None)
    study, places = load_study(path)
    folder = path.absolute().parent
    blocks = (*_listed_axes(study, places, folder, faults), *_sampled_axes(study, places, folder, faults))
    if asked.seeds is None and study.seeds is not None:
        seeds = range(study.seeds.first, study.seeds.last + 1)
    plan = checked_plan(Plan((*typed, *blocks), seeds, folder=folder), faults)
    own_seed = asked.seeds is None and study.seeds is None
    name = study.name or path.stem
    case = _case_of(study, path)
    return Planned(
        case, _constrained(plan, study.constraints, path), own_seed, study.metrics, study.samples, path, name
    )


def _case_of(study: StudyKeys, path: Path) -> WrittenCase:
    """Return the case of a study: a name or path beside it, or the keys in it."""
    if isinstance(study.case, str):
        beside = Path(os.path.expanduser(study.case))
        name = study.case if beside.is_absolute() else os.path.join(path.parent, study.case)
        tried = (name, *(f"{name}{suffix}" for suffix in (".yaml", ".yml")))
        if found := next((each for each in tried if os.path.isfile(each)), None):
            return read_case(found)
        try:
            return read_case(study.case)
        except InputError as error:
            raise InputError(*(f"{path.name}: case: {fault}" for fault in error.faults)) from error
    return written_case(dump(_plain({"name": study.name or path.stem} | dict(study.case))), path.absolute())


def _plain(data: Any) -> Any:
    """Return nested data with lists for tuples."""
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    return [_plain(value) for value in data] if isinstance(data, tuple) else data


def _listed_axes(study: StudyKeys, places: dict[str, str], folder: Path, faults: list[str]) -> list[Block]:
    """Return a block for each axis that is no distribution."""
    blocks: list[Block] = []
    for key, axis in study.axes.items():
        if why := unvaried(key):
            faults.append(f"{places[key]}: {why}")
        elif not is_sampled(axis):
            try:
                blocks.append((Axis(key, _values(axis, folder), places[key]),))
            except InputError as error:
                faults += [f"{places[key]}: {fault}" for fault in error.faults]
    return blocks


def _values(axis: Strict, folder: Path) -> tuple[Any, ...]:
    """Return the values of a list, a range or a folder of records."""
    if isinstance(axis, ListAxis):
        return axis.values
    if isinstance(axis, RangeAxis):
        if axis.spacing == "log":
            ends = spaced(math.log(axis.start), math.log(axis.stop), axis.count, whole=False)
            return (axis.start, *map(math.exp, ends[1:-1]), axis.stop)
        return spaced(axis.start, axis.stop, axis.count, axis.start.is_integer() and axis.stop.is_integer())
    assert isinstance(axis, FolderAxis)
    place = folder / os.path.expanduser(axis.folder)
    if not place.is_dir():
        raise InputError(f"no such folder: {place}; check the path")
    names = sorted(path.name for path in place.iterdir() if path.suffix in suffixes("records") and is_record(path))
    if not names:
        raise InputError(f"{place} holds no record; put records into it, or name another folder")
    return tuple(os.path.join(axis.folder, name) for name in names)


def _sampled_axes(study: StudyKeys, places: dict[str, str], folder: Path, faults: list[str]) -> list[Block]:
    """Return one block of all axes that are distributions: they are sampled together."""
    keys = [key for key, axis in study.axes.items() if is_sampled(axis)]
    if not keys or study.samples is None:
        return []
    observed: dict[str, tuple[Any, ...]] = {}
    for key in keys:
        axis = study.axes[key]
        if isinstance(axis, EmpiricalAxis):
            try:
                observed[key] = axis.values or _csv_column(folder / str(axis.file), str(axis.column))
            except InputError as error:
                faults += [f"{places[key]}: {fault}" for fault in error.faults]
    samples = study.samples
    try:
        cube = unit_samples(samples.method, samples.count, len(keys), samples.seed)
        if study.correlations:
            cube = correlated(cube, _pairs(study, keys))
    except InputError as error:
        faults += error.faults
    if faults:
        return []
    return [
        tuple(
            Axis(key, _taken(observed[key], column) if key in observed else quantiles(study.axes[key], column), place)
            for key, place, column in zip(keys, (places[key] for key in keys), cube.T, strict=True)
        )
    ]


def _taken(values: tuple[Any, ...], shares: Any) -> Any:
    """Return the observed values (n,) that shares of the unit interval stand for: numbers, else objects."""
    numbers = all(isinstance(value, float) for value in values)
    held = np.empty(len(values), dtype=float if numbers else object)
    for place, value in enumerate(values):
        held[place] = value
    return held[chosen(len(values), shares)]


def _pairs(study: StudyKeys, keys: list[str]) -> dict[tuple[int, int], float]:
    """Return the normal correlation of each pair of sampled axes, by their places."""
    found = {}
    for one in study.correlations:
        first, second = (keys.index(key) for key in one.between)
        found[first, second] = normal_correlation(one.rank) if one.rank is not None else float(one.normal or 0.0)
    return found


def _csv_column(path: Path, column: str) -> tuple[float, ...]:
    """Return the numbers in a column of a CSV file with a header; raises InputError."""
    path = Path(os.path.expanduser(path))
    try:
        if path.stat().st_size > MOST_CSV_BYTES:
            raise InputError(f"{path}: must be <= {MOST_CSV_BYTES} bytes, got {path.stat().st_size}")
        with open(path, encoding="utf-8-sig", newline="") as file:
            lines = csv.DictReader(file, skipinitialspace=True)
            if column not in (lines.fieldnames or ()):
                names = ", ".join(lines.fieldnames or ()) or "none"
                raise InputError(f"{path} has no column {column!r}; known: {names}"[:400])
            found = []
            for line in lines:
                value = _number(line[column])
                if value is None:
                    raise InputError(f"{path}:{lines.line_num}: {column} must be a number, got {line[column]!r:.40}")
                found.append(value)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV: {getattr(error, 'strerror', None) or error}") from error
    if not found:
        raise InputError(f"{path}: holds no row below its header; add values")
    return tuple(found)


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _constrained(plan: Plan, constraints: tuple[ConstraintSpec, ...], path: Path) -> Plan:
    """Return the plan with the points that meet every constraint; raises InputError where that is none."""
    if not constraints:
        return plan
    keep = np.ones(plan.points, dtype=bool)
    for k, one in enumerate(constraints, 1):
        left, right = (_side(plan, side, f"{path.name}: constraints[{k}]") for side in (one.left, one.right))
        keep &= COMPARED[one.op](left, one.times * right)
    if not keep.any():
        raise InputError(f"{path.name}: constraints: no row of {plan.points} meets them; loosen one")
    return replace(plan, kept=np.flatnonzero(keep))


def _side(plan: Plan, side: str | float, label: str) -> Any:
    """Return one side of a comparison: a number, or the numbers (n_points,) of an axis."""
    if not isinstance(side, str):
        return float(side)
    numbers = plan.numbers(side)
    if numbers is None:
        raise InputError(f"{label}: {side} has values that are no numbers, which cannot be compared")
    return numbers
