"""Recognise the format of a measured file by its content and read it."""

from __future__ import annotations

import io
import logging
import logging.handlers
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.matlab_files import is_matlab, variables_read_here
from rths_cli.files.measured_data.hdf5_files import hdf5_contents
from rths_cli.files.measured_data.named_variables import Variable, contents_of, matlab_contents
from rths_cli.files.measured_data.recording import Column, Contents, listed
from rths_cli.files.measured_data.text_tables import text_contents
from rths_cli.files.measured_data.units import abscissa_factor
from rths_cli.files.measured_data.universal_files import is_universal, universal_contents
from rths_cli.files.sandboxed_reading import read_in_copy
from rths_cli.safe_text import shortened, visible

READ = "CSV or text, MATLAB .mat, HDF5, TDMS, LabVIEW .lvm, universal file 58 or .npz"
_TDMS_SCALES = (
    "Linear", "Polynomial", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract", "AdvancedAPI",
)  # fmt: skip
_SOURCE = re.compile(r"NI_Scale\[\d+\]_\w+_Input_Source")
_RAW = 0xFFFFFFFF  # TDMS's number of the samples as they are stored
_SCALE_TYPE = re.compile(r"NI_Scale\[\d+\]_Scale_Type")
_LARGEST_UNPACKED = 1_000_000_000  # bytes
_HDF5 = b"\x89HDF\r\n\x1a\n"
_OTHERS = {
    b"TDSh": "is the index of a TDMS file; give the .tdms file beside it",
    b"\xd0\xcf\x11\xe0": "is an old Excel workbook (or another Office file); save the sheet as CSV",
    b"\x1f\x8b": "is a gzip archive; unpack it",
    b"7z\xbc\xaf\x27\x1c": "is a 7z archive; unpack it",
    b"\x93NUMPY": "is a NumPy array, which names no channels; save CSV or HDF5",
    b"%PDF": "is a PDF document; export the figures as CSV",
    b"MDF  ": "is an ASAM MDF file; export it as .mat or CSV",
    b"# Created by Octave": "is an Octave text file; save it with: save -v7 FILE.mat",
}


def is_recorded(data: bytes) -> bool:
    """Say whether bytes are of a format that only recorders and controllers write: all but plain tables of text."""
    labview = data.removeprefix(b"\xef\xbb\xbf").startswith(b"LabVIEW Measurement")
    return (
        labview or _is_npz(data) or is_universal(data) or _is_hdf5(data) or data.startswith(b"TDSm") or is_matlab(data)
    )


def _is_hdf5(data: bytes) -> bool:
    return any(data.startswith(_HDF5, offset) for offset in (0, 512, 1024, 2048, 4096))


def read_contents(path: Path, data: bytes) -> Contents:
    """Return what a file with these bytes holds; raise InputError, which says what it is, where it cannot be read."""
    if not data:
        raise InputError(f"{path}: is empty; give measured time histories: {READ}")
    for magic, what in _OTHERS.items():
        if data.startswith(magic):
            raise InputError(f"{path}: {what}")
    if _is_npz(data):
        return _guarded(path, "NumPy", data)
    if is_universal(data):
        return universal_contents(path, data)
    if data.startswith(b"PK\x03\x04"):
        raise InputError(f"{path}: {_zip_kind(data)}")
    if _is_hdf5(data):
        return _guarded(path, "HDF5", data)
    if data.startswith(b"TDSm"):
        return _guarded(path, "TDMS", data)
    if is_matlab(data):
        return _guarded(path, "MATLAB", data)
    return text_contents(path, _decode(path, data))


def _is_npz(data: bytes) -> bool:
    """Return whether a zip archive holds arrays, by the name of its first file: samples may be any bytes."""
    head = 30 + max(int.from_bytes(data[26:28], "little"), 32)
    return data.startswith(b"PK\x03\x04") and b".npy" in data[:head]


def _zip_kind(data: bytes) -> str:
    """Return what a zip archive is and what to do."""
    if b"xl/" in data:
        return "is an Excel workbook; save the sheet as CSV"
    return "is a zip archive; unpack it and give the file inside"


def _decode(path: Path, data: bytes) -> str:
    """Return a text; raise InputError for bytes that are none."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    for place, coding in ((1, "utf-16-le"), (0, "utf-16-be")):  # without its mark
        upper = data[place:2000:2]
        if len(data) % 2 == 0 and upper.count(0) > 0.9 * len(upper) and 0 not in data[1 - place : 2000 : 2]:
            return data.decode(coding, errors="replace")
    if data.translate(None, bytes(range(32, 256)) + b"\t\n\r\f"):
        raise InputError(f"{path}: is a binary file of unknown kind; give {READ}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _guarded(path: Path, kind: str, data: bytes) -> Contents:
    """Read a binary format in a copy of this process; a file on which its library fails becomes one InputError."""
    reader = {"HDF5": _hdf5, "TDMS": _tdms, "MATLAB": _matlab, "NumPy": _numpy}[kind]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            contents = read_in_copy(lambda: reader(path, data))
            return replace(contents, format=contents.format or kind)
    except ValueError as error:
        raise InputError(
            f"{path}: is a damaged or truncated {kind} file and cannot be read; export it again"
        ) from error


def _hdf5(path: Path, _: bytes) -> Contents:
    """Return the contents of an HDF5 file."""
    return hdf5_contents(path)


def _matlab(path: Path, _: bytes) -> Contents:
    """Return the contents of a MATLAB file up to version 7."""
    return matlab_contents(path, variables_read_here(path))


def _numpy(path: Path, data: bytes) -> Contents:
    """Return the contents of a NumPy archive (.npz): each array by its name; pickled ones are not used."""
    variables: dict[str, Variable] = {}
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        if sum(entry.file_size for entry in archive.zip.infolist()) > _LARGEST_UNPACKED:
            raise InputError(f"{path}: unpacks to more than {_LARGEST_UNPACKED / 1e9:g} GB; save fewer arrays")
        for name in archive.files:
            try:
                array = archive[name]
            except ValueError:  # pickled
                variables[name] = Variable(None)
                continue
            texts = [str(text) for text in array.reshape(-1)] if array.dtype.kind in "US" else None
            variables[name] = Variable(array if array.dtype.kind in "iuf" else texts)
    return contents_of(path, variables)


def _tdms(path: Path, data: bytes) -> Contents:
    """Return the contents of a TDMS file."""
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise InputError(
            f'{path}: is a TDMS file, for which a reader is missing; install it: pip install "rths-cli[tdms]"'
        ) from None
    with _quiet("nptdms") as complaints:
        file = TdmsFile.read(io.BytesIO(data), raw_timestamps=True)
        _refuse_unknown_scalings(path, file)
        _take_plain_samples_as_raw(file)
        channels = [(channel, np.asarray(channel[:])) for group in file.groups() for channel in group.channels()]
    names = [channel.name for channel, _ in channels]
    times = [getattr(channel.properties.get("wf_start_time"), "seconds", 0) for channel, _ in channels]
    epoch_s = max(times, default=0)
    columns, intervals, ignored = [], [], []
    for channel, values in channels:
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        if values.dtype.kind not in "iuf" or values.size == 0:
            ignored.append(name)
            continue
        stated = {**file.properties, **file[channel.group_name].properties, **channel.properties}
        unit = str(stated.get("unit_string", "") or stated.get("NI_UnitDescription", ""))
        factor = abscissa_factor(f"{path}: {name}", str(stated.get("wf_xunit_string", "")))
        column = Column(name, values.astype(np.float64), unit, _tdms_start(stated, epoch_s, factor))
        if "wf_increment" in stated:
            intervals.append((f"wf_increment of {name}", factor * float(stated["wf_increment"])))
            column = replace(column, dt_s=intervals[-1][1])
        columns.append(column)
    if not columns:
        raise InputError(f"{path}: holds no channel of numbers; give a TDMS file with measured channels")
    if (
        len({step for _, step in intervals}) > 1
        and len(intervals) == len(columns)
        and min(s for _, s in intervals) > 0.0
    ):
        intervals = [max(intervals, key=lambda stated: stated[1])]  # the slowest rate, to which the others are brought
    notes = [f"not used, because they are no series: {listed(ignored)}"] if ignored else []
    notes += [f"the TDMS file is damaged ({complaint}); what could be read is used" for complaint in complaints[:1]]
    return Contents(tuple(columns), tuple(intervals), tuple(notes))


def _tdms_start(stated: Mapping[str, Any], epoch_s: int, factor: float) -> float | None:
    """Return the start of a channel in s after `epoch_s`: its start time and start offset, whose unit is `factor` s;
    None for a channel without a start time beside others that have one (`epoch_s` is 0 where none has: then offsets
    alone count)."""
    time, offset = stated.get("wf_start_time"), factor * float(stated.get("wf_start_offset", 0.0))
    seconds = getattr(time, "seconds", 0)  # 0: LabVIEW writes it where the start is not known
    if not seconds:
        return None if epoch_s else offset
    return (seconds - epoch_s) + getattr(time, "second_fractions", 0) * 2.0**-64 + offset


def _refuse_unknown_scalings(path: Path, file: Any) -> None:
    """Raise InputError for channels whose scaling the library does not know and would leave out without a word."""
    faults = []
    for channel in (channel for group in file.groups() for channel in group.channels()):
        for stated in (channel.properties, file[channel.group_name].properties, file.properties):
            kinds = {key: str(stated[key]) for key in stated if _SCALE_TYPE.fullmatch(key)}
            if not kinds:
                continue
            unknown = sorted({kind for kind in kinds.values() if kind not in _TDMS_SCALES})
            if unknown and stated.get("NI_Scaling_Status", "unscaled") != "scaled":
                faults.append(
                    f"{path}: channel {channel.name!r} is stored unscaled, with a scaling of the kind "
                    f"{', '.join(unknown)} that is not known here ({', '.join(_TDMS_SCALES)} are); export it scaled"
                )
            break
    if faults:
        raise InputError(*faults)


def _take_plain_samples_as_raw(file: Any) -> None:
    """State the plain samples as source of scalings whose source is the DAQmx scaler 0: files that were written again
    keep the properties of DAQmx, without its kind of samples, on which the library fails."""
    for channel in (channel for group in file.groups() for channel in group.channels()):
        stated = channel.properties
        if channel.data_type.__name__ != "DaqMxRawData" and "NI_Scale[0]_Scale_Type" not in stated:
            stated.update(dict.fromkeys((k for k, v in stated.items() if _SOURCE.fullmatch(k) and v == 0), _RAW))


@contextmanager
def _quiet(name: str) -> Iterator[list[str]]:
    """Collect the warnings that a library logs, so that they become notes; each of its modules has a logger."""
    handler = logging.handlers.BufferingHandler(1_000_000)
    names = [name, *(other for other in logging.root.manager.loggerDict if other.startswith(f"{name}."))]
    before = [(logger := logging.getLogger(one), logger.handlers, logger.propagate) for one in names]
    complaints: list[str] = []
    for logger, _, _ in before:
        logger.handlers, logger.propagate = [handler], False
    try:
        yield complaints
    finally:
        complaints += [visible(shortened(record.getMessage())) for record in handler.buffer]
        for logger, handlers, propagate in before:
            logger.handlers, logger.propagate = handlers, propagate
