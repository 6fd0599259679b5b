"""The result file of a sweep (HDF5, CSV), and the text file of the rows of one under way.

Axes `variant` (runs counted from 1, the seed varying fastest) and `storey`; every varied key of the case, by its
dotted name, and `seed` are coordinates along `variant`; every figure is a dataset named by its path. It opens in
`xarray.open_dataset`. Written under a temporary name and renamed: a file with the final name is whole.

The first line says which sweep it is. A killed process may leave half a line at the end, which is dropped; what was
written before it is whole, and the numbers in it read back to the last bit.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rths_cli.errors import InputError
from rths_cli.files.durable_files import (
    Stamp,
    is_stream,
    open_regular,
    part_of,
    publish,
    remove_leftovers,
    written_whole,
)
from rths_cli.files.hdf5 import Dataset, Written, as_declared, datasets, text, write_group
from rths_cli.files.hdf5_opening import Wanted, opened
from rths_cli.files.hdf5_safety import LayoutError, attribute, attributes, member, values_of
from rths_cli.files.result_writer import Attribute, refusal
from rths_cli.files.staged_file import new_large_hdf5
from rths_cli.numerics.lti import Array
from rths_cli.quantities import AXES
from rths_cli.quantities.declaration import unit_of_name
from rths_cli.quantities.sweep_datasets import RUNS, SWEEP_ATTRIBUTES, SWEEP_DATASETS, TEXTS
from rths_cli.safe_text import csv_cell

if TYPE_CHECKING:
    import h5py
    from h5py.h5d import DatasetID

T = TypeVar("T")

FORMAT = "rths-sweep"
FORMAT_VERSION = 1
CSV_START = b"variant,"
BATCH_VALUES = 1 << 20  # of one axis, in memory on their way to the disk
TEXTS_AT_ONCE = LONG = 1 << 16  # values of one column
MOST_RUNS, MOST_STOREYS = 1 << 22, 1000  # of a table that is read whole
CASE = ("case_yaml", "case_resolved")
STUDY = "study_yaml"
PART = "part"
STATED = (
    "case_name", "rig", "rig_kind", "seeds", "status", "plan_sha256", "software_sha256", "exit_code", "seeds_per_point",
    "coordinates",
)  # fmt: skip
"""Attributes that every sweep has."""
NEEDED = {"exp_rths.tracking_rms_m_s2": 1, "exp_rths.rms_error_m_s2": 2}
"""Figures that every sweep has, with the number of their axes; NaN where a run has none, never infinite."""


@dataclass(frozen=True)
class Figure:
    """One figure over all runs: `values` (n_variants,) or (n_variants, n_storeys), NaN where a run has none."""

    values: Array
    units: str
    definition: str


@dataclass(frozen=True)
class Sweep:
    """A sweep as its file holds it: n runs, the `seeds_per_point` of one grid point next to each other.

    `varied`: the values (n,) of each varied key; `seed` (n,); `texts`: status, reason, verdict, model_sha256, processor
    (n,). `numbers` (n,): which runs of its sweep a part holds, counted from 1 in ascending order; None: all of them.
    """

    attributes: dict[str, Attribute]
    case_yaml: str
    resolved_yaml: str
    seeds_per_point: int
    varied: dict[str, tuple[Any, ...] | NDArray[Any]]
    seed: NDArray[np.int64]
    texts: dict[str, tuple[str, ...]]
    figures: dict[str, Figure]
    study_yaml: str = ""
    numbers: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class FigureHead:
    """One figure without its values: `shape` of those of one run, () or (n_storeys,)."""

    shape: tuple[int, ...]
    units: str
    definition: str


@dataclass(frozen=True)
class Head:
    """A sweep without its columns: `runs`, which keys are `varied` and whether each is a column of numbers, `figures`;
    the rest as in `Sweep`."""

    attributes: dict[str, Attribute]
    case_yaml: str
    resolved_yaml: str
    seeds_per_point: int
    runs: int
    varied: dict[str, bool]
    figures: dict[str, FigureHead]
    study_yaml: str = ""
    numbers: NDArray[np.int64] | None = None

    def sweep(self, columns: dict[str, NDArray[Any]]) -> Sweep:
        """Return the sweep with these columns (n,) by name, (n, n_storeys) for a figure of storeys. They are taken out
        of `columns`: a long one is not kept twice."""
        varied = {key: values_of_axis(columns.pop(key)) for key in self.varied}
        texts = {name: tuple(columns.pop(name)) for name in TEXTS}
        figures = {path: Figure(columns.pop(path), of.units, of.definition) for path, of in self.figures.items()}
        return Sweep(
            self.attributes, self.case_yaml, self.resolved_yaml, self.seeds_per_point, varied, columns.pop("seed"),
            texts, figures, self.study_yaml, self.numbers,
        )  # fmt: skip


def write_sweep(path: Path, sweep: Sweep, seen: Stamp = None) -> Path:
    """Write the file of a sweep and return its name; raises InputError when the disk refuses.

    It takes the place of the file with the stamp `seen` alone, as in `publish`.
    """
    part = part_of(path)
    try:
        remove_leftovers(path)
        with new_large_hdf5(part) as (file, commit):
            about = {"format": FORMAT, "format_version": FORMAT_VERSION, "seeds_per_point": sweep.seeds_per_point}
            names = {"coordinates": " ".join(["seed", *sweep.varied]), "figures": " ".join(sweep.figures)}
            file.attrs.update({**sweep.attributes, **about, **names})
            scales, left, at_once = _scales(sweep), _datasets(sweep), max(1, BATCH_VALUES // len(sweep.seed))
            written: Written = {}
            while left:
                batch = {name: left.pop(name) for name in list(left)[:at_once]}
                write_group(file, batch, scales, written)
                if left:  # a large table is not kept in memory twice
                    commit()
        return publish(part, path, seen)
    except (OSError, RuntimeError) as error:
        raise InputError(refusal(path, "cannot write the result file", error)) from error
    finally:
        with suppress(OSError):
            part.unlink()


def read_attributes(path: Path) -> dict[str, Attribute]:
    """Return the root attributes of a sweep's file that is to be replaced; raises InputError when it is none."""
    other = "exists and is no result of a sweep, which alone is replaced; choose another --output"
    return _reading(path, attributes, other)


def read_sweep(path: Path) -> Sweep:
    """Return a sweep from its file; raises InputError when it is none, or not as `write_sweep` writes it."""
    found = _reading(path, _sweep)
    if found.numbers is not None:
        part = found.attributes[PART]
        raise InputError(f"{path}: holds part {part} of a sweep; rths merge joins all parts, give what it writes")
    return found


def read_part(path: Path) -> Sweep:
    """Return a part of a sweep, or a whole one, from its file; raises InputError as `read_sweep` does."""
    return _reading(path, _sweep)


def read_head(path: Path) -> Head:
    """Return what the file of a sweep or of a part states beside its columns; raises InputError as `read_sweep` does
    where that is damaged."""
    return _reading(path, _head)


def read_columns(path: Path, keep: Callable[[str, NDArray[Any]], None]) -> None:
    """Give every column of a sweep or a part to `keep`, with its name: seeds, varied keys and texts (n,), figures (n,)
    or (n, n_storeys). One at a time is in memory. Raises InputError as `read_sweep` does."""
    _reading(path, lambda file: _give_columns(file, _head(file), keep))


def _reading(path: Path, read: Callable[[h5py.File], T], other: str = "is no file that rths sweep wrote") -> T:
    """Apply `read` to the open file of a sweep; every fault of the file is an InputError, with `other` for another."""
    wanted = Wanted("sweep as rths writes it", other, "run the sweep again.", virtual=True)
    with opened(path, wanted) as file:
        if attribute(file, "format") != FORMAT:
            raise InputError(f"{path}: {other}")
        _check_version(path, attribute(file, "format_version"))
        return read(file)


def _check_version(path: Path, version: Attribute | None) -> None:
    if not isinstance(version, int):
        raise LayoutError("does not state its format_version")
    if version > FORMAT_VERSION:
        raise InputError(f"{path}: has format version {version}, this rths reads up to {FORMAT_VERSION}; update rths.")


def _sweep(file: h5py.File) -> Sweep:
    """Return what the file of a sweep holds; raises LayoutError unless it is a table of as many rows everywhere."""
    head, found = _head(file), dict[str, NDArray[Any]]()
    _give_columns(file, head, found.__setitem__)
    return head.sweep(found)


def _head(file: h5py.File) -> Head:
    """Return what the file of a sweep states beside its columns, none of which is read; raises LayoutError."""
    about = attributes(file)
    for name in STATED:
        member(about, name, str if SWEEP_ATTRIBUTES[name].kind == "text" else int)
    nodes = dict(datasets(file))
    if any("/" in name for name in nodes):
        raise LayoutError("has groups in it")
    _check_table(nodes)
    keys = str(about["coordinates"]).split()[1:]
    runs, per_point = int(nodes["seed"].shape[0]), int(about["seeds_per_point"])
    numbers = _numbers(file, runs) if PART in about else None
    if per_point < 1 or not runs or (numbers is None and runs % per_point):
        raise LayoutError(f"has {runs} runs, {per_point} of each grid point")
    if numbers is not None and not 0 < member(about, "grid_points", int) * per_point <= MOST_RUNS:
        raise LayoutError(f"is a part of {about['grid_points']} grid points with {per_point} runs each")
    if lacks := [key for key in keys if key not in nodes]:
        raise LayoutError(f"has not one {lacks[0]} per run")
    paths = [name for name in nodes if name not in (*CASE, STUDY, *TEXTS, "seed", *keys)]
    order = str(about.get("figures", "")).split()
    if any(path not in paths for path in (*NEEDED, *order)):
        raise LayoutError("has not the figures of a sweep")
    figures = {path: _figure_head(nodes[path]) for path in dict.fromkeys([*order, *paths])}
    if len({figure.shape for figure in figures.values() if figure.shape}) > 1:
        raise LayoutError("has figures of other numbers of storeys")
    stated = {name: _values(nodes[name], name, {}) for name in (*CASE, STUDY) if name in nodes}
    yaml, resolved = (member(stated, name, str) for name in CASE)
    study = member(stated, STUDY, str) if STUDY in stated else ""
    varied = {key: nodes[key].dtype.kind == "f" for key in keys}
    return Head(about, yaml, resolved, per_point, runs, varied, figures, study, numbers)


def _figure_head(node: DatasetID) -> FigureHead:
    return FigureHead(node.shape[1:], text(node, "units"), text(node, "long_name"))


def _give_columns(file: h5py.File, head: Head, keep: Callable[[str, NDArray[Any]], None]) -> None:
    """Give every column of the table to `keep`, with its name, one at a time; raises LayoutError."""
    nodes, spelt = dict(datasets(file)), dict[str, str]()
    kinds = {"seed": "iu", **dict.fromkeys(TEXTS, "OSU"), **dict.fromkeys(head.varied, "OSUf")}
    for name in (*kinds, *head.figures):
        node = nodes.pop(name, None)  # an open dataset keeps what was read of it last
        if node is None and name == "processor":  # an older rths did not write it
            keep(name, np.full(head.runs, "", dtype=object))
            continue
        values = None if node is None else _values(node, name, spelt)
        keep(name, _column(values, name, kinds[name], head.runs) if name in kinds else _figure(values, name, head.runs))


def _numbers(file: h5py.File, runs: int) -> NDArray[np.int64]:
    """Return which runs (n,) a part holds; raises LayoutError."""
    scale = file["variant"]
    numbers = np.asarray(scale[:] if getattr(scale, "shape", None) == (runs,) else ())
    if numbers.dtype.kind not in "iu" or len(numbers) != runs or numbers[0] < 1 or np.any(np.diff(numbers) < 1):
        raise LayoutError("has not a number in ascending order for each run of a part")
    return numbers.astype(np.int64)


def _values(node: DatasetID, name: str, spelt: dict[str, str]) -> Any:
    """Return the values of a dataset; equal texts (n,) as one object, for a million rows share few. They are read
    `TEXTS_AT_ONCE` at a time, because each is an object of its own at first."""
    import h5py

    dataset = h5py.Dataset(node)
    if h5py.check_string_dtype(dataset.dtype) is None or dataset.ndim != 1:
        return values_of(node, name)
    found = np.empty(dataset.shape, dtype=object)
    for start in range(0, len(found), TEXTS_AT_ONCE):
        part = dataset.asstr()[start : start + TEXTS_AT_ONCE]
        found[start : start + TEXTS_AT_ONCE] = [spelt.setdefault(text, text) for text in map(str, part)]
    return found


def values_of_axis(column: NDArray[Any]) -> tuple[Any, ...] | NDArray[Any]:
    """Return the values (n,) of a varied key as a sweep holds them; many numbers stay an array: each is an object of 24
    bytes elsewhere."""
    return column if column.dtype.kind == "f" and len(column) > LONG else tuple(column.tolist())


def _check_table(nodes: Mapping[str, DatasetID]) -> None:
    """Raise LayoutError unless every dataset, before it is read, is one text or has the rows of a table of runs."""
    shapes: dict[str, tuple[int, ...]] = {name: node.shape for name, node in nodes.items()}
    runs = shapes.get("seed", ())
    if len(runs) != 1 or runs[0] > MOST_RUNS:
        raise LayoutError(f"has not a seed for each of at most {MOST_RUNS} runs")
    for name, shape in shapes.items():
        if shape and (shape[0] != runs[0] or len(shape) > 2 or max(shape[1:], default=1) > MOST_STOREYS):
            raise LayoutError(f"has not one {name} per run")


def _column(values: Any, name: str, kinds: str, runs: int) -> NDArray[Any]:
    """Return a value per run; raises LayoutError."""
    column = np.asarray(values)
    if column.ndim != 1 or column.dtype.kind not in kinds or len(column) != runs:
        raise LayoutError(f"has not one {name} per run")
    return column


def _figure(values: Any, path: str, runs: int) -> Array:
    """Return the numbers of a figure, per run or per run and storey; raises LayoutError."""
    numbers = np.asarray(values)
    axes = NEEDED.get(path, numbers.ndim)
    if numbers.dtype.kind not in "fiu" or numbers.ndim != axes or axes not in (1, 2) or len(numbers) != runs:
        raise LayoutError(f"has not one {path} per run")
    if path in NEEDED and np.any(np.isinf(numbers)):
        raise LayoutError(f"holds an infinite number in {path}")
    return numbers.astype(float, copy=False)


def check_csv(path: Path, result: Path) -> None:
    """Raise InputError where the table as CSV would replace what it must not: anything but such a table."""
    if path.resolve() == result.resolve():
        raise InputError(f"--csv {path}: is the result file itself; give it a name of its own")
    if is_stream(path):
        return
    try:
        with open_regular(path) as file:
            ours = file.read(len(CSV_START)) == CSV_START
    except FileNotFoundError:
        ours = True
    except OSError as error:
        raise InputError(refusal(path, "cannot read", error, advice=False)) from error
    if not ours:
        raise InputError(
            f"--csv {path}: exists and is no table of a sweep, which alone is replaced; choose another name"
        )


def write_csv(path: Path, sweep: Sweep) -> None:
    """Write the table of a sweep as CSV, one line per run, one column per figure and storey; raises InputError."""
    try:
        with written_whole(path) as part:
            part.write_text(_csv(sweep), encoding="utf-8")
    except OSError as error:
        raise InputError(refusal(path, "cannot write the table", error)) from error


def _csv(sweep: Sweep) -> str:
    """Return the table as text; numbers read back to the last bit, a figure that is not there is empty."""
    columns = dict(_columns(sweep))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(csv_cell, columns))
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def _columns(sweep: Sweep) -> Iterator[tuple[str, list[Any]]]:
    """Yield name and values (n,) of each column: coordinates, texts, figures with their storey in brackets."""
    yield "variant", _variants(sweep).tolist()
    for key, values in sweep.varied.items():
        yield key, [_cell(value) for value in (values.tolist() if isinstance(values, np.ndarray) else values)]
    yield "seed", sweep.seed.tolist()
    yield from ((name, [csv_cell(text) for text in sweep.texts[name]]) for name in TEXTS)
    for path, figure in sweep.figures.items():
        if figure.values.ndim == 1:
            yield path, [_cell(value) for value in figure.values.tolist()]
            continue
        for storey, values in enumerate(figure.values.T.tolist(), 1):
            yield f"{path}[{storey}]", [_cell(value) for value in values]


def _cell(value: Any) -> str:
    """Return a value as CSV holds it."""
    if isinstance(value, float):
        return "" if value != value else repr(value)
    return csv_cell(value) if isinstance(value, str) else json.dumps(value)


def _scales(sweep: Sweep) -> dict[str, Dataset]:
    storeys = max((figure.values.shape[1] for figure in sweep.figures.values() if figure.values.ndim > 1), default=1)
    return {
        name: Dataset(values, AXES[name].units, AXES[name].text, "computed")
        for name, values in (("variant", _variants(sweep)), ("storey", np.arange(1, storeys + 1)))
    }


def _variants(sweep: Sweep) -> NDArray[np.int64]:
    """Return the numbers (n,) of the runs, counted from 1."""
    return np.arange(1, len(sweep.seed) + 1) if sweep.numbers is None else sweep.numbers


def _datasets(sweep: Sweep) -> dict[str, Dataset]:
    """Return everything along the runs, and the case the sweep starts from."""
    found = {
        key: Dataset(stored_values(v), unit_of_name(key), f"varied key {key}", "computed", RUNS)
        for key, v in sweep.varied.items()
    }
    stated: dict[str, ArrayLike] = {name: _text(sweep.texts[name]) for name in TEXTS}
    stated |= {"seed": sweep.seed, "case_yaml": sweep.case_yaml, "case_resolved": sweep.resolved_yaml}
    stated |= {"study_yaml": sweep.study_yaml} if sweep.study_yaml else {}
    found |= {name: as_declared(one, stated[name]) for name, one in SWEEP_DATASETS.items() if name in stated}
    for path, figure in sweep.figures.items():
        dims = ("variant", "storey")[: figure.values.ndim]
        found[path] = Dataset(figure.values, figure.units, figure.definition, "computed", dims)
    return found


def stored_values(values: tuple[Any, ...] | NDArray[Any]) -> NDArray[Any]:
    """Return the values (n,) of a varied key: numbers where all are, else text."""
    if isinstance(values, np.ndarray):
        return values
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return np.array(values, dtype=float)
    return _text(tuple(value if isinstance(value, str) else json.dumps(value) for value in values))


def _text(values: tuple[str, ...]) -> NDArray[Any]:
    """Return texts as an array of objects: an array of characters would take the longest of them for each."""
    return np.array(values, dtype=object)


ROWS_FORMAT = "rths-sweep-rows"
BLOCK = 1 << 20  # bytes that are read at a time


def rows_path(result: Path) -> Path:
    """Return where the rows of a sweep stand until its result file is written."""
    return result.with_name(f"{result.name}.rows")


def read_rows(path: Path) -> tuple[dict[str, Any], Iterator[Any]]:
    """Return the header and, one at a time, the whole rows of a sweep under way; both raise InputError where the file
    is none. A million rows are not in memory at once."""
    lines = _lines(path)
    header = next(lines, None)
    if not isinstance(header, dict) or header.get("format") != ROWS_FORMAT:
        raise InputError(f"{path}: holds no rows of a sweep; remove it and run the sweep anew")
    return header, lines


def _lines(path: Path) -> Iterator[Any]:
    try:
        with open_regular(path) as file:
            for line in file:
                if line.endswith(b"\n"):  # what follows the last newline was being written
                    yield json.loads(line)
    except OSError as error:
        raise InputError(refusal(path, "cannot read", error, advice=False)) from error
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is damaged or holds no rows of a sweep; remove it and run the sweep anew") from None


def count_rows(path: Path) -> int:
    """Return the number of whole rows of a sweep under way, 0 where the file is not there."""
    try:
        with open(path, "rb") as file:
            return max(sum(block.count(b"\n") for block in iter(lambda: file.read(BLOCK), b"")) - 1, 0)
    except OSError:
        return 0


def _end_of_lines(path: Path) -> int:
    """Return where the last whole line of a file ends, in bytes."""
    with open(path, "rb") as file:
        end = file.seek(0, os.SEEK_END)
        while end:
            start = max(0, end - BLOCK)
            file.seek(start)
            place = file.read(end - start).rfind(b"\n")
            if place >= 0:
                return start + place + 1
            end = start
    return 0


class RowsFile:
    """Append rows to the file of a sweep under way; use as a context manager. Raises InputError where the disk
    refuses."""

    def __init__(self, path: Path, header: Mapping[str, Any], resume: bool) -> None:
        self._path = path
        self._header = {"format": ROWS_FORMAT, **header}
        self._resume = resume
        self._file: TextIO | None = None

    def __enter__(self) -> RowsFile:
        """Open the file: a new one with its header, or after the last whole row of one that exists."""
        try:
            if self._resume:
                os.truncate(self._path, _end_of_lines(self._path))
            self._file = open(self._path, "a" if self._resume else "x", encoding="utf-8")
            if not self._resume:
                self._write(self._header)
        except OSError as error:
            raise InputError(refusal(self._path, "cannot write the rows of the sweep", error)) from error
        return self

    def append(self, row: Sequence[Any]) -> None:
        """Write one row; whatever happens to the process afterwards, it is kept."""
        try:
            self._write(row)
        except OSError as error:
            raise InputError(refusal(self._path, "cannot write the rows of the sweep", error)) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file; it stays until `remove`."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def close(self) -> int:
        """Close the file and return the number of whole rows in it.

        A signal may arrive between the writing of a row and the next statement, so only the file knows the number.
        """
        self.__exit__(None, None, None)
        return count_rows(self._path)

    def remove(self) -> None:
        """Remove the file: its rows stand in the result."""
        with suppress(OSError):
            self._path.unlink()

    def _write(self, content: Any) -> None:
        assert self._file is not None
        self._file.write(json.dumps(content) + "\n")
        self._file.flush()
