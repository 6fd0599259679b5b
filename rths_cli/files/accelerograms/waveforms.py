"""SAC and miniSEED files through obspy, where it is installed; their figures have the unit that the case states."""

from __future__ import annotations

import io
import math
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.accelerograms.record import Channel, Header, Stated, check_moves, component_names

_MINISEED = re.compile(rb"\d{6}[DRQM] ")
_MINISEED_3 = re.compile(rb"MS\x03")
_SAC_VERSION_AT = 304  # byte of the header's number 76
_SAC_VERSIONS = (6, 7)
_SAC_HEADER = 632
_SAC_UNKNOWN = -12345.0


def kind_of(data: bytes) -> str:
    """Return `miniSEED` or `SAC` for data of that format, "" for any other."""
    if _MINISEED.match(data) or _MINISEED_3.match(data):
        return "miniSEED"
    if len(data) > _SAC_HEADER:
        found = {struct.unpack_from(order + "i", data, _SAC_VERSION_AT)[0] for order in "<>"}
        if found & set(_SAC_VERSIONS):
            return "SAC"
    return ""


def read(path: Path, data: bytes, kind: str) -> list[Channel]:
    """Return the channels of a SAC or miniSEED file, their unit not stated.

    Raises InputError without obspy, for data that it cannot read, for gaps, and for a SAC peak that contradicts.
    """
    try:
        import obspy
    except ImportError:
        raise InputError(
            f"{path}: is a {kind} file; install obspy to read it (pip install 'rths-cli[obspy]'), or convert it to CSV "
            "(time_s,accel_m_s2)"
        ) from None
    try:
        stream = obspy.read(io.BytesIO(data), format="MSEED" if kind == "miniSEED" else "SAC")
        stream.merge()
    except Exception as error:  # of any kind: obspy does not say which
        raise InputError(
            f"{path}: cannot be read as {kind} ({' '.join(str(error).split())[:80]}); take it from its source again"
        ) from error
    return [_channel(path, trace, kind) for trace in stream]


def _channel(path: Path, trace: Any, kind: str) -> Channel:
    stats = trace.stats
    if isinstance(trace.data, np.ma.MaskedArray):
        missing = int(np.ma.getmaskarray(trace.data).sum())
        raise InputError(f"{path}: {trace.id} has gaps of {missing} samples; mend the record, or cut it at the gap")
    figures = np.asarray(trace.data, dtype=float)
    if not np.isfinite(figures).all() or not math.isfinite(stats.delta):
        raise InputError(f"{path}: {trace.id} holds values that are not finite; mend or cut the record")
    check_moves(path, figures)
    header = Header(
        kind, title=f"{trace.id}, {stats.starttime}", dt_s=float(f"{stats.delta:.9g}"), samples=figures.size
    )
    stated = None
    if kind == "SAC":
        ends = [
            abs(float(stats.sac[key]))
            for key in ("depmin", "depmax")
            if stats.sac.get(key, _SAC_UNKNOWN) != _SAC_UNKNOWN
        ]
        stated = Stated(max(ends), 0.0, 0) if len(ends) == 2 and max(ends) > 0.0 else None
    names = component_names(stats.channel) if stats.channel else ()
    return Channel(header, figures, lambda _: 0, f"{stats.network}.{stats.station}".strip("."), names, "", stated)
