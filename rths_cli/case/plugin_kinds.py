"""Kinds of rigs that other packages bring: entry points of the group `rths.rigs`."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

GROUP = "rths.rigs"
OWN_KINDS = ("virtual", "udp", "ni")


def plugin_kinds() -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points of every further kind of rig by its name; a name of our own is never taken over."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for point in entry_points(group=GROUP):
        if point.name not in OWN_KINDS:
            found[point.name] = (*found.get(point.name, ()), point)
    return found
