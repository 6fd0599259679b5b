"""`--to mat`: a MATLAB file of version 5, a struct for each group, the controller's blocks for `ss`.

Time, or frequency, runs down the rows: a series is a column, a quantity of three storeys has three of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.result_listing import About, Outline
from rths_cli.files.result_reader import Dataset
from rths_cli.report.export.source_and_target import Source, Target
from rths_cli.version import __version__

LARGEST_BYTES = (1 << 31) - 1  # of a variable: MAT-File Format (R2023b), chapter 1
LONGEST_NAME = 63
HEADER_TEXT_BYTES = 116
KEYWORDS = frozenset(
    ("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if",
     "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while")
)  # fmt: skip
ABOUT = ("units", "long_name", "source")
Struct = dict[str, Any]


def mat_targets(source: Source, folder: Path) -> list[Target]:
    """Return the one file of a result; raises InputError where a variable would pass the format's 2 GB."""
    for top in dict.fromkeys(path.partition("/")[0] for path in source.groups):
        size = sum(source.size_bytes(path) for path in source.groups if path.partition("/")[0] == top)
        if size > LARGEST_BYTES:
            advice = "choose smaller groups by --group, or read the result file itself by MATLAB's h5read"
            raise InputError(
                f"{source.result.path}: group {top} takes {size / 1e9:.1f} GB, a .mat file of version 5 holds "
                f"{LARGEST_BYTES / 1e9:.1f} GB; {advice}"
            )
    return [Target(folder / f"{source.stem}.mat", lambda path, _: write_mat(source, path))]


def write_mat(source: Source, path: Path) -> None:
    """Write a result; the same result gives the same bytes, its header has no time of writing."""
    from scipy.io import savemat

    savemat(path, variables(source), long_field_names=True, oned_as="column")
    text = f"MATLAB 5.0 MAT-file, exported from an rths result by rths {__version__}"
    with open(path, "r+b") as file:
        file.write(text.encode("ascii").ljust(HEADER_TEXT_BYTES))


def variables(source: Source) -> Struct:
    """Return the variables of the file: `attributes`, and a struct for each group at the root."""
    root: Struct = {}
    for path, outline in source.groups.items():
        inner = root
        for part in path.split("/"):
            inner = inner.setdefault(legal_name(part), {})
        inner.update(_block(source, outline) if _is_block(outline) else _series(source, outline))
    about = source.result.attributes.items()
    return {"attributes": {legal_name(key): _plain(value) for key, value in about}, **root}


def legal_name(name: str) -> str:
    """Return a name as MATLAB takes it: a letter, then letters, digits and _, at most 63, and no keyword."""
    text = re.sub(r"\W", "_", name, flags=re.ASCII)
    text = text if re.match("[A-Za-z]", text) else f"x{text}"
    return f"{text}_" if text in KEYWORDS else text[:LONGEST_NAME]


def _is_block(outline: Outline) -> bool:
    return "dt_s" in outline.attributes and set("ABCD") <= set(outline.datasets)


def _block(source: Source, outline: Outline) -> Struct:
    """Return a discrete block x[k+1] = A x + B u, y = C x + D u: ss(A, B, C, D, Ts) makes it a system."""
    read = source.read(outline.path)
    matrices = {name: np.asarray(read[name].data, dtype=float) for name in "ABCD"}
    rest = {legal_name(key): _plain(value) for key, value in outline.attributes.items() if key != "dt_s"}
    return {**matrices, "Ts": outline.attributes["dt_s"], **rest}


def _series(source: Source, outline: Outline) -> Struct:
    """Return the datasets and scales of a group, with a struct each of their units, meanings and sources."""
    read = source.read(outline.path)
    values = {legal_name(name): _values(item) for name, item in read.items()}
    told = {about: {legal_name(name): str(getattr(item, about)) for name, item in read.items()} for about in ABOUT}
    rest = {legal_name(key): _plain(value) for key, value in outline.attributes.items()}
    return {**values, **(told if read else {}), **rest}


def _values(item: Dataset) -> Any:
    """Return a text, or numbers with time or frequency, their last axis, down the rows."""
    if isinstance(item.data, str):
        return _text(item.data)
    return np.asarray(item.data, dtype=float).T


def _plain(value: About | int) -> Any:
    """Return a text, a number, or texts as a cell array with one a row."""
    if isinstance(value, str):
        return _text(value)
    return _cells(value) if isinstance(value, tuple) else float(value)


def _cells(texts: Iterable[str]) -> Any:
    held = [_text(text) for text in texts]
    cells = np.empty((len(held), 1), dtype=object)
    cells[:, 0] = held
    return cells


def _text(text: str) -> str:
    """Return a text with a space behind it for each byte by which it is longer in UTF-8: Octave counts bytes."""
    return text + " " * (len(text.encode()) - len(text))
