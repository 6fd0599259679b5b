"""Logs of real-time controllers in MATLAB files: dSPACE ControlDesk, Simulink structures and arrays.

Sources: ControlDesk's measurement export (a structure with X and Y, each an array with Name, Data, Unit, and XIndex of
Y counted from 1); Simulink's formats "Structure with time", "Structure", "Array" and the To File block (time in row 1);
timeseries (Name, Time, Data, DataInfo.Units) and elements of a Dataset (Name, Values: timeseries) made structures.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.matlab_files import MatlabObject, Value
from rths_cli.files.measured_data.recording import Column, Contents, listed, stated_interval
from rths_cli.files.measured_data.units import is_time
from rths_cli.numerics.lti import Array

_EVEN = 1e-3  # of the usual step, by which steps of a time differ at most
_TIMETABLE = (
    "S = table2struct(timetable2table({tt}, 'ConvertRowTimes', false), 'ToScalar', true); "
    "S.time = seconds({tt}.Properties.RowTimes - {tt}.Properties.RowTimes(1)); save('run.mat', '-struct', 'S')"
)
_COMMANDS = {
    "timetable": _TIMETABLE.replace("{tt}", "{name}"),
    "timeseries": "S = struct('time', {name}.Time, 'channel', squeeze({name}.Data)); save('run.mat', '-struct', 'S')",
    "Simulink.SimulationData.Dataset": "tt = extractTimetable({name}); " + _TIMETABLE.replace("{tt}", "tt"),
    "Simulink.SimulationOutput": "tt = extractTimetable({name}.logsout); " + _TIMETABLE.replace("{tt}", "tt"),
    "table": "S = table2struct({name}, 'ToScalar', true); save('run.mat', '-struct', 'S')",
}


def logs_of(path: Path, variables: Mapping[str, Value]) -> Contents | None:
    """Return the channels of every log among the variables of a MATLAB file, each with its own time; None without logs.

    Raises InputError for an XIndex without its X, and a channel whose samples do not fit its time.
    """
    columns = [column for name, value in variables.items() for column in _columns(path, name, value)]
    if not columns:
        return None
    count = Counter(column.name for _, column in columns)
    named = tuple(replace(c, name=f"{log}/{c.name}") if count[c.name] > 1 else c for log, c in columns)
    logs = {log.split("/")[0] for log, _ in columns}
    named, intervals, used = _with_times_beside(named, {n: v for n, v in variables.items() if n not in logs})
    others = [name for name in variables if name not in logs and name not in used]
    notes = (f"not used beside the logs: {listed(others)}",) if others else ()
    desk = any(isinstance(value, dict) and {"X", "Y"} <= value.keys() for value in variables.values())
    return Contents(named, intervals, notes, format=f"MATLAB ({'dSPACE ControlDesk' if desk else 'Simulink'})")


def _with_times_beside(
    columns: tuple[Column, ...], beside: Mapping[str, Value]
) -> tuple[tuple[Column, ...], tuple[tuple[str, float], ...], set[str]]:
    """Return channels of logs without times with a time of their length beside the logs (`tout`), the intervals in s
    that are stated there (`fs`), and the variables used; all as they are where every log has its time."""
    if all(column.time is not None for column in columns):
        return columns, (), set()
    series = {name: found for name, value in beside.items() if (found := _numbers(value)) is not None}
    times = {found.size: Column(name, found) for name, found in series.items() if found.size > 1 and is_time(name)}
    timed = tuple(column if column.time else replace(column, time=times.get(column.values.size)) for column in columns)
    single = {name: float(found[0]) for name, found in series.items() if found.size == 1}
    intervals = {name: stated for name, value in single.items() if (stated := stated_interval(name, value)) is not None}
    used = {times[c.values.size].name for c in columns if c.time is None and c.values.size in times}
    return timed, tuple(intervals.items()), {*intervals, *used}


def _columns(path: Path, name: str, value: Value) -> Iterator[tuple[str, Column]]:
    """Yield the channels of a structure that is a log, and of those in it, with the log's name."""
    if isinstance(value, tuple):
        for place, entry in enumerate(value, 1):
            yield from _columns(path, f"{name}/{place}", entry)
    if not isinstance(value, dict):
        return
    if isinstance(value.get("Values"), dict):  # an element of a Dataset
        named = next((one["Name"] for one in (value["Values"], value) if _text(one.get("Name"))), [name.split("/")[-1]])
        value = {**value["Values"], "Name": named}
    if {"X", "Y"} <= value.keys():
        found = _control_desk(path, name, value)
    elif {"time", "signals"} <= value.keys():
        found = _simulink(path, name, value)
    elif _numbers(value.get("Time")) is not None and _numbers(value.get("Data")) is not None:
        label = _text(value.get("Name")) or name.rpartition("/")[2]
        about = value.get("DataInfo")
        unit = _text(about.get("Units")) if isinstance(about, dict) else ""
        found = _signal(path, name, label, value["Data"], unit, _time(value["Time"]))
    else:
        for key, part in value.items():
            yield from _columns(path, f"{name}/{key}", part)
        return
    for column in found:
        yield name, column


def _control_desk(path: Path, log: str, value: dict[str, Any]) -> Iterator[Column]:
    """Yield the channels of a ControlDesk measurement: Y(k) over X(Y(k).XIndex)."""
    times = _entries(value["X"])
    for place, one in enumerate(_entries(value["Y"]), 1):
        stated = _numbers(one.get("XIndex"))
        index = int(stated[0]) if stated is not None and stated.size else 1
        if (stated is None and len(times) > 1) or not 1 <= index <= len(times):
            raise InputError(
                f"{path}: {log}.Y({place}) states XIndex {'nothing' if stated is None else index}, X has {len(times)} "
                "entries; export the measurement again"
            )
        axis = times[index - 1]
        time = Column(_text(axis.get("Name")) or "time", _floats(axis.get("Data")), _text(axis.get("Unit")))
        label = _text(one.get("Name")) or f"Y({place})"
        yield from _signal(path, log, label, one.get("Data"), _text(one.get("Unit")), replace(time, name="time"))


def _simulink(path: Path, log: str, value: dict[str, Any]) -> Iterator[Column]:
    """Yield the channels of a Simulink structure: signals(k).values (n,), (n, c) or (r, c, n) over time (n,)."""
    time = _time(value["time"])
    for place, one in enumerate(_entries(value["signals"]), 1):
        block = _text(one.get("blockName")).rpartition("/")[2]
        label = _text(one.get("label")) or block or f"{log.rpartition('/')[2]}.signals({place})"
        yield from _signal(path, log, label, one.get("values"), "", time)


def _signal(path: Path, log: str, label: str, raw: Value, unit: str, time: Column | None) -> Iterator[Column]:
    """Yield the series of one signal over its time (None: not stated); raise InputError where they do not fit."""
    if not isinstance(raw, np.ndarray) or raw.dtype.kind not in "biuf" or not raw.size:
        raise InputError(f"{path}: {log}: the signal {label!r} holds no real numbers; export it again or leave it out")
    array = np.asarray(raw, dtype=np.float64)
    count = max(array.shape) if time is None else time.values.size
    if array.ndim > 2:
        array = array.reshape(-1, array.shape[-1], order="F").T
    rows = array.T if array.ndim == 2 and array.shape[0] == count else np.atleast_2d(array)
    if rows.shape[-1] != count:
        raise InputError(
            f"{path}: {log}: the signal {label!r} has {raw.shape} samples, its time has {count}; export it again"
        )
    for place, row in enumerate(rows, 1):
        yield Column(label if len(rows) == 1 else f"{label}(:,{place})", row, unit, time=time)


def with_time_of_matrix(contents: Contents) -> Contents:
    """Return contents with the first series of a matrix as time of the others in it, if it rises evenly by less than
    1 s, as the To File block of Simulink writes it; a note says so. Return other contents as they are.

    The time of one matrix counts for all series if it is the first one; several matrices have each their own.
    """
    matrices: dict[str, list[Column]] = {}
    for column in contents.columns:
        matrices.setdefault(column.name.rpartition("(:,")[0], []).append(column)
    steps = {name: _even_step(rows[0].values) for name, rows in matrices.items() if name and len(rows) > 1}
    timed = [name for name, step in steps.items() if 0.0 < step < 1.0]
    if not timed or (len(timed) == 1 and contents.columns[0] is not matrices[timed[0]][0]):
        return contents
    said = ", ".join(f"{name}(:,1)" for name in timed)
    note = (
        f"{said} rises evenly by {steps[timed[0]]:.6g}: taken as the time in s, as Simulink's To File block writes it"
    )
    if len(timed) == 1:
        columns = (replace(contents.columns[0], name="time (s)"), *contents.columns[1:])
    else:
        columns = tuple(one for name, rows in matrices.items() for one in (_over_first(name, rows, name in timed)))
    return replace(contents, columns=columns, notes=(*contents.notes, note))


def _even_step(values: Array) -> float:
    """Return the step of series (n,) that rises evenly, 0 of one that does not."""
    steps = np.diff(values)
    usual = float(np.median(steps)) if steps.size else 0.0
    return usual if steps.size and np.abs(steps - usual).max() <= _EVEN * abs(usual) else 0.0


def _over_first(name: str, rows: list[Column], timed: bool) -> list[Column]:
    """Return the series of a matrix over its first one, which is their time; as they are where it is not."""
    if not timed:
        return rows
    time = replace(rows[0], name="time (s)")
    return [replace(row, name=name if len(rows) == 2 else row.name, time=time) for row in rows[1:]]


def objects_sentence(path: Path, variables: Mapping[str, Value]) -> str:
    """Return why objects of MATLAB cannot be read here, with the command that converts the first; "" without any."""
    objects = {name: value.class_name for name, value in variables.items() if isinstance(value, MatlabObject)}
    if not objects:
        return ""
    name, kind = next(((n, k) for n, k in objects.items() if k in _COMMANDS), next(iter(objects.items())))
    command = _COMMANDS.get(kind, "S = struct('time', t, 'table', y); save('run.mat', '-struct', 'S')")
    return (
        f"{path}: {name} is a MATLAB object ({kind}), which only MATLAB can read; convert it there: "
        f"{command.replace('{name}', name)}"
    )


def _entries(value: Value) -> list[dict[str, Any]]:
    """Return the entries of an array of structures, of one or several."""
    every = value if isinstance(value, tuple) else (value,)
    return [one for one in every if isinstance(one, dict)]


def _text(value: Value) -> str:
    """Return a text, "" for anything else."""
    return "".join(value).strip() if isinstance(value, list) else ""


def _numbers(value: Value) -> Array | None:
    """Return real numbers as one series, None for anything else."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
        return None
    return np.asarray(value, dtype=np.float64).reshape(-1)


def _floats(value: Value) -> Array:
    """Return real numbers as one series, an empty one for anything else."""
    found = _numbers(value)
    return np.zeros(0) if found is None else found


def _time(value: Value) -> Column | None:
    """Return a time of Simulink in s, None where the structure holds none."""
    found = _numbers(value)
    return Column("time", found) if found is not None and found.size else None
