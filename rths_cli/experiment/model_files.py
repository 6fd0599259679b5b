"""Save and load model files, reject those of another rig or specimen; the cache of models of virtual rigs."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal

from rths_cli.case.resolve import VARIED
from rths_cli.case.rig_schema import (
    CERTAIN,
    RealRigSpec,
    RigSpec,
    UncertaintySpec,
    VirtualRigSpec,
    VirtualUncertaintySpec,
)
from rths_cli.errors import InputError
from rths_cli.experiment.model_datasets import from_groups, to_groups
from rths_cli.experiment.provenance import git_commit, package_version
from rths_cli.experiment.setup import Setup, shown
from rths_cli.files.durable_files import Stamp
from rths_cli.files.model_file import Written, read_model, write_model
from rths_cli.identification.results import Identification
from rths_cli.numerics.compiled import processor
from rths_cli.quantities import attribute_fault
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES
from rths_cli.rigs.description import capabilities_of
from rths_cli.rigs.from_case import laboratory_number
from rths_cli.user_cache import cache_or_temporary
from rths_cli.version import __version__

# they choose the instructions of BLAS, numpy and the C library, and with them the last bits of an identification
ROUNDING = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES", "GLIBC_TUNABLES", "MKL_CBWR")
KEPT = 200  # largest number of models in the cache; the oldest are removed first
TIME = "%Y-%m-%dT%H:%M:%SZ"
LEVELS = dict.fromkeys(("name", "warning_m_s2", "abort_m_s2", "sensitivity_uncertainty"), True)
HARDWARE_ONLY: dict[str, Any] = {  # of a rig file: no part of what the rig is
    **dict.fromkeys(("limits", "name", "after_identification"), True),
    **dict.fromkeys(("udp", "unattended", "watchdog_s", "overrun", "model"), True),
    "sensors": LEVELS,
    "channels": {"__all__": LEVELS},
    "imperfections": {"laboratory"},
    "uncertainty": {"table_gain"},
    "calibration": {
        **dict.fromkeys(("made_utc", "by", "model", "specimen", "masses"), True),
        "channels": {"__all__": {"sensitivity_uncertainty", "joint_uncertainty"}},
    },
}


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
    if capabilities_of(str(wanted["rig_kind"])).moves_hardware and _rig(stated) != _rig(wanted):
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
