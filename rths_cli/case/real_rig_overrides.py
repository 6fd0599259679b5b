"""What a case may change of a real rig's file: only tighten its limits."""

from __future__ import annotations

from collections.abc import Iterator

from rths_cli.case.field_types import shown
from rths_cli.case.rig_capabilities import capabilities_of
from rths_cli.case.rig_schema import (
    DEFAULT_ENERGY_RATIO,
    DEFAULT_LOST_SAMPLES,
    KINDS,
    PluginRigSpec,
    RealRigSpec,
    RigSpec,
)
from rths_cli.case.yaml_reader import Fault, Node, join, plain

REAL_DEFAULTS = {"lost_samples": float(DEFAULT_LOST_SAMPLES), "energy_ratio": DEFAULT_ENERGY_RATIO}
REAL: tuple[type[RigSpec], ...] = (PluginRigSpec, *KINDS.values())
KEYS = frozenset(key for model in REAL if issubclass(model, RealRigSpec) for key in model.model_fields)
STRICTER = "a case may only be stricter"


def is_real(rig: Node) -> bool:
    """Tell whether a rig's mapping is that of a table that moves; one that states no kind is simulated."""
    kind = rig.children.get("kind")
    return kind is not None and capabilities_of(kind.value).moves_hardware


def over_real_rig(base: Node, own: dict[str, Node], key: str) -> tuple[dict[str, Node], list[Fault]]:
    """Return what a case may state over the file of a real rig, and a fault for each thing it may not.

    Keys that no real rig has are left to the rig's model to refuse.
    """
    limits = own.get("limits")
    faults = list(_looser(base, limits, join(key, "limits"))) if limits is not None else []
    for name in sorted((own.keys() & KEYS) - {"limits"}):
        got = shown(plain(own[name]))
        ends = f"got {got}; change it there, or name a rig file of your own"
        where = f"only the rig's own file {base.mark.source.label} may state this"
        faults.append(Fault(own[name].place, join(key, name), f"{where}, {ends}"))
    return {name: node for name, node in own.items() if name not in KEYS or name == "limits"}, faults


def made_real(own: dict[str, Node], key: str) -> list[Fault]:
    """Return a fault where a case makes a real rig of a file that is none: no limit of that file would hold."""
    kind = own.get("kind")
    if kind is None or not capabilities_of(kind.value).moves_hardware:
        return []
    said = f"only the rig's own file may make it a real one, got {shown(plain(kind))}; state it there"
    return [Fault(kind.place, join(key, "kind"), said)]


def set_inside(rig: Node, key: str) -> list[Fault]:
    """Return a fault for everything that --set changes in a real rig whose mapping stands in the case itself."""
    faults = []
    for path, node in _leaves(rig, key):
        if node.mark.source == rig.mark.source or node.mark.source.path is not None:  # of this case, or of its base
            continue
        advice = "give a stricter limit under limits" if path.startswith(f"{key}.limits.") else "change it there"
        said = f"the case itself states this real rig, --set may not change it, got {shown(plain(node))}; {advice}"
        faults.append(Fault(node.mark, path, said))
    return faults


def _looser(base: Node, limits: Node, key: str) -> Iterator[Fault]:
    """Yield a fault for each limit that is not as strict as the rig's."""
    stated = base.children.get("limits", Node({}, base.mark)).children
    for name, node in limits.children.items():
        limit = stated[name].value if name in stated else None
        limit = REAL_DEFAULTS.get(name) if limit is None else limit
        if not _is_number(limit) or not (_is_number(node.value) or node.value is None):
            continue
        if node.value is None or node.value > limit:  # type: ignore[operator]
            got = shown(node.value) if node.value is None else f"{node.value:g}"
            ends = f"{STRICTER}, {base.mark.source.label} states the rig's"
            yield Fault(node.mark, join(key, name), f"must be <= the rig's {limit:g}, got {got}; {ends}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _leaves(node: Node, key: str) -> Iterator[tuple[str, Node]]:
    """Yield every value below a mapping with its dotted key; a list is one value."""
    for name, child in node.children.items():
        path = join(key, name)
        yield from _leaves(child, path) if child.children else ((path, child),)
