"""Save and load model files bit for bit, reject those of another rig or specimen; the cache of models of virtual
rigs."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import types
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from rths_cli.case.resolve import VARIED
from rths_cli.case.rig_schema import (
    CERTAIN,
    RealRigSpec,
    RigSpec,
    TargetRigSpec,
    UdpPlainRigSpec,
    UncertaintySpec,
    VirtualRigSpec,
    VirtualUncertaintySpec,
)
from rths_cli.errors import InputError
from rths_cli.experiment.provenance import git_commit, package_version
from rths_cli.experiment.setup import Setup, shown
from rths_cli.files.durable_files import Stamp
from rths_cli.files.hdf5 import Dataset, as_declared
from rths_cli.files.model_file import Written, read_model, write_model
from rths_cli.findings import as_data, from_data, stated
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
from rths_cli.numerics.compiled import processor
from rths_cli.numerics.lti import Frf, Model
from rths_cli.quantities import AXES, attribute_fault
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES, RECORDS, model_dataset
from rths_cli.rigs.description import capabilities_of
from rths_cli.rigs.from_case import laboratory_number
from rths_cli.structure import Specimen
from rths_cli.user_cache import cache_or_temporary
from rths_cli.version import __version__

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

# they choose the instructions of BLAS, numpy and the C library, and with them the last bits of an identification
ROUNDING = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES", "GLIBC_TUNABLES", "MKL_CBWR")
KEPT = 200  # largest number of models in the cache; the oldest are removed first
TIME = "%Y-%m-%dT%H:%M:%SZ"
LEVELS = dict.fromkeys(("name", "warning_m_s2", "abort_m_s2", "sensitivity_uncertainty"), True)
HARDWARE_ONLY: dict[str, Any] = {  # of a rig file: no part of what the rig is
    **dict.fromkeys(("limits", "name", "after_identification"), True),
    **dict.fromkeys(("udp", "link", "unattended", "watchdog_s", "overrun", "model"), True),
    "sensors": LEVELS,
    "channels": {"__all__": LEVELS},
    "imperfections": {"laboratory"},
    "uncertainty": {"table_gain"},
    "calibration": {
        **dict.fromkeys(("made_utc", "by", "model", "specimen", "masses"), True),
        "channels": {"__all__": {"sensitivity_uncertainty", "joint_uncertainty"}},
    },
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
        "verdict": _of_verdict(found.verdict),
        "compared": _fields(found.compared),
    }
    for name, frf, floor in zip(names, found.frfs, found.noise_floors, strict=True):
        groups[f"frf/{name}"] = _fields(frf) | {"frequency_hz": frf.frequency_hz}
        if floor is not None:
            groups[f"frf/{name}"] = {**groups[f"frf/{name}"], "noise_floor": floor}
    fits = (found.specimen, found.free_vibration, found.low_level)
    for where, fit in zip(RECORDS, fits, strict=True):
        if fit is not None:
            own = {name: value for name, value in _fields(fit.specimen).items() if name != "attached"}
            groups[f"specimen/{where}"] = {**_fields(fit), **own}
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
    if found.at_rest is not None:
        groups["actuator"] = dict(zip(("displacement_noise_m", "force_noise_n"), found.at_rest.tolist(), strict=True))
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
        specimen=_specimen(groups.get("specimen/excitation"), attached="force" in names),
        free_vibration=_specimen(groups.get("specimen/free_vibration")),
        low_level=_specimen(groups.get("specimen/low_level")),
        verdict=_verdict(groups["verdict"]),
        friction=_made(Friction, groups["friction"]) if "friction" in groups else None,
        latency=_made(DelayEstimate, groups["latency"]) if "latency" in groups else None,
        calibration=_made(Calibration, groups["calibration"]) if "calibration" in groups else None,
        pitch=_made(Pitch, groups["pitch"]) if "pitch" in groups else None,
        causes=_made(LevelCauses, groups.get("level_causes", {})),
        compared=_made(ComparedBand, groups.get("compared", {})),
        low_level_m_s2=float(groups["low_level"]["accel_rms_m_s2"]) if "low_level" in groups else None,
        low_level_lines=_made(LowLevelLines, groups["low_level_lines"]) if "low_level_lines" in groups else None,
        nonlinear=_made(NonlinearSpecimen, groups["nonlinear_specimen"]) if "nonlinear_specimen" in groups else None,
        at_rest=np.array([float(one) for one in groups["actuator"].values()]) if "actuator" in groups else None,
        **tables,
    )


def _of_verdict(verdict: Verdict) -> dict[str, Any]:
    """Return the datasets of a verdict: its reasons and warnings as sentences, and both as JSON."""
    every = tuple(json.dumps(as_data(one)) for one in (*verdict.refusals, *verdict.notes))
    texts = {"reasons": verdict.reasons, "warnings": verdict.warnings, "findings": every}
    values = _fields(replace(verdict, refusals=(), notes=()))
    return {**values, **{name: entries for name, entries in texts.items() if entries}}


def _verdict(values: Values) -> Verdict:
    """Return the verdict of its datasets; the sentences of an earlier file have no code."""
    reasons, warnings = (np.asarray(values.get(name, ())).tolist() for name in ("reasons", "warnings"))
    stored = [from_data(json.loads(text)) for text in values.get("findings", ())]
    every = stored or [*map(stated, reasons), *(stated(warning, "warns") for warning in warnings)]
    refusals, notes = tuple(every[: len(reasons)]), tuple(every[len(reasons) :])
    return replace(_made(Verdict, values), refusals=refusals, notes=notes)


def _specimen(values: Values | None, attached: bool = False) -> SpecimenFit | None:
    if values is None:
        return None
    return _made(SpecimenFit, {**values, "specimen": replace(_made(Specimen, values), attached=attached)})


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


@dataclass(frozen=True)
class Stored:
    """A model file that was read."""

    path: Path
    found: Identification
    made: datetime  # UTC
    about: Mapping[str, str | int | float]  # attributes, with which rig, specimen, settings and software are identified
    sha256: str  # of its content

    @property
    def age(self) -> str:
        """Return the date of the identification and its age, in words."""
        minutes = (datetime.now(UTC) - self.made).total_seconds() / 60.0
        for size, unit in ((60 * 24, "days"), (60, "hours"), (1, "minutes")):
            if minutes >= 2 * size or size == 1:
                count = round(max(minutes, 0.0) / size)
                return f"{self.made:%Y-%m-%d %H:%M} UTC, {count} {unit if count != 1 else unit[:-1]} ago"
        raise AssertionError


def save(
    path: Path, setup: Setup, found: Identification, source: str, data_sha256: str,
    replaces: Stamp | Literal["any"] = "any",
) -> Written:  # fmt: skip
    """Write a model file and return its name and the hash of its content; raises InputError if it cannot be written.

    `replaces`: as in `write_model`.
    """
    made = datetime.now(UTC).strftime(TIME)
    about = {**identity(setup), "data_source": source, "data_sha256": data_sha256, "created_utc": made}
    if fault := attribute_fault(about, MODEL_ATTRIBUTES):
        raise ValueError(f"{fault}; declare it in rths_cli/quantities/model_datasets.py.")
    return write_model(path, about, to_groups(found, channel_names(setup)), replaces)


def load(path: Path, setup: Setup) -> Stored:
    """Read a model file for a case's rig and specimen; raises InputError if it is damaged or belongs to others."""
    file = read_model(path)
    wanted = identity(setup)
    if file.attributes.get("rig_sha256") == _hash(_identified_rig(_with_earlier_default(setup.case.table))):
        wanted["rig_sha256"] = str(file.attributes["rig_sha256"])
    if isinstance(setup.case.table, TargetRigSpec) and file.attributes.get("rig_sha256") in _through_plain(setup):
        wanted["rig_sha256"] = str(file.attributes["rig_sha256"])
    if faults := differences(file.attributes, wanted):
        raise InputError(*(f"{shown(path)}: {fault}" for fault in faults))
    try:
        found = from_groups(file.groups, channel_names(setup))
        _check_band(path, found, setup)
        made = datetime.strptime(str(file.attributes["created_utc"]), TIME).replace(tzinfo=UTC)
        return Stored(path, found, made, file.attributes, file.sha256)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{shown(path)}: lacks a part of its model ({error}); identify again") from error


def _check_band(path: Path, found: Identification, setup: Setup) -> None:
    """Raise InputError if a model was compared with its data in another band than the case needs."""
    if found.compared == setup.compared:
        return
    low, high = found.compared.hz
    raise InputError(
        f"{shown(path)}: compared with its data in {found.compared}, the case needs {setup.compared}; identify again, "
        f"or state identification.compared_hz: [{low:g}, {high:g}]"
    )


def channel_names(setup: Setup) -> tuple[str, ...]:
    """Return the names of the rig's channels, the table's first."""
    return tuple(channel.name for channel in setup.rig.channels)


def identity(setup: Setup) -> dict[str, str | int | float]:
    """Return the attributes with which a model file identifies rig, specimen, settings and software."""
    case = setup.case
    options = case.identification
    return {
        "rig": case.table.name,
        "rig_kind": case.table.kind,
        "rig_sha256": _hash(_identified_rig(case.table)),
        "structure": case.structure.name,
        "specimen_sha256": _specimen_hash(setup),
        "floor_masses_kg": " ".join(f"{mass:g}" for mass in setup.floor_masses_kg),
        "interface_experimental_mass_kg": case.structure.interface_experimental_mass_kg,
        "sample_rate_hz": case.sample_rate_hz,
        "latency_samples": setup.rig.latency_samples,
        "sensor_dynamics": options.sensor_dynamics,
        "latency": options.latency,
        "seed": options.seed,
        "settings": options.model_dump_json(exclude={"model"}),
        "rths_version": __version__,
        "git_commit": git_commit(),
        **({} if (number := laboratory_number(case)) is None else {"laboratory": number}),
    }


def _with_earlier_default(table: RigSpec) -> RigSpec:
    """Return a rig as a model of it was identified before virtual rigs were uncertain by default; other rigs as they
    are."""
    default = VirtualUncertaintySpec()
    usual = isinstance(table, VirtualRigSpec) and _but_table_gain(table.uncertainty) == _but_table_gain(default)
    return table.model_copy(update={"uncertainty": CERTAIN}) if usual else table


def _but_table_gain(stated: UncertaintySpec) -> dict[str, float]:
    return stated.model_dump(exclude=HARDWARE_ONLY["uncertainty"])


def _identified_rig(table: RigSpec) -> str:
    """Return what of a rig file a model depends on; further channels are no part of it, nor are the uncertainties that
    a rig had by default when models began to depend on them: models of that time stay valid."""
    first = UncertaintySpec() if isinstance(table, RealRigSpec) else CERTAIN
    as_at_first = _but_table_gain(table.uncertainty) == _but_table_gain(first)
    beside = HARDWARE_ONLY | ({"uncertainty": True} if as_at_first else {})
    if isinstance(table, RealRigSpec):
        own = table.model_copy(update={"channels": table.accelerometers or None})
        return own.model_dump_json(exclude=beside)
    return table.model_dump_json(exclude={**beside, "channels": True})


def _through_plain(setup: Setup) -> list[str]:
    """Return the hashes of a rig that steps itself as it is identified: through the plain link, with either clock."""
    table = setup.case.table
    fields = {key: getattr(table, key) for key in type(table).model_fields if key != "kind"}
    rigs = (UdpPlainRigSpec.model_construct(**fields, kind="udp_plain", clock=clock) for clock in ("runner", "target"))
    return [_hash(_identified_rig(rig)) for rig in rigs]


def _specimen_hash(setup: Setup) -> str:
    """Return the hash of the specimen: of its weighed masses, on a virtual rig also of stiffness and damping."""
    structure = setup.case.structure
    declared = structure.experimental.model_dump_json() if setup.rig.can.carries_declared_specimen else ""
    masses = [*setup.floor_masses_kg.tolist(), structure.interface_experimental_mass_kg]
    return _hash(json.dumps(masses) + declared)


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def differences(stated: Mapping[str, str | int | float], wanted: Mapping[str, str | int | float]) -> list[str]:
    """Return a sentence for each difference between a model file and a case that forbids its use."""
    faults = []
    can = capabilities_of(str(wanted["rig_kind"]))  # a rig that steps itself is identified through another file
    if can.moves_hardware and not can.steps_itself and _rig(stated) != _rig(wanted):
        name, kind = _rig(stated)
        return [
            f"identified on rig {name} of kind {kind}, the case's rig is {wanted['rig']} of kind {wanted['rig_kind']}; "
            "a real rig needs a model that was identified on it"
        ]
    if stated.get("rig_sha256") != wanted["rig_sha256"]:
        faults.append(
            f"identified on rig {stated.get('rig', 'unknown')}, the case's rig {wanted['rig']} is another one (or its "
            "file or calibration has changed); identify the rig of the case"
        )
    if stated.get("laboratory") != wanted.get("laboratory") and not faults:
        faults.append(
            f"identified in laboratory {stated.get('laboratory', 'as declared')}, the case is in laboratory "
            f"{wanted.get('laboratory', 'as declared')}, whose sensors and masses are others; identify there, or state "
            "the laboratory (table.imperfections.laboratory)"
        )
    if stated.get("specimen_sha256") != wanted["specimen_sha256"]:
        faults.append(
            f"identified with the specimen of {stated.get('structure', 'unknown')} (floors "
            f"{stated.get('floor_masses_kg', '?')} kg), the case's is that of {wanted['structure']} "
            f"({wanted['floor_masses_kg']} kg) and differs; identify with the specimen of the case"
        )
    for key, text in (
        ("sample_rate_hz", "sampled at {} Hz, the case runs at {} Hz"),
        ("latency_samples", "identified with a latency of {} samples, the case's rig has {}"),
        ("sensor_dynamics", "identified with sensor dynamics {}, the case says {}"),
    ):
        if stated.get(key) != wanted[key]:
            faults.append(f"{text.format(stated.get(key, '?'), wanted[key])}; identify again, or change the case")
    return faults


def _rig(about: Mapping[str, str | int | float]) -> tuple[str, str]:
    """Return name and kind of a rig; a rig varied by --set, for example table.unattended=true, has the same name."""
    return str(about.get("rig", "unknown")).removesuffix(VARIED), str(about.get("rig_kind", "unknown"))


class Cache:
    """Models of virtual rigs in the user's cache; `fresh` ignores existing ones. Cache errors are ignored."""

    def __init__(self, fresh: bool = False, folder: Path | None = None) -> None:
        self._fresh = fresh
        self._folder = folder or cache_or_temporary() / "models"

    def has(self, setup: Setup) -> bool:
        """Return whether there is a model of the same rig, specimen, settings, seed, software and kind of processor."""
        return not self._fresh and os.path.exists(self.path(setup))

    def find(self, setup: Setup) -> Stored | None:
        """Return the model of the same rig, specimen, settings, seed, software and kind of processor, or None."""
        if not self.has(setup):
            return None
        path = self.path(setup)
        try:
            found = load(path, setup)
        except InputError:
            return None
        with suppress(OSError):
            os.utime(path)
        return found

    def keep(self, setup: Setup, found: Identification, data_sha256: str) -> None:
        """Store a model for later runs."""
        with suppress(InputError):
            save(self.path(setup), setup, found, "excited on the virtual table", data_sha256)
            self._prune()

    def path(self, setup: Setup) -> Path:
        """Return the cache file for the model of a setup's rig and specimen."""
        return self._folder / f"{key(setup)[:32]}.h5"

    def _prune(self) -> None:
        with suppress(OSError):
            aged = sorted(self._folder.glob("*.h5"), key=lambda path: path.stat().st_mtime, reverse=True)
            for path in aged[KEPT:]:
                path.unlink(missing_ok=True)


def key(setup: Setup) -> str:
    """Return a hash of everything that an identification on a virtual rig depends on."""
    case = setup.case
    parts = (
        case.table.model_dump_json(exclude={"after_identification", "name"}),
        case.structure.experimental.model_dump_json(),
        case.structure.interface_experimental_mass_kg,
        None if setup.building.heights_m is None else setup.building.heights_m.tolist(),
        case.identification.model_dump_json(),
        case.sample_rate_hz,
        laboratory_number(case),
        software(),
        processor(),
        platform.libc_ver(),
        *(os.environ.get(name, "") for name in ROUNDING),
    )
    return _hash(repr(parts))


@cache
def software() -> str:
    """Return a hash of this version's sources and of the numerical packages."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(f"{__version__} {platform.python_version()} {platform.machine()}".encode())
    for name in ("numpy", "scipy", "numba"):
        digest.update(package_version(name).encode())
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
