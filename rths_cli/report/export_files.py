"""The work of `rths export`: read and check all results first, then write each one completely or not at all, as CSV
or MATLAB file.

A table is a header and numbers, nothing else: time (or frequency) first, a column for each storey of a quantity.
Numbers have up to nine significant digits: a relative rounding of 5e-9 at most, below the resolution of a 24-bit
converter (6e-8), and enough to tell any two numbers of single precision apart. Time and frequency have up to twelve.
The other file is JSON in the form of W3C's Metadata Vocabulary for Tabular Data; what is no series (attributes,
figures, blocks, poles, the case) stands in its `notes`.

Time, or frequency, runs down the rows: a series is a column, a quantity of three storeys has three of them.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import part_of, remove_leftovers
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_listing import About, Outline, read_group, read_groups, read_outlines
from rths_cli.files.result_reader import Dataset, Result, read_checked, result_files
from rths_cli.files.result_writer import check_writable, refusal
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import csv_cell
from rths_cli.version import __version__

BYTES = 8  # of a number, as it is written

_AXES_OF_SERIES = (("time_s",), ("frequency_hz",))
Tell = Callable[[str], None]
"""Receives how far a file is written, as text."""
AXES = ("time_s", "frequency_hz")
ROWS = 4096  # made into text at a time
OF_AXIS, OF_VALUE = "%.12g", "%.9g"
NOT_FINITE = re.compile("nan|-?inf")
OTHERWISE = {"nan": "NaN", "inf": "INF", "-inf": "-INF"}
LARGEST_BYTES = (1 << 31) - 1  # of a variable: MAT-File Format (R2023b), chapter 1
LONGEST_NAME = 63
HEADER_TEXT_BYTES = 116
KEYWORDS = frozenset(
    ("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if",
     "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while")
)  # fmt: skip
ABOUT = ("units", "long_name", "source")
Struct = dict[str, Any]
NETCDF_REMOVED = (
    "netcdf is no longer a format: a result file is netCDF-4 itself; "
    'xarray.open_dataset("RESULT.h5", group="exp_rths", engine="h5netcdf") reads it, ncread in MATLAB'
)
TEXT_FACTOR = 2.1  # bytes of a number in CSV over those of the number, at most


@dataclass(frozen=True)
class Source:
    """A result to be exported, with its chosen groups by path, each group before those in it."""

    result: Result
    groups: Mapping[str, Outline]

    @property
    def stem(self) -> str:
        """Return the name of the result's file without its suffix."""
        return self.result.path.stem

    def read(self, group: str) -> dict[str, Dataset]:
        """Read the scales and datasets of a group by name; raises InputError."""
        return read_group(self.result.path, self.groups[group])

    def size_bytes(self, group: str) -> int:
        """Return the number of bytes of a group's numbers, without the groups in it."""
        outline = self.groups[group]
        shapes = [*outline.datasets.values(), *outline.scales.values()]
        return BYTES * sum(int(np.prod(shape)) for shape in shapes)

    @property
    def total_bytes(self) -> int:
        """Return the number of bytes of the numbers of all chosen groups."""
        return sum(self.size_bytes(group) for group in self.groups)


def open_source(path: Path, names: Sequence[str] = ()) -> Source:
    """Read the contents of a result without its series; `names`: chosen groups, with the groups in them; (): all.

    Raises InputError unless the file is a whole result file that holds these groups.
    """
    result, outlines = read_checked(path), read_outlines(path)
    wanted = [name.strip("/").replace("-", "_") for name in names]
    missing = [name for name in wanted if name not in outlines]
    if missing:
        status = result.attributes["status"]
        known = ", ".join(result.groups) or "none"
        raise InputError(
            *(f"{path}: holds no group {name} (status {status}); its groups are {known}" for name in missing)
        )
    return Source(result, {key: outline for key, outline in outlines.items() if _chosen(key, wanted)})


def _chosen(group: str, wanted: Sequence[str]) -> bool:
    return not wanted or any(group == name or group.startswith(f"{name}/") for name in wanted)


def notes(source: Source) -> dict[str, Any]:
    """Return the attributes of a result and, by group, the datasets that are not series; None if not finite."""
    about = {key: _plain(value) for key, value in source.result.attributes.items()}
    read = read_groups(source.result.path, source.groups.values(), lambda item: item.dims[-1:] not in _AXES_OF_SERIES)
    held = {path: _group(outline, read[path]) for path, outline in source.groups.items()}
    return {"attributes": about, "groups": {path: group for path, group in held.items() if group}}


def _group(outline: Outline, held: Mapping[str, Dataset]) -> dict[str, Any]:
    found: dict[str, Any] = {key: _plain(value) for key, value in outline.attributes.items()}
    for name, item in held.items():
        if name in outline.datasets:
            told = {"units": item.units, "long_name": item.long_name, "source": item.source}
            found[name] = {"value": _plain(np.asarray(item.data).tolist()), **told, "dims": list(item.dims)}
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True)
class Target:
    """A file to be written."""

    path: Path
    write: Callable[[Path, Tell], None]  # writes the whole file at a given path


def write_all(targets: Sequence[Target], tell: Tell = lambda _: None) -> None:
    """Write files under temporary names (`part_of`) and rename them when all are complete.

    Raises InputError with path and cause if one cannot be written; then, and after a signal, no file is left behind.
    """
    parts = [part_of(target.path) for target in targets]
    try:
        for target, part in zip(targets, parts, strict=True):
            remove_leftovers(target.path)
            with_reason(target, part, tell)
        for target, part in zip(targets, parts, strict=True):
            os.replace(part, target.path)
    finally:
        for part in parts:
            with suppress(OSError):
                part.unlink()


def with_reason(target: Target, part: Path, tell: Tell) -> None:
    """Write one file to `part`; raises InputError with path and cause if that fails."""
    try:
        tell(str(target.path))
        target.write(part, lambda text: tell(f"{target.path}, {text}"))
    except (OSError, RuntimeError) as error:
        raise InputError(refusal(target.path, "cannot write", error)) from error


@dataclass(frozen=True)
class Table:
    """One table: its axis, and the groups whose series it holds, each with what its columns start with."""

    name: str
    axis: str
    groups: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Column:
    """One column: name, values (n,), and what they are."""

    name: str
    values: Array
    about: Dataset


def csv_targets(source: Source, folder: Path) -> list[Target]:
    """Return the tables of a result, NAME.GROUP.csv, and NAME.json; reads the axes only."""
    planned = tables(source)
    files = [Target(folder / f"{table.name}.csv", partial(_write_table, source, table)) for table in planned]
    about = Target(folder / f"{source.stem}.json", lambda path, _: _write_metadata(source, planned, path))
    return [*files, about]


def tables(source: Source) -> list[Table]:
    """Return a table for each group with an axis; a group in it joins it, for their scales agree."""
    found: dict[str, Table] = {}
    for path, outline in source.groups.items():
        axis = next((name for name in AXES if name in outline.scales), None)
        if axis is None:
            continue
        above, _, leaf = path.rpartition("/")
        if above in found and outline.scales[axis] == source.groups[above].scales.get(axis):
            joined = (*found[above].groups, (path, f"{leaf}_"))
            found[above] = Table(found[above].name, axis, joined)
        else:
            found[path] = Table(f"{source.stem}.{path.replace('/', '.')}", axis, ((path, ""),))
    return list(found.values())


def columns(source: Source, table: Table) -> Iterator[Column]:
    """Yield the columns of a table, its axis first."""
    for group, prefix in table.groups:
        read = source.read(group)
        if not prefix:
            yield Column(table.axis, np.asarray(read[table.axis].data), read[table.axis])
        for name, item in read.items():
            if item.dims[-1:] == (table.axis,):
                yield from _columns(f"{prefix}{name}", item, [np.asarray(read[dim].data) for dim in item.dims[:-1]])


def _columns(name: str, item: Dataset, scales: Sequence[Array]) -> Iterator[Column]:
    """Yield a column for each value of the scales before the last: rel_disp_m_storey_2."""
    values = np.asarray(item.data)
    for place in product(*(range(len(scale)) for scale in scales)):
        ends = [f"_{dim}_{scale[i]:g}" for dim, scale, i in zip(item.dims, scales, place, strict=False)]
        yield Column(name + "".join(ends), values[place], item)


def _write_table(source: Source, table: Table, path: Path, tell: Tell) -> None:
    held = list(columns(source, table))
    count, line = len(held[0].values), ",".join([OF_AXIS, *[OF_VALUE] * (len(held) - 1)]) + "\n"
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(csv_cell(column.name) for column in held)
        for start in range(0, count, ROWS):
            rows = np.column_stack([column.values[start : start + ROWS] for column in held])
            file.write(_text(rows, line))
            tell(f"{100 * min(start + ROWS, count) / count:.0f} %")


def _text(rows: Array, line: str) -> str:
    """Return the lines of rows (n, columns); what is not finite as XML Schema spells it."""
    text = line * len(rows) % tuple(rows.ravel().tolist())
    return text if np.isfinite(rows).all() else NOT_FINITE.sub(lambda found: OTHERWISE[found[0]], text)


def _write_metadata(source: Source, planned: Sequence[Table], path: Path) -> None:
    about = source.result.attributes
    document = {
        "@context": "http://www.w3.org/ns/csvw",
        "dc:title": f"{about.get('case_name', '')}, method {about.get('method', '')}",
        "tables": [_about_table(source, table) for table in planned],
        "notes": [notes(source)],
    }
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _about_table(source: Source, table: Table) -> dict[str, Any]:
    return {
        "url": f"{table.name}.csv",
        "tableSchema": {"columns": [_about_column(column) for column in columns(source, table)]},
    }


def _about_column(column: Column) -> dict[str, Any]:
    return {
        "name": column.name,
        "titles": column.name,
        "datatype": "double",
        "dc:description": column.about.long_name,
        "schema:unitText": column.about.units,
        "schema:measurementTechnique": column.about.source,
    }


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
    return {"attributes": {legal_name(key): _matlab_value(value) for key, value in about}, **root}


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
    rest = {legal_name(key): _matlab_value(value) for key, value in outline.attributes.items() if key != "dt_s"}
    return {**matrices, "Ts": outline.attributes["dt_s"], **rest}


def _series(source: Source, outline: Outline) -> Struct:
    """Return the datasets and scales of a group, with a struct each of their units, meanings and sources."""
    read = source.read(outline.path)
    values = {legal_name(name): _values(item) for name, item in read.items()}
    told = {about: {legal_name(name): str(getattr(item, about)) for name, item in read.items()} for about in ABOUT}
    rest = {legal_name(key): _matlab_value(value) for key, value in outline.attributes.items()}
    return {**values, **(told if read else {}), **rest}


def _values(item: Dataset) -> Any:
    """Return a text, or numbers with time or frequency, their last axis, down the rows."""
    if isinstance(item.data, str):
        return _matlab_text(item.data)
    return np.asarray(item.data, dtype=float).T


def _matlab_value(value: About | int) -> Any:
    """Return a text, a number, or texts as a cell array with one a row."""
    if isinstance(value, str):
        return _matlab_text(value)
    return _cells(value) if isinstance(value, tuple) else float(value)


def _cells(texts: Iterable[str]) -> Any:
    held = [_matlab_text(text) for text in texts]
    cells = np.empty((len(held), 1), dtype=object)
    cells[:, 0] = held
    return cells


def _matlab_text(text: str) -> str:
    """Return a text with a space behind it for each byte by which it is longer in UTF-8: Octave counts bytes."""
    return text + " " * (len(text.encode()) - len(text))


FORMATS: Mapping[str, Callable[[Source, Path], list[Target]]] = {
    "csv": csv_targets,
    "mat": mat_targets,
}


@dataclass(frozen=True)
class ExportRequest:
    """Arguments of `rths export`."""

    paths: tuple[Path, ...]  # result files or folders of them
    form: str  # format: csv or mat
    folder: Path  # for the exported files
    groups: tuple[str, ...] = ()  # groups to export, with the groups in them; (): all
    replace: bool = True  # whether existing files may be replaced


@dataclass(frozen=True)
class Exported:
    """A result that was exported."""

    result: Path
    status: str  # of the result
    reason: str  # of that status
    files: tuple[Path, ...]  # that were written
    replaced: tuple[Path, ...] = ()  # those of them that were there before


def export(request: ExportRequest, progress: Callable[[str], None] = lambda _: None) -> list[Exported]:
    """Write every result of a request; raises InputError with all faults before the first is written."""
    planned = plan(request)
    needed = sum(source.total_bytes for source, _ in planned)
    check_writable(request.folder, int(needed * (TEXT_FACTOR if request.form == "csv" else 1.0)))
    done = []
    for source, targets in planned:
        replaced = tuple(target.path for target in targets if target.path.exists())
        write_all(targets, progress)
        about = source.result.attributes
        files = tuple(target.path for target in targets)
        done.append(
            Exported(source.result.path, str(about["status"]), str(about.get("status_reason", "")), files, replaced)
        )
    return done


def plan(request: ExportRequest) -> list[tuple[Source, list[Target]]]:
    """Read every result and name its files; raises InputError with all faults, writes nothing."""
    found, empty = result_files(request.paths)
    faults = list(empty.values())
    planned: list[tuple[Source, list[Target]]] = []
    for path in found:
        try:
            source = open_source(path, request.groups)
            planned.append((source, FORMATS[request.form](source, request.folder)))
        except InputError as error:
            faults += error.faults
    faults += _shared(planned)
    if faults:
        raise InputError(*faults)
    check_existing([(target.path, Kind.DOCUMENT) for _, targets in planned for target in targets], request.replace)
    return planned


def _shared(planned: Sequence[tuple[Source, list[Target]]]) -> list[str]:
    """Return a sentence for each file name that two results share."""
    first: dict[Path, Path] = {}
    faults = []
    for source, targets in planned:
        for target in targets:
            other = first.setdefault(target.path, source.result.path)
            if other != source.result.path:
                advice = "export them to different folders"
                faults.append(f"{source.result.path}: would become {target.path}, as {other} does; {advice}")
    return faults
