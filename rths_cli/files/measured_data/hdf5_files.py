"""Measured time histories in HDF5: the project's own form, MATLAB v7.3 files, and any file of series."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import make_folder, part_of, publish, stamp
from rths_cli.files.hdf5 import Dataset, write_group
from rths_cli.files.hdf5_opening import RESTORE, Wanted, opened
from rths_cli.files.hdf5_safety import LayoutError, held, part, values_of
from rths_cli.files.matlab_files import MatlabObject, Value, hdf5_value, series
from rths_cli.files.measured_data.controller_logs import logs_of
from rths_cli.files.measured_data.named_variables import Variable, contents_beside_objects
from rths_cli.files.measured_data.recording import (
    Column,
    Contents,
    Recording,
    numbers_of,
    stated_interval,
    states_start,
)
from rths_cli.files.result_writer import refusal
from rths_cli.files.staged_file import new_hdf5

if TYPE_CHECKING:
    import h5py

FORMAT = "rths-recording"
FORMAT_VERSION = 1
_UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit", "UNITS", "unit_string")
_DIMENSION = "This is a netCDF dimension but not a netCDF variable"  # netCDF4's NAME of a dataset without figures
_DEEPEST = 8
RECORDING = Wanted("file of measured time histories", "is not an HDF5 file; give measured time histories", RESTORE)


def write_recording(path: Path, recording: Recording) -> Path:
    """Write a recording to HDF5 so that `read_recording` returns names, units, interval, samples, notes bit for bit.

    The file appears under its name only when it is whole. It replaces an empty file at most: where another one has that
    name, it gets the next free one. Returns the name; raises InputError where the disk refuses.
    """
    path = Path(path)
    part = part_of(path)
    empty = stamp(path) if path.is_file() and path.stat().st_size == 0 else None
    try:
        make_folder(path.parent)
        with new_hdf5(part) as file:
            _fill(file, recording)
        return publish(part, path, empty)
    except (OSError, RuntimeError) as error:
        sentence = refusal(path, "cannot write the recording", error, advice=False)
        raise InputError(f"{sentence.rstrip('.')}; free space or choose another name") from error
    finally:
        with suppress(OSError):
            part.unlink()


def _fill(file: h5py.File, recording: Recording) -> None:
    """Write attributes, samples (c, n) with their scales, names and units."""
    count, length = recording.samples.shape
    file.attrs.update({"format": FORMAT, "format_version": FORMAT_VERSION, "dt_s": recording.dt_s})
    file.attrs["notes"] = json.dumps(recording.notes)
    scales = {
        "time_s": Dataset(np.arange(length) * recording.dt_s, "s", "time since the first sample", "computed"),
        "channel": Dataset(np.arange(1, count + 1), "1", "channel, counted from 1", "computed"),
    }
    datasets = {
        "samples": Dataset(recording.samples, "as in units", "measured samples", "measured", ("channel", "time_s")),
        "names": Dataset(np.array(recording.names, object).astype(str), "1", "channel names", "measured", ("channel",)),
        "units": Dataset(np.array(recording.units, object).astype(str), "1", "channel units", "measured", ("channel",)),
    }
    write_group(file, datasets, scales)


def hdf5_contents(path: Path) -> Contents:
    """Return what an HDF5 file holds; raise InputError for the project's other files and files without series."""
    with opened(path, RECORDING) as file:
        kind = _text(_held(file, "format", ""))
        if kind == FORMAT:
            return _own(path, file)
        if kind.startswith("rths-"):
            raise InputError(f"{path}: is a file of rths ({kind}), not a recording; give measured time histories")
        matlab = _structures_and_objects(file)
        if matlab and (logs := logs_of(path, matlab)) is not None:
            return logs
        variables = _by_channel_table(dict(_variables(path, file, file)))
        root = {f"attributes/{key}": Variable(np.asarray(value)) for key, value in _rates(file).items()}
        return contents_beside_objects(path, variables | root, matlab)


def _by_channel_table(variables: dict[str, Variable]) -> dict[str, Variable]:
    """Return the variables of a Rattlesnake file with its channels' names: the comments where each channel has its own,
    else node and direction; other variables as they are. Source: its channel table, one text per channel and column.
    """
    table = {key: v.value for key, v in variables.items() if key.startswith("channels/") and isinstance(v.value, list)}
    nodes = table.get("channels/node_number")
    if "time_data" not in variables or nodes is None:
        return variables
    directions = table.get("channels/node_direction", [""] * len(nodes))
    comments = [text.strip() for text in table.get("channels/comment", [])]
    unique = len(comments) == len(nodes) and all(comments) and len(set(comments)) == len(comments)
    names = comments if unique else [f"{n.strip()} {d.strip()}".strip() for n, d in zip(nodes, directions, strict=True)]
    units = {"channels/unit": variables["channels/unit"]} if "channels/unit" in variables else {}
    others = {key: v for key, v in variables.items() if not key.startswith("channels/")}
    return {**others, "channels/names": Variable(names), **units}


def _structures_and_objects(file: h5py.File) -> dict[str, Value]:
    """Return the structures and the objects of a MATLAB 7.3 file by name."""
    classes = {name: _text(_held(node, "MATLAB_class", "")) for name, node in file.items()}
    objects = {name for name, node in file.items() if "MATLAB_object_decode" in node.attrs}
    return {
        name: MatlabObject(kind) if name in objects else hdf5_value(file, file[name])
        for name, kind in classes.items()
        if kind == "struct" or name in objects
    }


def _own(path: Path, file: h5py.File) -> Contents:
    """Return the contents of the project's own form."""
    version = int(held(file, "format_version"))
    if version > FORMAT_VERSION:
        raise InputError(f"{path}: has format version {version}, this rths reads up to {FORMAT_VERSION}; update rths")
    read = {name: values_of(part(file, name), name, any_number=True) for name in ("samples", "names", "units")}
    samples, names, units = np.asarray(read["samples"], dtype=np.float64), read["names"], read["units"]
    if samples.ndim != 2 or any(np.shape(texts) != (len(samples),) for texts in (names, units)):
        raise InputError(
            f"{path}: has not a row of samples, a name and a unit for each channel; record or convert again"
        )
    columns = tuple(Column(str(n), row, str(u)) for n, row, u in zip(names, samples, units, strict=True))
    notes = tuple(str(note) for note in json.loads(_text(held(file, "notes"))))
    return Contents(columns, (("dt_s", float(held(file, "dt_s"))),), notes, exact=True, format="recording of rths")


def _variables(path: Path, file: h5py.File, group: h5py.Group, prefix: str = "") -> Iterator[tuple[str, Variable]]:
    """Yield every dataset below a group by its path, without MATLAB's hidden ones."""
    import h5py

    for name in group:
        node = group.get(name)
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        if isinstance(node, h5py.Group):
            if prefix.count("/") < _DEEPEST:
                yield from _variables(path, file, node, f"{prefix}{name}/")
        elif isinstance(node, h5py.Dataset) and not _text(_held(node, "NAME", "")).startswith(_DIMENSION):
            yield f"{prefix}{name}", _variable(path, file, node)


def _variable(path: Path, file: h5py.File, node: h5py.Dataset) -> Variable:
    """Return numbers, texts or neither from a dataset, with the unit and rate its attributes state."""
    import h5py

    kind = _text(_held(node, "MATLAB_class", ""))
    unit = next((_text(_held(node, key, "")) for key in _UNIT_ATTRIBUTES if key in node.attrs), "")
    if node.shape is None or _held(node, "MATLAB_empty", 0) or "MATLAB_object_decode" in node.attrs:
        return Variable(None)
    if kind in ("cell", "char") or h5py.check_ref_dtype(node.dtype) is h5py.Reference:
        texts = series(hdf5_value(file, node))
        return Variable(texts if isinstance(texts, list) else None)
    if h5py.check_string_dtype(node.dtype) is not None:
        return Variable([str(text) for text in np.atleast_1d(node.asstr()[()]).reshape(-1)])
    numeric = node.dtype.kind in "iuf" and kind != "logical"
    return Variable(np.asarray(node[()]) if numeric else None, unit, _rates(node), _starts(node))


def _rates(node: h5py.HLObject) -> dict[str, float]:
    """Return the attributes that state a rate or an interval."""
    stating = [name for name in node.attrs if stated_interval(name, 1.0) is not None]
    numbers = {name: np.asarray(_held(node, name, np.nan)).reshape(-1) for name in stating}
    return {key: float(v[0]) for key, v in numbers.items() if v.size == 1 and v.dtype.kind in "iuf"}


def _starts(node: h5py.HLObject) -> tuple[float, ...]:
    """Return the starts in s that attributes state, one or one per channel, () where none does."""
    stated = [numbers_of(_plain(_held(node, name, None))) for name in node.attrs if states_start(name)]
    return next((starts for starts in stated if starts), ())


def _plain(value: Any) -> Any:
    """Return an attribute's single text as text."""
    return _text(value) if isinstance(value, bytes | str) or np.asarray(value).dtype.kind in "SUO" else value


def _held(node: h5py.HLObject, name: str, otherwise: Any) -> Any:
    """Return what an attribute holds; `otherwise` where there is none, or one of neither texts nor numbers."""
    try:
        return held(node, name) if name in node.attrs else otherwise
    except LayoutError:
        return otherwise


def _text(value: Any) -> str:
    """Return an HDF5 attribute as text."""
    plain = value.reshape(-1)[0] if isinstance(value, np.ndarray) and value.size else value
    return plain.decode(errors="replace") if isinstance(plain, bytes) else str(plain)
