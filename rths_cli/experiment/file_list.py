"""The work of `rths list`: the cases, structures, rigs, records or references that a name may stand for here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rths_cli.case.load import load_cases, load_reference, load_rig, load_structure
from rths_cli.case.named_files import known_files
from rths_cli.case.shipped_files import is_shipped
from rths_cli.case.yaml_tree import display
from rths_cli.errors import InputError

Details = Mapping[str, Any]


@dataclass(frozen=True)
class Listed:
    """One file that can be named."""

    name: str
    file: str  # path as a user would type it
    own: bool  # whether it is the user's own, not a shipped one
    description: str  # one line, or why the file cannot be used
    details: Details  # for JSON; empty if the file cannot be used


def list_files(kind: str) -> list[Listed]:
    """Return the files of a kind (cases, structures, rigs, records or references), the user's own first."""
    found = [_listed(kind, name, path) for name, path in sorted(known_files(kind, Path.cwd()).items())]
    return sorted(found, key=lambda one: not one.own)


def _listed(kind: str, name: str, path: Path) -> Listed:
    own = not is_shipped(path)
    where = display(path) if own else str(path)
    try:
        description, details = DESCRIBED[kind](Path(where))
    except InputError as error:
        more = f" (and {len(error.faults) - 1} more)" if len(error.faults) > 1 else ""
        return Listed(name, where, own, f"cannot be used: {error.faults[0]}{more}", {})
    return Listed(name, where, own, description, details)


def _case(path: Path) -> tuple[str, Details]:
    case = load_cases([path])[0]
    details: dict[str, Any] = {
        "structure": case.structure.name,
        "damping": case.damping.name,
        "record": case.record.name,
        "scaling": case.scaling,
        "controller": case.controller.kind,
        "rig": case.table.name,
        "method": case.method,
    }
    text = "{structure}, damping {damping}, {record} x {scaling:g}, {controller}, rig {rig}".format(**details)
    return text, details


def _structure(path: Path) -> tuple[str, Details]:
    spec, levels, *_ = load_structure(str(path.absolute()))
    numerical, experimental = len(spec.numerical.masses_kg), len(spec.experimental.masses_kg)
    mass = sum(spec.numerical.masses_kg) + sum(spec.experimental.masses_kg)
    named = [level.name for level in levels]
    text = f"{numerical + experimental} storeys, {experimental} on the table, {mass:g} kg; damping "
    details = {"numerical_storeys": numerical, "experimental_storeys": experimental, "mass_kg": mass}
    return text + (", ".join(named) or "levels: none"), {**details, "damping_levels": named}


def _rig(path: Path) -> tuple[str, Details]:
    rig = load_rig(path)
    details = {
        "kind": rig.kind,
        "payload_kg": rig.nominal.payload_kg,
        "stroke_m": rig.limits.stroke_m,
        "force_n": rig.limits.force_n,
    }
    text = f"{rig.kind}, {rig.nominal.payload_kg:g} kg payload, +-{1e3 * rig.limits.stroke_m:g} mm, "
    return f"{text}{rig.limits.force_n:g} N", details


def _record(path: Path) -> tuple[str, Details]:
    from rths_cli.experiment.ground_motion_list import facts_of

    details = facts_of(path)
    text = "{title}; {samples} samples every {dt_s:g} s, {duration_s:.2f} s, peak {peak_m_s2:.4f} m/s^2"
    return text.format(**details), details


def _reference(path: Path) -> tuple[str, Details]:
    reference = load_reference(path)
    details = {"title": reference.title, "source": reference.source, "entries": len(reference.entries)}
    return f"{reference.title}; {reference.source}", details


DESCRIBED: Mapping[str, Callable[[Path], tuple[str, Details]]] = {
    "cases": _case,
    "structures": _structure,
    "rigs": _rig,
    "records": _record,
    "references": _reference,
}
