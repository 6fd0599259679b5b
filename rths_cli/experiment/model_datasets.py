"""Convert an identification to the datasets of a model file, and back, bit for bit."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from rths_cli.files.hdf5 import Dataset, as_declared
from rths_cli.identification.results import (
    Band,
    Calibration,
    Candidate,
    ChannelReport,
    DelayEstimate,
    FitError,
    Friction,
    Identification,
    LevelBand,
    LevelCauses,
    LowLevelLines,
    NonlinearSpecimen,
    Pitch,
    Root,
    SpecimenFit,
    Verdict,
)
from rths_cli.numerics.bands import ComparedBand
from rths_cli.numerics.lti import Frf, Model
from rths_cli.quantities import AXES
from rths_cli.quantities.model_datasets import RECORDS, model_dataset
from rths_cli.structure import Specimen

T = TypeVar("T")
Values = Mapping[str, Any]
Groups = dict[str, dict[str, Dataset]]

TABLES: dict[str, type] = {
    "channels": ChannelReport,
    "candidates": Candidate,
    "roots": Root,
    "residuals": Band,
    "levels": LevelBand,
}


def to_groups(found: Identification, names: tuple[str, ...]) -> Groups:
    """Return the groups of an identification; `names` are those of its channels, the table's first.

    Raises ValueError for one with samples, which a model file does not hold.
    """
    if found.samples:
        raise ValueError("a model file holds no samples of the identified model")
    groups: dict[str, Values] = {
        "table/best": _fields(found.best),
        "table/paper": _fields(found.paper),
        "fit_error/best": _fields(found.best_error),
        "fit_error/paper": _fields(found.paper_error),
        "verdict": _fields(found.verdict),
        "compared": _fields(found.compared),
    }
    for name, frf, floor in zip(names, found.frfs, found.noise_floors, strict=True):
        groups[f"frf/{name}"] = _fields(frf) | {"frequency_hz": frf.frequency_hz}
        if floor is not None:
            groups[f"frf/{name}"] = {**groups[f"frf/{name}"], "noise_floor": floor}
    fits = (found.specimen, found.free_vibration, found.low_level)
    for where, fit in zip(RECORDS, fits, strict=True):
        if fit is not None:
            groups[f"specimen/{where}"] = {**_fields(fit), **_fields(fit.specimen)}
    if found.friction is not None:
        groups["friction"] = _fields(found.friction)
    if found.latency is not None:
        groups["latency"] = _fields(found.latency)
    if found.calibration is not None:
        groups["calibration"] = _fields(found.calibration)
    if found.pitch is not None:
        groups["pitch"] = _fields(found.pitch)
    if found.causes.table or found.causes.storeys:
        groups["level_causes"] = _fields(found.causes)
    if found.low_level_m_s2 is not None:
        groups["low_level"] = {"accel_rms_m_s2": found.low_level_m_s2}
    if found.low_level_lines is not None:
        groups["low_level_lines"] = _fields(found.low_level_lines)
    if found.nonlinear is not None:
        groups["nonlinear_specimen"] = _fields(found.nonlinear)
    for table in TABLES:
        if rows := getattr(found, table):
            groups[table] = _columns(rows)
    return {
        group: {key: _dataset(group, key, value) for key, value in values.items()} for group, values in groups.items()
    }


def from_groups(groups: Mapping[str, Values], names: tuple[str, ...]) -> Identification:
    """Return the identification from the groups that `to_groups` made; raises KeyError if something is missing."""
    frfs = [groups[f"frf/{name}"] for name in names]
    tables: dict[str, Any] = {table: _rows(kind, groups.get(table, {})) for table, kind in TABLES.items()}
    return Identification(
        frfs=tuple(_made(Frf, frf) for frf in frfs),
        noise_floors=tuple(frf.get("noise_floor") for frf in frfs),
        best=_made(Model, groups["table/best"]),
        paper=_made(Model, groups["table/paper"]),
        best_error=_made(FitError, groups["fit_error/best"]),
        paper_error=_made(FitError, groups["fit_error/paper"]),
        specimen=_specimen(groups.get("specimen/excitation")),
        free_vibration=_specimen(groups.get("specimen/free_vibration")),
        low_level=_specimen(groups.get("specimen/low_level")),
        verdict=_made(Verdict, groups["verdict"]),
        friction=_made(Friction, groups["friction"]) if "friction" in groups else None,
        latency=_made(DelayEstimate, groups["latency"]) if "latency" in groups else None,
        calibration=_made(Calibration, groups["calibration"]) if "calibration" in groups else None,
        pitch=_made(Pitch, groups["pitch"]) if "pitch" in groups else None,
        causes=_made(LevelCauses, groups.get("level_causes", {})),
        compared=_made(ComparedBand, groups.get("compared", {})),
        low_level_m_s2=float(groups["low_level"]["accel_rms_m_s2"]) if "low_level" in groups else None,
        low_level_lines=_made(LowLevelLines, groups["low_level_lines"]) if "low_level_lines" in groups else None,
        nonlinear=_made(NonlinearSpecimen, groups["nonlinear_specimen"]) if "nonlinear_specimen" in groups else None,
        **tables,
    )


def _specimen(values: Values | None) -> SpecimenFit | None:
    if values is None:
        return None
    return _made(SpecimenFit, {**values, "specimen": _made(Specimen, values)})


def _fields(item: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that a dataset can hold; fields with None are omitted."""
    values = {field.name: getattr(item, field.name) for field in fields(item)}
    left_out = (type(None), Specimen)
    return {k: v for k, v in values.items() if not (isinstance(v, left_out) or (isinstance(v, tuple) and not v))}


def _dataset(group: str, name: str, value: Any) -> Dataset:
    """Return a value with its declaration; raises ValueError if it is not declared, or with another kind."""
    data = np.asarray(list(value) if isinstance(value, tuple) else value)
    data = data.astype(float) if data.dtype.kind in "biu" else data
    declared = model_dataset(group, name)
    if declared is None and name in AXES:
        return Dataset(data, AXES[name].units, AXES[name].text, "estimated", (name,))
    if declared is None:
        raise ValueError(f"{group}/{name} is declared nowhere; declare it in rths_cli/quantities/model_datasets.py.")
    return as_declared(declared, data)


def _columns(rows: tuple[Any, ...]) -> dict[str, Any]:
    """Return a sequence of dataclasses as one array (n_rows,) per field; an unknown number is NaN."""
    entries = {field.name: [getattr(row, field.name) for row in rows] for field in fields(rows[0])}
    return {name: tuple(np.nan if entry is None else entry for entry in column) for name, column in entries.items()}


def _rows(kind: type[T], columns: Values) -> tuple[T, ...]:
    """Return the sequence of dataclasses from the arrays that `_columns` made."""
    if not columns:
        return ()
    length = len(next(iter(columns.values())))
    return tuple(_made(kind, {key: column[i] for key, column in columns.items()}) for i in range(length))


def _made(kind: type[T], values: Values) -> T:
    """Return a dataclass from stored values, converted to the types of its fields; missing ones have their default."""
    hints = _hints(kind)  # type: ignore[arg-type]
    given = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name in values or (field.default is MISSING and field.default_factory is MISSING):
            given[field.name] = _as_declared(hints[field.name], values.get(field.name))
    return kind(**given)


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Return the declared type of each field of a dataclass."""
    return get_type_hints(kind)


def _as_declared(hint: Any, value: Any) -> Any:
    """Return a stored value in the type of its field; an omitted one is None or an empty tuple."""
    if get_origin(hint) in (Union, types.UnionType):
        if value is None or (np.ndim(value) == 0 and isinstance(value, float) and np.isnan(value)):
            return None
        return _as_declared(get_args(hint)[0], value)
    if get_origin(hint) is tuple:
        entries = () if value is None else tuple(np.asarray(value).tolist())
        return tuple(int(entry) for entry in entries) if get_args(hint)[0] is int else entries
    if hint in (int, float, complex, bool, str):
        return hint(value)
    return value
