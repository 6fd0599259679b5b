"""SAC and miniSEED files through obspy, where it is installed; their figures have the unit that the case states."""

from __future__ import annotations

import io
import math
import re
import struct
import warnings
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.accelerograms.record import Channel, Header, Stated, check_moves, component_names
from rths_cli.files.sandboxed_reading import read_in_copy
from rths_cli.numerics.lti import Array

_MINISEED = re.compile(rb"\d{6}[DRQMV] ")  # V: a full SEED file, whose waveforms are read as miniSEED
_MINISEED_3 = re.compile(rb"MS\x03")
_SAC_VERSION_AT = 304  # byte of the header's number 76
_SAC_VERSIONS = (6, 7)
_SAC_HEADER = 632
_OBSPY = {"miniSEED": "MSEED", "SAC": "SAC", "SAC text": "SACXY"}
_SAC_UNKNOWN = -12345.0
_OVERLAP = "has pieces that overlap and differ there; keep one of them, or cut the others"
_NO_ACCELERATIONS = {6: "displacement", 7: "velocity"}  # IDISP and IVEL of SAC's header


def kind_of(data: bytes) -> str:
    """Return `miniSEED`, `SAC` or `SAC text` for data of that format, "" for any other."""
    if _MINISEED.match(data) or _MINISEED_3.match(data):
        return "miniSEED"
    if _is_sac_text(data[:2000].split(b"\n")):
        return "SAC text"
    if len(data) > _SAC_HEADER:
        found = {struct.unpack_from(order + "i", data, _SAC_VERSION_AT)[0] for order in "<>"}
        if found & set(_SAC_VERSIONS):
            return "SAC"
    return ""


def _is_sac_text(lines: list[bytes]) -> bool:
    """Return whether lines are a SAC header in text: 14 of 5 reals, 8 of 5 integers, their seventh the version."""
    words = [line.split() for line in lines[:22]]
    return len(words) == 22 and all(len(row) == 5 for row in words) and words[15][1] in (b"6", b"7")


@dataclass(frozen=True)
class _Trace:
    """One trace of a file as obspy reads it: figures (n,), how many of them are missing, and what its header states."""

    name: str
    station: str
    channel: str
    dt_s: float
    figures: Array
    missing: int
    peak: float | None
    fault: str  # why it cannot be taken, "" where it may be


def read(path: Path, data: bytes, kind: str) -> list[Channel]:
    """Return the channels of a SAC or miniSEED file, their unit not stated.

    Raises InputError without obspy, for data that it cannot read, and for gaps.
    """
    if find_spec("obspy") is None:
        raise InputError(
            f"{path}: is a {kind} file; install obspy to read it (pip install 'rths-cli[obspy]'), or convert it to CSV "
            "(time_s,accel_m_s2)"
        )
    try:
        traces = read_in_copy(lambda: _traces(path, data, kind))
    except ValueError:
        raise InputError(
            f"{path}: cannot be read as {kind}; it is cut or damaged, take it from its source again"
        ) from None
    return [_channel(path, trace, kind) for trace in traces]


def _traces(path: Path, data: bytes, kind: str) -> list[_Trace]:
    """Return the traces of a file, those of one channel joined; raises InputError where their rates differ."""
    import obspy

    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        stream = obspy.read(io.BytesIO(data), format=_OBSPY[kind])
        cut = kind == "miniSEED" and _ends_cut(data)
    if cut or any("skip" in str(each.message) for each in warned):
        raise ValueError  # obspy leaves such pieces out
    for name in sorted({trace.id for trace in stream}):
        rates = sorted({float(trace.stats.sampling_rate) for trace in stream if trace.id == name})
        if len(rates) > 1:
            told = " and ".join(f"{rate:g}" for rate in rates)
            raise InputError(f"{path}: {name} has pieces at {told} Hz; give those of one rate in a file of their own")
    twice = {".".join(gap[:4]) for gap in stream.get_gaps() if gap[7] < 0}  # a negative number of missing samples
    stream.merge()
    return [_trace(each, each.id in twice) for each in stream]


def _ends_cut(data: bytes) -> bool:
    """Return whether miniSEED data end within a record."""
    from obspy.io.mseed.util import get_record_information

    if data.startswith(b"MS"):
        return False
    rest = len(data) % int(get_record_information(io.BytesIO(data))["record_length"])
    return rest > 0 and int(get_record_information(io.BytesIO(data[-rest:]))["record_length"]) > rest


def _trace(trace: Any, twice: bool) -> _Trace:
    stats, known = trace.stats, trace.stats.get("sac", {})
    kind = _NO_ACCELERATIONS.get(int(known.get("idep", 0)))
    missing = int(np.ma.getmaskarray(trace.data).sum())
    ends = [abs(float(known[key])) for key in ("depmin", "depmax") if known.get(key, _SAC_UNKNOWN) != _SAC_UNKNOWN]
    return _Trace(
        f"{trace.id}, {stats.starttime}",
        f"{stats.network}.{stats.station}".strip("."),
        stats.channel,
        float(f"{stats.delta:.9g}"),
        np.asarray(np.ma.getdata(trace.data), dtype=float),
        missing,
        max(ends) if len(ends) == 2 and max(ends) > 0.0 else None,
        f"is a record of {kind} (idep); give the acceleration record"
        if kind
        else _OVERLAP
        if twice and missing
        else "",
    )


def _channel(path: Path, trace: _Trace, kind: str) -> Channel:
    if trace.fault:
        raise InputError(f"{path}: {trace.name} {trace.fault}")
    if trace.missing:
        raise InputError(
            f"{path}: {trace.name} has gaps of {trace.missing} samples; mend the record, or cut it at the gap"
        )
    if not np.isfinite(trace.figures).all() or not math.isfinite(trace.dt_s):
        raise InputError(f"{path}: {trace.name} holds values that are not finite; mend or cut the record")
    check_moves(path, trace.figures)
    header = Header(kind, title=trace.name, dt_s=trace.dt_s, samples=trace.figures.size)
    names = component_names(trace.channel) if trace.channel else ()
    stated = None if trace.peak is None else Stated(trace.peak, 0.0, 0)
    return Channel(header, trace.figures, lambda _: 0, trace.station, names, "", stated)
