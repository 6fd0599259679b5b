"""Numbers in columns of fixed width, as a Fortran format such as `(8F10.5)` or `(10I8)` writes them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

_EDIT = re.compile(r"(\d{0,3})\s*([IFEGD])\s*(\d{1,3})(?:\.(\d{1,2}))?", re.IGNORECASE)


@dataclass(frozen=True)
class Layout:
    """`per_line` fields of `width` characters; a field without a point has `decimals` of them behind one."""

    per_line: int
    width: int
    decimals: int = 0


def layout_of(text: str) -> Layout | None:
    """Return the layout that a Fortran format states, None for any other text."""
    match = _EDIT.search(re.sub(r"\d*P,?", "", text, flags=re.IGNORECASE))
    if match is None or not 0 < int(match[3]) <= 40:
        return None
    return Layout(int(match[1] or 1) or 1, int(match[3]), int(match[4] or 0))


def layout_of_rows(line: str, per_line: int) -> Layout | None:
    """Return the layout of a full line of `per_line` right-aligned fields whose format is not stated, None for none."""
    length = len(line.rstrip())
    return Layout(per_line, length // per_line) if length and length % per_line == 0 else None


def numbers(path: Path, lines: list[str], first: int, count: int, layout: Layout) -> tuple[Array, int]:
    """Return `count` numbers that begin in line `first` (from 0), and the line after them.

    Raises InputError with the line of a field that is no number, and for a text that ends before.
    """
    values = np.empty(count)
    rows = -(-count // layout.per_line)
    for k in range(rows):
        done = k * layout.per_line
        wanted = min(layout.per_line, count - done)
        line = lines[first + k] if first + k < len(lines) else ""
        fields = [line[j * layout.width : (j + 1) * layout.width].strip() for j in range(wanted)]
        for j, cell in enumerate(fields):
            number = _number(cell, layout.decimals)
            if number is None:
                raise InputError(_fault(path, first + k + 1, cell, count, done + j, layout))
            values[done + j] = number
    return values, first + rows


def _fault(path: Path, line: int, cell: str, count: int, held: int, layout: Layout) -> str:
    if cell and not re.search(r"[A-DF-Za-df-z]{2}", cell):
        return (
            f"{path}:{line}: {cell!r} is not a number of {layout.per_line} a line in {layout.width} characters each, "
            "as the header says; take the file as its agency gives it"
        )
    return f"{path}:{line}: the header states {count} samples, the file holds {held}; take a file that is whole"


def _number(cell: str, decimals: int) -> float | None:
    """Return a field's number, with the decimals that a field without a point implies; None for any other text."""
    word = cell.replace("D", "E").replace("d", "E")
    if "_" in word or word.lower().strip("+-") in ("nan", "inf", "infinity"):
        return None
    try:
        value = float(word)
    except ValueError:
        return None
    return value if "." in word or "E" in word.upper() else value / 10.0**decimals
