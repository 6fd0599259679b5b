"""The `kind`s that other packages add to rig files: entry points of the group `rths.rigs`."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

from rths_cli.case.plugin_interface import RIGS

GROUP = RIGS


def plugin_kinds() -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points of every further kind of rig by its name."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for point in entry_points(group=GROUP):
        found[point.name] = (*found.get(point.name, ()), point)
    return found
