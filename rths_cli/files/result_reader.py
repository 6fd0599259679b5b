"""Read the result file of one case (HDF5, format version 1), whole or one series at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.hdf5 import INTERVAL, SOURCES, Dataset, datasets, numbers, text
from rths_cli.files.hdf5_opening import RESTORE, VIRTUAL, Wanted, advice, opened
from rths_cli.files.hdf5_safety import (
    LayoutError,
    attribute,
    attributes,
    check_numbers,
    held,
    part,
    quiet,
    scalar,
    values_of,
)
from rths_cli.files.result_schema import check_attributes, check_series, check_values, figure_fault
from rths_cli.files.result_writer import (
    FORMAT,
    FORMAT_VERSION,
    Attribute,
    ResultWriter,
    Status,
    check_writable,
)
from rths_cli.numerics.bands import COMPARED_HZ, TEST_BAND_HZ, ComparedBand
from rths_cli.numerics.lti import Array
from rths_cli.quantities import AXES, Interval, stored_dataset
from rths_cli.quantities.datasets import KEPT_SERIES, of_a_run

if TYPE_CHECKING:
    import h5py
    from h5py.h5d import DatasetID

__all__ = [
    "BEGUN",
    "COMPLETE",
    "Dataset",
    "Result",
    "ResultWriter",
    "SeriesLeftOut",
    "Status",
    "check_writable",
    "read_checked",
    "read_dataset",
    "read_result",
    "read_series",
]

T = TypeVar("T")
BEGUN, COMPLETE = "begun", "complete"  # of one run on the table, in the attribute RUN_status of the root


class SeriesLeftOut(InputError):
    """A series is asked for that `--series` kept out of a file; `reason` says so without naming the file."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}.")
        self.reason = reason


def left_out(name: str, series: str) -> str:
    """Return why a dataset or scale of a run is missing in a file with these series (one of KEPT_SERIES), else ""."""
    known = stored_dataset(name) is not None or name.rpartition("/")[2] in AXES
    if series == KEPT_SERIES[0] or not known or not of_a_run(name):
        return ""
    return f"{name} is not kept, the case was run with --series {series}; run it with --series {KEPT_SERIES[0]}"


@dataclass(frozen=True)
class Result:
    """Hold what a result file says about its case; series are read one by one with `read_series`.

    `metrics`, `units` and `definitions` share their keys, the paths of the figures (as in
    `exp_rths.rms_error_m_s2`); a metric is a number or an array (n_storeys,). `intervals` has those of the metrics that
    carry one. `groups` are those of the root.
    Units and definitions are read when they are first asked for: tables of many cases need none.
    """

    path: Path
    attributes: dict[str, Attribute]
    case_yaml: str
    resolved_yaml: str
    metrics: dict[str, float | Array]
    units: Mapping[str, str]
    definitions: Mapping[str, str]
    groups: tuple[str, ...]
    intervals: Mapping[str, Interval] = field(default_factory=dict)

    @property
    def sample_rate_hz(self) -> float:
        """Return the sample rate in Hz; raises InputError where a damaged file has lost it."""
        if (rate := self.attributes.get("sample_rate_hz")) is None:
            raise InputError(f"{self.path}: has lost its attribute sample_rate_hz; {self.made_anew}")
        return float(rate)

    @property
    def made_anew(self) -> str:
        """Return what to do about a damaged result: only a case of a virtual rig is run again."""
        return WANTED.again if self.attributes.get("rig_kind") == VIRTUAL else f"{RESTORE}."

    @property
    def series(self) -> str:
        """Return which time series the file holds, one of KEPT_SERIES; an older one holds all."""
        return str(self.attributes.get("series", KEPT_SERIES[0]))

    @property
    def test_band_hz(self) -> float:
        """Return the upper end of the test band in Hz; a file that does not state it is older than the choice."""
        return float(self.attributes.get("test_band_hz", TEST_BAND_HZ))

    @property
    def compared(self) -> ComparedBand:
        """Return the band in which the model of the table was compared with its data."""
        low, high = (f"compared_{end}_hz" for end in ("low", "high"))
        return ComparedBand(
            *(float(self.attributes.get(key, hz)) for key, hz in zip((low, high), COMPARED_HZ, strict=True))
        )


def result_files(paths: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Return every result file that files and folders name, once, in their order; and a sentence for each folder that
    holds none."""
    files: dict[str, Path] = {}
    empty: dict[Path, str] = {}
    for path in paths:
        found = sorted(path.glob("*.h5")) if path.is_dir() else [path]
        for file in found:
            files.setdefault(os.path.realpath(file), file)
        if not found:
            empty[path] = f"{path}: holds no result file (*.h5); run a case or name another folder."
    return list(files.values()), empty


def read_result(path: Path, whole: bool = False) -> Result:
    """Read attributes, case and metrics, `whole` their units and definitions too, which costs half as much as to read
    them later; raise InputError unless the file is a whole result file."""
    return _reading(Path(path), lambda file: _result(Path(path), file, whole))


def read_checked(path: Path, whole: bool = False) -> Result:
    """Read a result file as `read_result` does; raises InputError for figures of other shapes than declared, too."""
    found = read_result(path, whole)
    fault = figure_fault(found.metrics)
    if fault:
        raise InputError(f"{path}: {fault}, so it is no result file as rths run writes it; {found.made_anew}")
    return found


def read_dataset(path: Path, name: str) -> Dataset:
    """Read one dataset with unit, meaning, source and axes; one in single precision is read as double.

    Raises InputError where there is none, SeriesLeftOut where `--series` kept it out.
    """
    return _reading(Path(path), lambda file: _dataset(Path(path), file, name))


def read_series(path: Path, name: str) -> Array:
    """Read the values of one dataset (`exp_rths/abs_accel_m_s2`: (n_storeys, n)) as an array.

    Raises InputError where it states another unit than its declaration.
    """
    found = read_dataset(path, name)
    declared = stored_dataset(name)
    if declared is not None and found.units != declared.units:
        raise InputError(f"{path}: {name} is in {found.units}, expected is {declared.units}; convert it to that unit.")
    return np.asarray(found.data)


def _result(path: Path, file: h5py.File, whole: bool) -> Result:
    nodes = list(_metrics(file))
    metrics = {key: _figure(key, node) for key, node in nodes}
    units: Mapping[str, str]
    definitions: Mapping[str, str]
    if whole:
        units, definitions = _texts_of(nodes)
    else:
        texts = cache(lambda: _reading(path, lambda again: _texts_of(_metrics(again))))
        units, definitions = _Texts(metrics, lambda: texts()[0]), _Texts(metrics, lambda: texts()[1])
    about = attributes(file)
    check_attributes(about)
    yaml, resolved = (_case_text(file, name) for name in ("yaml", "resolved"))
    intervals = {key: found for key, node in nodes if (found := _interval(key, node, metrics[key])) is not None}
    return Result(path, about, yaml, resolved, metrics, units, definitions, tuple(file), intervals)


def _case_text(file: h5py.File, name: str) -> str:
    """Return a text of the case, "" where it is not stored."""
    node = part(file, f"case/{name}")
    return "" if node is None else str(scalar(f"case/{name}", values_of(node, f"case/{name}")))


def _metrics(file: h5py.File) -> Iterator[tuple[str, DatasetID]]:
    """Yield the figures of a file by their paths."""
    for name, node in datasets(file, "metrics"):
        yield name.replace("/", "."), node


def _figure(path: str, node: DatasetID) -> float | Array:
    if len(node.shape) > 1 or node.dtype.kind not in "fiu":
        raise LayoutError(f"has a figure {path} that is neither a number nor a row of numbers")
    value = quiet(numbers(node))
    check_numbers(path, value)
    return float(value) if value.ndim == 0 else value


def _interval(path: str, node: DatasetID, value: float | Array) -> Interval | None:
    """Return the interval of a figure, None where it carries none."""
    import h5py

    if not h5py.h5a.exists(node, INTERVAL[0].encode()):
        return None
    missing = [key for key in INTERVAL if not h5py.h5a.exists(node, key.encode())]
    stated = [] if missing else [np.asarray(held(h5py.Dataset(node), key)) for key in INTERVAL]
    shapes = [np.shape(value), np.shape(value), ()]
    if [one.shape for one in stated] != shapes or any(one.dtype.kind not in "fiu" for one in stated):
        raise LayoutError(f"has a figure {path} whose interval is not {', '.join(INTERVAL)} of its own shape")
    low, high, probability = (quiet(one.astype(float)) for one in stated)
    for end in (low, high):
        check_numbers(path, end)
    if np.any(low > high) or not 0.0 <= probability <= 1.0:
        raise LayoutError(f"has a figure {path} whose interval ends before it begins, or has no probability")
    return Interval(value, low, high, float(probability))


class _Texts(Mapping[str, str]):
    """Texts of the figures of a file, read when the first is asked for; raises InputError where the file is gone."""

    def __init__(self, figures: Collection[str], read: Callable[[], Mapping[str, str]]) -> None:
        self._figures, self._read = figures, read

    def __getitem__(self, figure: str) -> str:
        return self._read()[figure]

    def __iter__(self) -> Iterator[str]:
        return iter(self._figures)

    def __len__(self) -> int:
        return len(self._figures)


def _texts_of(nodes: Iterable[tuple[str, DatasetID]]) -> tuple[dict[str, str], dict[str, str]]:
    """Return units and definitions of figures."""
    found = [(key, text(node, "units"), text(node, "definition")) for key, node in nodes]
    return {key: unit for key, unit, _ in found}, {key: about for key, _, about in found}


def _dataset(path: Path, file: h5py.File, name: str) -> Dataset:
    import h5py

    found = part(file, name)
    if not isinstance(found, h5py.h5d.DatasetID):
        if reason := left_out(name, str(attribute(file, "series") or KEPT_SERIES[0])):
            raise SeriesLeftOut(path, reason)
        raise InputError(f"{path}: holds no dataset {name}; its groups are {', '.join(file)}.")
    node = h5py.Dataset(found)
    scales = list(_scales_of(node, name))
    check_series(name, node.shape, scales, lambda other: _shape(file, other))
    units, long_name, source = (text(found, key) for key in ("units", "long_name", "source"))
    if not units or not long_name or source not in SOURCES:
        raise LayoutError(f"has a dataset {name} without units, long_name or a source among {', '.join(SOURCES)}")
    dims = tuple(scale.rpartition("/")[2] for scale, _ in scales)
    values = values_of(found, name)
    check_values(name, values)
    if isinstance(values, np.ndarray) and values.dtype == np.float32:
        values = values.astype(np.float64)
    return Dataset(values, units, long_name, source, dims)  # type: ignore[arg-type]


def _shape(file: h5py.File, path: str) -> tuple[int, ...] | None:
    """Return the shape of a dataset, None where there is none."""
    import h5py

    node = part(file, path)
    return tuple(node.shape) if isinstance(node, h5py.h5d.DatasetID) else None


def _scales_of(node: h5py.Dataset, path: str) -> Iterator[tuple[str, int]]:
    """Yield path and length of the scale of each axis that has one; raises LayoutError for a scale that was removed."""
    for axis in node.dims:
        if len(axis):
            name = _beside(axis[0], node) or axis[0].name
            if name is None:  # attached, but in no group any more
                raise LayoutError(f"has lost the scale of {path}")
            yield name, axis[0].size


def _beside(scale: h5py.Dataset, node: h5py.Dataset) -> str | None:
    """Return the path of a scale in the group of its dataset, as rths writes it, None where it is not there.

    HDF5 names an object that was reached by a reference only after a search of the whole file.
    """
    from h5py import h5ds, h5o

    group, label = node.parent, h5ds.get_scale_name(scale.id) or b""
    if not label or label not in group.id or h5o.get_info(group.id, label).addr != h5o.get_info(scale.id).addr:
        return None
    return f"{group.name.rstrip('/')}/{label.decode()}"


WANTED = Wanted(
    "result file as rths run writes it", "is not an HDF5 file; give a result file written by rths run.",
    "run the case again.",
)  # fmt: skip


def _reading(path: Path, read: Callable[[h5py.File], T]) -> T:
    """Apply `read` to an open, checked result file; every fault of the file is an InputError."""
    if path.suffix in (".yaml", ".yml"):
        raise InputError(f"{path}: is a YAML file, not a result; rths run {path} makes a result of a case.")
    with opened(path, WANTED) as file:
        _check_format(path, file)
        return read(file)


def _check_format(path: Path, file: h5py.File) -> None:
    form = attribute(file, "format")
    if form == "rths-sweep":
        raise InputError(f"{path}: holds a sweep; rths sweep with the same options and --resume shows it.")
    if form != FORMAT:
        raise InputError(f"{path}: is not a result file of rths (no attribute format = {FORMAT}).")
    if attribute(file, "status") is None:
        raise InputError(f"{path}: does not say how its run ended (no attribute status); {advice(file, WANTED)}")
    version = int(attribute(file, "format_version") or 0)
    if version > FORMAT_VERSION:
        raise InputError(f"{path}: has format version {version}, this rths reads up to {FORMAT_VERSION}; update rths.")
