"""An identification as groups of datasets of a model file, and back, bit for bit."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from rths_cli.files.hdf5 import Dataset
from rths_cli.identification.results import (
    Band,
    Candidate,
    ChannelReport,
    DelayEstimate,
    FitError,
    Friction,
    Identification,
    LevelBand,
    LevelCauses,
    Root,
    SpecimenFit,
    Verdict,
)
from rths_cli.numerics.lti import Frf, Model
from rths_cli.structure import Specimen

T = TypeVar("T")
Values = Mapping[str, Any]
Groups = dict[str, dict[str, Dataset]]

UNITS = (
    ("_n_s_per_m", "N*s/m"), ("_n_per_m", "N/m"), ("_m_s2_per_v", "m/s^2/V"), ("_m_s2", "m/s^2"), ("_hz", "Hz"),
    ("_kg", "kg"), ("_m_s", "m/s"), ("_s", "s"), ("_v", "V"),
)  # fmt: skip
UNIT_OF = {
    "response": "m/s^2/V", "noise_floor": "m/s^2/V", "zeros": "rad/s", "poles": "rad/s", "gain": "as zeros and poles",
    "K": "N/m", "C": "N*s/m",
}  # fmt: skip
AXES = {"zeros": ("zero",), "poles": ("pole",), "mode_shapes": ("floor", "mode"), "K": ("floor", "of_floor"),
        "C": ("floor", "of_floor"), "masses_kg": ("floor",), "stiffness_n_per_m": ("floor",),
        "stiffness_error_n_per_m": ("floor",), "dashpots_n_s_per_m": ("floor",)}  # fmt: skip
TABLES: dict[str, type] = {
    "channels": ChannelReport,
    "candidates": Candidate,
    "roots": Root,
    "residuals": Band,
    "levels": LevelBand,
}


def to_groups(found: Identification, names: tuple[str, ...]) -> Groups:
    """Return the groups of an identification; `names` are those of its channels, the table's first."""
    groups = {
        "table/best": _flat(found.best),
        "table/paper": _flat(found.paper),
        "fit_error/best": _flat(found.best_error),
        "fit_error/paper": _flat(found.paper_error),
        "verdict": _flat(found.verdict),
    }
    for name, frf, floor in zip(names, found.frfs, found.noise_floors, strict=True):
        groups[f"frf/{name}"] = _flat(frf, "frequency_hz")
        if floor is not None:
            groups[f"frf/{name}"]["noise_floor"] = _dataset("noise_floor", floor, "frequency_hz")
    for where, fit in (("excitation", found.specimen), ("free_vibration", found.free_vibration)):
        if fit is not None:
            groups[f"specimen/{where}"] = {**_flat(fit, "mode"), **_flat(fit.specimen)}
    if found.friction is not None:
        groups["friction"] = _flat(found.friction)
    if found.latency is not None:
        groups["latency"] = _flat(found.latency)
    if found.causes.table or found.causes.storeys:
        groups["level_causes"] = _flat(found.causes)
    for table in TABLES:
        rows = getattr(found, table)
        if rows:
            groups[table] = _columns(rows)
    return groups


def from_groups(groups: Mapping[str, Values], names: tuple[str, ...]) -> Identification:
    """Return the identification that `to_groups` took apart; raises KeyError when something is missing."""
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
        verdict=_made(Verdict, groups["verdict"]),
        friction=_made(Friction, groups["friction"]) if "friction" in groups else None,
        latency=_made(DelayEstimate, groups["latency"]) if "latency" in groups else None,
        causes=_made(LevelCauses, groups.get("level_causes", {})),
        **tables,
    )


def _specimen(values: Values | None) -> SpecimenFit | None:
    if values is None:
        return None
    return _made(SpecimenFit, {**values, "specimen": _made(Specimen, values)})


def _flat(item: Any, axis: str = "") -> dict[str, Any]:
    """Return the fields of a dataclass that a dataset can hold; None is left out."""
    values = {field.name: getattr(item, field.name) for field in fields(item)}
    left_out = (type(None), Specimen)
    kept = {k: v for k, v in values.items() if not (isinstance(v, left_out) or (isinstance(v, tuple) and not v))}
    return {k: _dataset(k, v, axis) for k, v in kept.items()}


def _dataset(name: str, value: Any, axis: str = "") -> Dataset:
    """Return a value with its unit, meaning and axes."""
    data = np.asarray(list(value) if isinstance(value, tuple) else value)
    data = data.astype(float) if data.dtype.kind in "biu" else data
    unit = UNIT_OF.get(name) or next((unit for end, unit in UNITS if name.endswith(end)), "1")
    dims = AXES.get(name) or ((axis or f"{name}_entry",) if data.ndim == 1 else ())
    return Dataset(data, unit, name.replace("_", " "), "estimated", dims)


def _columns(rows: tuple[Any, ...]) -> dict[str, Dataset]:
    """Return a table of dataclasses as one array (n_rows,) per field; an unknown number is NaN."""
    columns = {}
    for field in fields(rows[0]):
        entries = [getattr(row, field.name) for row in rows]
        known = [np.nan if entry is None else entry for entry in entries]
        name = f"{field.name}_count" if field.type == "int" else field.name
        columns[field.name] = replace(_dataset(name, tuple(known), "row"), dims=("row",))
    return columns


def _rows(kind: type[T], columns: Values) -> tuple[T, ...]:
    """Return the dataclasses of a table."""
    if not columns:
        return ()
    length = len(next(iter(columns.values())))
    return tuple(_made(kind, {key: column[i] for key, column in columns.items()}) for i in range(length))


def _made(kind: type[T], values: Values) -> T:
    """Return a dataclass from stored values, each as its field is declared; one that is not there has its default."""
    hints = _hints(kind)  # type: ignore[arg-type]
    given = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name in values or field.default is MISSING:
            given[field.name] = _as_declared(hints[field.name], values.get(field.name))
    return kind(**given)


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Return how each field of a dataclass is declared."""
    return get_type_hints(kind)


def _as_declared(hint: Any, value: Any) -> Any:
    """Return a stored value in the type of its field; what was left out is None or an empty tuple."""
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
