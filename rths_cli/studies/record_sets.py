"""Sets of records as values of an axis: a folder, or a text file that names a record in each line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from rths_cli.case.named_files import find, is_bare, is_record, suffixes
from rths_cli.case.yaml_reader import Source, parse, plain
from rths_cli.errors import InputError
from rths_cli.safe_text import shortened

KEYS = ("record", "record.file")  # of a case, whose values are records
MOST_LIST_BYTES = 1 << 20
LINE = "a name, a path from the list's folder, or {file: ..., component: ...}"


def is_set(place: Path) -> bool:
    """Return whether a path is a folder, or a text file that is no record itself."""
    if place.is_dir():
        return True
    try:
        if not place.is_file() or is_record(place) or place.stat().st_size > MOST_LIST_BYTES:
            return False
        return b"\0" not in place.read_bytes()
    except OSError:
        return False


def records_of(named: str, folder: Path) -> tuple[Any, ...]:
    """Return the records of a set as values of `record`: paths as the set is named, names, mappings.

    `named`: the set's path from `folder`. Raises InputError, with every line at fault, for a folder without records and
    a list that names something else or something twice.
    """
    place = folder / os.path.expanduser(named)
    if place.is_dir():
        names = sorted(path.name for path in place.iterdir() if path.suffix in suffixes("records") and is_record(path))
        if not names:
            raise InputError(f"{place} holds no record; put records into it, or name another folder")
        return tuple(os.path.join(named, name) for name in names)
    if not is_set(place):
        raise InputError(f"no such folder: {place}; check the path")
    return _of_list(place, os.path.dirname(named) or os.curdir)


def _of_list(place: Path, beside: str) -> tuple[Any, ...]:
    """Return the records that the lines of a text file name; `beside`: its folder, as the values name it."""
    found: list[Any] = []
    faults: list[str] = []
    for number, line in enumerate(place.read_text(encoding="utf-8-sig", errors="replace").splitlines(), 1):
        text = line.partition(" #")[0].strip() if not line.lstrip().startswith("#") else ""
        if not text:
            continue
        value = _of_line(text, place, beside)
        if value is None:
            faults.append(f"{place}:{number}: {shortened(text, 60)!r} names no record; a line is {LINE}")
        elif value in found:
            faults.append(f"{place}:{number}: {shortened(text, 60)} stands there twice; remove one")
        else:
            found.append(value)
    if not found and not faults:
        faults.append(f"{place}: names no record; a line is {LINE}")
    if faults:
        raise InputError(*faults[:20])
    return tuple(found)


def _of_line(text: str, place: Path, beside: str) -> Any:
    """Return the value of `record` that a line states, None where it names no record."""
    if not text.startswith("{"):
        return _named(text, place, beside)
    node, _ = parse(text, Source(str(place), place.parent))
    value = plain(node) if node is not None else None
    if not isinstance(value, dict) or not isinstance(value.get("file"), str):
        return None
    named = _named(value["file"], place, beside)
    return None if named is None else {**value, "file": named}


def _named(name: str, place: Path, beside: str) -> str | None:
    """Return a record as a value names it, None where there is none."""
    path = Path(os.path.expanduser(name))
    if (place.parent / path).is_file():
        return str(path) if path.is_absolute() else os.path.join(beside, name)
    if not is_bare(name):
        return None
    try:
        find(name, "records", place.parent.absolute())
    except InputError:
        return None
    return name
