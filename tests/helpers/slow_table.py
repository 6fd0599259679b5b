"""The example plug-in as if it were installed: its package on the path, its entry points read from its own metadata."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from rths_cli.case import plugin_interface

EXAMPLE = Path(__file__).parents[2] / "examples" / "plugin_rig"


def slow_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the example plug-in for one test."""
    stated = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    points = {group: [EntryPoint(*pair, group) for pair in pairs.items()] for group, pairs in stated.items()}
    monkeypatch.syspath_prepend(str(EXAMPLE / "src"))
    monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points.get(group, []))
