"""What an installed package offers to a case: rigs, laws and compensators through entry points, and their names.

The module that an entry point of `rths.rigs`, `rths.laws` or `rths.compensators` names states `RTHS_INTERFACE`, a whole
number. Version 1 of rigs is that of rths 0.1, whose packages state none; version 2 renamed the fields of `Channel`.
"""

from __future__ import annotations

import logging
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from rths_cli.errors import InputError

STATED = "RTHS_INTERFACE"
RIGS, LAWS, COMPENSATORS = "rths.rigs", "rths.laws", "rths.compensators"
INTERFACE = {RIGS: 2, LAWS: 1, COMPENSATORS: 1}
"""The version of the interface of each group of entry points; those from 1 on are taken."""
ENDS = "0.3"  # version of rths without the old names
RENAMED = {
    "sensitivity_v_per_m_s2": "sensitivity_v_per_unit",
    "range_m_s2": "range",
    "warning_m_s2": "warning",
    "abort_m_s2": "abort",
}
"""Fields of a channel in version 1 of the interface of rigs, and their present names."""
MOVED = {"rths_cli.lti": "rths_cli.numerics.lti", "rths_cli.rig_info": "rths_cli.rigs.description"}
"""Modules of version 1, and where their names are now."""
OLD_NAMES: set[str] = set()
"""The old names that plug-ins of this process have asked for; told once the table is at rest."""
TOLD: set[str] = set()
"""The sentences that this process has warned of."""

GROUP = RIGS


def stated_interface(point: EntryPoint, who: str) -> int:
    """Return the version that an entry point's module states, 1 where it states none.

    Raises InputError for one that is no version, or later than this rths.
    """
    newest = INTERFACE[point.group]
    stated = getattr(import_module(point.module), STATED, 1)
    if not isinstance(stated, int) or isinstance(stated, bool) or stated < 1:
        raise InputError(f"{who}: its {STATED} is {str(stated)[:40]!r}, it must be a whole number, {newest} now")
    if stated > newest:
        raise InputError(
            f"{who}: was written for interface {stated} of {point.group}, this rths has {newest}; update rths, or take "
            "an older version of its package"
        )
    return stated


def old_version_sentence(point: EntryPoint, who: str, stated: int) -> str:
    """Return what to say of a plug-in of an older interface, "" for one of the newest."""
    newest = INTERFACE[point.group]
    if stated == newest:
        return ""
    return (
        f"{who} was written for interface {stated}, which rths takes until version {ENDS}; state "
        f"{STATED} = {newest} in {point.module} once it uses the present names"
    )


def not_loaded(error: BaseException) -> str:
    """Return why a plug-in cannot be loaded, where it asks for a module that rths has moved; else ""."""
    name = getattr(error, "name", None)
    if not isinstance(error, ImportError) or name not in MOVED:
        return ""
    return f"it imports {name}, which is now {MOVED[name]}"


def missing_name(error: BaseException) -> str:
    """Return what a plug-in asks for that its interface does not have, as a clause; "" for another error."""
    asked, of = getattr(error, "name", None), type(getattr(error, "obj", None))
    if not isinstance(error, AttributeError) or not of.__module__.startswith("rths_cli."):
        return ""
    return f"asks for {of.__name__}.{asked}, which interface {INTERFACE[RIGS]} of {RIGS} does not have"


def tell_once(sentence: str) -> None:
    """Warn on stderr, once in a process; "" is nothing."""
    if sentence and sentence not in TOLD:
        TOLD.add(sentence)
        logging.getLogger("rths_cli").warning("warning: %s", sentence)


def tell_old_names(who: str) -> None:
    """Warn of the old names that plug-ins have asked for."""
    for name in sorted(OLD_NAMES):
        tell_once(f"{who} uses {name} of a channel, which is {RENAMED[name]} now; the old name ends with {ENDS}")


def plugin_kinds() -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points of every further kind of rig by its name."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for point in entry_points(group=GROUP):
        found[point.name] = (*found.get(point.name, ()), point)
    return found
