"""Data classes of a measured file: as found (`Contents`), and checked (`Recording`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from rths_cli.numerics.lti import Array

_NAMES_LISTED = 12


@dataclass(frozen=True)
class Recording:
    """One measured recording: channels sampled together, as the file holds them.

    `sha256` is that of the file's bytes. `names` (c,) are as in the file, `units` (c,) canonical or "" where not
    known. `samples` (c, n) are in those units, NaN where missing, every `dt_s`. `notes` are sentences for the user.
    """

    path: Path
    sha256: str
    dt_s: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    samples: Array
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Column:
    """One series of a file: its name, its figures (n,), and the unit stated beside the name, "" if none.

    `start_s`: when its first sample was taken, in s on a clock that all channels share; None where nothing states it.
    """

    name: str
    values: Array
    unit: str = ""
    start_s: float | None = None


@dataclass(frozen=True)
class Contents:
    """What a file holds, before any check: columns (time among them) and stated sampling intervals.

    `intervals_s` pairs what states an interval with its value in s. `line_of` returns the line of a row counted from
    0 where the file has lines. `exact`: the project's own form, whose names and units stand as they are.
    """

    columns: tuple[Column, ...]
    intervals_s: tuple[tuple[str, float], ...] = ()
    notes: tuple[str, ...] = ()
    line_of: Callable[[int], int] | None = None
    exact: bool = False


def place(path: Path, contents: Contents, row: int) -> str:
    """Return where a row, counted from 0, stands: `file:line` for text, else `file: row N`."""
    return f"{path}: row {row + 1}" if contents.line_of is None else f"{path}:{contents.line_of(row)}"


def listed(names: Iterable[str]) -> str:
    """Return at most a dozen names as text."""
    every = list(names)
    more = f" and {len(every) - _NAMES_LISTED} more" if len(every) > _NAMES_LISTED else ""
    return ", ".join(every[:_NAMES_LISTED]) + more
