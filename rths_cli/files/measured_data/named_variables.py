"""Interpret the named variables of a MATLAB or HDF5 file: channels, time, sample rate."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.matlab_files import Value, series
from rths_cli.files.measured_data.controller_logs import logs_of, objects_sentence, with_time_of_matrix
from rths_cli.files.measured_data.recording import (
    MOST,
    Column,
    Contents,
    listed,
    numbers_of,
    stated_interval,
    states_start,
)
from rths_cli.files.measured_data.units import is_time
from rths_cli.numerics.lti import Array

_NAMES = {"names", "name", "channels", "channelnames", "labels", "columns"}
_UNITS = {"units", "unit", "channelunits"}
_NAMELESS = {"data", "value", "values", "samples", "signal", "y"}  # of a group's only series
_LEVELS = 4  # of structures in each other, below the first
_SHORT = 0.01
"""A series shorter than this part of the longest is no channel (coefficients, settings)."""


@dataclass(frozen=True)
class Variable:
    """One variable: numbers, a list of texts, or anything else (None); `unit`, intervals and starts (in s, one, or one
    per channel of a matrix) as stated beside it."""

    value: NDArray[Any] | list[str] | None
    unit: str = ""
    attributes: Mapping[str, float] = field(default_factory=dict)
    starts_s: tuple[float, ...] = ()


def contents_of(path: Path, variables: Mapping[str, Variable]) -> Contents:
    """Return the columns and sampling intervals among variables, whose names may be paths (`recording/table`).

    Raises InputError where a matrix and its names do not fit, or nothing is a series.
    """
    short = _short_names(variables)
    texts = {short[key]: v.value for key, v in variables.items() if isinstance(v.value, list)}
    ignored = [short[key] for key, v in variables.items() if v.value is None]
    columns: list[Column] = []
    intervals: list[tuple[str, float]] = []
    times = _own_times(variables)
    beside = {key.rpartition("/")[0]: numbers_of(v.value) for key, v in variables.items() if _is_start(key, v)}
    for key, variable in variables.items():
        if not isinstance(variable.value, np.ndarray):
            continue
        name, array = short[key], np.squeeze(variable.value)
        group = key.rpartition("/")[0]
        if key in (f"{group}/{time.name}" for time in times.get(group, ())):
            continue
        count = len(columns)
        intervals += _intervals(name, variable)
        starts = variable.starts_s or beside.get(key.rpartition("/")[0], ())
        if states_start(_leaf(name)) and array.ndim < 2 and array.size < MOST:
            continue
        if array.ndim == 1 and array.size > 1:
            columns += _started(path, [Column(name, _floats(array), variable.unit)], starts)
        elif array.ndim == 2 and array.size:
            columns += _started(path, _matrix(path, name, array, texts), starts)
        elif array.size != 1 or stated_interval(_leaf(name), 1.0) is None:
            ignored.append(name)
        columns[count:] = [_over(column, group, times.get(group, ())) for column in columns[count:]]
    contents = _without_short(path, columns, intervals, ignored)
    named = any(isinstance(variable.value, list) for variable in variables.values())
    if named or any(c.start_s is not None or is_time(c.name) for c in contents.columns):
        return contents
    return with_time_of_matrix(contents)


def matlab_contents(path: Path, values: Mapping[str, Value]) -> Contents:
    """Return what the variables of a MATLAB file hold: logs of controllers, else series, fields as `structure/field`.

    Raises InputError where objects, which only MATLAB reads, leave no channel beside the time.
    """
    logs = logs_of(path, values)
    if logs is not None:
        return logs
    variables: dict[str, Variable] = {}
    for name, value in values.items():
        fields = {f"{name}/{key}": each for key, each in value.items()} if isinstance(value, dict) else {name: value}
        for _ in range(_LEVELS):
            fields = {n: each for key, one in fields.items() for n, each in _fields(key, one)}
        variables |= {key: Variable(series(each)) for key, each in fields.items()}
    return contents_beside_objects(path, variables, values)


def _fields(name: str, value: Value) -> list[tuple[str, Value]]:
    """Return the fields of a structure by their paths, any other value by its name."""
    return [(f"{name}/{key}", each) for key, each in value.items()] if isinstance(value, dict) else [(name, value)]


def _own_times(variables: Mapping[str, Variable]) -> dict[str, tuple[Column, ...]]:
    """Return the time of each group or structure that has one, where several have; else none."""
    times: dict[str, tuple[Column, ...]] = {}
    for key, variable in variables.items():
        group, _, leaf = key.rpartition("/")
        array = np.squeeze(variable.value) if isinstance(variable.value, np.ndarray) else np.zeros(0)
        if group and is_time(leaf) and array.ndim == 1 and array.size > 1:
            times.setdefault(group, (Column(leaf, _floats(array), variable.unit),))
    return times if len(times) > 1 else {}


def _over(column: Column, group: str, times: tuple[Column, ...]) -> Column:
    """Return a channel over the time of its group, if that has its length, with the group's name where its own says
    nothing."""
    if not times or times[0].values.size != column.values.size:
        return column
    named = _leaf(group) if _leaf(column.name).lower() in _NAMELESS else column.name
    return replace(column, name=named, time=times[0])


def contents_beside_objects(path: Path, variables: Mapping[str, Variable], values: Mapping[str, Value]) -> Contents:
    """Do what `contents_of` does; raise InputError with MATLAB's command where objects leave no channel to read."""
    sentence = objects_sentence(path, values)
    try:
        contents = contents_of(path, variables)
    except InputError:
        if sentence:
            raise InputError(sentence) from None
        raise
    if sentence and all(is_time(column.name) for column in contents.columns):
        raise InputError(sentence)
    return contents


def _is_start(key: str, variable: Variable) -> bool:
    """Say whether a variable states the starts of the channels beside it."""
    return states_start(_leaf(key)) and variable.value is not None and np.size(variable.value) < MOST


def _started(path: Path, columns: list[Column], starts: tuple[float, ...]) -> list[Column]:
    """Return columns with their starts, one for all or one for each."""
    if len(starts) not in (0, 1, len(columns)):
        raise InputError(f"{path}: states {len(starts)} starts of {len(columns)} channels; give one per channel")
    each = starts * len(columns) if len(starts) == 1 else starts or (None,) * len(columns)
    return [replace(column, start_s=start) for column, start in zip(columns, each, strict=True)]


def _without_short(
    path: Path, columns: list[Column], intervals: list[tuple[str, float]], ignored: list[str]
) -> Contents:
    """Return the contents without series that are too short to be channels; all ignored ones are named in a note."""
    if not columns:
        raise InputError(f"{path}: holds no series of numbers; save each channel as a vector, or a matrix and `names`")
    longest = max(len(column.values) for column in columns)
    short = [column.name for column in columns if len(column.values) < _SHORT * longest]
    kept = tuple(column for column in columns if column.name not in short)
    notes = (f"not used, because they are no series: {listed(ignored + short)}",) if ignored + short else ()
    return Contents(kept, tuple(intervals), notes)


def _intervals(name: str, variable: Variable) -> list[tuple[str, float]]:
    """Return the sampling intervals in s that a scalar variable or attributes state."""
    array = np.asarray(variable.value)
    stated = {name: float(array.reshape(-1)[0])} if array.size == 1 else {}
    stated |= {f"{name}/{key}": value for key, value in variable.attributes.items()}
    found = [(where, stated_interval(_leaf(where), value)) for where, value in stated.items()]
    return [(where, value) for where, value in found if value is not None]


def _matrix(path: Path, name: str, array: NDArray[Any], texts: Mapping[str, list[str]]) -> list[Column]:
    """Return the columns of a matrix, samples along its longer axis unless the names say otherwise."""
    names = next((text for key, text in texts.items() if _leaf(key).lower().replace("_", "") in _NAMES), None)
    units = next((text for key, text in texts.items() if _leaf(key).lower().replace("_", "") in _UNITS), None)
    count = min(array.shape)
    if names is not None and len(names) in array.shape:
        count = len(names)
    rows = array if array.shape[0] == count else array.T
    for what, given in (("names", names), ("units", units)):
        if given is not None and len(given) != count:
            raise InputError(
                f"{path}: {name} has {count} channels, {what} has {len(given)} texts; give one per channel"
            )
    names = names if names is not None else [f"{name}(:,{k})" for k in range(1, count + 1)]
    units = units if units is not None else [""] * count
    return [Column(n.strip(), _floats(row), u.strip()) for n, row, u in zip(names, rows, units, strict=True)]


def _floats(array: NDArray[Any]) -> Array:
    """Return numbers as float64."""
    return np.asarray(array, dtype=np.float64)


def _leaf(name: str) -> str:
    """Return the last part of a name such as `recording/table`; a slash in brackets belongs to a unit."""
    return re.split(r"/(?![^(\[]*[)\]])", name)[-1]


def _short_names(variables: Mapping[str, Variable]) -> dict[str, str]:
    """Return each variable's last name where it is the only one of that name, else its whole path."""
    count = Counter(_leaf(key) for key in variables)
    return {key: _leaf(key) if count[_leaf(key)] == 1 else key for key in variables}
