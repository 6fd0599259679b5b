"""Read result files, complete or not, of this version and of earlier ones."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.errors import InputError
from rths_cli.files.hdf5 import INTERVAL, SOURCES, Dataset, datasets, numbers, text
from rths_cli.files.hdf5_opening import RESTORE, VIRTUAL, Wanted, advice, opened
from rths_cli.files.hdf5_safety import (
    LARGEST,
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
from rths_cli.files.result_writer import FORMAT, FORMAT_VERSION, Attribute, ResultWriter, Status, check_writable
from rths_cli.numerics.bands import COMPARED_HZ, TEST_BAND_HZ, ComparedBand
from rths_cli.numerics.lti import Array
from rths_cli.quantities import ATTRIBUTES, AXES, LATENCIES, AttributeDeclaration, Interval, metric, stored_dataset
from rths_cli.quantities.datasets import KEPT_SERIES, SOLUTIONS, of_a_run
from rths_cli.quantities.declaration import RISING, SAMPLED

if TYPE_CHECKING:
    import h5py
    from h5py.h5d import DatasetID

MATRICES = ("A", "B", "C", "D")
SUMS = ("total", "compensated", "left", "predicted", "declared")
TOGETHER = {
    "latency.total_s": (
        "latency.frequency_hz",
        *(f"latency.{name}_s" for name in (*LATENCIES, *SUMS)),
        *(f"latency.{name}_left_s" for name in LATENCIES),
    ),
    "latency.identified_s": ("latency.identified_error_s",),
    "budget.rms_error_coupling_m_s2": ("budget.table_gain_error", "budget.table_delay_error_s", "budget.friction_v"),
}
"""Figures without which the one that names them says nothing."""

T = TypeVar("T")
BEGUN, COMPLETE = "begun", "complete"  # of one run on the table, in the attribute RUN_status of the root
WANTED = Wanted(
    "result file as rths run writes it", "is not an HDF5 file; give a result file written by rths run.",
    "run the case again.",
)  # fmt: skip


def check_attributes(found: Mapping[str, str | int | float]) -> None:
    """Raise LayoutError for an attribute of the root of another type or beyond its range."""
    for name, value in found.items():
        if (declared := ATTRIBUTES.get(name)) is not None:
            _check_attribute(declared, value)
    _check_figures(str(found.get("reference_json") or "{}"))
    _json_mapping("package_versions", str(found.get("package_versions") or "{}"))


def _check_attribute(declared: AttributeDeclaration, value: str | int | float) -> None:
    """Raise LayoutError for an attribute of another kind than declared, or beyond its limits."""
    name, limits = declared.name, declared.limits
    if declared.kind == "text":
        if not isinstance(value, str):
            raise LayoutError(f"has the attribute {name} = {value}, which must be a text")
        if limits and value not in limits:
            raise LayoutError(f"has the {name} {value[:40]!r}, which is none of {', '.join(map(str, limits))}")
        return
    low, high = limits or (-LARGEST, LARGEST)
    if isinstance(value, str) or not low <= value <= high:  # type: ignore[operator]
        raise LayoutError(f"has the attribute {name} = {str(value)[:40]!r}, which must be {low:g} to {high:g}")


def check_series(
    path: str,
    shape: Sequence[int],
    scales: Sequence[tuple[str, int]],
    shape_of: Callable[[str], tuple[int, ...] | None],
) -> None:
    """Raise LayoutError for a dataset with other axes than declared, or whose scales do not fit it.

    `scales`: path and length of the scale of each axis that has one; `shape_of`: shape of another dataset by its
    path, None where there is none.
    """
    group = path.rpartition("/")[0]
    if scales and tuple(length for _, length in scales) != tuple(shape):
        raise LayoutError(f"has scales of other lengths than {path}")
    if any(scale.rpartition("/")[2] in RISING for scale, _ in scales[:-1]):
        raise LayoutError(f"has the time on another axis than the last one of {path}")
    if group.startswith("controller"):
        _check_block(group, path, shape_of)
    elif not group.startswith("metrics"):
        axes = [scale for scale, _ in scales]
        _check_declared(path, shape, axes)
        _check_runs(path, shape, axes, shape_of)


def check_values(path: str, values: Any) -> None:
    """Raise LayoutError for values that a declared dataset, a scale or a matrix of a block cannot have."""
    group, _, name = path.rpartition("/")
    matrix, declared = group.startswith("controller") and name in MATRICES, stored_dataset(path)
    scale = _is_scale(path)
    if not matrix and not scale and (declared is None or declared.kind == "text"):
        return
    found = np.asarray(values)
    if found.dtype.kind not in "iuf":
        raise LayoutError(f"holds no numbers in {path}")
    sampled = declared is not None and declared.axes[-1:] in [(axis,) for axis in SAMPLED]
    if not sampled and not np.all(np.isfinite(found)):
        raise LayoutError(f"holds a number that is not finite in {path}")
    if scale and name in RISING and np.any(np.diff(found) <= 0.0):
        raise LayoutError(f"holds values that do not rise in {path}")
    if scale and name == "frequency_hz" and np.any(found <= 0.0):
        raise LayoutError(f"holds a frequency that is not positive in {path}")


def figure_fault(figures: Mapping[str, ArrayLike]) -> str:
    """Return what is wrong with the shapes of figures, as a clause about their file; "" where nothing is."""
    sizes: dict[str, tuple[int, str]] = {}
    for path, value in figures.items():
        found = metric(path)
        if found is None:
            continue
        if np.ndim(value) != (1 if found.over else 0):
            wanted = f"one value per {found.over}" if found.over else "one value"
            return f"has a figure {path} of {np.size(value)} values, which must have {wanted}"
        axis = found.over if found.over in ("", "storey") else f"{path.partition('.')[0]}.{found.over}"
        size, first = sizes.setdefault(axis, (np.size(value), path))
        if axis and size != np.size(value):
            return f"has {np.size(value)} values of {path} and {size} of {first}"
    missing = [name for path, names in TOGETHER.items() if path in figures for name in names if name not in figures]
    return f"has no figure {missing[0]}" if missing else ""


def _is_scale(path: str) -> bool:
    """Return whether a path is the scale of an axis, outside /metrics and /controller."""
    group, _, name = path.rpartition("/")
    return name in AXES and stored_dataset(path) is None and not group.startswith(("metrics", "controller"))


def _check_block(group: str, path: str, shape_of: Callable[[str], tuple[int, ...] | None]) -> None:
    """Raise LayoutError where the matrices of a block do not fit each other: A (n, n), B (n, m), C (p, n), D (p, m)."""
    if path.rpartition("/")[2] not in MATRICES:
        return
    shapes = [shape_of(f"{group}/{name}") for name in MATRICES]
    if any(shape is None or len(shape) != 2 for shape in shapes):
        raise LayoutError(f"has not the four matrices of a block in {group}")
    a, b, c, d = shapes
    if not (a and b and c and d) or (*a, b[0], c[1], *d) != (a[0],) * 4 + (c[0], b[1]):
        raise LayoutError(f"has matrices in {group} that do not fit each other")


def _check_declared(path: str, shape: Sequence[int], scales: Sequence[str]) -> None:
    """Raise LayoutError for a dataset or scale with other axes than declared."""
    group, declared = path.rpartition("/")[0], stored_dataset(path)
    if declared is None:
        if _is_scale(path) and len(shape) != 1:
            raise LayoutError(f"has {len(shape)} axes in {path}, which must have 1")
        return
    if len(shape) != len(declared.axes):
        raise LayoutError(f"has {len(shape)} axes in {path}, which must have {len(declared.axes)}")
    for i, axis in enumerate(declared.axes):
        if i >= len(scales) or scales[i].strip("/") != f"{group}/{axis}":
            raise LayoutError(f"has not the scale {axis} of its own group on axis {i} of {path}")


def _check_runs(
    path: str, shape: Sequence[int], scales: Sequence[str], shape_of: Callable[[str], tuple[int, ...] | None]
) -> None:
    """Raise LayoutError where a run has more samples than the record, or other storeys than SIM."""
    run, name, declared = path.partition("/")[0], path.rpartition("/")[2], stored_dataset(path)

    def length_of(other: str) -> int | None:
        return (shape_of(other) or (None,))[0]

    last = declared.axes[-1:] if declared else tuple(scale.rpartition("/")[2] for scale in scales[-1:])
    on_time = last == ("time_s",) or name == "time_s"
    of_run, of_record = length_of(f"{run}/time_s"), length_of("record/time_s")
    if on_time and of_run is not None and shape[-1] != of_run:
        raise LayoutError(f"has {shape[-1]} samples of {path} and {of_run} of {run}/time_s")
    if on_time and of_record is not None and (shape[-1] > of_record or (run in SOLUTIONS and shape[-1] != of_record)):
        raise LayoutError(f"has {shape[-1]} samples of {path} and {of_record} of record/time_s")
    storeys = length_of("sim/storey")
    if declared is not None and declared.axes[:1] == ("storey",) and storeys is not None and shape[0] != storeys:
        raise LayoutError(f"has {shape[0]} storeys of {path} and {storeys} of SIM")


def _check_figures(text: str) -> None:
    """Raise LayoutError for published figures that are not numbers by their paths."""
    for value in _json_mapping("reference_json", text).values():
        items = value if isinstance(value, list) else [value]
        if not all(item is None or _is_number(item) for item in items):
            raise LayoutError("has published figures in reference_json that are no numbers")


def _is_number(item: Any) -> bool:
    return isinstance(item, int | float) and not isinstance(item, bool) and abs(item) <= LARGEST


def _json_mapping(name: str, text: str) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise LayoutError(f"has no JSON in its attribute {name}") from error
    if not isinstance(found, dict):
        raise LayoutError(f"has no JSON mapping in its attribute {name}")
    return found


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


def read_summary(path: Path, figures: Collection[str], about: Collection[str]) -> Result:
    """Read the case, the named metrics and the named attributes alone, in a thirtieth of the time of `read_result`;
    units, definitions and intervals are left out. Raises InputError as `read_result` does."""

    def read(file: h5py.File) -> Result:
        nodes = ((key, part(file, f"metrics/{key.replace('.', '/')}")) for key in figures)
        metrics = {key: _figure(key, node) for key, node in nodes if node is not None}
        yaml, resolved = (_case_text(file, name) for name in ("yaml", "resolved"))
        stated = {name: value for name in about if (value := attribute(file, name)) is not None}
        return Result(Path(path), stated, yaml, resolved, metrics, {}, {}, tuple(file))

    return _reading(Path(path), read)


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
        if "interface_accel" in name and part(file, "exp_rths/interface_disp_desired_m") is not None:
            raise InputError(
                f"{path}: is of a test with an actuator, which measures no accelerations; its figures "
                "and its page are not drawn yet: rths report without --figures and --format html prints its numbers, "
                "rths export its series"
            )
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
