"""What `rths plugin test` does: load what a package or a file brings, and hold its rigs and compensators to their
contracts."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from pathlib import Path

from rths_cli.case.compensator_schema import OWN
from rths_cli.case.plugin_interface import COMPENSATORS, INTERFACE, LAWS, RIGS, stated_interface
from rths_cli.control.compensator import Definition, definition_of
from rths_cli.errors import InputError, RthsError
from rths_cli.laboratory.compensator_trial import clauses
from rths_cli.rigs.contract import Kept, contract, made_info
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.plugin_rigs import open_plugin

DEFAULT_CASE = "el_centro_low_ff_fb"  # lends its structure to the rig file
HARDWARE = "hardware"
LOADED = "it is loaded, with an interface that this rths has"


@dataclass(frozen=True)
class Tested:
    """One entry point of a package: its interface (0: not known) and the clauses that were tried."""

    name: str
    group: str
    value: str
    interface: int
    clauses: tuple[Kept, ...]

    @property
    def kept(self) -> bool:
        """Return whether nothing was broken."""
        return not any(one.fault for one in self.clauses)


def try_package(package: str, rig_file: str | None, say: Callable[[str], None]) -> tuple[Tested, ...]:
    """Return what became of each entry point of a package; raises InputError where there is none, or where a rig has
    hardware behind it, which the contract would move."""
    if package.endswith(".py") or Path(package).is_file():
        say(package)
        return (_compensator_file(Path(package)),)
    points = _points(package)
    given = _described(rig_file) if rig_file else None
    if given is not None and not any(point.name == given[0].kind and point.group == RIGS for point in points):
        kinds = ", ".join(point.name for point in points if point.group == RIGS) or "none"
        raise InputError(f"--rig {rig_file}: is of kind {given[0].kind}, {package} brings {kinds}")
    found = []
    for point in points:
        say(f"{point.name} of {package}")
        if point.group == LAWS:
            found.append(_law(point))
        elif point.group == COMPENSATORS:
            found.append(_compensator(point))
        elif given is None or given[0].kind == point.name:
            info, options = given or (made_info(point.name), {})
            found.append(_rig(point, info, options))
    return tuple(found)


def _points(package: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of an installed package, or those of a kind of rig, law or compensator of that name."""
    try:
        of_package = tuple(point for point in distribution(package).entry_points if point.group in INTERFACE)
    except (PackageNotFoundError, ValueError):
        known = [point for group in INTERFACE for point in entry_points(group=group)]
        named = tuple(point for point in known if package in (point.name, point.module.partition(".")[0]))
        if named:
            return named
        names = ", ".join(sorted({point.name for point in known})) or "none"
        raise InputError(
            f"{package}: no package of that name is installed, and no rig, law or compensator is called so; installed: "
            f"{names}; install it first: pip install FOLDER"
        ) from None
    if not of_package:
        raise InputError(f"{package}: names nothing in the entry point groups {', '.join(INTERFACE)}")
    return of_package


def _described(rig_file: str) -> tuple[RigInfo, Mapping[str, object]]:
    """Return a rig as its file describes it, on the structure of a shipped case, and its options."""
    from rths_cli.case.load import load_cases
    from rths_cli.case.rig_schema import PluginRigSpec
    from rths_cli.rigs.from_case import rig_info

    table = f"table={json.dumps(rig_file)}"
    case = load_cases([DEFAULT_CASE], (table,), {table: f"--rig {rig_file}"})[0]
    if not isinstance(case.table, PluginRigSpec):
        raise InputError(f"--rig {rig_file}: its kind is {case.table.kind}, which no package brings")
    return rig_info(case), case.table.options


def _law(point: EntryPoint) -> Tested:
    from rths_cli.structure.own_laws import installed_law

    try:
        interface = stated_interface(point, f"law {point.name}")
        installed_law(point.name)
    except InputError as error:
        return Tested(point.name, LAWS, point.value, 0, tuple(Kept(LOADED, fault) for fault in error.faults))
    return Tested(point.name, LAWS, point.value, interface, (Kept(LOADED, ""),))


def _compensator_file(path: Path) -> Tested:
    """Return what became of the compensator in a user's file."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    return _tried_compensator(path.name, str(path), 0, lambda: definition_of(OWN, path))


def _compensator(point: EntryPoint) -> Tested:
    try:
        interface = stated_interface(point, f"compensator {point.name}")
    except InputError as error:
        return Tested(point.name, COMPENSATORS, point.value, 0, tuple(Kept(LOADED, fault) for fault in error.faults))
    return _tried_compensator(point.name, point.value, interface, lambda: definition_of(point.name))


def _tried_compensator(name: str, value: str, interface: int, load: Callable[[], Definition]) -> Tested:
    try:
        definition = load()
    except InputError as error:
        return Tested(name, COMPENSATORS, value, interface, tuple(Kept(LOADED, fault) for fault in error.faults))
    return Tested(name, COMPENSATORS, value, interface, (Kept(LOADED, ""), *clauses(definition)))


def _rig(point: EntryPoint, info: RigInfo, options: Mapping[str, object]) -> Tested:
    try:
        rig = open_plugin(info, options)
        interface = stated_interface(point, point.name)
        rig.open()
        behind = rig.info.driver_verified
        rig.close()
    except RthsError as error:
        faults = error.faults if isinstance(error, InputError) else (str(error),)
        return Tested(point.name, RIGS, point.value, 0, tuple(Kept(LOADED, fault) for fault in faults))
    if behind == HARDWARE:
        raise InputError(
            f"{point.name}: states that hardware is behind it, which the contract would move to its limits; let it run "
            "on a simulation of its own and state driver_verified='fake' or 'loopback'"
        )
    clauses = tuple(contract(lambda: open_plugin(info, options)))
    return Tested(point.name, RIGS, point.value, interface, (Kept(LOADED, ""), *clauses))
