"""Recorded ground accelerations from the files of agencies, laboratories and programs, known by their content.

One module per family: `peer` (.AT2), `knet` (K-NET, KiK-net), `cosmos` (COSMOS, CSMIP), `dyna` (ESM, ITACA),
`waveforms` (SAC, miniSEED), `columns` (CSV, spreadsheets, paths of OpenSees), `recordings` (what recorders and
controllers write: `files.measured_data`); `others` names what is not read.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import FACTORS_M_S2, find_unit
from rths_cli.files.accelerograms import columns, cosmos, dyna, knet, peer, recordings, waveforms
from rths_cli.files.accelerograms.others import is_asdf, named, named_binary
from rths_cli.files.accelerograms.record import (
    Accelerogram,
    Channel,
    check_count,
    check_peak,
    unit_and_interval,
)
from rths_cli.files.durable_files import read_whole
from rths_cli.files.foreign_texts import format_of
from rths_cli.files.measured_data import is_recorded
from rths_cli.safe_text import shortened

__all__ = ["MAX_LINES", "Accelerogram", "find_unit", "read_accelerogram", "read_components"]

MAX_BYTES = 60_000_000
MAX_LINES = 5_000_000
MOST_LISTED = 12


def read_accelerogram(
    path: str | Path, unit: str | None = None, dt_s: float | None = None, component: str | None = None
) -> Accelerogram:
    """Read an accelerogram; `unit` and `dt_s` (in s) state what the file does not say, `component` which one is meant.

    Raises InputError, with file and line, when the file has none of the formats read here, when unit or interval is
    missing, unknown or contradicts the file, for a component that is not in the file or none stated of several, for
    uneven time steps, values not finite, fewer than three samples, a count or peak other than the header's, and a peak
    above 100 m/s^2.
    """
    path, digest, channels = _channels(path, dt_s)
    return _finished(path, digest, _chosen(path, channels, component), unit, dt_s)


def read_components(path: str | Path, unit: str | None = None, dt_s: float | None = None) -> tuple[Accelerogram, ...]:
    """Read every component of a file, in its order; raises InputError as `read_accelerogram` does."""
    path, digest, channels = _channels(path, dt_s)
    return tuple(_finished(path, digest, channel, unit, dt_s) for channel in channels)


def _channels(path: str | Path, dt_s: float | None) -> tuple[Path, str, list[Channel]]:
    """Return a file's path as messages name it, the SHA-256 of its bytes, and its components."""
    path = _from_here(Path(path))
    data = read_whole(path, MAX_BYTES, "an accelerogram", "name an accelerogram file")
    digest = hashlib.sha256(data).hexdigest()
    if kind := waveforms.kind_of(data):
        return path, digest, waveforms.read(path, data, kind)
    if is_recorded(data) and not is_asdf(data):
        return path, digest, recordings.read(path, dt_s)
    if (count := max(data.count(b"\n"), data.count(b"\r"))) > MAX_LINES:
        raise InputError(f"{path}: has {count} lines, the limit is {MAX_LINES}; cut or resample the record")
    lines = _decode(path, data).splitlines()
    if foreign := format_of(lines) or named(lines):
        raise InputError(f"{path}: {foreign}")
    for family in (knet, cosmos, dyna, peer):
        channels = family.read(path, lines)
        if channels is not None:
            return path, digest, channels
    return path, digest, columns.read(path, lines, dt_s)


def _finished(path: Path, digest: str, channel: Channel, unit: str | None, dt_s: float | None) -> Accelerogram:
    """Return a component in m/s^2, checked against its header and what the case states."""
    header = channel.header
    check_count(path, header, channel.figures.size)
    unit_read, interval = unit_and_interval(path, header, unit, dt_s)
    check_peak(path, channel, unit_read)
    return Accelerogram(
        interval,
        np.asarray(channel.figures * FACTORS_M_S2[unit_read]),
        header.title or path.stem,
        header.origin,
        unit_read,
        header.layout,
        digest,
        channel.station,
        channel.component,
        channel.corrected,
    )


def _chosen(path: Path, channels: list[Channel], component: str | None) -> Channel:
    """Return the component that is meant; raises InputError where none or several are."""
    listed = ", ".join(shortened(channel.component, 30) or "unnamed" for channel in channels[:MOST_LISTED])
    if component is None:
        if len(channels) == 1:
            return channels[0]
        raise InputError(
            f"{path}: holds {len(channels)} components ({listed}); state one (record: {{file: {path.name}, component: "
            f"{channels[0].component or '...'}}})"
        )
    wanted = component.strip().casefold()
    deepest = max((len(channel.names) for channel in channels), default=0)
    for depth in range(deepest):
        found = [c for c in channels if len(c.names) > depth and c.names[depth].casefold() == wanted]
        if len(found) == 1:
            return found[0]
    anywhere = [c for c in channels if wanted in (name.casefold() for name in c.names)]
    if len(anywhere) == 1:
        return anywhere[0]
    holds = f"it holds {listed}" if any(channel.names for channel in channels) else "it names no component"
    raise InputError(f"record.component: {path} has no component {shortened(component, 30)!r}; {holds}")


def _from_here(path: Path) -> Path:
    """Return a path as messages name it: relative to the current folder where the file lies below it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _decode(path: Path, data: bytes) -> str:
    """Return the text; headers of old files are not always UTF-8."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    data = data.rstrip(b"\0\x1a \t\r\n")  # the end of a text of DOS
    if data.translate(None, bytes(range(32, 256)) + b"\t\n\r\f"):
        raise InputError(f"{path}: {named_binary(data)}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
