"""Data classes of YAML nodes with their line and column, and of faults."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rths_cli.case.shipped_files import is_shipped


@dataclass(frozen=True)
class Source:
    """A file, or the command line: `label` is how faults name it, relative paths in it start at `folder`."""

    label: str
    folder: Path
    path: Path | None = None


@dataclass(frozen=True)
class Mark:
    """A place in a source; line and column count from 1, line 0 stands for the source as a whole."""

    source: Source
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.source.label}:{self.line}:{self.column}" if self.line else self.source.label


OPTIONS = ("--rig ", "--structure ", "rths serve ")  # what names a value on the command line beside --set


@dataclass(frozen=True)
class Fault:
    """One fault: where it is, the dotted key it is about (may be empty), and a sentence."""

    mark: Mark
    key: str
    message: str

    def __str__(self) -> str:
        label = self.mark.source.label
        told = f"{label}.".startswith(f"--set {self.key}.") or (label.startswith(OPTIONS))
        named = f"{self.key}: " if self.key and not told else ""
        return f"{self.mark}: {named}{self.message}"


Scalar = str | int | float | bool | Path | None


@dataclass(frozen=True)
class Node:
    """A value of a YAML document with its place; children of a mapping also know the place of their key."""

    value: Scalar | tuple[Node, ...] | dict[str, Node]
    mark: Mark
    key_mark: Mark | None = None

    @property
    def place(self) -> Mark:
        """Return where the key stands, or the value when there is no key."""
        return self.key_mark or self.mark

    @property
    def children(self) -> dict[str, Node]:
        """Return the keys of a mapping; a list or a scalar has none."""
        return self.value if isinstance(self.value, dict) else {}


def plain(node: Node) -> Any:
    """Return the value without places: dict, tuple or scalar."""
    if isinstance(node.value, dict):
        return {key: plain(child) for key, child in node.value.items()}
    if isinstance(node.value, tuple):
        return tuple(plain(child) for child in node.value)
    return node.value


def join(path: str, key: str | int) -> str:
    """Return the dotted name of a key below `path`; a list index stands in brackets, counted from 1."""
    if isinstance(key, int):
        return f"{path}[{key + 1}]"
    shown = key if re.fullmatch(r"[\w+\-./\[\]]{1,80}", key) else repr(key[:40])
    return f"{path}.{shown}" if path else shown


def display(path: Path) -> str:
    """Return a path as faults show it: relative to the current folder when it lies below it, the name of a shipped file
    elsewhere."""
    relative = os.path.relpath(path)
    if not relative.startswith(".."):
        return printable(relative)
    return printable(path.stem if is_shipped(path) else str(path.absolute()))


def printable(text: str) -> str:
    """Return a text as it is, or quoted with escapes when a terminal could not show it on one line."""
    return text if text.isprintable() else repr(text)
