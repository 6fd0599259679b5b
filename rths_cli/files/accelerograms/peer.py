"""PEER records (.AT2) of every generation; the same layout with velocities (.VT2) or displacements (.DT2)."""

from __future__ import annotations

import re
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import find_unit
from rths_cli.files.accelerograms.columns import series
from rths_cli.files.accelerograms.record import (
    Channel,
    Header,
    count_of,
    interval_of,
    known_unit,
    squeezed,
)

# Each is given a line with single spaces, so that none tries the ways to share a run of them.
_AT2_NEW = re.compile(
    r"(?=.*\b(?:NPTS|NUMBER OF POINTS) ?[=:] ?(\d+)(?![\d.]|,\d))(?=.*\bDT ?[=:] ?([\d.eE+-]+))", re.IGNORECASE
)
_AT2_OLD = re.compile(r"^(\d+) ([\d.eE+-]+) NPTS ?, ?DT", re.IGNORECASE)
_AT2_UNIT = re.compile(r"UNITS? OF ([^ ,]+)", re.IGNORECASE)
_OTHER_RECORD = re.compile(r"^(VELOCITY|DISPLACEMENT)\b", re.IGNORECASE)
_AT2_LAST_LINE = 10


def read(path: Path, lines: list[str]) -> list[Channel] | None:
    """Return the record of a PEER .AT2 file, None for any other text; raises InputError."""
    header = at2_header(path, lines)
    return None if header is None else [series(path, lines, header)]


def at2_header(path: Path, lines: list[str]) -> Header | None:
    """Return the header of a PEER .AT2 file, old or new, or None when no line states NPTS and DT."""
    for index, line in enumerate(map(squeezed, lines[:_AT2_LAST_LINE])):
        match = _AT2_NEW.match(line) or _AT2_OLD.search(line)
        if match is None or line.startswith("#"):
            continue
        unit, unit_line = _at2_unit(path, lines[:index])
        return Header(
            "PEER AT2",
            first_line=index + 1,
            title=lines[1].strip() if index > 1 else "",
            origin=lines[0].strip() if index > 0 else "",
            unit=unit,
            unit_line=unit_line,
            dt_s=interval_of(f"{path}:{index + 1}", match[2]),
            dt_line=index + 1,
            samples=count_of(f"{path}:{index + 1}", match[1]),
            samples_line=index + 1,
        )
    return None


def _at2_unit(path: Path, lines: list[str]) -> tuple[str | None, int]:
    """Return the unit and its line from a header like `ACCELERATION TIME SERIES IN UNITS OF G`."""
    for number, line in enumerate(lines, 1):
        match = _AT2_UNIT.search(squeezed(line))
        if match is not None:
            kind = _OTHER_RECORD.search(squeezed(line))
            if kind is not None and find_unit(match[1]) is None:
                raise InputError(
                    f"{path}:{number}: is a {kind[1].lower()} record; give the acceleration record of the same station "
                    "(.AT2)"
                )
            return known_unit(f"{path}:{number}", match[1]), number
    return None, 0
