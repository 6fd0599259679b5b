"""`--to csv`: one table per run, and a JSON file that describes the columns.

A table is a header and numbers, nothing else: time (or frequency) first, a column for each storey of a quantity.
Numbers have up to nine significant digits: a relative rounding of 5e-9 at most, below the resolution of a 24-bit
converter (6e-8), and enough to tell any two numbers of single precision apart. Time and frequency have up to twelve.
The other file is JSON in the form of W3C's Metadata Vocabulary for Tabular Data; what is no series (attributes,
figures, blocks, poles, the case) stands in its `notes`.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.files.result_reader import Dataset
from rths_cli.numerics.lti import Array
from rths_cli.report.export.source_and_target import Source, Target, Tell, notes
from rths_cli.safe_text import csv_cell

AXES = ("time_s", "frequency_hz")
ROWS = 4096  # made into text at a time
OF_AXIS, OF_VALUE = "%.12g", "%.9g"
NOT_FINITE = re.compile("nan|-?inf")
OTHERWISE = {"nan": "NaN", "inf": "INF", "-inf": "-INF"}


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
